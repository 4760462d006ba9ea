"""Damaged captures, streams and files beside them: nothing whole is lost, nothing wrong taken."""

from __future__ import annotations

import json
import math
import random
import struct
import sys
from array import array
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli import solenav
from hypothesis import assume, given
from hypothesis import strategies as st

from solenav import capture, engines, link, parameters
from solenav.capture import file as capture_file
from solenav.capture import sidecar
from solenav.capture.summary import summary
from solenav.errors import SolenavError
from solenav.evaluation import evaluate
from solenav.verification import verify
from solenav_core import layout, messages, navigator
from solenav_tools.monitor.live import Live
from solenav_tools.monitor.terminal import panel

sys.path.insert(0, str(Path(__file__).parents[1] / "tools" / "faults"))
import host

HEADER = struct.Struct("<dH")


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> host.Subject:
    return host.small_subject(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="session")
def subjects(small: host.Subject) -> list[host.Subject]:
    """The small capture a tick a record, and in the pieces that a port gives."""
    return [small, host.in_pieces(small)]


# The campaign in short; `python tools/faults` runs all of it.


@pytest.mark.parametrize("maker", host.MAKERS, ids=lambda maker: maker.__name__)
def test_every_kind_of_damage_is_survived(
    subjects: list[host.Subject], maker: host.Maker, tmp_path: Path
) -> None:
    rng = random.Random(2026)
    for i in range(8):
        subject = subjects[i % 2]
        outcome = host.examine(subject, maker(subject, rng), tmp_path)
        assert outcome.clean, outcome


@pytest.mark.parametrize("maker", [host.bit_flips, host.reordered, host.accident])
def test_damage_can_be_drawn_and_replayed(
    small: host.Subject, maker: host.Maker, tmp_path: Path
) -> None:
    outcome = host.examine(small, maker(small, random.Random(1)), tmp_path, draw=True)
    assert outcome.clean, outcome


def test_a_file_cut_anywhere_gives_every_whole_frame(small: host.Subject, tmp_path: Path) -> None:
    for outcome in host.cuts(small, range(0, len(small.file), 331), tmp_path):
        assert outcome.clean, outcome


def test_damage_beside_a_capture_is_a_result_or_an_error_with_a_remedy(
    small: host.Subject, tmp_path: Path
) -> None:
    for outcome in host.beside(small, 3, 60, tmp_path):
        assert outcome.clean, outcome


def test_the_same_seed_is_the_same_campaign(small: host.Subject) -> None:
    first, second = (list(host.corruptions(small, 4, 40)) for _ in range(2))
    assert first == second
    assert first != list(host.corruptions(small, 5, 40))


# Record headers.


def whole_frames(path: Path) -> list[link.Frame]:
    reader = link.FrameReader()
    items = [item for _t, data in capture.read_records(path) for item in reader.feed(data)]
    return [item for item in items if isinstance(item, link.Frame)]


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@given(which=st.integers(0, 10_000), length=st.integers(0, 65535), data=st.data())
def test_a_wrong_record_length_costs_no_frame(
    subjects: list[host.Subject],
    tmp_path_factory: pytest.TempPathFactory,
    which: int,
    length: int,
    data: st.DataObject,
) -> None:
    subject = data.draw(st.sampled_from(subjects))
    content = bytearray(subject.file)
    at = subject.headers[which % len(subject.headers)]
    # One that leads to another record to the byte can't be told from a right one.
    assume(at + 10 + length not in subject.headers)
    content[at + 8 : at + 10] = length.to_bytes(2, "little")
    path = written(tmp_path_factory.mktemp("length") / "x.solcap", bytes(content))
    assert whole_frames(path) == [frame for _start, _stop, frame in subject.frames]


@given(at=st.integers(18, 5000), size=st.integers(1, 20), insert=st.booleans())
def test_bytes_more_or_less_cost_only_the_frames_that_they_hit(
    subjects: list[host.Subject],
    tmp_path_factory: pytest.TempPathFactory,
    at: int,
    size: int,
    insert: bool,
) -> None:
    edit = host.Edit(at, at, b"\x55" * size) if insert else host.Edit(at, at + size, b"")
    for subject in subjects:
        damage = host.Damage("some bytes", [edit])
        path = tmp_path_factory.mktemp("bytes") / "x.solcap"
        found = whole_frames(written(path, subject.damaged(damage)))
        assert all(frame in found for frame in subject.untouched(damage))


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 1e300])
def test_wrong_arrival_times_cost_nothing_and_make_sound_json(
    small: host.Subject, tmp_path: Path, value: float
) -> None:
    records = [(value, data) for _arrival, data in small.records]
    found = capture.load(written(tmp_path / "x.solcap", host.packed(records)))
    assert sum(found.counts.values()) == len(small.frames)
    json.dumps(summary(found), allow_nan=False)


@pytest.mark.parametrize("shift", [-3600.0, -0.5, 1e6])
def test_a_clock_that_is_set_costs_nothing(
    small: host.Subject, tmp_path: Path, shift: float
) -> None:
    half = len(small.records) // 2
    records = small.records[:half]
    records = records + [(arrival + shift, data) for arrival, data in small.records[half:]]
    path = written(tmp_path / "x.solcap", host.packed(records))
    assert capture.read_records(path) == records


def test_garbage_for_a_file_ends(tmp_path: Path) -> None:
    content = capture_file.MAGIC + random.Random(1).randbytes(300_000)
    got = capture.load(written(tmp_path / "x.solcap", content))
    assert len(got.samples) == 0


# The stream.


def statuses(count: int) -> list[bytes]:
    payload = bytes(range(1, messages.SIZES[messages.STATUS] + 1))
    return [link.encode(messages.STATUS, tick, tick, payload) for tick in range(1, count + 1)]


def ticks_in(stream: bytes) -> list[int]:
    items = link.FrameReader().feed(stream)
    return [item.tick for item in items if isinstance(item, link.Frame)]


@given(at=st.integers(0, 3), byte=st.one_of(st.none(), st.integers(1, 255)))
def test_a_lost_delimiter_costs_no_frame_after_it(at: int, byte: int | None) -> None:
    frames = statuses(5)
    frames[at] = frames[at][:-1] + (b"" if byte is None else bytes([byte]))
    assert ticks_in(b"".join(frames)) == [1, 2, 3, 4, 5]


@given(noise=st.binary(max_size=3000), cut=st.integers(1, 4000))
def test_noise_before_a_frame_does_not_cost_it(noise: bytes, cut: int) -> None:
    stream = noise + statuses(1)[0]
    reader = link.FrameReader()
    items = [*reader.feed(stream[:cut]), *reader.feed(stream[cut:])]
    assert [item.tick for item in items if isinstance(item, link.Frame)] == [1]


# Frames that their neighbours contradict.

Change = Callable[[link.Frame], link.Frame]


def with_frame(subject: host.Subject, path: Path, kind: int, change: Change) -> Path:
    """The subject's capture with one frame of a kind, in its middle, changed; its CRC fits."""
    of_kind = [frame for _start, _stop, frame in subject.frames if frame.kind == kind]
    chosen = of_kind[len(of_kind) // 2]
    frames = [
        change(frame) if frame == chosen else frame for _start, _stop, frame in subject.frames
    ]
    stream = b"".join(link.encode(*frame) for frame in frames)
    return written(
        path, host.packed([(0.0, stream[i : i + 999]) for i in range(0, len(stream), 999)])
    )


def field(kind: int, name: str) -> int:
    """Where a field begins in a payload."""
    at = 0
    for key, code, count, _format, _meaning in link.FIELDS[kind]:
        if key == name:
            return at
        at += struct.calcsize(f"<{count}{code}")
    raise KeyError(name)


def overwritten(name: str, value: bytes) -> Change:
    def change(frame: link.Frame) -> link.Frame:
        at = field(frame.kind, name)
        payload = frame.payload[:at] + value + frame.payload[at + len(value) :]
        return frame._replace(payload=payload)

    return change


@pytest.mark.parametrize(
    ("kind", "change", "reason"),
    [
        (messages.SAMPLE, lambda f: f._replace(tick=3_000_000_000), "tick out of order"),
        (messages.SAMPLE, lambda f: f._replace(tick=1), "tick out of order"),
        (messages.POSE, lambda f: f._replace(tick=0), "tick out of order"),
    ],
)
def test_a_frame_whose_tick_its_neighbours_contradict_is_left_out(
    small: host.Subject, tmp_path: Path, kind: int, change: Change, reason: str
) -> None:
    found = capture.load(with_frame(small, tmp_path / "x.solcap", kind, change))
    assert found.damaged == {reason: 1}
    assert evaluate(found).restarts == 0
    assert verify(found, "fast").difference is None


@pytest.mark.parametrize(
    ("name", "value"),
    [("position", b"\0\0\0\x44"), ("cell", b"\x05"), ("velocity", b"\0\0\0\x44")],
)
def test_a_pose_that_leaps_is_measured_by_nobody_and_found_by_verify(
    small: host.Subject, tmp_path: Path, name: str, value: bytes
) -> None:
    path = with_frame(small, tmp_path / "x.solcap", messages.POSE, overwritten(name, value))
    found = capture.load(path)
    result = evaluate(found)
    assert result.left_out == 1
    assert result.poses == len(found.poses) - 1
    difference = verify(found, "fast").difference
    assert difference is not None and difference.field.startswith(name)


def test_a_time_stamp_gone_astray_shifts_no_other(small: host.Subject, tmp_path: Path) -> None:
    change = overwritten("time", b"\xff\xff\xff\x7f")
    found = capture.load(with_frame(small, tmp_path / "x.solcap", messages.SAMPLE, change))
    sound = capture.load(written(tmp_path / "y.solcap", small.file))
    ticks = sound.poses.tick
    assert np.allclose(found.time_of_tick(ticks), sound.time_of_tick(ticks))
    assert summary(found)["samples"] == summary(sound)["samples"]


def test_a_sound_capture_has_nothing_left_out(subjects: list[host.Subject], tmp_path: Path) -> None:
    for subject in subjects:
        found = capture.load(written(tmp_path / "x.solcap", subject.file))
        assert not found.damaged
        assert verify(found, "fast").verified


def test_frames_that_come_twice_count_once(small: host.Subject, tmp_path: Path) -> None:
    start, stop = small.frames[200][0], small.frames[230][1]
    stream = small.stream[:stop] + small.stream[start:]
    found = capture.load(written(tmp_path / "x.solcap", host.packed([(0.0, stream)])))
    assert np.array_equal(np.diff(found.samples.tick), np.ones(len(found.samples) - 1))
    assert set(found.damaged) == {"repeated"}
    assert evaluate(found).restarts == 0


def test_a_damaged_step_count_changes_no_sum(small: host.Subject, tmp_path: Path) -> None:
    sound = evaluate(capture.load(written(tmp_path / "y.solcap", small.file)))
    path = with_frame(
        small, tmp_path / "x.solcap", messages.POSE, overwritten("steps", b"\x99\x19")
    )
    assert evaluate(capture.load(path)).steps == sound.steps


# What would lead compiled kernels out of their arrays, or a reader out of its bounds.


def test_parameters_out_of_range_are_refused(small: host.Subject, tmp_path: Path) -> None:
    at = 4 * messages.NAMES.index("WINDOW")
    path = with_frame(small, tmp_path / "x.solcap", messages.PARAMS, lambda f: f)
    found = capture.load(path)
    values = bytearray(found.params[0][1].tobytes())
    values[at : at + 4] = (1_000_000).to_bytes(4, "little")
    found.params[0] = (found.params[0][0], array("i", values))
    with pytest.raises(SolenavError, match="WINDOW = 1000000 is outside"):
        verify(found, "fast")


@pytest.mark.parametrize("name", ["RING_HEAD", "RING_FILL", "RNG"])
@pytest.mark.parametrize("value", [-1, 1 << 20])
def test_a_snapshot_with_an_impossible_index_is_refused(name: str, value: int) -> None:
    engine = engines.create("pure", parameters.to_integers(parameters.Settings(), 200.0))
    state = navigator.new_state()
    state[layout.offsets(layout.STATE_FIELDS)[name]] = value
    with pytest.raises(ValueError, match="is outside 0 to"):
        engine.restore(state.tobytes())


def test_verify_does_not_go_on_from_a_snapshot_that_a_digest_contradicts(
    small: host.Subject, tmp_path: Path
) -> None:
    found = capture.load(written(tmp_path / "x.solcap", small.file))
    order, tick, state = found.snapshots[0]
    found.snapshots[0] = (order, tick, state[:-4] + b"\1\2\3\4")
    gap = (found.samples.tick < tick - 30) | (found.samples.tick > tick - 20)
    table = found.samples
    found.samples = replace(
        table, rows=table.rows[gap], tick=table.tick[gap], order=table.order[gap]
    )
    report = verify(found, "fast")
    assert report.difference is None
    assert report.unchecked_samples >= 20


def test_a_capture_of_gaps_alone_is_verified_in_bounded_work(
    small: host.Subject, tmp_path: Path
) -> None:
    """Every tick backwards: as many gaps as samples."""
    found = capture.load(written(tmp_path / "x.solcap", small.file))
    rows = np.repeat(found.samples.rows, 500)
    count = len(rows)
    found.samples = replace(
        found.samples, rows=rows, tick=np.arange(count, 0, -1) + 10, order=np.arange(count)
    )
    report = verify(found, "fast")
    assert not report.verified
    assert report.unchecked_samples == count


def test_a_replay_over_lost_samples_says_that_its_poses_are_not_the_boards(
    small: host.Subject, tmp_path: Path
) -> None:
    samples = [frame for frame in small.frames if frame[2].kind == messages.SAMPLE]
    start, stop, _frame = samples[80]
    stream = host.edited(small.stream, [host.Edit(start, stop, b"")])
    path = written(tmp_path / "x.solcap", host.packed([(0.0, stream)]))
    sound = written(tmp_path / "y.solcap", small.file)
    for file, says in ((path, "1 samples never arrived"), (sound, "")):
        done = solenav("replay", file, "-o", tmp_path / "out.solcap", "--engine", "fast")
        assert done.returncode == 0 and says in done.stderr
        assert bool(done.stderr) == bool(says)


# Beside the capture.


def test_a_sidecar_nested_without_end_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "x.solcap"
    sidecar.sidecar_path(path).write_text("[" * 100_000)
    with pytest.raises(SolenavError, match="can't be read") as caught:
        sidecar.read_sidecar(path)
    assert caught.value.remedy


def test_half_a_character_in_a_sidecar_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "x.solcap"
    sidecar.sidecar_path(path).write_text(r'{"name": "\ud800"}')
    with pytest.raises(SolenavError, match="can't be read"):
        sidecar.read_sidecar(path)


HEAD = "time_s,east_m,north_m,up_m\r\n"


@pytest.mark.parametrize(
    "content",
    [
        HEAD + "1,2,3,4\r\nnan,2,3,4\r\n",
        HEAD + "2,2,3,4\r\n1,2,3,4\r\n",
        HEAD + "1,inf,3,4\r\n",
        HEAD + "1,1e308,3,4\r\n",
        HEAD + "1,2\r\n2,3,4,5\r\n",
        HEAD + "1,2,3,4,5\r\n",
        HEAD + '"' + "x" * 200_000 + "\r\n",
        "a\0b\r\n",
    ],
)
def test_a_damaged_truth_is_never_taken_for_a_truth(tmp_path: Path, content: str) -> None:
    path = tmp_path / "x.solcap"
    sidecar.truth_path(path).write_text(content, newline="")
    with pytest.raises(SolenavError, match="no truth table"):
        sidecar.read_truth(path)


@pytest.mark.parametrize("cut", [1, 2, 3, 5, 8])
def test_a_truth_cut_off_gives_its_whole_rows(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "x.solcap"
    text = HEAD + "1,2,3,4.5\r\n2,3,4,5.25\r\n"
    sidecar.truth_path(path).write_text(text[:-cut], newline="")
    truth = sidecar.read_truth(path)
    assert truth is not None and truth.position_enu.tolist() == [[2.0, 3.0, 4.5]]


# The live view.


@pytest.mark.parametrize("text", ["[/]", "[bold", "[red]x[/blue]"])
def test_whatever_a_board_logs_can_be_shown(text: str) -> None:
    view = Live()
    view.take(link.Frame(messages.LOG, 0, 1, b"\2" + text.encode()), 0.0)
    panel(view, "port", 0.0)
    assert text in view.line()


def test_a_tick_gone_astray_does_not_stay_in_the_view() -> None:
    view = Live()
    payload = bytes(messages.SIZES[messages.STATUS])
    for tick in (10, 4_000_000_000, 11):
        view.take(link.Frame(messages.STATUS, 0, tick, payload), 0.0)
    assert view.tick == 11
