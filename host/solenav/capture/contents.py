"""A capture's contents: every message in arrays, gaps and damage counted."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import parameters
from solenav.capture import order as ordering
from solenav.capture.file import scan
from solenav.capture.sidecar import read_sidecar, read_truth
from solenav.errors import SolenavError
from solenav.link import FIELDS, NAMES, Damage, Frame, FrameReader, unpack
from solenav.link.schema import need_forest, need_schema
from solenav.modes import labels
from solenav.modes.labels import Label
from solenav.recording import FloatArray, Truth
from solenav_core import layout, messages

_CODES = {"b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4"}
_TABLES = (messages.SAMPLE, messages.POSE, messages.STEP, messages.ALIGN, messages.STATUS)


def dtype(kind: int) -> np.dtype[Any]:
    """The NumPy record of a message's payload."""
    return np.dtype(
        [
            (name, _CODES[code]) if count == 1 else (name, _CODES[code], (count,))
            for name, code, count, _format, _meaning in FIELDS[kind]
            if code != "*"
        ]
    )


@dataclass
class Table:
    """All messages of one type: `rows` (structured by field name), `tick`, `order` (n,).

    `order` is the frame's place in the stream, over all types.
    """

    rows: NDArray[Any]
    tick: NDArray[np.int64]
    order: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.tick)

    def where(self, kept: NDArray[np.bool_]) -> Table:
        """The rows where `kept` (n,) is True."""
        return Table(self.rows[kept], self.tick[kept], self.order[kept])


@dataclass
class Capture:
    """Everything that a capture holds, as received; nothing repaired.

    Left out and counted in `damaged` is what isn't whole, what came twice, and what has a tick that
    the frames around it contradict (`solenav.capture.order`).
    """

    path: Path
    sidecar: dict[str, Any]
    samples: Table
    poses: Table
    steps: Table
    aligns: Table
    statuses: Table
    hellos: list[tuple[int, dict[str, Any]]] = field(default_factory=list)  # order, fields
    params: list[tuple[int, array[int]]] = field(default_factory=list)
    snapshots: list[tuple[int, int, bytes]] = field(default_factory=list)  # order, tick, state
    logs: list[tuple[int, str, str]] = field(default_factory=list)  # tick, level, text
    counts: Counter[str] = field(default_factory=Counter)
    damaged: Counter[str] = field(default_factory=Counter)
    cut_off_bytes: int = 0  # of a last record that isn't whole
    arrival: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def truth(self) -> Truth | None:
        """The truth beside the capture, or None. SolenavError where its file is damaged."""
        return read_truth(self.path)

    @cached_property
    def modes(self) -> tuple[Label, ...]:
        """How the foot moved when, as the table beside the capture says. See `labels.read`."""
        return labels.read(self.path)

    @property
    def sample_counts(self) -> NDArray[np.int16]:
        """All samples as the core takes them, (n, 10): ax ay az gx gy gz mx my mz flags."""
        rows = self.samples.rows
        return words(
            np.hstack([rows["acc"], rows["gyro"]]), rows["mag"], rows["flags"], rows["lost"]
        )

    def need_samples(self) -> None:
        """SolenavError unless there are samples and the parameters that they ran with.

        Parameters outside their limits are an error as well: the core doesn't check its indices.
        """
        self.need_schema()
        if not len(self.samples):
            raise SolenavError(
                f"{self.path} has no samples",
                "record with SAMPLE frames on, or check that the board was running",
            )
        if not self.params:
            raise SolenavError(
                f"{self.path} has no PARAMS message: what the core ran with is unknown",
                "record from the board's start, or with a recorder that asks for it",
            )
        for _order, values in self.params:
            parameters.checked(values.tolist())

    def need_forest(self, forest: array[int] | None) -> None:
        """SolenavError where the board had another forest than this; None: the shipped one."""
        for _order, hello in self.hellos:
            need_forest(hello, forest, str(self.path))

    def need_schema(self) -> None:
        """SolenavError where the firmware spoke another schema than this host."""
        for _order, hello in self.hellos:
            need_schema(hello, str(self.path))

    def need_poses(self) -> None:
        """SolenavError unless there are poses."""
        self.need_schema()
        if not len(self.poses):
            raise SolenavError(
                f"{self.path} has no poses",
                "run the core over its samples first: `solenav replay` or `solenav run-firmware`"
                if len(self.samples) and not len(self.statuses)
                else "the sensor must stand still for a second after start, for the alignment",
            )

    def rate_hz(self) -> float:
        """The nominal sample rate that the core ran with."""
        if self.params:
            return self.params[0][1][messages.NAMES.index("RATE_MHZ")] / 1000
        return self.hellos[0][1]["rate"] / 1000 if self.hellos else 0.0

    def time_of_tick(self, tick: NDArray[np.int64]) -> FloatArray:
        """Seconds since the first tick's sample, by the samples' time stamps where there are any.

        Ticks whose sample is missing are interpolated; without samples the nominal rate counts.
        """
        ticks, first = np.unique(self.samples.tick, return_index=True)
        if len(ticks) < 2:
            return (tick - 1) / max(self.rate_hz(), 1e-9)
        stamps = unwrap(self.samples.rows["time"][first])
        period = (stamps[-1] - stamps[0]) / (ticks[-1] - ticks[0])
        start = stamps[0] - (ticks[0] - 1) * period
        seconds = np.interp(tick, ticks, stamps - start)
        # np.interp holds the ends; beyond them the mean period goes on.
        seconds += (
            np.minimum(tick - ticks[0], 0) * period + np.maximum(tick - ticks[-1], 0) * period
        )
        return seconds

    def positions(self) -> FloatArray:
        """Position of every pose in metres ENU, (n, 3)."""
        rows = self.poses.rows
        return rows["cell"].astype(np.float64) * layout.CELL_M + rows["position"] / 2**18


def words(
    counts: NDArray[np.int16],
    mag: NDArray[np.int16],
    flags: NDArray[np.uint8],
    lost: NDArray[np.uint8],
) -> NDArray[np.int16]:
    """Samples as the core takes them, (n, 10), from SAMPLE's fields.

    `counts` (n, 6) ax ay az gx gy gz; `mag` (n, 3); `flags`, `lost` (n,), `lost` at most 127.
    """
    last = flags.astype(np.int16) | (np.minimum(lost, messages.LOST_MAX).astype(np.int16) << 8)
    return np.hstack([counts, mag, last[:, None]])


def unwrap(time_us: NDArray[Any]) -> FloatArray:
    """Board time stamps (µs modulo 2**32, in order) to seconds without wraps.

    A single stamp that those around it contradict counts as half-way between them.
    """
    stamps = time_us.astype(np.int64)
    astray = np.flatnonzero(ordering.untimely(stamps))
    stamps[astray] = stamps[astray - 1] + (stamps[astray + 1] - stamps[astray - 1]) % 2**32 // 2
    steps = np.diff(stamps) % 2**32
    return np.concatenate([[0.0], np.cumsum(steps)]) * 1e-6 + float(time_us[0]) * 1e-6


class Fragments:
    """Puts the fragments of a message of one tick together: PARAMS or SNAPSHOT."""

    def __init__(self) -> None:
        self.tick = -1
        self.data = bytearray()

    def add(self, frame: Frame) -> bytes | None:
        """The whole message where this fragment was its last; None before, or if one is missing."""
        part = unpack(frame)
        if part["offset"] == 0:
            self.tick = frame.tick
            self.data = bytearray()
        if frame.tick != self.tick or part["offset"] != len(self.data):
            self.tick = -1  # a fragment is missing, or came twice
            return None
        self.data += part["data"]
        return bytes(self.data) if len(self.data) == part["total"] else None


def load(path: Path | str) -> Capture:
    """Read a capture. SolenavError where it is missing, empty or no capture.

    Damage inside (bad frames, a cut-off end) is counted, never an error: what is readable stays.
    """
    path = Path(path)
    reader = FrameReader()
    payloads = {kind: bytearray() for kind in _TABLES}
    ticks: dict[int, list[int]] = {kind: [] for kind in _TABLES}
    orders: dict[int, list[int]] = {kind: [] for kind in _TABLES}
    none = [_empty(kind) for kind in _TABLES]
    out = Capture(path, read_sidecar(path), none[0], none[1], none[2], none[3], none[4])
    fragments = {kind: Fragments() for kind in (messages.SNAPSHOT, messages.PARAMS)}
    order = 0
    arrivals: list[float] = []
    records, cut_off = scan(path)
    for arrival, data in records:
        if math.isfinite(arrival):
            arrivals = [arrivals[0] if arrivals else arrival, arrival]
        for item in reader.feed(data):
            order += 1
            if isinstance(item, Damage):
                out.damaged[item.reason.split(" of ")[0]] += 1
                continue
            out.counts[NAMES[item.kind]] += 1
            if item.kind in payloads:
                payloads[item.kind] += item.payload
                ticks[item.kind].append(item.tick)
                orders[item.kind].append(order)
            else:
                _keep(out, item, order, fragments)
    for left in reader.close():
        out.damaged[left.reason] += 1
    tables = [
        Table(
            np.frombuffer(bytes(payloads[kind]), dtype(kind)),
            np.array(ticks[kind], np.int64),
            np.array(orders[kind], np.int64),
        )
        for kind in _TABLES
    ]
    out.samples, out.poses, out.steps, out.aligns, out.statuses = tables
    _sift(out)
    out.cut_off_bytes = cut_off
    if arrivals:
        out.arrival = (arrivals[0], arrivals[1])
    return out


def _sift(out: Capture) -> None:
    """Leave out and count frames that came twice, and ticks that the frames around contradict."""
    for name in ("samples", "poses", "steps", "aligns"):
        table: Table = getattr(out, name)
        found = ordering.misplaced(table.rows, table.tick, table.order)
        bad = np.logical_or.reduce(list(found.values()))
        if bad.any():
            out.damaged += ordering.counted(found)
            setattr(out, name, table.where(~bad))


def _empty(kind: int) -> Table:
    none = np.empty(0, np.int64)
    return Table(np.empty(0, dtype(kind)), none, none)


def _keep(out: Capture, frame: Frame, order: int, fragments: dict[int, Fragments]) -> None:
    """File a frame of the rarer types."""
    fields = unpack(frame)
    if frame.kind == messages.HELLO:
        out.hellos.append((order, fields))
    elif frame.kind == messages.LOG:
        level = messages.LEVELS[min(fields["level"], 2)]
        out.logs.append((frame.tick, level, fields["text"].decode("utf-8", "replace")))
    elif frame.kind in fragments:
        whole = fragments[frame.kind].add(frame)
        if whole is None:
            return
        if frame.kind == messages.SNAPSHOT:
            if len(whole) == 4 * layout.size(layout.STATE_FIELDS):
                out.snapshots.append((order, frame.tick, whole))
        elif len(whole) == 4 * len(messages.NAMES):
            out.params.append((order, array("i", whole)))
