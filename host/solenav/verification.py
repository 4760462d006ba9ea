"""Proof of a run: the core over a capture's samples against everything else that it holds.

The samples and parameters of a capture determine each later state to the bit, so a run is
rebuilt from PARAMS and SAMPLE alone and compared with every ALIGN, POSE, STEP and SNAPSHOT.
After a gap the next SNAPSHOT is where it goes on.
"""

from __future__ import annotations

import dataclasses
from array import array
from binascii import crc32
from collections.abc import Callable
from typing import Any

import numpy as np

from solenav import engines
from solenav.capture.contents import Capture, dtype
from solenav.errors import SolenavError
from solenav.link import NAMES
from solenav_core import layout, messages

# The stage that owns a field, for messages; in the order in which a tick computes them.
_STAGES = {
    "acc_norm": "detector",
    "flags": "detector",
    "ticks": "align",
    "restarts": "align",
    "peak_acc": "align",
    "peak_rate": "align",
    "gravity": "align",
    "bias": "strapdown",
    "motion": "forest",
    "m2": "particles",
    "n_eff": "particles",
    "threshold": "particles",
    "resampled": "particles",
    "attitude": "strapdown",
    "velocity": "strapdown",
    "position": "strapdown",
    "cell": "strapdown",
    "displacement": "steps",
    "turn": "steps",
    "heading": "steps",
    "variance": "steps",
    "steps": "steps",
    "distance": "steps",
    "digest": "state",
}


@dataclasses.dataclass
class Difference:
    """Where host and capture part: the first field, in the order of the tick, that differs."""

    tick: int
    message: str
    stage: str
    field: str
    capture: int
    host: int
    also: list[str] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class Report:
    """What a verification found. `verified` is True where all that was compared is equal."""

    engine: str
    samples: int = 0
    replayed: int = 0  # samples that the core was run over
    compared_ticks: int = 0  # ticks with at least one message to compare
    covered_ticks: int = 0  # ticks whose outcome a later equal digest of the same stretch proves
    compared: dict[str, int] = dataclasses.field(default_factory=dict)  # messages by type
    gaps: int = 0
    missing_samples: int = 0  # lost samples between the first and the last
    unchecked_samples: int = 0  # there, but after a gap and before the next snapshot
    difference: Difference | None = None

    @property
    def verified(self) -> bool:
        return self.difference is None and self.compared_ticks > 0

    def as_dict(self) -> dict[str, Any]:
        return {"verified": self.verified, **dataclasses.asdict(self)}


class _Run:
    """The core as it follows the capture."""

    def __init__(self, capture: Capture, engine: str, forest: array[int] | None) -> None:
        self.report = Report(engine, samples=len(capture.samples))
        self.counts = capture.sample_counts
        self.ticks = capture.samples.tick
        # The rows at which a stretch of consecutive ticks ends.
        self.breaks = np.append(np.flatnonzero(np.diff(self.ticks) != 1) + 1, len(self.ticks))
        self.params = capture.params[0][1][:]
        self.forest = forest
        self.engine = engines.create(engine, self.params, forest)
        self.tick = 0
        self.row = 0
        self.in_step = True  # the engine's state is that of the board
        self.waiting = 0  # ticks since the last comparison of this stretch
        self.last_compared = (-1, -1)
        self.heard = (-1, 0)  # tick and digest of the last message that wasn't compared

    def restart(self) -> None:
        self.engine = engines.create(self.report.engine, self.params, self.forest)
        self.waiting = 0

    def change(self, params: array[int]) -> None:
        """Parameters that hold from the next tick on."""
        self.params[:] = params

    def join(self, tick: int, state: bytes) -> None:
        """Go on from a snapshot; not from one that the last message's digest contradicts."""
        if self.heard[0] == tick and self.heard[1] != crc32(state):
            return
        try:
            self.engine.restore(state)
        except ValueError:
            return  # no state that the core ever has
        if tick != self.tick:
            # The board itself went on from another state: after a restart or a long gap.
            self.report.gaps += 1
            self.report.missing_samples += max(0, tick - self.tick)
            self.tick = tick
            self.waiting = 0
        self.in_step = True

    def samples_until(self, row: int) -> None:
        """Take the samples up to, not including, `row`."""
        while self.row < row:
            tick = int(self.ticks[self.row])
            if tick == 1:
                self.restart()
                self.in_step = True
            elif tick != self.tick + 1:
                self.report.gaps += 1
                self.report.missing_samples += max(0, tick - self.tick - 1)
                self.in_step = False
                self.waiting = 0
            stop = min(row, int(self.breaks[np.searchsorted(self.breaks, self.row, "right")]))
            if self.in_step:
                self.engine.advance(self.counts, self.row, stop)
                self.report.replayed += stop - self.row
                self.waiting += stop - self.row
            else:
                self.report.unchecked_samples += stop - self.row
            self.tick = int(self.ticks[stop - 1])
            self.row = stop

    def equal(self, name: str) -> None:
        """Count a message of this tick that is equal."""
        self.report.compared[name] = self.report.compared.get(name, 0) + 1
        if (self.tick, self.row) != self.last_compared:
            self.report.compared_ticks += 1
        self.last_compared = (self.tick, self.row)
        self.report.covered_ticks += self.waiting
        self.waiting = 0


def verify(
    capture: Capture,
    engine: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
    forest: array[int] | None = None,
) -> Report:
    """Compare a capture with the core, up to the first difference.

    `forest`: the words of the one that the board had, where it isn't the shipped one. SolenavError
    (exit code 2) where it can't be compared: another schema, another forest, no samples, nothing
    to compare with.
    """
    capture.need_samples()
    capture.need_forest(forest)
    run = _Run(capture, engine or engines.default_name(), forest)
    items = _items(capture)
    if not items:
        raise SolenavError(
            f"{capture.path} holds no ALIGN, POSE, STEP or SNAPSHOT to compare with",
            "verify what `run-firmware`, `replay` or `record` wrote; samples alone prove nothing",
        )
    rows = np.searchsorted(capture.samples.order, [order for order, *_ in items])
    for (_order, kind, tick, payload), row in zip(items, rows, strict=True):
        run.samples_until(int(row))
        if kind == messages.PARAMS:
            run.change(array("i", payload))
        elif kind == messages.SNAPSHOT and (tick != run.tick or not run.in_step):
            run.join(tick, payload)
        elif tick != run.tick or not run.in_step:
            # Its own sample is missing, or one before it: the gap shows at the next one.
            if kind != messages.SNAPSHOT:
                run.heard = (tick, int.from_bytes(payload[-4:], "little"))
        else:
            difference = _compare(run.engine, kind, tick, payload)
            if difference is not None:
                run.report.difference = difference
                return run.report
            run.equal(NAMES[kind])
        progress(run.row)
    run.samples_until(len(capture.samples))
    progress(len(capture.samples))
    return run.report


def _items(capture: Capture) -> list[tuple[int, int, int, bytes]]:
    """What to compare, in stream order: (order, type, tick, payload). PARAMS among them."""
    out = [(order, messages.SNAPSHOT, tick, state) for order, tick, state in capture.snapshots]
    for kind, table in (
        (messages.ALIGN, capture.aligns),
        (messages.POSE, capture.poses),
        (messages.STEP, capture.steps),
    ):
        size = messages.SIZES[kind]
        data = table.rows.tobytes()
        out += [
            (order, kind, tick, data[i * size : (i + 1) * size])
            for i, (order, tick) in enumerate(
                zip(table.order.tolist(), table.tick.tolist(), strict=True)
            )
        ]
    if out:
        out += [(order, messages.PARAMS, 0, p.tobytes()) for order, p in capture.params]
    return sorted(out, key=lambda item: item[0])


def _compare(engine: engines.Engine, kind: int, tick: int, payload: bytes) -> Difference | None:
    """The first difference between a message and the engine's state, or None."""
    if kind == messages.SNAPSHOT:
        return _compare_state(engine, tick, payload)
    buffer = bytearray(256)
    if kind == messages.ALIGN:
        end = messages.pack_align(buffer, 0, engine.state)
    elif kind == messages.STEP:
        end = messages.pack_step(buffer, 0, engine.state)
    else:
        end = messages.pack_pose(buffer, 0, engine.state, engine.params)
    if buffer[:end] == payload:
        return None
    theirs = np.frombuffer(payload, dtype(kind))[0]
    ours = np.frombuffer(bytes(buffer[:end]), dtype(kind))[0]
    found = []
    for name in sorted(ours.dtype.names or (), key=list(_STAGES).index):
        for i, (a, b) in enumerate(
            zip(np.atleast_1d(theirs[name]), np.atleast_1d(ours[name]), strict=True)
        ):
            if a != b:
                label = name if np.ndim(ours[name]) == 0 else f"{name}[{i}]"
                found.append((_STAGES[name], label, int(a), int(b)))
    stage, label, a, b = found[0]
    also = [name for _stage, name, _a, _b in found[1:]]
    return Difference(tick, NAMES[kind], stage, label, a, b, also)


def _compare_state(engine: engines.Engine, tick: int, state: bytes) -> Difference | None:
    theirs = array("i", state)
    wrong = [i for i, (a, b) in enumerate(zip(theirs, engine.state, strict=True)) if a != b]
    if not wrong:
        return None
    names = [layout.locate(layout.STATE_FIELDS, i) for i in wrong]
    stage, label = names[0]
    first = wrong[0]
    also = [name for _stage, name in names[1:]]
    return Difference(tick, "SNAPSHOT", stage, label, theirs[first], engine.state[first], also)
