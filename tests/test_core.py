"""What the core does: static start, stance, unrest, steps, recovery."""

from __future__ import annotations

import math
from array import array

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from solenav import engines, mpu9150, parameters
from solenav.sim.scenario import simulate
from solenav_core import calibration, detector, layout, navigator, particles, strapdown
from solenav_tools.monitor.live import heading_deg

AT = layout.offsets(layout.STATE_FIELDS)
FloatArray = NDArray[np.float64]


def words(engine: engines.Engine, name: str, bits: int = 0) -> FloatArray:
    """A field of the state in SI units."""
    count = next(n for field, n, _stage, _format in layout.STATE_FIELDS if field == name)
    return np.array(engine.state[AT[name] : AT[name] + count]) / 2**bits


def start(rate_hz: float = 200.0, **changes: float) -> engines.Engine:
    return engines.create("fast", parameters.to_integers(parameters.Settings(**changes), rate_hz))


def still(
    count: int,
    up: FloatArray | None = None,
    bias_dps: FloatArray | None = None,
    noise: float = 2.0,
    seed: int = 1,
) -> NDArray[np.int16]:
    """Counts of a sensor at rest: `up` in body axes (unit), gyro bias in °/s."""
    mean = np.zeros(6)
    mean[:3] = 2048 * (np.array([0.0, 0.0, 1.0]) if up is None else up)
    if bias_dps is not None:
        mean[3:] = bias_dps * mpu9150.GYRO_LSB_PER_DPS
    return np.rint(mean + np.random.default_rng(seed).normal(0, noise, (count, 6))).astype(np.int16)


def rotation(attitude: FloatArray) -> FloatArray:
    w, x, y, z = attitude
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def moving(count: int) -> NDArray[np.int16]:
    rng = np.random.default_rng(5)
    return rng.normal(0, 3000, (count, 6)).astype(np.int16)


# Static start


@settings(max_examples=60)
@given(st.floats(-1, 1), st.floats(0, 2 * math.pi), st.floats(-180, 180), st.integers(0, 1000))
def test_any_mounting_is_levelled_and_headed(
    cosine: float, azimuth: float, heading: float, seed: int
) -> None:
    sine = math.sqrt(1 - cosine**2)
    up = np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), cosine])
    engine = start(initial_heading_deg=heading)
    engine.advance(still(200, up, noise=0.0, seed=seed))
    attitude = words(engine, "ATT", 30)
    assert np.linalg.norm(attitude) == pytest.approx(1.0, abs=1e-8)
    measured = np.rint(2048 * up) / np.linalg.norm(np.rint(2048 * up))
    mount = [int(axis) for axis in words(engine, "MOUNT")]
    body = [np.sign(axis) * measured[abs(axis) - 1] for axis in mount]
    assert np.allclose(rotation(attitude) @ body, [0, 0, 1], atol=1e-6)
    # However the sensor is mounted, the axis that is the body's front is nowhere near upright.
    got = heading_deg(tuple(engine.state[AT["ATT"] : AT["ATT"] + 4]))
    assert (got - heading + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)


def test_gravity_and_bias_are_the_means() -> None:
    engine = start()
    bias = np.array([5.0, -3.0, 1.0])
    engine.advance(still(200, bias_dps=bias, noise=3.0))
    assert words(engine, "BIAS", 20) / 16.4 == pytest.approx(bias, abs=0.05)
    assert words(engine, "GRAVITY", 20) == pytest.approx([9.80665], abs=5e-3)


def test_motion_starts_the_stretch_anew() -> None:
    engine = start()
    engine.advance(np.vstack([still(30), moving(50), still(199)]))
    assert not engine.navigating
    engine.advance(still(1))
    assert engine.navigating
    assert words(engine, "AL_RESTARTS")[0] >= 1


def test_a_short_stillness_serves_until_a_longer_one_comes() -> None:
    engine = start()
    wobble = still(3)
    wobble[:, 3] += 150  # 9 °/s for 15 ms: fidgeting, no step
    engine.advance(np.vstack([still(60, bias_dps=np.array([1.0, 0, 0])), wobble]))
    assert engine.navigating and words(engine, "AL_BEST")[0] == 60
    engine.advance(np.vstack([still(90), wobble]))
    assert words(engine, "AL_BEST")[0] == pytest.approx(90, abs=1)
    assert words(engine, "BIAS", 20)[0] == pytest.approx(0, abs=2)
    engine.advance(still(200))
    assert words(engine, "AL_BEST")[0] == 200


def test_the_first_swing_ends_the_search() -> None:
    engine = start()
    engine.advance(np.vstack([still(60), moving(40), still(250)]))
    assert words(engine, "AL_BEST")[0] == 60
    assert words(engine, "AL_DONE")[0] == 1


@pytest.mark.parametrize(
    "counts",
    [
        still(600, up=np.array([0.0, 0.0, 0.5])),
        still(600, up=np.array([0.0, 0.0, 1.4])),
        still(600, bias_dps=np.array([80.0, 0.0, 0.0])),
        np.zeros((600, 6), np.int16),
        np.full((600, 6), 32767, np.int16),
        moving(600),
    ],
    ids=["half g", "1.4 g", "turning", "no sensor", "stuck at full scale", "moving"],
)
def test_nonsense_is_no_static_start(counts: NDArray[np.int16]) -> None:
    engine = start()
    engine.advance(counts)
    assert not engine.navigating


# Standing and walking


def test_standing_for_minutes_stays_put() -> None:
    engine = start()
    engine.advance(still(200 * 300, bias_dps=np.array([0.5, -0.3, 0.2]), noise=4.0))
    assert np.abs(words(engine, "POS", 18)).max() < 0.05
    assert np.abs(words(engine, "VEL", 24)).max() < 0.02
    assert words(engine, "STEPS")[0] == 0


def test_a_slow_drift_of_the_bias_is_learned_while_standing() -> None:
    engine = start()
    engine.advance(still(400))
    for second in range(40):
        bias = np.array([0.0, 0.0, min(1.0, second / 30)])
        engine.advance(still(200, bias_dps=bias, seed=second))
    assert words(engine, "BIAS", 20)[2] / 16.4 == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("rate", [100.0, 200.0, 400.0])
def test_every_stride_is_a_step_and_the_walk_is_found(rate: float) -> None:
    recording = simulate("loop", seed=2, rate_hz=rate)
    engine = start(rate, initial_heading_deg=math.degrees(recording.notes["initial_heading_rad"]))
    engine.advance(mpu9150.to_counts(recording.accel, recording.gyro).counts)
    assert words(engine, "STEPS")[0] == recording.notes["strides"]
    assert words(engine, "DISTANCE", 10)[0] == pytest.approx(68.6, rel=0.02)
    truth = recording.truth
    assert truth is not None
    assert np.linalg.norm(words(engine, "POS", 18) - truth.position_enu[-1]) < 0.02 * 68.6


@pytest.mark.parametrize("scenario", ["line35", "loop"])
def test_stance_is_found_where_the_foot_stands(scenario: str) -> None:
    recording = simulate(scenario, seed=4)
    truth = recording.truth
    assert truth is not None and truth.stance is not None
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    engine = start()
    found = np.zeros(len(counts), bool)
    for row in range(len(counts)):
        engine.advance(counts, row, row + 1)
        found[row] = engine.state[AT["STANCE"]] == 1
    # The window of C3 delays the start of each stance by 50 ms.
    assert np.mean(found[truth.stance]) > 0.9
    # The detector is wide, so that runners have stances: a slow foot's lift-off passes, and
    # unrest says how little it is worth.
    assert np.mean(found[~truth.stance]) < 0.15


SIGMA = round(parameters.Settings().unrest_rate_dps * mpu9150.GYRO_LSB_PER_DPS)
"""Counts of a rate that makes T = 1."""


def test_unrest_is_small_where_a_foot_stands_and_large_where_it_turns() -> None:
    engine = start()
    engine.advance(still(300))
    off = round(parameters.Settings().unrest_accel / mpu9150.ACCEL_MPS2_PER_LSB)
    for counts, expected in (
        ((0, 0, 2048, 0, 0, 0), 0.0),
        ((0, 0, 2048, 0, 0, SIGMA), 1.0),
        ((0, 0, 2048, 0, 10 * SIGMA, 0), 100.0),
        ((0, 0, 2048 + off, 0, 0, 0), 1.0),
    ):
        assert unrest(engine, counts) == pytest.approx(expected, rel=0.15, abs=0.05)


def test_the_least_unrest_of_late_is_the_measure_for_a_foot_that_is_never_still() -> None:
    """After some seconds at ten sigma such a rate is the best there is: unrest comes down to 1."""
    engine = start()
    engine.advance(still(300))
    rocking = np.tile(np.array([0, 0, 2048, 0, 10 * SIGMA, 0], np.int16), (1200, 1))
    engine.advance(rocking[:20])
    assert unrest(engine, tuple(rocking[0])) > 50
    engine.advance(rocking)
    assert unrest(engine, tuple(rocking[0])) == pytest.approx(1.0, rel=0.02)


def unrest(engine: engines.Engine, counts: tuple[int, ...]) -> float:
    """u of a sample after what the engine has seen; the engine stays as it was."""
    state, work, sample = array("i", engine.state), navigator.new_work(), navigator.new_sample()
    for i, value in enumerate(counts):
        sample[i] = int(value)
    calibration.condition(state, engine.params, work, sample)
    detector.push(state, engine.params, work)
    detector.unrest(state, engine.params, work)
    return work[layout.offsets(layout.WORK_FIELDS)["UNREST"]] / 2**8


def test_heading_errors_turn_the_track_by_as_much() -> None:
    recording = simulate("line35", seed=1)
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    ends = []
    for heading in (0.0, 90.0):
        engine = start(initial_heading_deg=heading)
        engine.advance(counts)
        ends.append(words(engine, "POS", 18)[:2])
    north, east = ends
    assert north[1] > 30 and east[0] > 30
    assert np.linalg.norm([north[1] - east[0], north[0] + east[1]]) < 0.2


def test_the_filter_recovers_from_a_false_velocity() -> None:
    """Locked out by a velocity that fits no particle, it accepts zero (H1) within two seconds."""
    engine = start()
    engine.advance(still(400))
    engine.state[AT["VEL"]] = 5 * 2**24
    engine.advance(still(500, seed=9))
    assert np.abs(words(engine, "VEL", 24)).max() < 0.05
    assert words(engine, "LOCKOUTS")[0] >= 1


def test_a_wrong_tilt_is_levelled_by_walking() -> None:
    """Tilt makes velocity errors that stance shows: the feedback takes them out of the attitude."""
    recording = simulate("loop", seed=5)
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    engine = start()
    engine.advance(counts, 0, 300)
    half = math.radians(1.5) / 2
    strapdown.turn(engine.state, round(half * 2**30), 0, 0, 1)
    reference = start()
    reference.advance(counts)
    engine.advance(counts, 300)
    up = rotation(words(engine, "ATT", 30))[2]
    level = rotation(words(reference, "ATT", 30))[2]
    assert math.degrees(math.acos(min(1.0, float(up @ level)))) < 0.3


# Randomness


def test_the_random_numbers_are_xorshift32() -> None:
    state = navigator.new_state()
    x = 2463534242
    state[AT["RNG"]], state[AT["RNG"] + 1] = x >> 16, x & 65535
    for _ in range(1000):
        particles.stir(state)
        x ^= (x << 13) & 0xFFFFFFFF
        x ^= x >> 17
        x ^= (x << 5) & 0xFFFFFFFF
        assert (state[AT["RNG"]] << 16) + state[AT["RNG"] + 1] == x
        assert particles.row(state) == ((x & 65535) * 100) >> 16
