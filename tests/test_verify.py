"""Verification: equal runs are proven, any other bit is found, gaps are counted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solenav import capture, link, replaying
from solenav.errors import SolenavError
from solenav.verification import Report, verify
from solenav_core import messages
from solenav_core.params import retimed

Edit = Callable[[link.Frame], "list[link.Frame]"]


def rewritten(source: Path, target: Path, edit: Edit) -> Path:
    """The capture with every frame passed through `edit`."""
    reader = link.FrameReader()
    with capture.CaptureWriter(target, flush=False) as writer:
        for arrival, data in capture.read_records(source):
            for item in reader.feed(data):
                assert isinstance(item, link.Frame)
                writer.write(arrival, b"".join(link.encode(*frame) for frame in edit(item)))
    return target


def check(path: Path) -> Report:
    return verify(capture.load(path), "fast")


def flip(frame: link.Frame, byte: int, mask: int = 1) -> link.Frame:
    payload = bytearray(frame.payload)
    payload[byte] ^= mask
    return frame._replace(payload=bytes(payload))


def test_a_replayed_walk_is_proven_on_every_tick(replayed: Path) -> None:
    report = check(replayed)
    assert report.verified
    assert report.replayed == report.covered_ticks == report.samples == 6000
    assert report.compared["POSE"] == 6000 - 199
    assert report.compared["ALIGN"] == 1
    assert report.compared["SNAPSHOT"] == 3
    assert report.compared["STEP"] > 5


def test_pure_proves_what_fast_wrote(replayed: Path, tmp_path: Path) -> None:
    short = rewritten(replayed, tmp_path / "short.solcap", lambda f: [f] if f.tick <= 1000 else [])
    report = verify(capture.load(short), "pure")
    assert report.verified and report.covered_ticks == 1000


@pytest.mark.parametrize(
    ("kind", "byte", "stage", "field"),
    [
        (messages.POSE, 0, "strapdown", "position[0]"),
        (messages.POSE, 20, "strapdown", "velocity[1]"),
        (messages.POSE, 43, "detector", "flags"),
        (messages.POSE, 44, "forest", "motion"),
        (messages.POSE, 45, "particles", "threshold"),
        (messages.POSE, messages.SIZES[messages.POSE] - 1, "state", "digest"),
        (messages.STEP, 3, "steps", "displacement[0]"),
        (messages.ALIGN, 16, "strapdown", "bias[0]"),
    ],
)
def test_one_flipped_bit_is_found_with_tick_stage_and_field(
    replayed: Path, tmp_path: Path, kind: int, byte: int, stage: str, field: str
) -> None:
    ticks = [f.tick for f in frames_of(replayed) if f.kind == kind]
    target = ticks[len(ticks) // 2]
    path = rewritten(
        replayed,
        tmp_path / "x.solcap",
        lambda f: [flip(f, byte)] if (f.kind, f.tick) == (kind, target) else [f],
    )
    report = check(path)
    assert not report.verified
    assert report.difference is not None
    assert (report.difference.tick, report.difference.stage) == (target, stage)
    assert report.difference.field == field
    assert report.difference.capture != report.difference.host


def frames_of(path: Path) -> list[link.Frame]:
    reader = link.FrameReader()
    items = [item for _t, data in capture.read_records(path) for item in reader.feed(data)]
    return [item for item in items if isinstance(item, link.Frame)]


def test_a_flipped_bit_in_a_sample_is_found_at_its_tick(replayed: Path, tmp_path: Path) -> None:
    path = rewritten(
        replayed,
        tmp_path / "x.solcap",
        lambda f: [flip(f, 4)] if (f.kind, f.tick) == (messages.SAMPLE, 4321) else [f],
    )
    report = check(path)
    assert report.difference is not None and report.difference.tick == 4321


def test_a_flipped_bit_in_a_snapshot_names_the_word(replayed: Path, tmp_path: Path) -> None:
    done = []

    def edit(frame: link.Frame) -> list[link.Frame]:
        if frame.kind == messages.SNAPSHOT and not done and frame.tick == 4000:
            done.append(frame)
            return [flip(frame, 4)]
        return [frame]

    report = check(rewritten(replayed, tmp_path / "x.solcap", edit))
    assert report.difference is not None
    # Offset and total take the payload's first four bytes: word 0 is the tick.
    assert (report.difference.message, report.difference.field) == ("SNAPSHOT", "TICK")


def test_after_a_gap_it_goes_on_from_the_next_snapshot(replayed: Path, tmp_path: Path) -> None:
    lost = range(2500, 2511)
    path = rewritten(
        replayed,
        tmp_path / "x.solcap",
        lambda f: [] if f.kind == messages.SAMPLE and f.tick in lost else [f],
    )
    report = check(path)
    assert report.verified
    assert (report.gaps, report.missing_samples) == (1, 11)
    # The next snapshot is at tick 4000.
    assert report.unchecked_samples == 4000 - 2510
    assert report.covered_ticks == 6000 - 11 - (4000 - 2510)


def test_joining_in_late_starts_at_the_first_snapshot(replayed: Path, tmp_path: Path) -> None:
    path = rewritten(
        replayed,
        tmp_path / "x.solcap",
        lambda f: [] if f.kind != messages.PARAMS and f.tick < 1500 else [f],
    )
    report = check(path)
    assert report.verified
    assert report.missing_samples == 1499
    assert report.covered_ticks == 6000 - 2000


def test_two_runs_in_one_capture_are_both_proven(replayed: Path, tmp_path: Path) -> None:
    """A start command begins again at tick 1."""
    path = tmp_path / "x.solcap"
    with capture.CaptureWriter(path, flush=False) as writer:
        for _ in range(2):
            for arrival, data in capture.read_records(replayed):
                writer.write(arrival, data)
    report = check(path)
    assert report.verified and report.covered_ticks == 12000


def test_other_parameters_are_another_run(replayed: Path, tmp_path: Path) -> None:
    at = 4 * messages.NAMES.index("R")

    def edit(frame: link.Frame) -> list[link.Frame]:
        if frame.kind == messages.PARAMS:
            inside = messages.SIZES[messages.PARAMS] + at - link.unpack(frame)["offset"]
            if 0 <= inside < len(frame.payload):
                return [flip(frame, inside + 1, 0x40)]
        return [frame]

    path = rewritten(replayed, tmp_path / "x.solcap", edit)
    report = check(path)
    # The first tick after the static start shows it already.
    assert report.difference is not None and report.difference.tick == 201


def test_parameters_that_change_on_the_way_are_followed(replayed: Path, tmp_path: Path) -> None:
    """As a board does that has learned its sensor's clock."""
    changed = capture.load(replayed).params[0][1][:]
    retimed(changed, changed[:], round(256 * 5000 * 1.02))
    head = len(changed.tobytes()).to_bytes(2, "little")
    parts = [(at, changed.tobytes()[at : at + 192]) for at in range(0, 4 * len(changed), 192)]

    def edit(frame: link.Frame) -> list[link.Frame]:
        if (frame.kind, frame.tick) != (messages.SAMPLE, 3001):
            return [frame]
        payloads = [at.to_bytes(2, "little") + head + part for at, part in parts]
        return [link.Frame(messages.PARAMS, 0, 3000, p) for p in payloads] + [frame]

    board = capture.load(rewritten(replayed, tmp_path / "board.solcap", edit))
    run = tmp_path / "run.solcap"
    replaying.replay(board, run, engine="fast")
    report = check(run)
    assert report.verified and report.covered_ticks == 6000

    ends = [capture.load(path).poses.rows["digest"] for path in (replayed, run)]
    differs = np.flatnonzero(ends[0] != ends[1])
    assert 199 + differs[0] == 3000  # rows count from the first pose, on tick 200


def test_samples_alone_prove_nothing_and_it_says_so(walk: Path) -> None:
    with pytest.raises(SolenavError, match="holds no ALIGN, POSE") as caught:
        check(walk)
    assert caught.value.exit_code == 2


def test_no_samples_cannot_be_verified(replayed: Path, tmp_path: Path) -> None:
    path = rewritten(
        replayed, tmp_path / "x.solcap", lambda f: [] if f.kind == messages.SAMPLE else [f]
    )
    with pytest.raises(SolenavError, match="no samples"):
        check(path)


def test_replay_says_the_same_on_every_engine(walk: Path, tmp_path: Path) -> None:
    short = rewritten(walk, tmp_path / "in.solcap", lambda f: [f] if f.tick <= 700 else [])
    outputs = []
    for engine in ("pure", "fast"):
        out = tmp_path / f"{engine}.solcap"
        replaying.replay(capture.load(short), out, engine=engine)
        outputs.append([f for f in frames_of(out) if f.kind != messages.HELLO])
    assert outputs[0] == outputs[1]


def test_replay_keeps_samples_and_truth(walk: Path, replayed: Path) -> None:
    before, after = capture.load(walk), capture.load(replayed)
    assert np.array_equal(before.sample_counts, after.sample_counts)
    assert before.truth is not None and after.truth is not None
    assert np.array_equal(before.truth.position_enu, after.truth.position_enu)
