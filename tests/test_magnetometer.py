"""The magnetometer: readers, counts, what an imported capture carries, and the simulated field."""

from __future__ import annotations

import math
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from solenav import capture, importing, mpu9150, replaying
from solenav.datasets import read
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording
from solenav.sim import field
from solenav.sim.imu import IDEAL, SensorErrors
from solenav.sim.scenario import simulate
from solenav_core import messages

Case = tuple[str, str, float, float]
"""Format, file, and between what the field's median lies, µT."""

REAL: list[Case] = [
    ("llio", "llio/SC_11.csv", 40, 50),
    ("llio", "llio/SC_13.csv", 40, 50),
    ("openshoe", "openshoe/Measurement_100521_2_data_inert.txt", 45, 51),
    ("openshoe", "openshoe/Measurement_100521_30_data_inert.txt", 45, 51),
    ("openshoe", "openshoe/Measurement_100521_31_data_inert.txt", 45, 51),
    ("openshoe", "openshoe/Measurement_100521_32_data_inert.txt", 45, 51),
    ("gaitmap", "gaitmap/aligned_data_with_mag_l_walks.csv", 45, 55),
]


def case_id(case: Case) -> str:
    return Path(case[1]).stem


def mag_of(recording: Recording) -> FloatArray:
    assert recording.mag is not None
    return recording.mag


def flagged(samples: replaying.Samples, flag: int) -> NDArray[np.intp]:
    return np.flatnonzero(samples.flags & flag)


# --- readers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", REAL, ids=case_id)
def test_a_real_magnetometer_reads_in_microtesla(data: Path, case: Case) -> None:
    recording = read(data / "foot" / case[1], case[0])
    mag = mag_of(recording)
    assert mag.shape == recording.accel.shape
    missing = np.isnan(mag)
    np.testing.assert_array_equal(missing.any(axis=1), missing.all(axis=1))
    assert missing.mean() == pytest.approx(0.03 if case[0] == "openshoe" else 0.0, abs=0.005)
    median = np.nanmedian(np.linalg.norm(mag, axis=1))
    assert case[2] < median < case[3]


@pytest.mark.parametrize("case", REAL, ids=case_id)
def test_the_magnetometers_axes_are_the_gyros(data: Path, case: Case) -> None:
    """A field that stands still turns, seen from the foot, against the foot's turns."""
    recording = read(data / "foot" / case[1], case[0])
    mag = mag_of(recording)
    known = ~np.isnan(mag).any(axis=1)
    window = round(0.05 * recording.rate_hz)
    field_, rate = (
        moving_mean(columns, window)
        for columns in (filled(recording.time_s, mag, known), recording.gyro)
    )
    # The LORD's magnetometer is late, which costs more than wrong axes of the others would.
    if case[0] == "llio":
        rate = np.roll(rate, round(0.025 * recording.rate_hz), axis=0)
    change = np.gradient(field_, recording.time_s, axis=0)
    misfits = {}
    for axes in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            turn = np.eye(3)[list(axes)] * np.array(signs)[:, None]
            if np.linalg.det(turn) > 0:
                seen, moved = field_ @ turn.T, change @ turn.T
                misfits[axes, signs] = np.square(moved + np.cross(rate, seen))[200:-200].mean()
    assert min(misfits, key=misfits.__getitem__) == ((0, 1, 2), (1, 1, 1))
    rest = sorted(misfits.values())
    assert rest[0] < 0.7 * rest[1]


def moving_mean(columns: FloatArray, window: int) -> FloatArray:
    kernel = np.ones(window) / window
    return np.column_stack([np.convolve(column, kernel, "same") for column in columns.T])


def filled(time_s: FloatArray, mag: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    return np.column_stack([np.interp(time_s, time_s[known], c[known]) for c in mag.T])


def test_recordings_without_a_magnetometer_have_none(data: Path) -> None:
    assert read(data / "foot" / "gaitmap" / "imu_sample.csv", "gaitmap").mag is None
    assert read(data / "foot" / "xio" / "short_walk.csv", "xio").mag is None


def test_the_l_walks_say_that_their_unit_is_a_guess(data: Path) -> None:
    path = data / "foot" / "gaitmap" / "aligned_data_with_mag_l_walks.csv"
    recording = read(path, "gaitmap")
    assert "unit not given" in recording.notes["magnetometer"]
    assert recording.rate_hz == pytest.approx(400.0)
    assert len(recording.time_s) == 100_000
    assert recording.name == path.stem


MAG_HEADER = "scaledMagX,scaledMagY,scaledMagZ"


def export(folder: Path, readings: list[str]) -> Path:
    """A LORD export at rest, z down, with these cells as its magnetometer."""
    kinds = ("Accel", "Gyro", "Mag")
    header = ",".join(["Time", *(f"inertial-1:scaled{k}{axis}" for k in kinds for axis in "XYZ")])
    lines = [header, *(f"{i * 0.005},0,0,-1,0,0,0,{cells}" for i, cells in enumerate(readings))]
    path = folder / "SC_1.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_blank_cell_of_the_magnetometer_is_no_reading(tmp_path: Path) -> None:
    mag = mag_of(read(export(tmp_path, ["0.2,0,0.4", "0.2,,0.4", "0.3,0,0.4"]), "llio"))
    np.testing.assert_allclose(mag[[0, 2]], [[20, 0, 40], [30, 0, 40]])
    assert np.isnan(mag[1]).all()


def test_a_magnetometer_that_never_read_is_none(tmp_path: Path) -> None:
    assert read(export(tmp_path, ["nan,nan,nan"] * 4), "llio").mag is None


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        (["20,0,40"] * 4, "perhaps the file is in another unit"),
        (["0.002,0,0.004"] * 4, "perhaps the file is in another unit"),
        (["0.2,0,0.4", "0.2,inf,0.4", "0.2,0,0.4"], "line 3: the magnetic field is infinite"),
        (["0.2,0,0.4", "0.2,x,0.4", "0.2,0,0.4"], "line 3: could not convert"),
    ],
)
def test_a_faulty_magnetometer_is_said(tmp_path: Path, cells: list[str], said: str) -> None:
    with pytest.raises(SolenavError) as caught:
        read(export(tmp_path, cells), "llio")
    assert said in caught.value.message
    assert caught.value.remedy


def test_a_recordings_beginning_keeps_its_magnetometer() -> None:
    recording = simulate("stand", duration_s=10)
    beginning = recording.first(4.0)
    assert len(beginning.time_s) == 800
    np.testing.assert_array_equal(mag_of(beginning), mag_of(recording)[:800])


# --- counts --------------------------------------------------------------------------------------

count = st.integers(mpu9150.MAG_COUNT_MIN, mpu9150.MAG_COUNT_MAX)


@given(hnp.arrays(np.int16, st.tuples(st.integers(1, 20), st.just(3)), elements=count))
def test_magnetometer_counts_survive_the_way_to_microtesla_and_back(
    counts: NDArray[np.int16],
) -> None:
    back, overflow = mpu9150.mag_to_counts(mpu9150.mag_from_counts(counts))
    np.testing.assert_array_equal(back, counts)
    assert back.dtype == np.int16
    assert not overflow.any()


@given(
    hnp.arrays(
        np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=st.floats(-3000, 3000)
    )
)
def test_a_field_is_rounded_to_the_nearest_count_or_overflows(values: FloatArray) -> None:
    counts, overflow = mpu9150.mag_to_counts(values)
    error = np.abs(mpu9150.mag_from_counts(counts) - values)
    assert (error[~overflow] <= 0.15 + 1e-9).all()
    assert (error[overflow].max(axis=1) > 0.15 - 1e-9).all()
    assert (np.abs(values[overflow]).max(axis=1) > 1228).all()


def test_the_magnetometers_scale_is_the_data_sheets() -> None:
    counts, overflow = mpu9150.mag_to_counts(
        np.array([[0.3, -30.0, 1228.5], [0, 0, -1228.8], [0, 1229, 0], [np.nan, 2000, 0]])
    )
    np.testing.assert_array_equal(counts, [[1, -100, 4095], [0, 0, -4096], [0, 4095, 0], [0, 0, 0]])
    np.testing.assert_array_equal(overflow, [False, False, True, False])


# --- captures ------------------------------------------------------------------------------------


def standing(mag: FloatArray | None, rate_hz: float = 200.0, count: int = 400) -> Recording:
    accel = np.tile([0.0, 0.0, 9.80665], (count, 1))
    time_s = np.arange(count) / rate_hz
    return Recording("standing", time_s, accel, 0 * accel, rate_hz, mag=mag)


@pytest.mark.parametrize(
    ("rate_hz", "every"), [(50, 1), (100, 1), (200, 2), (204.8, 2), (249.75, 3), (400, 4)]
)
def test_readings_come_as_an_ak8975_makes_them(rate_hz: float, every: int) -> None:
    mag = np.column_stack([np.arange(400.0), np.zeros(400), np.full(400, 40.0)])
    samples, _ = importing.samples_of(standing(mag, rate_hz))
    new = flagged(samples, messages.MAG_NEW)
    np.testing.assert_array_equal(new, np.arange(0, 400, every))
    held = np.arange(400) // every * every
    np.testing.assert_allclose(mpu9150.mag_from_counts(samples.mag)[:, 0], held, atol=0.15 + 1e-9)


def test_a_sample_without_reading_takes_the_next_and_holds_the_last() -> None:
    mag = np.tile([20.0, 0.0, 40.0], (400, 1))
    mag[:3] = np.nan
    mag[5] = np.nan
    mag[6] = [30.0, 0.0, 40.0]
    samples, _ = importing.samples_of(standing(mag))
    assert flagged(samples, messages.MAG_NEW)[:4].tolist() == [3, 6, 8, 10]
    np.testing.assert_array_equal(samples.mag[:3], 0)
    np.testing.assert_array_equal(samples.mag[3:8, 0], [67, 67, 67, 100, 100])


def test_an_overflow_is_flagged_and_the_last_sound_reading_stays() -> None:
    mag = np.tile([20.0, 0.0, 40.0], (400, 1))
    mag[100] = [1300.0, 0.0, 0.0]
    samples, _ = importing.samples_of(standing(mag))
    assert flagged(samples, messages.MAG_BAD).tolist() == [100]
    assert 100 not in flagged(samples, messages.MAG_NEW)
    np.testing.assert_array_equal(samples.mag, np.tile([67, 0, 133], (400, 1)))


def test_without_a_magnetometer_no_sample_has_a_reading() -> None:
    samples, _ = importing.samples_of(standing(None))
    assert not samples.flags.any()
    assert not samples.mag.any()


def test_a_capture_carries_the_magnetometer_to_the_core(tmp_path: Path) -> None:
    recording = simulate("stand", duration_s=4)
    path = tmp_path / "stand.solcap"
    notes = importing.to_capture(recording, path)
    assert notes["mag_readings"] == 400
    assert notes["mag_overflows"] == 0
    found = capture.load(path)
    expected, _ = importing.samples_of(recording)
    np.testing.assert_array_equal(found.sample_counts, expected.words)
    np.testing.assert_array_equal(found.sample_counts[:, 6:9], expected.mag)


# --- simulated field -----------------------------------------------------------------------------


def test_outdoors_the_foot_measures_the_earths_field_whatever_its_attitude() -> None:
    recording = simulate("loop", errors=IDEAL)
    mag = mag_of(recording)
    np.testing.assert_allclose(np.linalg.norm(mag, axis=1), 49.0)
    assert recording.truth is not None
    assert recording.truth.stance is not None
    stance = recording.truth.stance & np.roll(recording.truth.stance, 1)
    down = -recording.accel[stance] / np.linalg.norm(recording.accel[stance], axis=1)[:, None]
    dip = np.degrees(np.arcsin((mag[stance] * down).sum(axis=1) / 49.0))
    np.testing.assert_allclose(dip, 66.0, atol=1e-6)


@pytest.mark.parametrize("declination", [0.0, 4.0, -12.0])
def test_the_compass_shows_the_heading_less_the_declination(declination: float) -> None:
    earth = field.Earth(declination=math.radians(declination))
    recording = simulate("line35", errors=IDEAL, earth=earth)
    right, front, _ = mag_of(recording)[0]
    compass = math.atan2(-right, front)
    heading = recording.notes["initial_heading_rad"] - earth.declination
    assert math.remainder(compass - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_the_field_leaves_the_other_sensors_as_they_were() -> None:
    outdoors, indoors = simulate("loop"), simulate("loop", indoors=True)
    np.testing.assert_array_equal(outdoors.accel, indoors.accel)
    np.testing.assert_array_equal(outdoors.gyro, indoors.gyro)
    assert not np.allclose(mag_of(outdoors), mag_of(indoors))


def test_a_magnetised_sphere_draws_the_field_in_at_its_poles() -> None:
    """Iron takes in the field: 3 times the Earth's at its poles, none at its equator."""
    earth = field.Earth(inclination=math.pi / 2)
    ball = field.Steel(np.zeros((1, 3)), field.sphere(np.array([0.2]), earth.enu))
    pole, equator = np.array([[0.0, 0.0, 0.2]]), np.array([[0.2, 0.0, 0.0]])
    np.testing.assert_allclose(field.field_at(pole, earth, ball), [[0, 0, -147.0]], atol=1e-9)
    np.testing.assert_allclose(field.field_at(equator, earth, ball), 0.0, atol=1e-9)


moments = hnp.arrays(np.float64, 3, elements=st.floats(-2, 2))


@given(st.floats(0.5, 3), st.floats(-4, 4), st.floats(-1.6, 1.6), moments)
def test_a_dipoles_field_has_neither_source_nor_curl(
    distance: float, azimuth: float, elevation: float, moment: FloatArray
) -> None:
    level = math.cos(elevation)
    direction = [level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation)]
    away = distance * np.array(direction)
    step = 1e-4
    around = np.vstack([away + step * np.eye(3), away - step * np.eye(3)])
    steel = field.Steel(np.zeros((1, 3)), moment[None])
    none = field.Earth(strength=0.0)
    values = field.field_at(around, none, steel)
    slope = (values[:3] - values[3:]) / (2 * step)
    assert abs(np.trace(slope)) < 1e-4
    np.testing.assert_allclose(slope, slope.T, atol=1e-4)


@given(st.integers(0, 1000))
def test_no_foot_gets_inside_the_steel(seed: int) -> None:
    way = np.column_stack([np.arange(30.0), np.zeros(30), np.zeros(30)])
    earth = field.Earth()
    steel = field.indoors(way, earth, np.random.default_rng(seed))
    assert len(steel.position) > 40
    assert (steel.position[:, 2] <= -0.15).all()
    assert np.isfinite(field.field_at(way, earth, steel)).all()


def test_indoors_the_field_varies_as_in_a_building() -> None:
    strengths = []
    for seed in range(1, 9):
        recording = simulate("loop", seed=seed, indoors=True, errors=IDEAL)
        assert recording.truth is not None
        assert recording.truth.stance is not None
        swing = ~recording.truth.stance
        landings = np.flatnonzero(swing[:-1] & ~swing[1:]) + 1
        strengths.append(np.linalg.norm(mag_of(recording)[landings], axis=1))
    low, middle, high = np.quantile(np.concatenate(strengths), [0.05, 0.5, 0.95])
    assert 30 < low < 45
    assert 44 < middle < 54
    assert 60 < high < 100


def test_hard_iron_is_a_constant_of_the_sensor_and_soft_iron_is_not() -> None:
    ideal = mag_of(simulate("loop", errors=IDEAL))
    hard = mag_of(simulate("loop", errors=SensorErrors(hard_iron=20.0))) - ideal
    np.testing.assert_allclose(hard, np.tile(hard[0], (len(hard), 1)), atol=1e-9)
    assert 5 < np.linalg.norm(hard[0]) < 100
    soft = mag_of(simulate("loop", errors=SensorErrors(soft_iron=0.1)))
    matrix = np.linalg.lstsq(ideal, soft, rcond=None)[0]
    np.testing.assert_allclose(ideal @ matrix, soft, atol=1e-9)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)
    assert not np.allclose(matrix, np.eye(3), atol=0.02)


def test_magnetometer_noise_is_per_reading() -> None:
    still = mag_of(simulate("stand", errors=SensorErrors(mag_noise=0.4)))
    assert still.std(axis=0) == pytest.approx(0.4, rel=0.05)
