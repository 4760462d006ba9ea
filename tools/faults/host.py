"""The host's half of the fault campaign: damaged captures, streams, sidecars and truths.

`Subject` is a sound capture taken apart: which bytes of its file belong to which frame. A damage is
a list of edits, of the file or of the stream in it, so for each frame it is known whether it was
hit. `examine` runs everything that reads captures over the damaged one and says what went wrong.
"""

from __future__ import annotations

import json
import math
import random
import signal
import struct
import tempfile
import traceback
from binascii import crc_hqx
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np
from cobs import cobs
from numpy.typing import NDArray

from solenav import capture, importing, link, parameters, replaying
from solenav.capture import sidecar
from solenav.capture.contents import Capture
from solenav.capture.file import MAGIC
from solenav.capture.summary import summary
from solenav.errors import SolenavError
from solenav.evaluation import evaluate
from solenav.plotting import plot
from solenav.recording import Recording
from solenav.sim.scenario import simulate
from solenav.verification import verify
from solenav_core import messages
from solenav_tools.monitor.live import Live
from solenav_tools.monitor.terminal import panel

ENGINE = "fast"
GUARD_S = 20.0
"""No single case may take longer: it hangs."""

ACCIDENT = "CRC fits by accident"

_HEADER = struct.Struct("<dH")
_NEAR = 8  # records
_TABLES = {
    messages.SAMPLE: "samples",
    messages.POSE: "poses",
    messages.STEP: "steps",
    messages.ALIGN: "aligns",
}


class Edit(NamedTuple):
    """Bytes `start` to `stop` replaced by `new`."""

    start: int
    stop: int
    new: bytes


class Damage(NamedTuple):
    """What is done to a subject: edits of its file, or of its stream."""

    kind: str
    edits: list[Edit]
    of_stream: bool = False
    moves: bool = False  # frames are repeated or out of their order: that looks like restarts


@dataclass
class Subject:
    """A sound capture in pieces. `records` are the pieces of `stream` that its file holds."""

    name: str
    records: list[tuple[float, bytes]]
    notes: str = "{}"
    truth: str = ""

    @cached_property
    def stream(self) -> bytes:
        return b"".join(data for _arrival, data in self.records)

    @cached_property
    def file(self) -> bytes:
        return packed(self.records)

    @cached_property
    def where(self) -> NDArray[np.int64]:
        """The place in the file of each byte of the stream, (n,)."""
        places = []
        at = len(MAGIC)
        for _arrival, data in self.records:
            at += _HEADER.size
            places.append(np.arange(at, at + len(data)))
            at += len(data)
        return np.concatenate(places)

    @cached_property
    def headers(self) -> list[int]:
        """Where the file's record headers begin."""
        at = len(MAGIC)
        out = []
        for _arrival, data in self.records:
            out.append(at)
            at += _HEADER.size + len(data)
        return out

    @cached_property
    def frames(self) -> list[tuple[int, int, link.Frame]]:
        """Every frame with the stream's bytes that it takes, its delimiter among them."""
        out = []
        start = 0
        for stuffed in self.stream.split(b"\0")[:-1]:
            stop = start + len(stuffed) + 1
            if stuffed:
                frame = link.decode(stuffed)
                assert isinstance(frame, link.Frame), "the subject itself is damaged"
                out.append((start, stop, frame))
            start = stop
        return out

    @cached_property
    def known(self) -> set[tuple[int, int, bytes]]:
        return {key(frame) for _start, _stop, frame in self.frames}

    def untouched(self, damage: Damage) -> list[link.Frame]:
        """The frames that the damage leaves whole, in their order.

        Where two records near each other are broken, nothing says where the headers between them
        are: frames that reach over those count as hit.
        """
        places = self.where if not damage.of_stream else np.arange(len(self.stream))
        doubtful = [] if damage.of_stream else self._doubtful(damage)
        out = []
        for start, stop, frame in self.frames:
            low, high = int(places[start]), int(places[stop - 1])
            if any(code == "*" for _name, code, *_rest in link.FIELDS[frame.kind]):
                # Where it begins can't be told without the delimiter before it.
                low = int(places[start - 1]) if start else low - 1
            hit = any(low < header <= high for header in doubtful)
            for edit in damage.edits:
                if edit.stop > edit.start:
                    hit = hit or (edit.start <= high and edit.stop > low)
                else:
                    hit = hit or low < edit.start <= high
            if not hit:
                out.append(frame)
        return out

    def _doubtful(self, damage: Damage) -> list[int]:
        """Headers between two broken records that are near each other."""
        broken = set()
        for edit in damage.edits:
            first = bisect_right(self.headers, edit.start) - 1
            last = bisect_right(self.headers, max(edit.start, edit.stop - 1)) - 1
            for record in range(max(0, first), last + 1):
                in_header = edit.start < self.headers[record] + _HEADER.size
                if in_header or record > first or len(edit.new) != edit.stop - edit.start:
                    broken.add(record)
        out = []
        for one, next_one in pairwise(sorted(broken)):
            if next_one - one <= _NEAR:
                out += self.headers[one : next_one + 1]
        return out

    def damaged(self, damage: Damage) -> bytes:
        """The file after the damage."""
        if not damage.of_stream:
            return edited(self.file, damage.edits)
        stream = edited(self.stream, damage.edits)
        size = 64
        return packed(
            [(i * 1e-3, stream[at : at + size]) for i, at in enumerate(range(0, len(stream), size))]
        )


def key(frame: link.Frame) -> tuple[int, int, bytes]:
    return frame.kind, frame.tick, frame.payload


def packed(records: list[tuple[float, bytes]]) -> bytes:
    """A capture file of these records."""
    return MAGIC + b"".join(_HEADER.pack(t, len(data)) + data for t, data in records)


def edited(data: bytes, edits: list[Edit]) -> bytes:
    out = []
    at = 0
    for edit in sorted(edits):
        out += [data[at : edit.start], edit.new]
        at = edit.stop
    return b"".join([*out, data[at:]])


def small_subject(folder: Path) -> Subject:
    """A sound capture of two seconds that has every message."""
    return _replayed(folder, 15.9)


def subjects(folder: Path) -> list[Subject]:
    """Two sound captures: as `replay` writes them, a tick a record, and as a port gives bytes."""
    single = _replayed(folder, 18.3)
    return [single, in_pieces(single)]


def in_pieces(subject: Subject) -> Subject:
    """The same stream in the pieces of any size in which a port gives it, at the time of day."""
    rng = random.Random(11)
    pieces = []
    at, now = 0, 1.7e9
    while at < len(subject.stream):
        size = rng.choice((7, 31, 64, 255, 256, 257, 600))
        pieces.append((now, subject.stream[at : at + size]))
        at += size
        now += rng.uniform(0.001, 0.05)
    return replace(subject, name="as a port gives it", records=pieces)


def _replayed(folder: Path, stop_s: float) -> Subject:
    """The core over the first steps of a walk, from standing."""
    settings = parameters.Settings(align_s=0.3)
    walk = folder / "walk.solcap"
    importing.to_capture(
        stretch(simulate("loop", seed=5, rate_hz=100.0), 14.3, stop_s), walk, settings
    )
    run = folder / "run.solcap"
    replaying.replay(capture.load(walk), run, engine=ENGINE, snapshot_s=1.0)
    notes = sidecar.sidecar_path(walk).read_text(encoding="utf-8")
    truth = sidecar.truth_path(walk).read_text(encoding="utf-8")
    return Subject("a tick a record", capture.read_records(run), notes, truth)


def stretch(recording: Recording, start_s: float, stop_s: float) -> Recording:
    """The recording between two times, as if it began there."""
    recording = recording.first(stop_s)
    truth = recording.truth
    assert truth is not None
    kept, known = recording.time_s >= start_s, truth.time_s >= start_s
    return replace(
        recording,
        time_s=recording.time_s[kept] - start_s,
        accel=recording.accel[kept],
        gyro=recording.gyro[kept],
        mag=None if recording.mag is None else recording.mag[kept],
        truth=replace(
            truth,
            time_s=truth.time_s[known] - start_s,
            position_enu=truth.position_enu[known],
            velocity_enu=None,
            stance=None,
        ),
    )


# How a capture is damaged. Each takes a subject and a random generator.


def bit_flips(subject: Subject, rng: random.Random) -> Damage:
    edits = {}
    for _ in range(rng.choice((1, 1, 2, 5, 40))):
        at = rng.randrange(len(MAGIC), len(subject.file))
        edits[at] = Edit(at, at + 1, bytes([subject.file[at] ^ (1 << rng.randrange(8))]))
    return Damage("bits flipped", list(edits.values()))


def burst(subject: Subject, rng: random.Random) -> Damage:
    at = rng.randrange(len(MAGIC), len(subject.file))
    stop = min(len(subject.file), at + rng.choice((2, 3, 8, 40, 300)))
    return Damage("bytes overwritten", [Edit(at, stop, rng.randbytes(stop - at))])


def inserted(subject: Subject, rng: random.Random) -> Damage:
    at = rng.randrange(len(MAGIC), len(subject.file) + 1)
    return Damage("bytes inserted", [Edit(at, at, rng.randbytes(rng.choice((1, 2, 9, 200, 3000))))])


def deleted(subject: Subject, rng: random.Random) -> Damage:
    at = rng.randrange(len(MAGIC), len(subject.file))
    stop = min(len(subject.file), at + rng.choice((1, 2, 9, 200, 3000)))
    return Damage("bytes deleted", [Edit(at, stop, b"")])


def zeroed(subject: Subject, rng: random.Random) -> Damage:
    at = rng.randrange(len(MAGIC), len(subject.file))
    stop = min(len(subject.file), at + rng.choice((1, 10, 100, 512, 4096)))
    return Damage("run of zeros", [Edit(at, stop, bytes(stop - at))])


def swapped(subject: Subject, rng: random.Random) -> Damage:
    """Two blocks of a file system in each other's place."""
    size = rng.choice((16, 128, 512))
    a, b = sorted(rng.sample(range(len(MAGIC), len(subject.file) - size, size), 2))
    first, second = subject.file[a : a + size], subject.file[b : b + size]
    return Damage(
        "blocks swapped", [Edit(a, a + size, second), Edit(b, b + size, first)], moves=True
    )


def lengths(subject: Subject, rng: random.Random) -> Damage:
    """Record headers with a length of anything, often huge."""
    edits = []
    for at in rng.sample(subject.headers, rng.choice((1, 1, 3))):
        length = rng.choice((0, 1, 65535, rng.randrange(65536)))
        edits.append(Edit(at + 8, at + 10, length.to_bytes(2, "little")))
    return Damage("record length wrong", edits)


def times(subject: Subject, rng: random.Random) -> Damage:
    """Arrival times that are no numbers, infinite, far off."""
    edits = []
    for at in rng.sample(subject.headers, rng.choice((1, 3, len(subject.headers) // 2))):
        value = rng.choice((math.nan, math.inf, -math.inf, -1.0, 1e300, 0.0))
        edits.append(Edit(at, at + 8, struct.pack("<d", value)))
    return Damage("arrival time wrong", edits)


def clock_back(subject: Subject, rng: random.Random) -> Damage:
    """The recorder's clock is set, back or ahead."""
    start = rng.randrange(1, len(subject.headers))
    shift = rng.choice((-0.5, -3600.0, -1e6, 1e6))
    edits = []
    for at, (arrival, _data) in zip(subject.headers[start:], subject.records[start:], strict=True):
        edits.append(Edit(at, at + 8, struct.pack("<d", arrival + shift)))
    return Damage("clock set", edits)


def _some_frames(subject: Subject, rng: random.Random) -> tuple[int, int]:
    first = rng.randrange(len(subject.frames) - 1)
    last = min(len(subject.frames) - 1, first + rng.choice((0, 0, 1, 5, 30)))
    return first, last


def repeated(subject: Subject, rng: random.Random) -> Damage:
    """Frames that come twice."""
    first, last = _some_frames(subject, rng)
    start, stop = subject.frames[first][0], subject.frames[last][1]
    return Damage(
        "frames repeated", [Edit(stop, stop, subject.stream[start:stop])], True, moves=True
    )


def reordered(subject: Subject, rng: random.Random) -> Damage:
    """Frames that come later than those after them."""
    first, last = _some_frames(subject, rng)
    start, stop = subject.frames[first][0], subject.frames[last][1]
    to = subject.frames[min(len(subject.frames) - 1, last + rng.choice((1, 2, 20)))][1]
    moved = subject.stream[stop:to] + subject.stream[start:stop]
    return Damage("frames out of order", [Edit(start, to, moved)], True, moves=True)


def lost(subject: Subject, rng: random.Random) -> Damage:
    """Frames that never came."""
    first, last = _some_frames(subject, rng)
    start, stop = subject.frames[first][0], subject.frames[last][1]
    return Damage("frames lost", [Edit(start, stop, b"")], True)


def foreign(subject: Subject, rng: random.Random) -> Damage:
    """Frames of another schema, of no known type, or of the wrong size, with sound CRCs."""
    at = rng.choice(subject.frames)[0]
    kind = rng.choice([*link.NAMES, rng.randrange(256)])
    body = struct.pack("<BBI", kind, rng.randrange(256), rng.randrange(2**32))
    body += rng.randbytes(rng.randrange(241))
    seed = messages.SCHEMA ^ 0x1234 if kind in link.NAMES else messages.SCHEMA
    if kind in messages.OPEN:
        body = body[: 6 + max(0, messages.SIZES[kind] - 1)]
        seed = 0xFFFF
    return Damage("frames of another schema", [Edit(at, at, _framed(body, seed))], True)


def strange_hello(subject: Subject, rng: random.Random) -> Damage:
    """A board of another version says who it is."""
    at = rng.choice(subject.frames)[0]
    payload = bytearray(rng.randbytes(messages.SIZES[messages.HELLO]))
    payload[:2] = (messages.SCHEMA ^ 1).to_bytes(2, "little")
    text = rng.randbytes(rng.randrange(60))
    frame = link.encode(messages.HELLO, 0, 0, bytes(payload) + text)
    return Damage("HELLO of another schema", [Edit(at, at, frame)], True)


def flood(subject: Subject, rng: random.Random) -> Damage:
    """Noise between frames, without a delimiter or full of them."""
    at = rng.choice(subject.frames)[0]
    size = rng.choice((1, 200, 1000, 20000))
    noise = rng.randbytes(size)
    if rng.random() < 0.5:
        noise = noise.replace(b"\0", b"\1")
    return Damage("noise between frames", [Edit(at, at, noise)], True)


def accident(subject: Subject, rng: random.Random) -> Damage:
    """A frame that was damaged so that its CRC fits: made on purpose, it would take 65536 tries."""
    start, stop, frame = rng.choice(subject.frames)
    body = bytearray(struct.pack("<BBI", *frame[:3]) + frame.payload)
    # The type stays: another one would hardly fit the size.
    at = rng.randrange(1, len(body))
    end = min(len(body), at + rng.choice((1, 2, 4, 20)))
    body[at:end] = rng.randbytes(end - at)
    seed = 0xFFFF if frame.kind in messages.OPEN else messages.SCHEMA
    return Damage(ACCIDENT, [Edit(start, stop, _framed(bytes(body), seed))], True)


def _framed(body: bytes, seed: int) -> bytes:
    return cobs.encode(body + crc_hqx(body, seed).to_bytes(2, "little")) + b"\0"


Maker = Callable[[Subject, random.Random], Damage]
MAKERS: tuple[Maker, ...] = (
    bit_flips,
    burst,
    inserted,
    deleted,
    zeroed,
    swapped,
    lengths,
    times,
    clock_back,
    repeated,
    reordered,
    lost,
    foreign,
    strange_hello,
    flood,
    accident,
)


def corruptions(subject: Subject, seed: int, count: int) -> Iterator[Damage]:
    """`count` random damages of a subject, the kinds in turn; the same for the same seed."""
    rng = random.Random(seed)
    for i in range(count):
        yield MAKERS[i % len(MAKERS)](subject, rng)


@dataclass
class Outcome:
    """What came of one damaged capture."""

    kind: str
    what: str  # was damaged, and where
    refused: str = ""  # the first reader that refused it, as it should: with what and a remedy
    missing: int = 0  # frames that the damage left whole and that weren't delivered
    accidents: int = 0  # frames delivered that nobody sent
    caught: bool = False  # `verify` reports what an accident changed, or refuses
    unnoticed: bool = False  # an accident that nothing contradicts: neither order nor digest
    silent: list[str] = field(default_factory=list)
    traceback: str = ""
    hang: bool = False

    @property
    def clean(self) -> bool:
        return not (self.missing or self.silent or self.traceback or self.hang)


class _Hang(BaseException):
    """The guard's time is over. Not an Exception: nothing on the way may swallow it."""


def _ring(_number: int, _frame: FrameType | None) -> None:
    raise _Hang


def examine(subject: Subject, damage: Damage, folder: Path, *, draw: bool = False) -> Outcome:
    """Everything that reads captures over one damaged one. `draw`: `plot` and `replay` as well."""
    places = ", ".join(f"{e.start}:{e.stop} by {len(e.new)}" for e in damage.edits[:5])
    outcome = Outcome(damage.kind, f"{subject.name}, bytes {places}")
    path = folder / "damaged.solcap"
    path.write_bytes(subject.damaged(damage))
    sidecar.sidecar_path(path).write_text(subject.notes, encoding="utf-8")
    sidecar.truth_path(path).write_text(subject.truth, encoding="utf-8", newline="")
    _guarded(outcome, lambda: _read(subject, damage, path, outcome, draw))
    return outcome


def cuts(subject: Subject, sizes: Iterable[int], folder: Path) -> list[Outcome]:
    """The file cut off at each of these sizes, through everything that reads captures."""
    damages = (Damage("file cut off", [Edit(size, len(subject.file), b"")]) for size in sizes)
    return [examine(subject, damage, folder) for damage in damages]


def _guarded(outcome: Outcome, work: Callable[[], None]) -> None:
    """Do it; what it raises and whether it ends goes into the outcome."""
    before = signal.signal(signal.SIGALRM, _ring)
    signal.setitimer(signal.ITIMER_REAL, GUARD_S)
    try:
        work()
    except _Hang:
        outcome.hang = True
    except Exception:
        outcome.traceback = traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _accepted(outcome: Outcome, name: str, work: Callable[[], Any]) -> Any:
    """What the reader returns; None where it refuses with a SolenavError that says what to do."""
    try:
        return work()
    except SolenavError as error:
        if not error.remedy:
            raise
        outcome.refused = outcome.refused or f"{name}: {error.message}"
        return None


def _read(subject: Subject, damage: Damage, path: Path, outcome: Outcome, draw: bool) -> None:
    found = _accepted(outcome, "load", lambda: capture.load(path))
    if found is None:
        # Only where the file's first bytes are damaged, or nothing of it is left.
        if path.read_bytes().startswith(MAGIC):
            outcome.missing += len(subject.frames)
        return
    untouched = subject.untouched(damage)
    _deliveries(subject, damage, path, outcome, untouched)
    facts = summary(found)
    json.dumps(facts, allow_nan=False)
    _tables(subject, damage, found, outcome, untouched)
    report = _accepted(outcome, "verify", lambda: verify(found, ENGINE))
    result = _accepted(outcome, "evaluate", lambda: evaluate(found))
    if result is not None:
        json.dumps(result.as_dict(), allow_nan=False)
        if result.restarts and not (damage.moves or outcome.accidents):
            outcome.silent.append(f"{result.restarts} restarts that never were")
    if report is not None:
        accidents = outcome.accidents > 0 or damage.kind == ACCIDENT
        outcome.caught = accidents and not report.verified
        outcome.unnoticed = outcome.accidents > 0 and report.verified
        if report.difference is not None and not accidents and not damage.moves:
            outcome.silent.append(f"difference without a cause: {report.difference}")
        if outcome.unnoticed and damage.kind != ACCIDENT:
            outcome.silent.append(f"{outcome.accidents} frames that nobody sent")
    if draw:
        _drawn(found, path, outcome)


def _deliveries(
    subject: Subject, damage: Damage, path: Path, outcome: Outcome, untouched: list[link.Frame]
) -> None:
    """What the reader and the live view make of the stream."""
    reader = link.FrameReader()
    view = Live()
    now = 0.0
    delivered: Counter[tuple[int, int, bytes]] = Counter()
    for _arrival, data in capture.read_records(path):
        for item in reader.feed(data):
            now += 0.005
            view.take(item, now)
            if isinstance(item, link.Frame):
                delivered[key(item)] += 1
    view.line()
    panel(view, "port", now)
    wanted = Counter(key(frame) for frame in untouched)
    outcome.missing += sum((wanted - delivered).values())


def _tables(
    subject: Subject,
    damage: Damage,
    found: Capture,
    outcome: Outcome,
    untouched: list[link.Frame],
) -> None:
    """Whether the loaded capture holds what was left whole, and nothing that nobody sent."""
    wanted = Counter(key(frame) for frame in untouched if frame.kind in _TABLES)
    held: Counter[tuple[int, int, bytes]] = Counter()
    for kind, name in _TABLES.items():
        table = getattr(found, name)
        held.update(
            (kind, tick, row.tobytes())
            for tick, row in zip(table.tick.tolist(), table.rows, strict=True)
        )
    outcome.accidents = sum(count for frame, count in held.items() if frame not in subject.known)
    if not damage.moves:
        outcome.missing = max(outcome.missing, sum((wanted - held).values()))


def _drawn(found: Capture, path: Path, outcome: Outcome) -> None:
    _accepted(outcome, "plot", lambda: plot(found, path.with_suffix(".png")))
    again = path.with_name("again.solcap")
    _accepted(outcome, "replay", lambda: replaying.replay(found, again, engine=ENGINE))


def beside(subject: Subject, seed: int, count: int, folder: Path) -> Iterator[Outcome]:
    """Damaged sidecars and truths beside a sound capture; garbage, cuts, other contents."""
    rng = random.Random(seed)
    path = folder / "sound.solcap"
    path.write_bytes(subject.file)
    texts = {"sidecar": subject.notes.encode(), "truth": subject.truth.encode()}
    for i in range(count):
        hit = ("sidecar", "truth")[i % 2]
        content = dict(texts)
        content[hit] = _spoilt(content[hit], rng, hit)
        sidecar.sidecar_path(path).write_bytes(content["sidecar"])
        sidecar.truth_path(path).write_bytes(content["truth"])
        outcome = Outcome(f"{hit} damaged", repr(content[hit][:200]))
        draw = i % 25 == 0
        _guarded(outcome, lambda outcome=outcome, draw=draw: _beside(path, outcome, draw))  # type: ignore[misc]
        yield outcome


def _beside(path: Path, outcome: Outcome, draw: bool) -> None:
    found = _accepted(outcome, "load", lambda: capture.load(path))
    if found is None:
        return
    json.dumps(summary(found), allow_nan=False)
    result = _accepted(outcome, "evaluate", lambda: evaluate(found))
    if result is not None:
        json.dumps(result.as_dict(), allow_nan=False)
    if draw:
        _drawn(found, path, outcome)


_OTHER = {
    "sidecar": (
        b"",
        b"null",
        b"[]",
        b"[" * 100_000,
        b'{"truth": 7, "name": {"a": []}, "source": null}',
        b'{"truth": {"frame": ["enu"], "closed_loop": "yes"}}',
        b'{"name": "$\\\\frac{$", "source": "\\ud800"}',
        b"\xff\xfe\x00",
        b'{"a": 1e999, "b": NaN, "c": ' + b"9" * 5000 + b"}",
    ),
    "truth": (
        b"",
        b"\n",
        b"time_s,east_m,north_m,up_m\r\n",
        b"time_s,east_m,north_m,up_m\r\n1,2,3,4\r\n",
        b"time_s,east_m,north_m,up_m\r\nnan,2,3,4\r\n5,2,3,4\r\n",
        b"time_s,east_m,north_m,up_m\r\n1,inf,3,4\r\n2,2,3,4\r\n",
        b"time_s,east_m,north_m,up_m\r\n1,,,\r\n2,,,\r\n",
        b"time_s,east_m,north_m,up_m\r\n1,1e308,1e308,1e308\r\n2,-1e308,2,3\r\n",
        b"time_s;east_m\r\n1;2\r\n",
        b"a\0b\r\n",
        b'"' + b"x" * 200_000,
    ),
}


def _spoilt(content: bytes, rng: random.Random, hit: str) -> bytes:
    way = rng.randrange(5)
    at = rng.randrange(len(content))
    if way == 0:
        return content[:at]
    if way == 1:
        return content[:at] + rng.randbytes(rng.choice((1, 10, 500))) + content[at:]
    if way == 2:
        return content[:at] + bytes([rng.choice(b'0123456789,.-e"\n{}[]')]) + content[at + 1 :]
    if way == 3:
        return content[:at] + content[at + rng.choice((1, 20, 300)) :]
    return rng.choice(_OTHER[hit])


@dataclass
class Chance:
    """How often damage gets through, of `tries` damaged frames."""

    tries: int = 0
    passed: int = 0  # the CRC fits


def chance(subject: Subject, seed: int, tries: int) -> Chance:
    """Frames overwritten in 3 to 20 random bytes, anywhere: how many still have a CRC that fits."""
    rng = random.Random(seed)
    out = Chance()
    stuffed = [subject.stream[start : stop - 1] for start, stop, _frame in subject.frames]
    while out.tries < tries:
        data = bytearray(rng.choice(stuffed))
        size = rng.randrange(3, 21)
        at = rng.randrange(max(1, len(data) - size))
        noise = rng.randbytes(size).replace(b"\0", b"\1")
        if data[at : at + size] == noise[: len(data) - at]:
            continue
        data[at : at + size] = noise
        out.tries += 1
        out.passed += isinstance(link.decode(bytes(data)), link.Frame)
    return out


def scratch() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="solenav-faults-")
