"""The simulator: samples that integrate back to the truth, and a gait that looks like one."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from solenav.errors import SolenavError
from solenav.modes.labels import MODES
from solenav.recording import FloatArray, Recording, Truth
from solenav.sim.gait import FLIGHT, RISER_M, SCENARIOS, motion
from solenav.sim.imu import GRAVITY, IDEAL, TABLE1, SensorErrors
from solenav.sim.scenario import simulate

WALKS = ["line35", "loop"]


def truth_of(recording: Recording) -> Truth:
    assert recording.truth is not None
    return recording.truth


def stance_of(recording: Recording) -> NDArray[np.bool_]:
    stance = truth_of(recording).stance
    assert stance is not None
    return stance


def strapdown(recording: Recording) -> FloatArray:
    """Positions (n, 3) ENU by plain integration from rest at the origin, without any update."""
    dt = 1 / recording.rate_hz
    azimuth = recording.notes["initial_heading_rad"]
    # Columns are the body's right, front and up at the start.
    attitude = np.array(
        [
            [math.cos(azimuth), math.sin(azimuth), 0],
            [-math.sin(azimuth), math.cos(azimuth), 0],
            [0, 0, 1],
        ]
    )
    velocity = np.zeros(3)
    position = np.zeros(3)
    positions = np.empty_like(recording.accel)
    gravity = np.array([0, 0, -GRAVITY])
    for i, (accel, rate) in enumerate(zip(recording.accel, recording.gyro, strict=True)):
        half = rodrigues(rate * dt / 2)
        before = velocity
        velocity = velocity + (attitude @ half @ accel + gravity) * dt
        position = position + (before + velocity) / 2 * dt
        attitude = attitude @ half @ half
        positions[i] = position
    return positions


def rodrigues(turn: FloatArray) -> FloatArray:
    x, y, z = turn.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0:
        return np.eye(3)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def looks_like_stance(recording: Recording) -> NDArray[np.bool_]:
    force = np.linalg.norm(recording.accel, axis=1)
    rate = np.linalg.norm(recording.gyro, axis=1)
    return (force > 8.3) & (force < 11.3) & (rate < math.radians(50))


@pytest.mark.parametrize(
    ("scenario", "rate_hz"), [("line35", 100), ("line35", 200), ("line35", 400), ("loop", 200)]
)
def test_ideal_samples_integrate_to_the_truth(scenario: str, rate_hz: float) -> None:
    recording = simulate(scenario, rate_hz=rate_hz, errors=IDEAL)
    error = np.linalg.norm(strapdown(recording) - truth_of(recording).position_enu, axis=1)
    assert error.max() < 0.01
    assert error[-1] < 1e-4


def test_line35_is_the_walk_of_the_paper() -> None:
    recording = simulate("line35")
    truth = truth_of(recording)
    end = truth.position_enu[-1]
    np.testing.assert_allclose(end, [-34.46, -6.08, 0], atol=1e-9)
    assert math.hypot(*end) == pytest.approx(35, abs=0.01)
    assert math.degrees(math.atan2(end[1], end[0])) % 360 == pytest.approx(190, abs=0.01)
    assert math.degrees(recording.notes["initial_heading_rad"]) == pytest.approx(260, abs=0.01)
    assert len(recording.time_s) == 26000
    stance = stance_of(recording)
    assert stance[: 10 * 200].all()
    assert stance[-10 * 200 :].all()
    assert not truth.closed_loop


def test_loop_ends_where_and_as_it_began() -> None:
    gait = SCENARIOS["loop"](np.random.default_rng(1), None)
    ends = motion(gait, np.array([0.0, gait.duration_s]))
    np.testing.assert_allclose(ends.position_enu, 0, atol=1e-9)
    # Once around turns the quaternion's sign and nothing else.
    np.testing.assert_allclose(ends.attitude[0], -ends.attitude[1], atol=1e-9)
    recording = simulate("loop", errors=IDEAL)
    assert truth_of(recording).closed_loop
    assert math.degrees(recording.gyro[:, 2].max()) > 100


def test_laps_go_five_times_around() -> None:
    recording = simulate("laps", errors=IDEAL, rate_hz=50)
    position = truth_of(recording).position_enu
    np.testing.assert_allclose(position[-1], 0, atol=1e-9)
    assert truth_of(recording).closed_loop
    middle = (position.min(axis=0) + position.max(axis=0)) / 2
    east, north, _ = (position - middle).T
    turned = np.ptp(np.unwrap(np.arctan2(north, east)))
    assert turned == pytest.approx(5 * 2 * math.pi, rel=0.01)
    assert np.ptp(position[:, :2], axis=0).max() < 30


@pytest.mark.parametrize(("scenario", "speed_mps"), [("corridor", 1.1), ("corridor-fast", 1.7)])
def test_corridors_are_38_by_60_m_and_close(scenario: str, speed_mps: float) -> None:
    recording = simulate(scenario, errors=IDEAL, rate_hz=100)
    truth = truth_of(recording)
    np.testing.assert_allclose(truth.position_enu[-1], 0, atol=1e-9)
    azimuth = recording.notes["initial_heading_rad"]
    along = truth.position_enu[:, :2] @ [math.sin(azimuth), math.cos(azimuth)]
    across = truth.position_enu[:, :2] @ [math.cos(azimuth), -math.sin(azimuth)]
    # The foot sways by some centimetres beside the line.
    assert np.ptp(along) == pytest.approx(60, abs=0.2)
    assert np.ptp(across) == pytest.approx(38, abs=0.2)
    moving = ~stance_of(recording)
    first, last = np.flatnonzero(moving)[[0, -1]]
    assert 192.6 / ((last - first) / 100) == pytest.approx(speed_mps, rel=0.05)
    assert np.abs(recording.accel).max() < 16 * GRAVITY
    assert np.degrees(np.abs(recording.gyro)).max() < 2000


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("scenario", WALKS)
def test_a_walk_has_the_figures_of_a_gait(scenario: str, seed: int) -> None:
    recording = simulate(scenario, seed=seed, errors=IDEAL)
    truth = truth_of(recording)
    swing = ~stance_of(recording)
    first, last = np.flatnonzero(swing)[[0, -1]]
    force = np.linalg.norm(recording.accel, axis=1).max() / GRAVITY
    rate = math.degrees(np.linalg.norm(recording.gyro, axis=1).max())
    low, high = (0.35, 0.45) if scenario == "loop" else (0.5, 0.6)
    assert low < 1 - swing[first:last].mean() < high
    assert 3 < force < 10
    assert np.abs(recording.accel).max() < 16 * GRAVITY
    assert 300 < rate < 900
    assert 0.10 < truth.position_enu[:, 2].max() < 0.20
    assert truth.position_enu[:, 2].min() > -1e-3


@pytest.mark.parametrize("scenario", WALKS)
def test_truth_stance_and_the_detector_agree(scenario: str) -> None:
    recording = simulate(scenario, errors=TABLE1)
    stance = stance_of(recording)
    # The sample in which the foot lands still holds the last of its motion.
    inner = stance & np.roll(stance, 1)
    assert looks_like_stance(recording)[inner].all()
    assert looks_like_stance(recording)[~stance].mean() < 0.1


@pytest.mark.parametrize("scenario", WALKS)
def test_the_foot_is_exactly_still_in_stance(scenario: str) -> None:
    recording = simulate(scenario, errors=IDEAL)
    stance = stance_of(recording)
    inner = stance & np.roll(stance, 1)
    velocity = truth_of(recording).velocity_enu
    assert velocity is not None
    assert not velocity[stance].any()
    assert not truth_of(recording).position_enu[stance, 2].any()
    np.testing.assert_allclose(recording.accel[inner], np.tile([0, 0, GRAVITY], (inner.sum(), 1)))
    np.testing.assert_allclose(recording.gyro[inner], 0, atol=1e-9)


@pytest.mark.parametrize("scenario", WALKS)
def test_velocity_is_the_derivative_of_position_and_acceleration_is_continuous(
    scenario: str,
) -> None:
    gait = SCENARIOS[scenario](np.random.default_rng(5), None)
    rate = 100_000
    states = motion(gait, 35 + np.arange(4 * rate) / rate)
    velocity = (states.velocity_enu[1:] + states.velocity_enu[:-1]) / 2
    np.testing.assert_allclose(np.diff(states.position_enu, axis=0) * rate, velocity, atol=1e-4)
    acceleration = np.diff(states.velocity_enu, axis=0) * rate
    # A jump would not shrink with the step; the steepest flank, the heel strike, is 2e4 m/s³.
    assert np.abs(np.diff(acceleration, axis=0)).max() < 3e4 / rate


def test_a_seed_fixes_everything() -> None:
    one, again, other = simulate("loop"), simulate("loop"), simulate("loop", seed=2)
    np.testing.assert_array_equal(one.accel, again.accel)
    np.testing.assert_array_equal(one.gyro, again.gyro)
    np.testing.assert_array_equal(truth_of(one).position_enu, truth_of(again).position_enu)
    assert not np.array_equal(one.accel, other.accel)
    assert not np.array_equal(truth_of(one).position_enu, truth_of(other).position_enu)


def test_the_gait_depends_neither_on_the_rate_nor_on_the_errors() -> None:
    coarse = simulate("line35", rate_hz=100, errors=IDEAL)
    fine = simulate("line35", rate_hz=200)
    np.testing.assert_allclose(
        truth_of(coarse).position_enu, truth_of(fine).position_enu[1::2], atol=1e-12
    )


@pytest.mark.parametrize("rate_hz", [100, 400])
def test_noise_has_the_density_of_the_data_sheet(rate_hz: float) -> None:
    recording = simulate("stand", rate_hz=rate_hz)
    band = math.sqrt(rate_hz / 2)
    assert recording.accel.std(axis=0) == pytest.approx(400e-6 * 9.80665 * band, rel=0.05)
    assert recording.gyro.std(axis=0) == pytest.approx(math.radians(0.005) * band, rel=0.05)


@pytest.mark.parametrize("rate_hz", [100, 400])
def test_coloured_noise_has_its_size_and_its_lags_at_any_rate(rate_hz: float) -> None:
    errors = SensorErrors(accel_coloured=0.1, gyro_coloured=0.01)
    recording = simulate("stand", rate_hz=rate_hz, errors=errors, duration_s=1200)
    sensors = (recording.accel - [0, 0, GRAVITY], 0.1), (recording.gyro, 0.01)
    slow, fast = errors.lags_s
    for values, size in sensors:
        assert values.std(axis=0) == pytest.approx(size, rel=0.1)
        lag = round(0.1 * rate_hz)
        seen = np.mean(values[lag:] * values[:-lag]) / values.var()
        # Of two lags in a row; sampling changes little at these rates.
        expected = (slow * math.exp(-0.1 / slow) - fast * math.exp(-0.1 / fast)) / (slow - fast)
        assert seen == pytest.approx(expected, abs=0.05)


def test_coloured_noise_leaves_everything_else_as_it_was() -> None:
    plain = simulate("loop", errors=TABLE1)
    both = simulate("loop", errors=replace(TABLE1, gyro_coloured=0.01))
    np.testing.assert_array_equal(plain.accel, both.accel)
    np.testing.assert_array_equal(truth_of(plain).position_enu, truth_of(both).position_enu)
    assert (both.gyro - plain.gyro).std() == pytest.approx(0.01, rel=0.2)


def test_biases_spread_as_in_table_1() -> None:
    still = [simulate("stand", rate_hz=50, duration_s=20, seed=seed) for seed in range(100)]
    accel = np.array([r.accel.mean(axis=0) - [0, 0, GRAVITY] for r in still])
    gyro = np.array([r.gyro.mean(axis=0) for r in still])
    assert accel.std() == pytest.approx(0.008, rel=0.15)
    assert gyro.std() == pytest.approx(math.radians(0.05), rel=0.15)
    assert abs(accel.mean()) < 0.002
    assert abs(gyro.mean()) < math.radians(0.0125)


def test_walk_and_scale_errors_do_what_they_say() -> None:
    wander = simulate("stand", duration_s=1000, rate_hz=50, errors=SensorErrors(gyro_walk=1e-3))
    steps = np.diff(wander.gyro[::50], axis=0)
    assert steps.std() == pytest.approx(1e-3, rel=0.1)
    ideal = simulate("loop", errors=IDEAL)
    scaled = simulate("loop", errors=SensorErrors(accel_scale=0.01))
    ratio = scaled.accel[:, 2] / ideal.accel[:, 2]
    assert np.ptp(ratio) < 1e-9
    assert 0 < abs(ratio[0] - 1) < 0.05
    np.testing.assert_array_equal(scaled.gyro, ideal.gyro)


def test_stand_stays_at_the_origin_for_as_long_as_asked() -> None:
    recording = simulate("stand", duration_s=12.5, errors=IDEAL)
    assert len(recording.time_s) == 2500
    assert stance_of(recording).all()
    assert not truth_of(recording).position_enu.any()
    assert not recording.gyro.any()


def test_a_longer_walk_stands_longer_at_its_end() -> None:
    usual, longer = simulate("loop", errors=IDEAL), simulate("loop", errors=IDEAL, duration_s=100)
    count = len(usual.time_s)
    assert len(longer.time_s) == 20000
    np.testing.assert_array_equal(longer.accel[:count], usual.accel)
    assert stance_of(longer)[count:].all()


@pytest.mark.parametrize(
    ("scenario", "changes"),
    [
        ("moonwalk", {}),
        ("loop", {"rate_hz": 49}),
        ("loop", {"rate_hz": 1001}),
        ("loop", {"rate_hz": math.nan}),
        ("loop", {"seed": -1}),
        ("loop", {"duration_s": 60}),
        ("line35", {"duration_s": 100}),
        ("stand", {"duration_s": 1.9}),
        ("stand", {"duration_s": math.inf}),
        ("stand", {"duration_s": math.nan}),
    ],
)
def test_bad_arguments_say_what_to_do(scenario: str, changes: dict[str, float]) -> None:
    with pytest.raises(SolenavError) as caught:
        simulate(scenario, **changes)  # type: ignore[arg-type]
    assert caught.value.remedy


@pytest.mark.parametrize("seed", [1, 2])
def test_stairs_lead_up_and_down_again(seed: int) -> None:
    recording = simulate("stairs", seed=seed, errors=IDEAL, rate_hz=50)
    height = truth_of(recording).position_enu[:, 2]
    assert height[-1] == pytest.approx(0.0, abs=1e-9)
    stance = stance_of(recording)
    assert height[stance].max() == pytest.approx(2 * FLIGHT * RISER_M)
    climbs = {label.mode: 0.0 for label in recording.modes}
    for label in recording.modes:
        first, last = np.searchsorted(recording.time_s, [label.start_s, label.end_s])
        climbs[label.mode] += height[min(last, len(height) - 1)] - height[first]
    assert climbs["upstairs"] == pytest.approx(2 * FLIGHT * RISER_M, abs=0.03)
    assert climbs["downstairs"] == pytest.approx(-2 * FLIGHT * RISER_M, abs=0.03)


def test_labels_cover_a_simulated_course() -> None:
    recording = simulate("modes", errors=IDEAL, rate_hz=50)
    labels = recording.modes
    assert {label.mode for label in labels} == set(MODES)
    assert labels[0].start_s == 0.0
    assert labels[-1].end_s == pytest.approx(recording.time_s[-1], abs=0.1)
    for before, after in pairwise(labels):
        assert before.end_s == after.start_s
    speed = np.linalg.norm(np.diff(truth_of(recording).position_enu, axis=0), axis=1) * 50
    fastest = {
        mode: max(
            speed[int(a.start_s * 50) : int(a.end_s * 50)].max() for a in labels if a.mode == mode
        )
        for mode in ("still", "walk", "run")
    }
    assert fastest["still"] < 0.1
    assert fastest["run"] > 1.2 * fastest["walk"]
