"""What the core does about samples that never came: short holes, long ones, restarts."""

from __future__ import annotations

from array import array

import numpy as np
import pytest
from numpy.typing import NDArray

from solenav import engines, mpu9150, parameters
from solenav.sim.scenario import simulate
from solenav_core import layout, messages, navigator

PARAMS = parameters.to_integers(parameters.Settings(), 200.0)
AT = layout.offsets(layout.STATE_FIELDS)
BRIDGED = parameters.named(PARAMS)["BRIDGE_TICKS"]


@pytest.fixture(scope="module")
def walk() -> NDArray[np.int16]:
    """35 m straight on."""
    recording = simulate("line35", seed=3)
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    return np.hstack([counts, np.zeros((len(counts), 4), np.int16)])


def run(counts: NDArray[np.int16]) -> engines.Engine:
    engine = engines.create("fast", PARAMS)
    engine.advance(counts)
    return engine


def position(engine: engines.Engine) -> NDArray[np.float64]:
    return np.array(engine.state[AT["POS"] : AT["POS"] + 3]) / 2**18


def flags(engine: engines.Engine) -> int:
    buffer = bytearray(256)
    end = messages.pack_pose(buffer, 0, engine.state, engine.params)
    before = messages.form(messages.MESSAGES[messages.POSE - 1][3][:4])
    at = messages.calcsize(before)
    assert end > at
    return buffer[at]


def without(counts: NDArray[np.int16], start: int, lost: int) -> NDArray[np.int16]:
    """The samples as they come where some are lost from row `start` on."""
    out = np.delete(counts, np.s_[start : start + lost], axis=0)
    out[start, 9] = messages.GAP_BEFORE | min(lost, messages.LOST_MAX) << 8
    return out


def swing_rows(counts: NDArray[np.int16]) -> list[int]:
    """Rows in the middle of swings: where the gyro turns fastest, at least a second apart."""
    rate = np.abs(counts[:, 3:6].astype(int)).sum(axis=1)
    rows: list[int] = []
    for row in np.argsort(-rate):
        if row > 1000 and all(abs(row - other) > 200 for other in rows):
            rows.append(int(row))
        if len(rows) == 6:
            return rows
    return rows


@pytest.mark.parametrize("lost", [1, 5, BRIDGED])
def test_a_short_hole_in_mid_swing_is_bridged(walk: NDArray[np.int16], lost: int) -> None:
    whole = position(run(walk))
    for row in swing_rows(walk):
        engine = run(without(walk, row, lost))
        off = np.linalg.norm(position(engine) - whole)
        assert off < {1: 0.02, 5: 0.03, BRIDGED: 0.15}[lost], (row, off)
        assert not flags(engine) & (messages.GAP | messages.RESUMED)


def test_a_hole_that_is_not_told_of_costs_more_than_one_that_is(walk: NDArray[np.int16]) -> None:
    whole = position(run(walk))
    off = {"told": 0.0, "not told": 0.0}
    for row in swing_rows(walk):
        told = without(walk, row, 10)
        off["told"] += float(np.linalg.norm(position(run(told)) - whole))
        told[row, 9] = 0
        off["not told"] += float(np.linalg.norm(position(run(told)) - whole))
    assert off["told"] < off["not told"] / 2, off


def test_a_hole_too_long_to_bridge_marks_every_pose_from_then_on(walk: NDArray[np.int16]) -> None:
    row = swing_rows(walk)[0]
    broken = without(walk, row, BRIDGED + 1)
    engine = engines.create("fast", PARAMS)
    engine.advance(broken, 0, row)
    assert not flags(engine) & messages.GAP
    _row, events = engine.advance(broken, row, row + 1)
    assert events & navigator.BROKEN and flags(engine) & messages.GAP
    engine.advance(broken, row + 1)
    assert flags(engine) & messages.GAP


def test_poses_after_a_lockout_are_marked_like_those_after_a_hole(
    walk: NDArray[np.int16],
) -> None:
    """As something was wrong for a second: no sound walk locks the filter out."""
    engine = run(walk)
    assert engine.state[AT["LOCKOUTS"]] == 0 and not flags(engine) & messages.GAP
    engine.state[AT["LOCKOUTS"]] = 1
    assert flags(engine) & messages.GAP


def resumed(walk: NDArray[np.int16], stop: int, start: int) -> tuple[engines.Engine, int]:
    """The walk without the rows between, resumed; and the row at which it navigates again."""
    engine = engines.create("pure", PARAMS)
    engine.state[:] = run(walk[:stop]).state
    navigator.resume(engine.state)
    row = start
    while not engine.navigating and row < len(walk):
        row, _events = engine.advance(walk, row, row + 1)
    return engine, row


def test_after_a_long_hole_it_goes_on_from_where_it_was(walk: NDArray[np.int16]) -> None:
    for stop in swing_rows(walk)[:3]:
        before = run(walk[:stop])
        engine, row = resumed(walk, stop, stop + 400)
        # A stride takes 1.1 s: the next stance is never further than that.
        assert row - (stop + 400) < 400
        assert np.allclose(position(engine), position(before), atol=0.02)
        assert flags(engine) & messages.RESUMED
        for name in ("STEPS", "DISTANCE", "RESUMED"):
            was = before.state[AT[name]] + (name == "RESUMED")
            assert engine.state[AT[name]] == was, name
        # What is walked from here on is the true walk's, heading included, to some per cent.
        fast = engines.create("fast", PARAMS)
        fast.state[:] = engine.state
        fast.advance(walk, row)
        reference = run(walk[:row])
        begun = position(reference)
        reference.advance(walk, row)
        walked = position(reference) - begun
        off = np.linalg.norm(position(fast) - position(engine) - walked)
        assert off < 0.05 * np.linalg.norm(walked), (stop, off)


def test_until_it_stands_again_it_gives_no_pose_and_moves_nothing(
    walk: NDArray[np.int16],
) -> None:
    stop = swing_rows(walk)[0]
    engine = engines.create("fast", PARAMS)
    engine.state[:] = run(walk[:stop]).state
    was, tick = position(engine), engine.state[AT["TICK"]]
    navigator.resume(engine.state)
    # A hole shows in the ticks.
    assert engine.state[AT["TICK"]] == tick + 1
    engine.advance(np.random.default_rng(1).normal(0, 9000, (300, 6)).astype(np.int16))
    assert not engine.navigating and np.array_equal(position(engine), was)


def test_before_the_first_static_start_there_is_nothing_to_resume(
    walk: NDArray[np.int16],
) -> None:
    state = navigator.new_state()
    navigator.resume(state)
    assert state[AT["RESUMED"]] == 0
    words = array("i", bytes(4 * navigator.SAVED))
    assert not navigator.save(state, words)


def test_what_is_saved_brings_position_heading_biases_and_steps_back(
    walk: NDArray[np.int16],
) -> None:
    stop = swing_rows(walk)[2]
    before = run(walk[:stop])
    words = array("i", bytes(4 * navigator.SAVED))
    assert navigator.save(before.state, words)
    engine = engines.create("fast", PARAMS)
    navigator.load(engine.state, words, 2000)
    assert engine.state[AT["TICK"]] == stop + 2001
    assert not engine.navigating
    row = stop + 300
    while not engine.navigating:
        row, _events = engine.advance(walk, row, row + 1)
    assert np.allclose(position(engine), position(before), atol=0.02)
    for name in ("BIAS", "GRAVITY", "STEPS", "DISTANCE", "CELL", "MOUNT"):
        count = {n: c for n, c, _s, _f in layout.STATE_FIELDS}[name]
        at = AT[name]
        assert engine.state[at : at + count] == before.state[at : at + count], name
    assert flags(engine) & messages.RESUMED
    engine.advance(walk, row)
    assert engine.state[AT["STEPS"]] > before.state[AT["STEPS"]]
