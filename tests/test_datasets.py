"""Readers of the public recordings, and the conversion to MPU-9150 counts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from solenav import mpu9150
from solenav.datasets import FORMATS, checks, read
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording, Truth

FOOT_DATA = Path(__file__).parents[2] / "shared" / "data" / "foot"
needs_data = pytest.mark.skipif(
    not FOOT_DATA.is_dir(), reason="the recordings (../shared/data) are not beside this checkout"
)

Case = tuple[str, str, str, int, float]
"""Format, file, foot, samples, rate in Hz."""

REAL: list[Case] = [
    ("llio", "llio/SensorConnectData_31_LLIO.mat", "right", 8549, 200.0),
    ("llio", "llio/SensorConnectData_32_LLIO.mat", "right", 14601, 200.0),
    ("llio", "llio/SensorConnectData_33_LLIO.mat", "right", 11000, 200.0),
    ("llio", "llio/SensorConnectData_34_LLIO.mat", "right", 5200, 200.0),
    ("llio", "llio/SensorConnectData_35_LLIO.mat", "right", 6001, 200.0),
    ("llio", "llio/SensorConnectData_36_LLIO.mat", "right", 14000, 200.0),
    ("llio", "llio/SC_11.csv", "right", 7600, 200.0),
    ("llio", "llio/SC_13.csv", "right", 7001, 200.0),
    ("openshoe", "openshoe/Measurement_100521_2_data_inert.txt", "right", 16420, 249.75),
    ("openshoe", "openshoe/Measurement_100521_30_data_inert.txt", "right", 16153, 249.75),
    ("openshoe", "openshoe/Measurement_100521_31_data_inert.txt", "right", 16785, 249.75),
    ("openshoe", "openshoe/Measurement_100521_32_data_inert.txt", "right", 16295, 249.75),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-22-03.mat", "right", 6490, 200.0),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-23-25.mat", "right", 7117, 200.0),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-26-05.mat", "right", 7525, 200.0),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-30-14.mat", "right", 8979, 200.0),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-37-47.mat", "right", 9394, 200.0),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-40-44.mat", "right", 10128, 200.0),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-49-29.mat", "right", 11121, 200.0),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-51-23.mat", "right", 6244, 200.0),
    ("xio", "xio/long_walk.csv", "right", 28188, 398.504),
    ("xio", "xio/short_walk.csv", "right", 16578, 398.313),
    ("gaitmap", "gaitmap/imu_sample.csv", "left", 7928, 204.8),
    ("gaitmap", "gaitmap/imu_sample.csv", "right", 7928, 204.8),
    ("gaitmap", "gaitmap/imu_sample_healthy_stair_up.csv", "left", 5130, 204.8),
    ("gaitmap", "gaitmap/imu_sample_healthy_stair_down.csv", "right", 4488, 204.8),
]
TRACKED = [
    case for case in REAL if case[1].startswith(("llio/Sensor", "pyshoe", "gaitmap/imu_sample.csv"))
]


def case_id(case: Case) -> str:
    return f"{Path(case[1]).stem}-{case[2]}" if case[0] == "gaitmap" else Path(case[1]).stem


def real(case: Case) -> Recording:
    if case[0] in ("llio", "pyshoe"):
        pytest.importorskip("scipy")
    return read(FOOT_DATA / case[1], case[0], foot=case[2])


def truth_of(recording: Recording) -> Truth:
    assert recording.truth is not None
    return recording.truth


# --- real recordings ---------------------------------------------------------------------------


@needs_data
@pytest.mark.parametrize("case", REAL, ids=case_id)
def test_a_real_recording_reads_whole_and_in_si_units(
    case: Case,
) -> None:
    r = real(case)
    assert len(r.time_s) == case[3]
    assert r.accel.shape == r.gyro.shape == (case[3], 3)
    assert r.rate_hz == pytest.approx(case[4], rel=1e-4)
    assert r.time_s[0] == 0
    assert (np.diff(r.time_s) > 0).all()
    still = np.linalg.norm(r.gyro, axis=1) < 0.2
    assert still.sum() > 100
    # 4 %: the right foot's sensor of the stairs is 3.3 % low
    assert np.median(np.linalg.norm(r.accel[still], axis=1)) == pytest.approx(9.81, rel=0.04)
    assert r.source == f"{case[0]} {Path(case[1]).name}"


@needs_data
@pytest.mark.parametrize("case", TRACKED, ids=case_id)
def test_truth_lies_within_the_recording(case: Case) -> None:
    r = real(case)
    truth = truth_of(r)
    assert truth.position_enu.shape == (len(truth.time_s), 3)
    assert (np.diff(truth.time_s) > 0).all()
    assert truth.time_s[0] >= 0
    assert truth.time_s[-1] <= r.time_s[-1]
    assert 2 < np.ptp(truth.position_enu[:, :2], axis=0).max() < 40
    assert truth.frame == "local"
    assert not truth.closed_loop


@needs_data
@pytest.mark.parametrize("case", TRACKED, ids=case_id)
def test_truth_turns_the_way_the_gyro_turns(case: Case) -> None:
    """A mirrored reference would turn the other way."""
    r = real(case)
    truth = truth_of(r)
    seconds = np.searchsorted(truth.time_s, np.arange(0.0, truth.time_s[-1]))
    points = np.unique(seconds)
    moves = np.diff(truth.position_enu[points, :2], axis=0)
    midway = (truth.time_s[points][1:] + truth.time_s[points][:-1]) / 2
    walking = np.linalg.norm(moves, axis=1) > 0.4
    course = np.arctan2(moves[walking, 1], moves[walking, 0])
    yaw = yaw_of(r)[np.searchsorted(r.time_s, midway[walking])]
    as_read, mirrored = (abs(np.exp(1j * (sign * course - yaw)).mean()) for sign in (1, -1))
    assert as_read > mirrored


@needs_data
@pytest.mark.parametrize("case", [c for c in TRACKED if c[0] != "llio"], ids=case_id)
def test_the_foot_rises_in_swing(case: Case) -> None:
    height = truth_of(real(case)).position_enu[:, 2]
    height = height - np.median(height[:50])
    assert height.max() > 0.08
    assert height.min() > -0.05


@needs_data
def test_llio_truth_has_no_height_and_is_none_without_the_csv(tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    source = FOOT_DATA / "llio" / "SensorConnectData_34_LLIO.mat"
    truth = truth_of(read(source, "llio"))
    assert len(truth.time_s) == 25
    assert np.isnan(truth.position_enu[:, 2]).all()
    assert np.isfinite(truth.position_enu[:, :2]).all()
    alone = tmp_path / source.name
    alone.write_bytes(source.read_bytes())
    assert read(alone, "llio").truth is None


@needs_data
@pytest.mark.parametrize("case", [c for c in TRACKED if c[0] == "pyshoe"], ids=case_id)
def test_pyshoe_labels_stance_where_the_foot_is_slow(case: Case) -> None:
    truth = truth_of(real(case))
    assert truth.stance is not None
    speed = np.linalg.norm(np.gradient(truth.position_enu, truth.time_s, axis=0), axis=1)
    assert np.median(speed[truth.stance]) < 0.1 < np.median(speed[~truth.stance])


@needs_data
@pytest.mark.parametrize("case", [c for c in REAL if c[0] in ("openshoe", "xio")], ids=case_id)
def test_a_closed_walk_says_so_and_no_more(case: Case) -> None:
    truth = truth_of(real(case))
    assert truth.closed_loop
    assert truth.time_s.shape == (0,)
    assert truth.position_enu.shape == (0, 3)


@needs_data
def test_gaitmap_reads_each_foot_and_stairs_have_no_truth() -> None:
    walk = FOOT_DATA / "gaitmap" / "imu_sample.csv"
    left, right = (read(walk, "gaitmap", foot=foot) for foot in ("left", "right"))
    assert left.name != right.name
    assert not np.allclose(left.accel, right.accel)
    start = [truth_of(r).position_enu[0] for r in (left, right)]
    assert 0.05 < np.linalg.norm(start[0] - start[1]) < 0.3
    assert read(walk.with_name("imu_sample_healthy_stair_up.csv"), "gaitmap").truth is None


@needs_data
def test_xio_keeps_received_samples_and_counts_the_repairs() -> None:
    path = FOOT_DATA / "xio" / "long_walk.csv"
    r = read(path, "xio")
    assert r.notes["duplicates_dropped"] == 252
    assert r.notes["samples_filled"] == 308
    assert r.notes["longest_gap_s"] == pytest.approx(7 / r.rate_hz, rel=1e-3)
    assert len(r.time_s) == 28132 - 252 + 308
    raw = np.loadtxt(path, delimiter=",", skiprows=1)
    at = np.rint(raw[:, 0] * r.rate_hz).astype(int)
    np.testing.assert_allclose(r.time_s[at], raw[:, 0], atol=2e-4)
    np.testing.assert_array_equal(r.gyro[at], np.deg2rad(raw[:, 1:4]))


def yaw_of(r: Recording) -> FloatArray:
    """Heading of the foot's level axis, from gyro alone, levelled on the first samples."""
    up = r.accel[:20].mean(axis=0)
    up /= np.linalg.norm(up)
    forward = np.eye(3)[np.argmin(np.abs(up))]
    forward -= up * (forward @ up)
    forward /= np.linalg.norm(forward)
    sideways = np.cross(up, forward)
    attitude = np.stack([forward, sideways, up])
    angle = r.gyro / r.rate_hz
    size = np.maximum(np.linalg.norm(angle, axis=1), 1e-12)[:, np.newaxis, np.newaxis]
    axis = np.cross(np.eye(3), angle[:, np.newaxis, :]) / size
    turns = np.eye(3) + np.sin(size) * axis + (1 - np.cos(size)) * axis @ axis
    yaw = np.empty(len(turns))
    for i, turn in enumerate(turns):
        attitude = attitude @ turn
        level = attitude @ sideways
        yaw[i] = np.arctan2(level[1], level[0])
    return yaw


# --- faulty files --------------------------------------------------------------------------------

XIO_HEADER = (
    "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),"
    "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)"
)
OPENSHOE_HEADER = "Header: a_x [g]: a_y [g]: a_z [g]: ar_x [rad/s]: ar_y [rad/s]: ar_z [rad/s]: Nr:"


def xio_lines(n: int = 8) -> list[str]:
    """Header and `n` samples at rest, 400 Hz."""
    return [XIO_HEADER, *(f"{i * 0.0025:.4f},0.{i},0,0,0,0,1" for i in range(n))]


def openshoe_lines(n: int = 8) -> list[str]:
    rows = [f"0xcb 0 0 1 0.0{i} 0 0 {i + 1}" for i in range(n)]
    return ["", "Inertial data.", "", OPENSHOE_HEADER, *rows]


def gaitmap_lines(n: int = 8) -> list[str]:
    channels = [f"{kind}_{axis}" for kind in ("acc", "gyr") for axis in "xyz"]
    header = ["," + ",".join(["right_sensor"] * 6), "," + ",".join(channels)]
    return [*header, *(f"{i},0,0,9.8,{i},0,0" for i in range(n))]


def export_lines(n: int = 8) -> list[str]:
    channels = [f"inertial:scaled{kind}{axis}" for kind in ("Accel", "Gyro") for axis in "XYZ"]
    return [",".join(["Time", *channels]), *(f"{i * 0.005},0,0,-1,0.0{i},0,0" for i in range(n))]


LINES: dict[str, tuple[str, Callable[[], list[str]]]] = {
    "xio": ("walk.csv", xio_lines),
    "openshoe": ("walk.txt", openshoe_lines),
    "gaitmap": ("imu_walk.csv", gaitmap_lines),
    "llio": ("SC_1.csv", export_lines),
}


def write(folder: Path, format: str, lines: list[str]) -> Path:
    path = folder / LINES[format][0]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_mat(path: Path, **variables: Any) -> Path:
    pytest.importorskip("scipy.io").savemat(path, variables)
    return path


def pyshoe_variables(n: int = 8) -> dict[str, FloatArray]:
    imu = np.tile([0.0, 0.0, -9.8, 0.01, 0.0, 0.0], (n, 1))
    return {"ts": np.arange(n) * 0.005, "imu": imu}


def fault(path: Path, format: str, **options: str) -> str:
    """Message of the SolenavError that reading raises; it must have a remedy."""
    with pytest.raises(SolenavError) as caught:
        read(path, format, **options)
    assert caught.value.remedy
    return caught.value.message


@pytest.mark.parametrize("format", LINES)
def test_a_small_sound_file_reads(tmp_path: Path, format: str) -> None:
    r = read(write(tmp_path, format, LINES[format][1]()), format)
    assert len(r.time_s) == 8
    np.testing.assert_allclose(np.linalg.norm(r.accel, axis=1), 9.8, rtol=1e-3)


@pytest.mark.parametrize("format", FORMATS)
def test_an_absent_file_is_named(tmp_path: Path, format: str) -> None:
    assert "nowhere" in fault(tmp_path / "nowhere.csv", format)


@pytest.mark.parametrize("format", FORMATS)
def test_a_directory_is_refused(tmp_path: Path, format: str) -> None:
    assert "is a directory" in fault(tmp_path, format)


def test_an_unknown_format_or_foot_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "xio", xio_lines())
    assert "unknown format 'ngimu'" in fault(path, "ngimu")
    assert "unknown foot 'middle'" in fault(path, "xio", foot="middle")


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("suffix", [".png", ".csv", ".txt", ".mat"])
def test_a_picture_is_refused_under_any_name(tmp_path: Path, format: str, suffix: str) -> None:
    if suffix == ".mat":
        pytest.importorskip("scipy")
    path = tmp_path / f"picture{suffix}"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 8)
    assert str(path) in fault(path, format)


@pytest.mark.parametrize("other", [name for name in FORMATS if name != "xio"])
def test_a_file_of_another_format_is_refused(tmp_path: Path, other: str) -> None:
    path = write(tmp_path, "xio", xio_lines())
    assert str(path) in fault(path, other)
    renamed = path.rename(path.with_suffix(".txt" if other == "openshoe" else ".csv"))
    assert str(renamed) in fault(renamed, other)


@pytest.mark.parametrize("format", LINES)
def test_an_empty_file_is_refused(tmp_path: Path, format: str) -> None:
    assert "is empty" in fault(write(tmp_path, format, []), format)


@pytest.mark.parametrize("format", LINES)
@pytest.mark.parametrize("samples", [0, 1])
def test_fewer_than_two_samples_are_refused(tmp_path: Path, format: str, samples: int) -> None:
    lines = LINES[format][1]()
    message = fault(write(tmp_path, format, lines[: len(lines) - 8 + samples]), format)
    assert f"after {samples} samples" in message


@pytest.mark.parametrize("format", LINES)
@pytest.mark.parametrize("cell", ["nan", "inf"])
def test_a_sample_that_is_not_finite_is_located(tmp_path: Path, format: str, cell: str) -> None:
    lines = LINES[format][1]()
    separator = " " if format == "openshoe" else ","
    cells = lines[-3].split(separator)
    cells[3] = cell
    lines[-3] = separator.join(cells)
    column = "gyro z" if format == "xio" else "accel z"
    assert f"line {len(lines) - 2}: {column} is {cell}" in fault(
        write(tmp_path, format, lines), format
    )


def test_a_blank_cell_counts_as_nan(tmp_path: Path) -> None:
    lines = xio_lines()
    lines[4] = "0.0075,,0,0,0,0,1"
    assert "line 5: gyro x is nan" in fault(write(tmp_path, "xio", lines), "xio")


@pytest.mark.parametrize("format", LINES)
def test_a_cell_that_is_no_number_is_located(tmp_path: Path, format: str) -> None:
    lines = LINES[format][1]()
    lines[-3] = lines[-3].replace("1", "x").replace("9", "x")
    assert f"line {len(lines) - 2}: could not convert" in fault(
        write(tmp_path, format, lines), format
    )


@pytest.mark.parametrize("format", LINES)
def test_a_short_line_is_located(tmp_path: Path, format: str) -> None:
    lines = LINES[format][1]()
    lines[-3] = lines[-3][:6]
    assert f"line {len(lines) - 2}:" in fault(write(tmp_path, format, lines), format)


@pytest.mark.parametrize("format", LINES)
def test_a_missing_column_is_named(tmp_path: Path, format: str) -> None:
    lines = [line.replace("Z", "W").replace("z", "w") for line in LINES[format][1]()]
    message = fault(write(tmp_path, format, lines), format)
    assert "has no column" in message
    assert "Z" in message or "z" in message


def test_the_missing_foot_is_named(tmp_path: Path) -> None:
    path = write(tmp_path, "gaitmap", gaitmap_lines())
    assert "left_sensor acc_x" in fault(path, "gaitmap", foot="left")


@pytest.mark.parametrize("format", LINES)
def test_time_that_goes_back_is_located(tmp_path: Path, format: str) -> None:
    lines = LINES[format][1]()
    lines[-2], lines[-3] = lines[-3], lines[-2]
    assert f"line {len(lines) - 1}: time goes back" in fault(write(tmp_path, format, lines), format)


@pytest.mark.parametrize("format", ["openshoe", "gaitmap", "llio"])
def test_time_that_repeats_is_located(tmp_path: Path, format: str) -> None:
    lines = LINES[format][1]()
    lines[-3] = lines[-4]
    assert f"line {len(lines) - 2}: time repeats" in fault(write(tmp_path, format, lines), format)


@pytest.mark.parametrize("format", LINES)
def test_a_long_gap_is_located(tmp_path: Path, format: str) -> None:
    lines = LINES[format][1]()
    if format == "openshoe":
        lines[-1] = lines[-1][:-1] + "900"
    else:
        lines[-1] = "900" + lines[-1][lines[-1].index(",") :]
    assert f"line {len(lines)}:" in fault(write(tmp_path, format, lines), format)


@pytest.mark.parametrize("format", LINES)
def test_acceleration_in_another_unit_is_suspected(tmp_path: Path, format: str) -> None:
    gravity = {"xio": ",1", "openshoe": " 0 0 1 ", "gaitmap": "9.8", "llio": "-1"}[format]
    lines = [
        line.replace(gravity, gravity.replace("1", "1000").replace("9.8", "1.0"))
        for line in LINES[format][1]()
    ]
    assert "perhaps the file is in" in fault(write(tmp_path, format, lines), format)


def test_a_rate_in_degrees_is_suspected(tmp_path: Path) -> None:
    lines = export_lines()
    lines[5] = lines[5].replace("0.04", "350")
    message = fault(write(tmp_path, "llio", lines), "llio")
    assert "line 6" in message
    assert "°/s" in message


def test_xio_drops_repeats_and_fills_what_is_lost(tmp_path: Path) -> None:
    lines = xio_lines()
    del lines[4]  # 7.5 ms
    lines.insert(6, lines[5])
    r = read(write(tmp_path, "xio", lines), "xio")
    assert len(r.time_s) == 8
    np.testing.assert_allclose(np.rad2deg(r.gyro[:, 0]), np.arange(8) / 10, atol=1e-9)
    np.testing.assert_allclose(np.diff(r.time_s), 0.0025)
    assert r.notes == {
        "duplicates_dropped": 1,
        "samples_filled": 1,
        "longest_gap_s": pytest.approx(0.005),
    }


def test_xio_refuses_two_samples_at_one_time(tmp_path: Path) -> None:
    lines = xio_lines()
    lines.insert(5, lines[4][:-1] + "2")
    assert "line 6: same time" in fault(write(tmp_path, "xio", lines), "xio")


def test_xio_refuses_stamps_off_the_period(tmp_path: Path) -> None:
    lines = xio_lines()
    lines[5] = lines[5].replace("0.0100", "0.0111")
    assert "line 6: the step of 3.600 ms" in fault(write(tmp_path, "xio", lines), "xio")


def test_xio_refuses_one_sample_repeated(tmp_path: Path) -> None:
    lines = xio_lines(1)
    assert "repeat one sample" in fault(write(tmp_path, "xio", [*lines, lines[1]]), "xio")


def test_openshoe_drops_a_last_line_cut_short(tmp_path: Path) -> None:
    r = read(write(tmp_path, "openshoe", [*openshoe_lines(), "0xcb 0 0"]), "openshoe")
    assert len(r.time_s) == 8
    assert r.notes["last_line_dropped"]


def test_gaitmap_truth_is_nan_where_a_marker_is_hidden(tmp_path: Path) -> None:
    path = write(tmp_path, "gaitmap", gaitmap_lines())
    names = ["R_TOE", "R_FCC", "R_FM5"]
    header = [
        "," + ",".join(name for name in names for _ in range(3)),
        "," + ",".join("xyz" * 3),
    ]
    rows = ["0,1000,0,0,2000,0,0,3000,0,30", "1,1000,0,0,,,,3000,0,30"]
    path.with_name("mocap_walk.csv").write_text("\n".join([*header, *rows]))
    truth = truth_of(read(path, "gaitmap"))
    np.testing.assert_allclose(truth.time_s, [0, 0.01])
    np.testing.assert_allclose(truth.position_enu[0], [2, 0, 0.01])
    assert np.isnan(truth.position_enu[1]).all()


@pytest.mark.parametrize(
    "format, missing", [("pyshoe", "ts"), ("pyshoe", "imu"), ("llio", "imu_data")]
)
def test_a_missing_variable_is_named(tmp_path: Path, format: str, missing: str) -> None:
    variables = {k: v for k, v in pyshoe_variables().items() if k != missing}
    path = write_mat(tmp_path / "walk.mat", **variables)
    assert missing in fault(path, format)


@pytest.mark.parametrize(
    "name, value, said",
    [
        ("imu", np.zeros((8, 5)), "variable imu is float64 (8, 5)"),
        ("imu", "words", "variable imu is <U5"),
        ("imu", np.zeros((0, 6)), "lengths differ (ts 8, imu 0 rows)"),
        ("ts", np.zeros(8), "row 2: time repeats"),
        ("gt", np.zeros((7, 3)), "lengths differ (ts 8, gt 7 rows)"),
        ("gt", np.zeros((8, 2)), "variable gt is float64 (8, 2)"),
    ],
)
def test_a_variable_of_another_shape_is_named(
    tmp_path: Path, name: str, value: Any, said: str
) -> None:
    path = write_mat(tmp_path / "walk.mat", **{**pyshoe_variables(), name: value})
    assert said in fault(path, "pyshoe")


def test_a_nan_in_a_mat_file_is_located(tmp_path: Path) -> None:
    variables = pyshoe_variables()
    variables["imu"][4, 5] = np.nan
    path = write_mat(tmp_path / "walk.mat", **variables)
    assert "row 5: gyro z is nan" in fault(path, "pyshoe")


def test_pyshoe_without_reference_has_no_truth(tmp_path: Path) -> None:
    path = write_mat(tmp_path / "walk.mat", **pyshoe_variables())
    assert read(path, "pyshoe").truth is None


def write_h5(folder: Path, accel: FloatArray, gyro: FloatArray, mag: FloatArray) -> Path:
    """Files of an mpu6050 recording, arrays (n, 4) of time and axes; the accelerometer's path."""
    h5py = pytest.importorskip("h5py")
    for name, variable, array in (
        ("mpu6050_accelerometer.mat", "accelBuffer", accel),
        ("mpu6050_gyroscope.mat", "gyroBuffer", gyro),
        ("hmc5883l_compass.mat", "compassBuffer", mag),
    ):
        with h5py.File(folder / name, "w") as file:
            file[variable] = array.T
    return folder / "mpu6050_accelerometer.mat"


def mpu6050_arrays(n: int = 100) -> list[FloatArray]:
    time = np.linspace(0, (n - 1) / 100, n)
    time[4] += 0.004
    slow = time[0] + np.arange(n // 2) / 50
    return [
        np.column_stack([time, np.tile([0.0, 0.0, -1.0], (n, 1))]),
        np.column_stack([time, np.tile([1.0, 2.0, 3.0], (n, 1))]),
        np.column_stack([slow, np.tile([0.2, 0.0, -0.4], (n // 2, 1))]),
    ]


def test_mpu6050_lays_out_bursts_evenly_in_the_accelerometers_axes(tmp_path: Path) -> None:
    r = read(write_h5(tmp_path, *mpu6050_arrays()), "mpu6050")
    np.testing.assert_allclose(np.diff(r.time_s), 0.01)
    np.testing.assert_allclose(r.accel[0], [0, 0, 9.80665])
    np.testing.assert_allclose(np.rad2deg(r.gyro[0]), [1, 2, 3])
    assert r.mag is not None
    np.testing.assert_allclose(r.mag[::2], np.tile([-20.0, 0, -40], (50, 1)))
    assert np.isnan(r.mag[1::2]).all()
    assert r.notes["folder"] == tmp_path.name


def test_mpu6050_without_a_compass_has_no_field(tmp_path: Path) -> None:
    path = write_h5(tmp_path, *mpu6050_arrays())
    path.with_name("hmc5883l_compass.mat").unlink()
    assert read(path, "mpu6050").mag is None


def test_mpu6050_names_a_missing_gyro_file(tmp_path: Path) -> None:
    path = write_h5(tmp_path, *mpu6050_arrays())
    path.with_name("mpu6050_gyroscope.mat").unlink()
    assert "mpu6050_gyroscope.mat does not exist" in fault(path, "mpu6050")


def test_mpu6050_refuses_a_damaged_file_and_another_sensors(tmp_path: Path) -> None:
    path = write_h5(tmp_path, *mpu6050_arrays())
    assert "is not mpu6050_acc" in fault(path.with_name("mpu6050_gyroscope.mat"), "mpu6050")
    path.write_bytes(path.read_bytes()[:200])
    assert "not a readable .mat" in fault(path, "mpu6050")


def test_the_tumbles_field_keeps_its_angle_to_gravity(data: Path) -> None:
    pytest.importorskip("h5py")
    folder = data / "static" / "mpu6050" / "full-sphere"
    r = read(folder / "mpu6050_accelerometer.mat", "mpu6050")
    assert len(r.time_s) == 10528
    assert r.rate_hz == pytest.approx(99.05, abs=0.01)
    assert r.mag is not None
    known = ~np.isnan(r.mag[:, 0])
    assert known.sum() > 8100
    # Hard iron and scales as the tumble's ellipsoid has them.
    field = (r.mag[known] - [0.56, 10.53, 1.26]) * [0.919, 0.874, 1.026]
    force = r.accel[known]
    cosine = (field * force).sum(axis=1)
    cosine /= np.linalg.norm(field, axis=1) * np.linalg.norm(force, axis=1)
    assert np.median(cosine) == pytest.approx(-0.91, abs=0.02)
    assert cosine.std() < 0.06


def test_without_scipy_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_module(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(checks, "import_module", no_module)
    path = tmp_path / "walk.mat"
    path.touch()
    with pytest.raises(SolenavError) as caught:
        read(path, "pyshoe")
    assert caught.value.remedy == "pip install 'solenav[import]'"


# --- counts --------------------------------------------------------------------------------------

int16 = hnp.arrays(
    np.int16, st.tuples(st.integers(1, 20), st.just(6)), elements=st.integers(-32768, 32767)
)
si = hnp.arrays(
    np.float64, st.tuples(st.integers(1, 20), st.just(6)), elements=st.floats(-400.0, 400.0)
)


@given(int16)
def test_counts_survive_the_way_to_si_and_back(counts: NDArray[np.int16]) -> None:
    back = mpu9150.to_counts(*mpu9150.from_counts(counts))
    np.testing.assert_array_equal(back.counts, counts)
    assert back.counts.dtype == np.int16
    assert not back.clipped.any()


@given(si)
def test_si_values_are_rounded_to_the_nearest_count_and_clipped(values: FloatArray) -> None:
    scale = np.repeat([mpu9150.ACCEL_MPS2_PER_LSB, mpu9150.GYRO_RADPS_PER_LSB], 3)
    result = mpu9150.to_counts(values[:, :3], values[:, 3:])
    exact = values / scale
    within = (exact >= -32768.5) & (exact <= 32767.5)
    assert (np.abs(result.counts - exact)[within] <= 0.5 + 1e-9).all()
    np.testing.assert_array_equal(
        result.counts[~within], np.where(exact[~within] > 0, 32767, -32768)
    )
    assert (
        result.clipped_accel <= result.clipped.sum() <= result.clipped_accel + result.clipped_gyro
    )
    assert set(np.flatnonzero((~within).any(axis=1))) <= set(np.flatnonzero(result.clipped))


def test_clipped_samples_are_counted_once_per_sensor() -> None:
    accel = np.array([[0, 0, 9.8], [200.0, -200.0, 0], [0, 0, 0]])
    gyro = np.array([[0, 0, 0], [0, 40.0, 0], [-40.0, 0, 40.0]])
    result = mpu9150.to_counts(accel, gyro)
    assert (result.clipped_accel, result.clipped_gyro) == (1, 2)
    np.testing.assert_array_equal(result.clipped, [False, True, True])
    np.testing.assert_array_equal(result.counts[1], [32767, -32768, 0, 0, 32767, 0])


def test_the_scales_are_those_of_the_data_sheet() -> None:
    result = mpu9150.to_counts(
        np.array([[9.80665, 0.0, -9.80665 * 16]]), np.deg2rad([[1000.0, -2.0, 0.0]])
    )
    np.testing.assert_array_equal(result.counts, [[2048, 0, -32768, 16400, -33, 0]])
    assert not result.clipped.any()
    assert mpu9150.TEMPERATURE_LSB_PER_DEGC == 340
    assert mpu9150.TEMPERATURE_OFFSET_DEGC == 35
