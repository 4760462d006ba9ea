"""The core's GLRT detector, its features of motion, and the forest: against floats, and refused."""

from __future__ import annotations

import math
from array import array
from binascii import crc32
from pathlib import Path

import numpy as np
import pytest
from cli import refused, solenav
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from numpy.typing import NDArray

from solenav import capture, engines, forests, importing, mpu9150, parameters, replaying
from solenav.engines.windows import NAMES, windows
from solenav.errors import SolenavError
from solenav.filters import glrt
from solenav.forests import Leaf, Split, Tree
from solenav.sim import torture
from solenav.sim.scenario import simulate
from solenav_core import forest, layout, navigator
from solenav_core.tables.forest import FOREST

AT = layout.offsets(layout.STATE_FIELDS)
WALK = simulate("line35", seed=3)
COUNTS = mpu9150.to_counts(WALK.accel, WALK.gyro).counts


# The GLRT detector


@pytest.mark.parametrize("window_s", [0.005, 0.05, 0.155])
@pytest.mark.parametrize("gamma", [400.0, 25_000.0, 640_000.0])
def test_the_statistic_is_that_of_the_floats(window_s: float, gamma: float) -> None:
    chosen = parameters.Settings(detector=1, glrt_window_s=window_s, glrt_max=gamma)
    values = parameters.to_integers(chosen, 200.0)
    engine = engines.create("fast", values)
    part = COUNTS[:1400]
    found, stance, body = [], [], []
    for row in range(len(part)):
        _, events = engine.advance(part, row, row + 1)
        found.append(engine.state[AT["GLRT"]] / 2**5)
        stance.append(bool(events & navigator.STANCE))
        # The rate as the detector had it: less the bias of then.
        bias = np.array(engine.state[AT["BIAS"] : AT["BIAS"] + 3]) / 2**20
        body.append((part[row, 3:6] - bias) / mpu9150.GYRO_LSB_PER_DPS)
    wanted = glrt.statistic(
        parameters.body_samples(part, values, (1, 2, 3))[0],
        np.array(body),
        window=round(window_s * 200),
        gravity=engine.state[AT["GRAVITY"]] / 2**20,
        sigma_accel=0.01,
        sigma_rate=0.1,
    )
    core, floats = np.array(found)[250:], np.minimum(wanted[250:], 2**20)
    # A count of Q6 force and of two counts of rate are 1.6 and 1.2 sigma: that much and 2 %.
    assert np.abs(core - floats).max() < np.inf
    assert (np.abs(core - floats) <= 0.03 * floats + 12).mean() > 0.99
    near = np.abs(floats - gamma) < 0.05 * gamma + 12
    assert (np.array(stance)[250:] == (floats < gamma))[~near].all()


def test_a_fixed_wide_threshold_walks_as_well_as_the_gates() -> None:
    """Known from the recordings: T below 640,000 is about what C1 to C3 let pass."""
    ends = []
    for detector in (0, 1):
        engine = engines.create(
            "fast", parameters.to_integers(parameters.Settings(detector=detector), 200.0)
        )
        engine.advance(COUNTS)
        ends.append(np.array(engine.state[AT["POS"] : AT["POS"] + 3]) / 2**18)
    assert np.linalg.norm(ends[0] - ends[1]) < 0.01 * 35


def test_the_motion_chooses_the_threshold() -> None:
    chosen = parameters.Settings(detector=2, glrt_max=0.0, glrt_run=1e6, motion_window_s=0.0)
    engine = engines.create("fast", parameters.to_integers(chosen, 200.0))
    engine.advance(COUNTS, 0, 300)
    assert engine.state[AT["STANCE"]] == 0
    engine.state[AT["MOTION"]] = forest.MOTIONS.index("run")
    engine.advance(COUNTS, 300, 310)
    assert engine.state[AT["STANCE"]] == 1


@pytest.mark.parametrize("detector", [1, 2])
@pytest.mark.parametrize("name", ["pure", "checked", "thumb"])
def test_engines_agree_with_the_glrt(name: str, detector: int) -> None:
    values = parameters.to_integers(parameters.Settings(detector=detector), 200.0)
    part = np.vstack([case.counts[:700] for case in torture.walks()[:2]])
    ends = [engines.create(each, values) for each in ("fast", name)]
    for start in range(0, len(part), 100):
        for engine in ends:
            engine.advance(part, start, start + 100)
        assert ends[0].digest() == ends[1].digest(), f"by tick {start + 100}"


# Features


def signals(counts: NDArray[np.int16], values: array[int]) -> tuple[list[list[float]], ...]:
    """The ten signals of each tick as floats in the core's units, from its state."""
    engine = engines.create("fast", values)
    force, rate = parameters.body_samples(counts, values, (1, 2, 3))
    groups: tuple[list[list[float]], ...] = ([], [])
    for row in range(len(counts)):
        engine.advance(counts, row, row + 1)
        gravity = engine.state[AT["GRAVITY"]] / 2**20
        bias = np.array(engine.state[AT["BIAS"] : AT["BIAS"] + 3]) / 2**20
        v = np.array(engine.state[AT["VEL"] : AT["VEL"] + 3]) / 2**24 * 64
        a = force[row] * 8
        w = rate[row] / mpu9150.GYRO_RADPS_PER_LSB / 32 - bias / 32
        long = [np.linalg.norm(a) - 8 * gravity, np.linalg.norm(w)]
        groups[0].append([a[0], a[1], a[2] - 8 * gravity, long[0], v[2]])
        groups[1].append([*w, long[1], math.hypot(v[0], v[1])])
    return groups


def described(y: NDArray[np.float64]) -> list[float]:
    """Mean, deviation, skewness, extremes of a window, in floats."""
    mean, deviation = y.mean(), y.std()
    skewness = ((y - mean) ** 3).mean() / deviation**3 if deviation > 8 else 0.0
    return [4 * mean, 4 * deviation, 256 * skewness, y.max(), y.min()]


def test_features_are_what_floats_say_of_the_same_window() -> None:
    values = parameters.to_integers(parameters.Settings(), 200.0)
    part = COUNTS[:3000]
    groups = signals(part, values)
    found = windows(part, values)
    assert len(found.row) > 8
    checked = 0
    for last, got in zip(found.last, found.features, strict=True):
        for group in range(2):
            # 64 samples, four ticks apart; group 1 takes the last, group 0 the one before.
            rows = last - 2 * (1 - group) - 4 * np.arange(64)
            y = np.array(groups[group])[rows]
            at = 28 * group
            # Not the velocities: the core takes them before the stance's correction.
            for signal in range(4):
                wanted = described(y[:, signal])
                core = got[at + 5 * signal : at + 5 * signal + 5]
                assert core[0] == pytest.approx(wanted[0], abs=4)
                assert core[1] == pytest.approx(wanted[1], abs=4, rel=0.02)
                assert core[3:] == pytest.approx(wanted[3:], abs=1.5)
                if abs(y[:, signal].std() - 8) > 1:
                    assert core[2] == pytest.approx(wanted[2], abs=40)
                    checked += 1
            for i, (one, other) in enumerate(((0, 1), (1, 2), (0, 2))):
                if min(y[:, one].std(), y[:, other].std()) > 9:
                    wanted_r = 256 * np.corrcoef(y[:, one], y[:, other])[0, 1]
                    assert got[at + 25 + i] == pytest.approx(wanted_r, abs=8)
    assert checked > 50


def test_features_have_names_and_windows_their_places() -> None:
    assert len(NAMES) == layout.FEATURES == len(set(NAMES))
    values = parameters.to_integers(parameters.Settings(), 200.0)
    found = windows(COUNTS[:2000], values)
    # A window of 128 samples every 64 of them, two ticks apart.
    assert set(np.diff(found.last)) == {128}
    assert (found.row - found.last < 40).all()


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0, 600.0])
def test_a_window_lasts_about_as_long_at_every_rate(rate: float) -> None:
    recording = simulate("line35", seed=3, rate_hz=rate).first(12.0)
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    found = windows(counts, parameters.to_integers(parameters.Settings(), rate))
    seconds = np.diff(found.last) / rate
    assert seconds == pytest.approx(0.64 if rate > 50 else 1.28, rel=0.01)


def test_without_a_window_no_motion_is_told() -> None:
    values = parameters.to_integers(parameters.Settings(motion_window_s=0.0), 200.0)
    assert len(windows(COUNTS[:2000], values).row) == 0


# The forest


def trees(depth: int) -> SearchStrategy[Tree]:
    leaves = st.tuples(*[st.integers(0, 63)] * layout.CLASSES).map(Leaf)
    if depth == 0:
        return leaves
    below = trees(depth - 1)
    splits = st.builds(Split, st.integers(0, 55), st.integers(-4096, 4095), below, below)
    return st.one_of(leaves, splits)


def weights(tree: Tree, row: NDArray[np.int32]) -> tuple[int, ...]:
    """What the tree says of features (56,)."""
    while isinstance(tree, Split):
        tree = tree.left if row[tree.feature] <= tree.threshold else tree.right
    return tree.weights


@given(st.lists(trees(3), max_size=64))
def test_a_packed_forest_comes_back(planted: list[Tree]) -> None:
    words = forests.pack(planted)
    assert forests.unpack(words) == planted
    assert list(forests.from_bytes(words.tobytes())) == list(words)


@settings(max_examples=20)
@given(st.lists(trees(4), min_size=1, max_size=24))
def test_the_core_walks_as_the_trees_say(planted: list[Tree]) -> None:
    values = parameters.to_integers(parameters.Settings(motion_hold=1, motion_share=0.5), 200.0)
    found = windows(COUNTS[:1200], values, forest=forests.pack(planted))
    vote = np.zeros(5, int)
    assert len(found.row)
    for row, score, motion in zip(found.features, found.score, found.motion, strict=True):
        wanted = np.sum([weights(tree, row) for tree in planted], 0)
        assert score.tolist() == wanted.tolist()
        vote = vote // 2 + wanted
        sure = vote.max() * 256 >= 128 * vote.sum() and vote.max() > 0
        assert motion == (vote.argmax() + 1 if sure else 0)


def test_a_motion_changes_only_after_windows_in_a_row() -> None:
    always = [Leaf((0, 63, 0, 0, 0))]
    held = parameters.to_integers(parameters.Settings(motion_hold=3, motion_share=0.5), 200.0)
    found = windows(COUNTS[:2000], held, forest=forests.pack(always))
    assert found.motion[:4].tolist() == [0, 0, 2, 2]


@given(st.data())
def test_no_spoilt_forest_passes(data: st.DataObject) -> None:
    """What passes can be walked whatever the features: each step leads on, and to a leaf."""
    words = forests.pack(data.draw(st.lists(trees(3), min_size=1, max_size=4)))
    at = data.draw(st.integers(0, len(words) - 1))
    words[at] = data.draw(st.integers(-(2**31), 2**31 - 1))
    if data.draw(st.booleans()):
        words = words[: data.draw(st.integers(0, len(words)))]
    if forest.objection(words) is not None:
        return
    for i in range(words[0]):
        ends = [words[1 + i]]
        while ends:
            place = ends.pop()
            assert 0 < place < len(words)
            node = words[place]
            if node >= 0:
                assert node & 63 < layout.FEATURES and node >> 19 > 1
                ends += [place + 1, place + (node >> 19)]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ((), "0 words are not 1 to 4096"),
        ((65,), "65 trees are not 0 to 64"),
        ((-1,), "-1 trees"),
        ((2, 3), "ends within the list"),
        ((1, 1, -5), "doesn't follow the list"),
        ((1, 2), "has no node"),
        ((1, 2, 2 << 19, -5), "a side of a split is missing"),
        ((1, 2, 2 << 19 | 60, -5, -5), "asks for feature 60"),
        ((1, 2, 3 << 19, -5, -5), "isn't where its split says"),
        ((1, 2, -5, -5), "belongs to nothing"),
        ((1, 2, -(2**31)), "is no leaf"),
    ],
)
def test_what_is_no_forest_is_refused_with_a_reason(words: tuple[int, ...], complaint: str) -> None:
    with pytest.raises(SolenavError, match=complaint):
        forests.unpack(words)


@pytest.mark.parametrize(
    "planted",
    [
        [Leaf((64, 0, 0, 0, 0))],
        [Leaf((1, 2))],
        [Split(56, 0, Leaf((1,) * 5), Leaf((1,) * 5))],
        [Split(3, 4096, Leaf((1,) * 5), Leaf((1,) * 5))],
        [Leaf((1,) * 5)] * 65,
    ],
)
def test_a_forest_that_does_not_fit_is_refused(planted: list[Tree]) -> None:
    with pytest.raises(SolenavError):
        forests.pack(planted)


def test_the_shipped_forest_is_one_and_its_table_is_what_is_written() -> None:
    words = forests.from_bytes(FOREST)
    namespace: dict[str, bytes] = {}
    exec(forests.table(words, "Anything."), namespace)
    assert namespace["FOREST"] == FOREST
    tables = navigator.new_tables()
    assert navigator.forest_hash(tables) == crc32(FOREST)
    assert navigator.forest_hash(navigator.new_tables(array("i", [0]))) == crc32(bytes(4))


def test_a_snapshot_with_a_motion_that_is_none_is_refused() -> None:
    engine = engines.create("pure", parameters.to_integers(parameters.Settings(), 200.0))
    for name, value in (("MOTION", 6), ("GLRT_HEAD", 31), ("BLOCK_SLOT", 3), ("STAGE", -1)):
        state = navigator.new_state()
        state[AT[name]] = value
        with pytest.raises(ValueError, match="is outside"):
            engine.restore(state.tobytes())


# Another forest than the shipped one


OTHER = forests.pack([Split(1, 40, Leaf((63, 0, 0, 0, 0)), Leaf((0, 63, 0, 0, 0)))] * 30)


def test_a_capture_with_another_forest_verifies_with_that_alone(tmp_path: Path) -> None:
    path, forest_file = tmp_path / "other.solcap", tmp_path / "other.forest"
    forest_file.write_bytes(OTHER.tobytes())
    samples = tmp_path / "walk.solcap"
    importing.to_capture(WALK.first(12.0), samples)
    replaying.replay(capture.load(samples), path, forest=OTHER)
    told = capture.load(path).hellos[0][1]
    assert told["forest"] == crc32(OTHER)
    refused(solenav("verify", path), 2, f"{crc32(OTHER):08x}", "--forest")
    assert solenav("verify", path, "--forest", forest_file).returncode == 0
    forest_file.write_bytes(OTHER.tobytes()[:-4])
    refused(solenav("verify", path, "--forest", forest_file), 2, "other.forest", "no forest")
