"""What each filter makes of a walk: the core, its twins in floats, and the rivals."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from solenav import capture, datasets, engines, importing
from solenav.errors import SolenavError
from solenav.filters import FILTERS, Aids, Track, Walk, adaptive, motion, named
from solenav.filters.adaptive import Variant
from solenav.filters.walk import load
from solenav.recording import FloatArray, Recording
from solenav.sim.imu import IDEAL
from solenav.sim.scenario import simulate
from solenav_core import layout
from solenav_core.params import NAMES

AIDED = [name for name, filter in FILTERS.items() if "gate" in filter.aids]
CORRECTING = [name for name in FILTERS if name != "ins"]
WITH_AIDS = [*CORRECTING, *(f"{name}+still+gate" for name in AIDED)]


def walk_of(recording: Recording, folder: Path) -> Walk:
    """The walk of a recording, by way of a capture."""
    path = folder / "walk.solcap"
    importing.to_capture(recording, path)
    return load(capture.load(path))


@pytest.fixture(scope="module")
def ideal(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """The loop of 68 m, stance as the truth has it, a sensor whose only error is that it counts."""
    walk = walk_of(simulate("loop", errors=IDEAL), tmp_path_factory.mktemp("ideal"))
    assert walk.truth is not None and walk.truth.stance is not None
    return walk.with_stance(walk.truth.stance)


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """The loop under the paper's sensor."""
    return walk_of(simulate("loop"), tmp_path_factory.mktemp("real"))


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """A minute of standing under the paper's sensor."""
    return walk_of(simulate("stand"), tmp_path_factory.mktemp("stand"))


def off(walk: Walk, track: Track) -> FloatArray:
    """Horizontal distance from the truth at each sample after the static start, m."""
    assert walk.truth is not None
    error = (track.position - walk.truth.position_enu)[walk.start.row + 1 :]
    return np.hypot(error[:, 0], error[:, 1])


def rmse(walk: Walk, track: Track) -> float:
    return math.sqrt(float(np.mean(off(walk, track) ** 2)))


def swings(walk: Walk) -> list[tuple[int, int]]:
    """Rows (begin, end) of the swings of more than 0.2 s."""
    edges = np.flatnonzero(np.diff(walk.stance[walk.start.row + 1 :].astype(int)))
    rows = edges + walk.start.row + 2
    return [
        (a, b)
        for a, b in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True)
        if not walk.stance[a] and b - a > 0.2 * walk.rate_hz
    ]


# Every filter


@pytest.mark.parametrize("name", WITH_AIDS)
def test_a_filter_that_corrects_follows_an_ideal_walk(name: str, ideal: Walk) -> None:
    assert rmse(ideal, named(name)(ideal)) < 0.3


def test_without_correction_even_an_ideal_walk_goes_astray(ideal: Walk) -> None:
    assert rmse(ideal, named("ins")(ideal)) > 1.0


@pytest.mark.parametrize("name", ["ekf", "ekf15", "kf-twin", "apf-float", "apf"])
def test_a_filter_that_corrects_the_way_of_the_swing_beats_a_velocity_reset(
    name: str, real: Walk
) -> None:
    assert rmse(real, named(name)(real)) < 0.25 * rmse(real, named("reset")(real))


@pytest.mark.parametrize("name", WITH_AIDS)
def test_a_standing_foot_stays_put(name: str, stand: Walk) -> None:
    assert off(stand, named(name)(stand)).max() < 0.05


def test_a_standing_foot_walks_off_without_correction(stand: Walk) -> None:
    assert off(stand, named("ins")(stand)).max() > 1.0


@pytest.mark.parametrize("name", FILTERS)
def test_navigation_begins_after_the_static_start_at_rest_in_the_origin(
    name: str, real: Walk
) -> None:
    track = named(name)(real)
    assert track.position.shape == track.velocity.shape == (len(real.counts), 3)
    assert not track.position[: real.start.row + 1].any()
    assert not track.velocity[: real.start.row + 1].any()
    assert np.abs(track.velocity[real.start.row + 1]).max() < 0.1
    assert np.abs(track.position[real.start.row + 1]).max() < 0.001


@pytest.mark.parametrize("name", [*FILTERS, "pf+still+gate", "apf-literal+still+gate"])
def test_the_same_walk_gives_the_same_track(name: str, real: Walk) -> None:
    first, second = named(name)(real), named(name)(real)
    assert np.array_equal(first.position, second.position)
    assert np.array_equal(first.velocity, second.velocity)


@pytest.mark.parametrize("name", AIDED)
def test_without_a_stance_a_rival_is_dead_reckoning(name: str, real: Walk) -> None:
    blind = real.with_stance(np.zeros_like(real.stance))
    assert np.array_equal(named(name)(blind).position, named("ins")(real).position)


def test_an_unknown_filter_is_refused_with_those_there_are() -> None:
    with pytest.raises(SolenavError, match="no filter 'ukf'") as refusal:
        named("ukf+still")
    assert "ekf15" in refusal.value.remedy


@pytest.mark.parametrize(("name", "remedy"), [("ekf+zaru", "still, gate"), ("apf+gate", "its own")])
def test_an_aid_that_a_filter_does_not_take_is_refused(name: str, remedy: str) -> None:
    with pytest.raises(SolenavError, match="takes no aid") as refusal:
        named(name)
    assert remedy in refusal.value.remedy


# Aids


@pytest.mark.parametrize("name", ["reset", "ekf", "ekf15", "pf", "apf-literal"])
def test_the_still_update_learns_a_slow_bias(name: str, tmp_path: Path) -> None:
    """After the static start the gyro drifts away by 0.5 °/s while the foot still stands."""
    recording = simulate("loop", errors=IDEAL)
    drift = math.radians(0.5) * np.clip((recording.time_s - 2.0) / 5.0, 0.0, 1.0)
    walk = walk_of(replace(recording, gyro=recording.gyro + drift[:, None]), tmp_path)
    helped = rmse(walk, named(f"{name}+still")(walk))
    assert helped < 0.5 * rmse(walk, named(name)(walk))


@pytest.mark.parametrize("name", AIDED)
def test_a_gate_refuses_a_false_stance_in_mid_swing(name: str, real: Walk) -> None:
    begin, end = swings(real)[20]
    middle = (begin + end) // 2
    stance = real.stance.copy()
    stance[middle : middle + 6] = True
    false = real.with_stance(stance)

    def speed(name: str, walk: Walk) -> FloatArray:
        return named(name)(walk).velocity[middle + 5]

    assert np.linalg.norm(speed(f"{name}+gate", real)) > 2.0
    assert np.array_equal(speed(f"{name}+gate", false), speed(f"{name}+gate", real))
    assert np.linalg.norm(speed(name, false) - speed(name, real)) > 0.2


# The filters for themselves


@pytest.mark.parametrize("name", ["ekf", "ekf15"])
def test_an_ekf_finds_the_tilt_that_the_static_start_got_wrong(name: str, ideal: Walk) -> None:
    attitude = ideal.start.attitude.copy()
    motion.turn(attitude, np.radians([0.5, -0.5, 0.0]))
    tilted = replace(ideal, start=replace(ideal.start, attitude=attitude))
    assert rmse(tilted, named("reset")(tilted)) > 0.5
    assert rmse(tilted, named(name)(tilted)) < 0.05


def test_the_literal_filter_gains_nothing_over_a_velocity_reset(real: Walk) -> None:
    assert rmse(real, named("apf-literal")(real)) > 0.9 * rmse(real, named("reset")(real))


def test_apf_ends_in_the_state_of_the_fast_engine(walk: Path) -> None:
    source = capture.load(walk)
    engine = engines.create("fast", source.params[0][1])
    engine.advance(source.sample_counts)
    track = named("apf")(load(source))
    at = layout.offsets(layout.STATE_FIELDS)
    velocity = np.array(engine.state[at["VEL"] : at["VEL"] + 3]) / 2**24
    position = np.array(engine.state[at["POS"] : at["POS"] + 3]) / 2**18
    assert track.position[-1].tolist() == position.tolist()
    assert track.velocity[-1].tolist() == velocity.tolist()


def assert_floats_agree(walk: Walk) -> None:
    """`apf-float` is where `apf` is, within 1 cm or 0.1 % of the distance."""
    apart = (named("apf-float")(walk).position - named("apf")(walk).position)[:, :2]
    assert np.hypot(*apart.T).max() < max(0.01, 1e-3 * walk.distance_m)


def test_the_core_in_floats_stays_with_the_core_on_a_simulated_loop(real: Walk) -> None:
    assert_floats_agree(real)


@pytest.mark.parametrize(
    ("format", "file"),
    [
        ("llio", "llio/SensorConnectData_33_LLIO.mat"),
        ("openshoe", "openshoe/Measurement_100521_2_data_inert.txt"),
        ("pyshoe", "pyshoe_vicon/2017-11-22-11-40-44.mat"),
        ("xio", "xio/short_walk.csv"),
        ("gaitmap", "gaitmap/imu_sample.csv"),
    ],
)
def test_the_core_in_floats_stays_with_the_core_on_a_real_walk(
    format: str, file: str, data: Path, tmp_path: Path
) -> None:
    assert_floats_agree(walk_of(datasets.read(data / "foot" / file, format), tmp_path))


# Variants of the core's algorithm in floats

VARIANTS = [
    Variant(doubt=0.1),
    Variant(doubt=0.1, widen=False),
    Variant(keep=True),
    Variant(doubt=0.1, widen=False, keep=True),
    Variant(doubt=0.1, widen=False, per_stance=True),
    Variant(doubt=0.1, widen=False, per_stance=True, keep=True),
    Variant(freedom=4.0, widen=False),
    Variant(tails=True),
]


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_a_variant_of_the_cloud_follows_the_loop_in_its_own_way(
    variant: Variant, real: Walk
) -> None:
    track = adaptive.particles(real, Aids(), variant)
    assert rmse(real, track) < 0.25 * rmse(real, named("reset")(real))
    assert not np.array_equal(track.position, named("apf-float")(real).position)


def test_the_twin_with_the_mixture_follows_the_loop_too(real: Walk) -> None:
    track = adaptive.twin(real, Aids(), Variant(doubt=0.1, widen=False))
    assert rmse(real, track) < 0.25 * rmse(real, named("reset")(real))


def test_a_mixture_refuses_a_false_stance_that_a_plain_likelihood_takes(real: Walk) -> None:
    begin, end = swings(real)[20]
    middle = (begin + end) // 2
    stance = real.stance.copy()
    stance[middle] = True
    # A hard decision: every sample of a stance weighs the same.
    params = real.params[:]
    for name in ("UNREST_RATE", "UNREST_ACC"):
        params[NAMES.index(name)] = 0
    false = replace(real, stance=stance, params=params)

    def change(variant: Variant) -> float:
        velocity = adaptive.particles(false, Aids(), variant).velocity
        return float(np.linalg.norm(velocity[middle] - velocity[middle - 1]))

    plain = Variant(widen=False)
    assert change(plain) > 5 * change(plain._replace(doubt=0.1))
