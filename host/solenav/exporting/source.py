"""What all formats are written from: the capture's frames in order, and its last run as a track."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import capture as captures
from solenav.capture.contents import Capture, dtype
from solenav.capture.file import read_records
from solenav.evaluation import last_run
from solenav.link import Frame, FrameReader
from solenav.recording import FloatArray


@dataclass
class Written:
    """The files that were written, how many rows or messages, and what the format can't hold."""

    files: list[Path]
    items: int
    losses: list[str] = field(default_factory=list)


@dataclass
class Rows:
    """The frames of one message type, in order: `order` is the place in the stream."""

    kind: int
    frames: list[Frame] = field(default_factory=list)
    order: list[int] = field(default_factory=list)
    arrival: list[float] = field(default_factory=list)

    @cached_property
    def table(self) -> NDArray[Any]:
        """The fields of fixed size, a structured array."""
        record = dtype(self.kind)
        fixed = b"".join(frame.payload[: record.itemsize] for frame in self.frames)
        return (
            np.frombuffer(fixed, record) if record.itemsize else np.empty(len(self.frames), record)
        )


@dataclass
class Track:
    """Poses of the last run, at strictly increasing times since its first sample.

    `time_s` (n,); `position` (n, 3) m ENU; `velocity` (n, 3) m/s; `attitude` (n, 4) body to ENU,
    scalar first; `poses` (n,) the whole messages.
    """

    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    attitude: FloatArray
    poses: NDArray[Any]


@dataclass
class Source:
    """A capture, loaded."""

    path: Path
    capture: Capture

    @cached_property
    def rows(self) -> dict[int, Rows]:
        """Every intact frame, by message type."""
        reader = FrameReader()
        out: dict[int, Rows] = {}
        place = 0
        for arrival, data in read_records(self.path):
            for item in reader.feed(data):
                place += 1
                if isinstance(item, Frame):
                    rows = out.setdefault(item.kind, Rows(item.kind))
                    rows.frames.append(item)
                    rows.order.append(place)
                    rows.arrival.append(arrival)
        return out

    @cached_property
    def last(self) -> tuple[Capture, int]:
        """The last run in it, and how many came before."""
        return last_run(self.capture)

    @property
    def track(self) -> Track:
        """The poses of the last run. SolenavError where there is none."""
        run, _restarts = self.last
        run.need_poses()
        time_s = run.time_of_tick(run.poses.tick)
        kept = np.concatenate([[True], np.diff(np.maximum.accumulate(time_s)) > 0])
        rows = run.poses.rows[kept]
        return Track(
            time_s[kept],
            run.positions()[kept],
            rows["velocity"] / 2**24,
            rows["attitude"] / 2**30,
            rows,
        )

    def common_losses(self) -> list[str]:
        """What every format but the capture itself leaves out."""
        out = []
        damaged = sum(self.capture.damaged.values())
        if damaged:
            out.append(f"{damaged} damaged frames")
        if self.capture.cut_off_bytes:
            out.append(f"{self.capture.cut_off_bytes} bytes of an unfinished record at the end")
        return out

    def run_losses(self) -> list[str]:
        """What a format of one run leaves out."""
        earlier = self.last[1]
        return self.common_losses() + ([f"{earlier} earlier runs"] if earlier else [])


def open_capture(path: Path) -> Source:
    """A capture to write from. SolenavError where it can't be read or is of another schema."""
    capture = captures.load(path)
    capture.need_schema()
    return Source(path, capture)
