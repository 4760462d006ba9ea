"""The board's half of the fault campaign: the real firmware on the simulated board, with faults.

A run is a walk of some 20 s with a script of faults (`solenav.sim.board.faults`). What the board
sent is laid beside the core over the same samples without faults, sample by sample, and beside what
is in the board's flash afterwards.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from host import stretch
from solenav import capture, engines, link, mpu9150, parameters
from solenav.errors import SolenavError
from solenav.recording import FloatArray
from solenav.sim.scenario import simulate
from solenav.verification import verify
from solenav_core import layout, messages
from solenav_tools.board import Samples, SimulatedBoard
from solenav_tools.ports import PortVanished, open_port, read_some

RATE_HZ = 200.0
WALK = (13.4, 37.4)
"""Seconds of the simulated loop: from a standing second and a half on."""
TOLERANCE_M = 1.0
"""A pose further off than this, less than a stride, without a flag is a silent wrong pose."""
DETECTION_S = 0.3
"""So soon a fault must show: the sensor's settings are looked at four times a second."""
FLAGGED = messages.GAP | messages.RESUMED | messages.SATURATED | messages.FROZEN
GUARD_S = 90.0
"""Wall clock of a run, after which it hangs; it takes two or three seconds."""
AGAIN_S = 1.0
"""Navigating again: with poses in the last second of the walk."""

_CONFIG = {"checkpoint_s": 2}
_MOVING = 800  # counts of the gyro: 50 °/s
_AT = layout.offsets(layout.STATE_FIELDS)

Fault = dict[str, Any]


class Walk:
    """What the sensor measures, and where the core is at each sample without any fault."""

    def __init__(self, start_s: float = WALK[0], stop_s: float = WALK[1]) -> None:
        recording = stretch(simulate("loop", seed=5, rate_hz=RATE_HZ), start_s, stop_s)
        counted = mpu9150.to_counts(recording.accel, recording.gyro)
        self.counts = counted.counts[:, :6]
        self.time_us = np.rint(recording.time_s * 1e6).astype(np.int64)
        self.params = parameters.to_integers(parameters.Settings(), RATE_HZ)

    @property
    def samples(self) -> Samples:
        return Samples(self.time_us, self.counts, np.zeros(len(self.counts), np.int16))

    @cached_property
    def rows(self) -> dict[bytes, int]:
        """The row that has these counts, where the foot moves: there no two are alike."""
        moving = np.flatnonzero(np.abs(self.counts[:, 3:]).max(axis=1) > _MOVING)
        return {self.counts[row].tobytes(): int(row) for row in moving}

    @cached_property
    def positions(self) -> FloatArray:
        """Where the core is after each sample (n, 3) in m, NaN before the static start."""
        engine = engines.create("fast", self.params)
        out = np.full((len(self.counts), 3), np.nan)
        for row in range(len(self.counts)):
            engine.advance(self.counts, row, row + 1)
            if engine.navigating:
                cell = np.array(engine.state[_AT["CELL"] : _AT["CELL"] + 3])
                place = np.array(engine.state[_AT["POS"] : _AT["POS"] + 3])
                out[row] = cell * float(layout.CELL_M) + place / 2**18
        return out


@dataclass(frozen=True)
class Case:
    """A run to make."""

    kind: str
    faults: tuple[Fault, ...]
    config: dict[str, Any] = field(default_factory=dict)
    ends: tuple[int, ...] = (messages.RUNNING,)  # modes in which it may end


@dataclass
class Outcome:
    """What came of a run."""

    case: Case
    mode: int = -1  # of the last STATUS
    survived: bool = False
    error_m: float | None = None  # of the last pose
    flagged: bool = False
    anew: bool = False  # a run began afresh, from a static start
    lost: int = 0  # samples of the walk that never reached the core
    brief_m: float = 0.0  # the same, though a flag may have followed within `DETECTION_S`
    silent_m: float = 0.0  # largest error of a pose without a flag, where that is too much
    unsafe: int = 0  # bytes that the black box had acknowledged and that aren't in flash
    damaged: int = 0  # frames in the black box that are not whole
    restarts: list[str] = field(default_factory=list)
    difference: str = ""
    traceback: str = ""
    hang: bool = False
    operations: int = 0  # of the flash
    log: list[str] = field(default_factory=list)

    @property
    def clean(self) -> bool:
        wrong = self.silent_m or self.unsafe or self.difference or self.traceback or self.hang
        return self.survived and not wrong


def _times(rng: random.Random, low_ms: float, high_ms: float) -> int:
    """A length in µs, small ones as likely as large ones."""
    return round(1000 * low_ms * (high_ms / low_ms) ** rng.random())


_AXES = ("ax", "ay", "az", "gx", "gy", "gz")
# Sample rate, filter, both ranges, FIFO, interrupts, user control, power.
_REGISTERS = (0x19, 0x1A, 0x1B, 0x1C, 0x23, 0x38, 0x6A, 0x6B)

_Script = Callable[[random.Random, int], list[Fault]]
SCRIPTS: dict[str, _Script] = {
    "nack": lambda rng, at: [
        {
            "kind": "nack",
            "at": at,
            "for": _times(rng, 2, 3000),
            "every": rng.choice((1, 1, 2, 5, 20)),
            "above": rng.choice((0, 0, 100_000)),
        }
    ],
    "stuck_sda": lambda rng, at: [{"kind": "stuck_sda", "at": at, "clocks": rng.randint(1, 9)}],
    "wrong_id": lambda rng, at: [
        {"kind": "wrong_id", "at": at, "for": _times(rng, 100, 3000), "value": rng.randrange(256)},
        {"kind": "reset", "at": at + 20_000},
    ],
    "frozen": lambda rng, at: [{"kind": "frozen", "at": at, "for": _times(rng, 50, 3000)}],
    "fifo_overflow": lambda rng, at: [
        {"kind": "fifo_overflow", "at": at, "for": _times(rng, 20, 2000)}
    ],
    "hang": lambda rng, at: [{"kind": "hang", "at": at, "for": _times(rng, 20, 3000)}],
    "watchdog": lambda rng, at: [{"kind": "watchdog", "at": 8_600_000 + at % 2_000_000}],
    "spike": lambda rng, at: [
        {
            "kind": "spike",
            "at": at + i * 60_000,
            "axis": rng.choice(_AXES),
            "value": rng.choice((32767, -32768, rng.randrange(-32768, 32768))),
            **rng.choice(({}, {}, {"for": rng.randint(5_000, 15_000)})),
        }
        for i in range(rng.choice((1, 3, 10)))
    ],
    "bit_flip": lambda rng, at: [
        {
            "kind": "bit_flip",
            "at": at + i * 50_000,
            "byte": rng.randrange(14),
            "bit": rng.randrange(8),
            "count": rng.choice((1, 1, 3)),
        }
        for i in range(rng.choice((1, 3, 10)))
    ],
    "register": lambda rng, at: [
        {
            "kind": "register",
            "at": at,
            "register": rng.choice(_REGISTERS),
            "value": rng.randrange(256),
        }
    ],
    "reset": lambda rng, at: [{"kind": "reset", "at": at}],
    "brown_out": lambda rng, at: [{"kind": "brown_out", "at": at, "for": _times(rng, 2, 500)}],
    "gone": lambda rng, at: [{"kind": "gone", "at": at, "for": _times(rng, 300, 4000)}],
    # A degree in a minute is much; this is one in ten seconds.
    "temperature": lambda rng, at: [
        {"kind": "temperature", "at": at, "for": 10_000_000, "degrees": rng.choice((-1, 1))}
    ],
    "compass": lambda rng, at: [{"kind": "compass", "at": at, "for": _times(rng, 100, 5000)}],
    "magnet": lambda rng, at: [
        {
            "kind": "magnet",
            "at": at,
            "for": _times(rng, 100, 5000),
            "field": [rng.randrange(-4000, 4000) for _ in range(3)],
        }
    ],
    "uart_noise": lambda rng, at: [
        {"kind": "uart_noise", "at": at, "for": 4_000_000, "seed": rng.randrange(1, 1 << 30)}
    ],
    "uart_flood": lambda rng, at: [
        {
            "kind": "uart_flood",
            "at": at,
            "for": _times(rng, 500, 4000),
            "seed": rng.randrange(1, 1 << 30),
            **rng.choice(({}, {"data": "00"}, {"data": "0142ff"}, {"data": "55"})),
        }
    ],
    "power_cut": lambda rng, at: [{"kind": "power_cut", "at": at, "for": _times(rng, 50, 2000)}],
    "flash_full": lambda rng, at: [{"kind": "flash_full", "at": at, "for": _times(rng, 500, 9000)}],
}


# A hang as long as that leaves no time for others; after a restart samples that a temperature has
# changed can't be told from others.
_ALONE = ("watchdog", "temperature")
KINDS = (*SCRIPTS, "clock", "gone for good", "several")


def cases(seed: int, count: int) -> list[Case]:
    """`count` runs, the kinds in turn, each at another moment; the same for the same seed."""
    rng = random.Random(seed)
    out = []
    for i in range(count):
        kind = KINDS[i % len(KINDS)]
        at = rng.randrange(5_000_000, 14_000_000)
        config = {"sampling": "ready"} if rng.random() < 0.25 else {}
        if kind == "clock":
            factor = round(rng.uniform(0.96, 1.04), 3)
            fault = {"kind": "clock", "after": 0, "factor": factor}
            out.append(Case(kind, (fault,), config))
        elif kind == "gone for good":
            fault = {"kind": "gone", "at": at, "for": 1_000_000_000}
            out.append(Case(kind, (fault,), config, (messages.FAULT,)))
        elif kind == "several":
            faults: list[Fault] = []
            for name in rng.sample([name for name in SCRIPTS if name not in _ALONE], 3):
                faults += SCRIPTS[name](rng, rng.randrange(5_000_000, 14_000_000))
            out.append(Case(kind, tuple(faults), config))
        else:
            out.append(Case(kind, tuple(SCRIPTS[kind](rng, at)), config))
    return out


# Whoever loses power before the first step starts anew, and needs to stand still for that.
_AFTER_CUT = (messages.RUNNING, messages.RESUMING, messages.ALIGNING)
SESSION = {"blackbox_samples": True}


def short_walk() -> Walk:
    """Eight seconds: power is cut in it at every operation of the flash."""
    return Walk(WALK[0], WALK[0] + 8.0)


def cut_at(operation: int) -> Case:
    """Power cut at the n-th operation of the flash, in a session that records everything."""
    fault = {"kind": "power_cut", "operation": operation, "for": 200_000}
    return Case("power cut at a flash write", (fault,), SESSION, _AFTER_CUT)


def run(walk: Walk, case: Case, folder: Path) -> Outcome:
    """One run, judged."""
    outcome = Outcome(case)
    config = {**_CONFIG, **case.config}
    data = bytearray()
    began = time.monotonic()
    with SimulatedBoard(walk.samples, config, faults=case.faults) as board:
        with open_port(board.port) as port:
            while not outcome.hang:
                try:
                    data += read_some(port)
                except PortVanished:
                    break
                outcome.hang = time.monotonic() - began > GUARD_S
        if not outcome.hang:
            board.wait(GUARD_S)
            try:
                board.check()
            except SolenavError as error:
                outcome.traceback = error.message
        outcome.restarts = list(board.restarts)
        outcome.operations = board.report.get("flash", [0])[0]
        files = [path.read_bytes() for path in sorted((board.folder / "log").glob("*.frames"))]
    items = list(link.FrameReader().feed(bytes(data)))
    frames = [item for item in items if isinstance(item, link.Frame)]
    _crashes(frames, outcome)
    _poses(walk, frames, outcome)
    _records(frames, files, outcome)
    _proof(bytes(data), folder, outcome)
    return outcome


def _crashes(frames: list[link.Frame], outcome: Outcome) -> None:
    """A traceback that the firmware told of over the link before it restarted."""
    for frame in frames:
        if frame.kind == messages.STATUS:
            outcome.mode = link.unpack(frame)["mode"]
        elif frame.kind == messages.LOG:
            text = link.unpack(frame)["text"].decode("utf-8", "replace")
            outcome.log.append(f"tick {frame.tick}: {text}")
            if text.split(":")[0].endswith(("Error", "Exception")) and not outcome.traceback:
                outcome.traceback = text


def _poses(walk: Walk, frames: list[link.Frame], outcome: Outcome) -> None:
    """Every pose beside the one of the core without faults, by the sample that it came from."""
    place = _Place(walk)
    last_row = since = -1
    delivered = 0
    last_tick = 0
    for frame in frames:
        if frame.kind == messages.SAMPLE:
            # Ticks go back only where the navigator began afresh.
            outcome.anew = outcome.anew or frame.tick < last_tick
            last_tick = frame.tick
            place.take(frame)
            delivered += 1
        elif frame.kind == messages.POSE and frame.tick == place.tick and place.row >= 0:
            last_row = place.row
            fields = link.unpack(frame)
            outcome.flagged = bool(fields["flags"] & FLAGGED)
            if outcome.anew:
                outcome.error_m = None  # it counts from another place
                continue
            position = np.array(fields["cell"]) * float(layout.CELL_M)
            position += np.array(fields["position"]) / 2**18
            error = float(np.linalg.norm(position - walk.positions[place.row]))
            outcome.error_m = error
            if error > TOLERANCE_M and not outcome.flagged:
                since = place.row if since < 0 else since
                outcome.brief_m = max(outcome.brief_m, error)
                if place.row - since > DETECTION_S * RATE_HZ:
                    outcome.silent_m = max(outcome.silent_m, error)
            else:
                since = -1
    if since >= 0:
        outcome.silent_m = outcome.brief_m  # nothing came that would have told
    outcome.lost = len(walk.counts) - delivered
    if outcome.mode == messages.RUNNING:
        fresh = last_row >= len(walk.counts) - AGAIN_S * RATE_HZ
        outcome.survived = (fresh or len(outcome.case.ends) > 1) and (
            messages.RUNNING in outcome.case.ends
        )
    else:
        outcome.survived = outcome.mode in outcome.case.ends


class _Place:
    """Which row of the walk a sample is, by its counts, or by its time where those are spoilt."""

    def __init__(self, walk: Walk) -> None:
        self.walk = walk
        self.row = -1
        self.tick = -1
        self._time = 0
        self._known = (0, 0)  # the last row that was told by its counts, µs since then

    def take(self, frame: link.Frame) -> None:
        fields = link.unpack(frame)
        counts = np.array([*fields["acc"], *fields["gyro"]], np.int16)
        row, since_us = self._known
        if self.row >= 0:
            since_us += (fields["time"] - self._time) % 2**32
        told = self.walk.rows.get(counts.tobytes())
        if told is not None:
            row, since_us = told, 0
        self._known = row, since_us
        # After a restart the board's time is another until counts are known again.
        if since_us < 60_000_000:
            self.row = min(len(self.walk.counts) - 1, row + round(since_us * RATE_HZ / 1e6))
            self.tick = frame.tick
        self._time = fields["time"]


def _records(frames: list[link.Frame], files: list[bytes], outcome: Outcome) -> None:
    """Whether flash holds all that the board said was safe there, life by life."""
    lives: list[tuple[set[link.Frame], int]] = [(set(), 0)]
    for frame in frames:
        logged = lives[-1][1]
        if frame.kind == messages.STATUS:
            now = link.unpack(frame)["logged"]
            if now < logged:
                lives.append((set(), now))
            logged = now
        lives[-1][0].add(frame)
        lives[-1] = (lives[-1][0], max(logged, lives[-1][1]))
    sizes: Counter[int] = Counter()
    life = 0
    for content in files:
        reader = link.FrameReader()
        items = [*reader.feed(content), *reader.close()]
        outcome.damaged += sum(isinstance(item, link.Damage) for item in items)
        known = [len(sent.intersection(items)) for sent, _logged in lives]  # type: ignore[arg-type]
        if max(known):
            life = known.index(max(known))
        sizes[life] += len(content)
    outcome.unsafe = sum(max(0, logged - sizes[i]) for i, (_sent, logged) in enumerate(lives))


def _proof(data: bytes, folder: Path, outcome: Outcome) -> None:
    """Whether the firmware computed what the host's core does from the samples that it sent."""
    path = folder / "run.solcap"
    with capture.CaptureWriter(path, flush=False) as writer:
        writer.write(0.0, data)
    try:
        report = verify(capture.load(path), "fast")
    except SolenavError as error:
        outcome.difference = error.message
        return
    if report.difference is not None:
        outcome.difference = str(report.difference)
