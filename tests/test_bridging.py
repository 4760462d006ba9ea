"""Foot and waist together: the waist's steps where the foot's navigation has a hole."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("numba")
pytest.importorskip("dtaidistance")

from solenav import capture, engines, importing, mpu9150, parameters, pdr, replaying
from solenav.capture.contents import dtype
from solenav.errors import SolenavError
from solenav.pdr import Hole, StepTrack, step_table
from solenav.pdr.track import FOOT
from solenav.recording import Recording, Truth
from solenav.sim.scenario import simulate
from solenav_core import messages, navigator
from solenav_tools.board import Samples, SimulatedBoard
from solenav_tools.cli.app import app
from solenav_tools.ports import PortVanished, open_port, read_some

RATE = 200.0
PARAMS = parameters.to_integers(parameters.Settings(), RATE)
# The first corner of the loop, and some steps on both sides of it.
CORNER = Hole(22.0, 30.0, resumed=True)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("loop", seed=4)


def truth_of(recording: Recording) -> Truth:
    assert recording.truth is not None
    return recording.truth


def foot_of(recording: Recording, *missing: Hole) -> StepTrack:
    """The foot's STEPs; across each hole the core is resumed, as the firmware does."""
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    rows = np.hstack([counts, np.zeros((len(counts), 4), np.int16)])
    gone = [(round(h.begin_s * RATE), round(h.end_s * RATE)) for h in missing]
    engine = engines.create("fast", PARAMS)
    found, time_s, row = [], [], 0
    buffer = bytearray(256)
    while row < len(rows):
        after = [stop for start, stop in gone if start <= row < stop]
        if after:
            navigator.resume(engine.state)
            row = after[0]
        _row, events = engine.advance(rows, row, row + 1)
        if events & navigator.STEP:
            end = messages.pack_step(buffer, 0, engine.state)
            found.append(np.frombuffer(bytes(buffer[:end]), dtype(messages.STEP))[0])
            time_s.append(row / RATE)
        row += 1
    steps = np.array(found)
    covariance = np.zeros((len(steps), 3, 3))
    covariance[:, range(3), range(3)] = steps["variance"] / 2**24
    return StepTrack(
        "foot",
        np.array(time_s),
        steps["displacement"] / 2**18,
        math.pi / 2 - steps["heading"] * (2 * math.pi / 2**16),
        covariance,
        np.zeros(3),
        time_s[0] - float(steps["ticks"][0]) / RATE,
        FOOT,
    )


@pytest.fixture(scope="module")
def phone(recording: Recording) -> Recording:
    """A phone carried along the same walk: its axes are its own."""
    truth = truth_of(recording)
    time_s = np.arange(0.0, truth.time_s[-1], 0.02)
    east, north = (
        np.interp(time_s + 0.6, truth.time_s, truth.position_enu[:, k])
        - np.interp(time_s - 0.6, truth.time_s, truth.position_enu[:, k])
        for k in (0, 1)
    )
    walking = np.hypot(east, north) > 0.3
    course = np.interp(time_s, time_s[walking], np.unwrap(np.arctan2(north, east)[walking]))
    rng = np.random.default_rng(1)
    accel = rng.normal(0, 0.1, (len(time_s), 3))
    accel[:, 2] += 9.81 + 3.0 * np.sin(2 * np.pi * 2 / 1.05 * time_s) * walking
    gyro = rng.normal(0, 0.01, accel.shape)
    gyro[:, 2] += np.gradient(course, time_s)
    return Recording("phone", time_s, accel, gyro, 50.0)


@pytest.fixture(scope="module")
def waist(phone: Recording) -> StepTrack:
    """Its steps, of generic length."""
    return pdr.reckon(phone)


def off_m(track: StepTrack, recording: Recording, at_s: float | None = None) -> float:
    """How far the end is from the true place then (or at `at_s`), m.

    The foot calls North where it points at first.
    """
    truth = truth_of(recording)
    when = track.time_s[-1] if at_s is None else at_s
    east, north = (np.interp(when, truth.time_s, truth.position_enu[:, k]) for k in (0, 1))
    true = complex(east, north) * np.exp(1j * recording.notes["initial_heading_rad"])
    return float(abs(complex(*track.position[-1, :2]) - true))


def test_the_waist_bridges_a_hole_in_which_the_foot_turned(
    recording: Recording, waist: StepTrack
) -> None:
    whole, broken = foot_of(recording), foot_of(recording, CORNER)
    both = pdr.joined(broken, waist, [CORNER])
    assert both.source == "foot and waist"
    # Without the waist 9 m and the corner are missing.
    assert off_m(broken, recording) > 10.0
    assert off_m(both, recording) < 2.0
    assert both.distance_m == pytest.approx(whole.distance_m, rel=0.05)
    assert (np.diff(both.position_s) > 0).all()
    # Nothing shorter than a step is left at the hole's edges.
    assert np.diff(both.position_s).min() >= 0.3
    # Before the hole it is the foot's walk.
    before = both.time_s < CORNER.begin_s - 2.0
    assert before.sum() > 3
    np.testing.assert_array_equal(both.displacement[before], whole.displacement[: before.sum()])
    # Whose error is larger shows in the covariance.
    within = (both.time_s > CORNER.begin_s) & (both.time_s < CORNER.end_s)
    size = np.trace(both.covariance, axis1=1, axis2=2)
    assert size[within].mean() > 3 * size[before].mean()
    assert (np.linalg.eigvalsh(both.covariance) > -1e-12).all()


def test_the_waist_goes_on_where_the_foot_ends(recording: Recording, waist: StepTrack) -> None:
    dead = Hole(50.0, truth_of(recording).time_s[-1], resumed=True)
    broken = foot_of(recording, dead)
    both = pdr.joined(broken, waist, [dead])
    assert both.time_s[-1] == waist.time_s[-1]
    assert off_m(broken, recording, both.time_s[-1]) > 5.0
    assert off_m(both, recording) < 3.0


def test_two_holes_are_bridged_one_after_the_other(recording: Recording, waist: StepTrack) -> None:
    second = Hole(48.0, 53.0, resumed=True)
    both = pdr.joined(foot_of(recording, CORNER, second), waist, [second, CORNER])
    assert off_m(both, recording) < 3.0
    assert (np.diff(both.position_s) > 0).all()


def test_without_holes_it_is_the_foots_walk(recording: Recording, waist: StepTrack) -> None:
    whole = foot_of(recording)
    same = pdr.joined(whole, waist, [])
    assert same.source == FOOT
    np.testing.assert_array_equal(same.position, whole.position)


def test_what_cannot_be_joined_is_refused(recording: Recording, waist: StepTrack) -> None:
    broken = foot_of(recording, CORNER)
    with pytest.raises(SolenavError, match="the foot's hole lasts from"):
        pdr.joined(broken, waist.after(100.0), [CORNER])
    with pytest.raises(SolenavError, match="fewer than 4 steps of foot and waist before the hole"):
        pdr.joined(broken, waist, [Hole(17.0, 18.0, resumed=True)])


def test_holes_are_what_the_board_lost_not_the_link(tmp_path: Path) -> None:
    whole = tmp_path / "whole.solcap"
    importing.to_capture(simulate("loop", seed=4).first(10.0), whole)
    loaded = capture.load(whole)
    assert pdr.holes(loaded) == []
    samples = replaying.samples_of(loaded)
    # Rows that the board lost: 15 (GAP) at 4 s, 100 (RESUMED) at 7 s; ticks go on without them.
    kept = np.ones(len(samples.counts), bool)
    kept[800:815] = kept[1400:1500] = False
    parts = {name: getattr(samples, name)[kept] for name in vars(samples)}
    torn = tmp_path / "torn.solcap"
    replaying.write_samples(
        torn,
        replaying.Samples(**parts),
        loaded.params[0][1],
        text="torn",
        notes={},
        truth=None,
    )
    found = pdr.holes(capture.load(torn))
    assert [h.resumed for h in found] == [False, True]
    assert [h.begin_s for h in found] == pytest.approx([3.995, 6.995], abs=0.02)
    assert [h.end_s - h.begin_s for h in found] == pytest.approx([0.08, 0.505], abs=0.02)
    # The link loses frames: their ticks are missing with them.
    lost = replace(loaded, samples=loaded.samples.where(kept))
    assert pdr.holes(lost) == []


LATER = 5.0


def test_the_command_bridges_a_sensor_that_was_unplugged(
    recording: Recording, phone: Recording, tmp_path: Path
) -> None:
    """The real firmware on the simulated board, and a phone that began to record 5 s later."""
    walk = recording.first(50.0)
    counts = mpu9150.to_counts(walk.accel, walk.gyro).counts[:, :6]
    stamps = np.rint(walk.time_s * 1e6).astype(np.int64)
    samples = Samples(stamps, counts, np.zeros(len(counts), np.int16))
    gone = {"kind": "gone", "at": round(CORNER.begin_s * 1e6), "for": 8_000_000}
    data = bytearray()
    with (
        SimulatedBoard(samples, {}, faults=(gone,)) as board,
        open_port(board.port) as port,
        contextlib.suppress(PortVanished),
    ):
        while True:
            data += read_some(port)
    run = tmp_path / "run.solcap"
    with capture.CaptureWriter(run, flush=False) as writer:
        writer.write(0.0, bytes(data))
    trace = tmp_path / "phone.txt"
    with trace.open("w") as lines:
        for t, force, rate in zip(phone.time_s, phone.accel, phone.gyro, strict=True):
            if LATER <= t < 50.0:
                for kind, values in (("ACCELEROMETER", force), ("GYROSCOPE", rate)):
                    cells = "\t".join(f"{v:.6f}" for v in values)
                    lines.write(f"{round(1000 * t)}\tTYPE_{kind}\t{cells}\t3\n")
    steps = tmp_path / "steps.csv"
    words = ["pdr", trace, "-f", "indoor", "--foot", run, "--later", LATER, "-o", steps]
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, (done.output, done.exception)
    both, _ = step_table.read(steps)
    assert both.source == "foot and waist"
    assert off_m(pdr.of_capture(capture.load(run)), recording) > 5.0
    assert off_m(both, recording) < 2.0
