"""A recording in several captures, each of which can be verified by itself.

Before a new file begins, HELLO, PARAMS and a SNAPSHOT are asked for. The seam is right before that
snapshot: every frame is in exactly one of the files, and the new one begins with copies of HELLO
and PARAMS, so that its first sample is proven as well.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from solenav.capture import CaptureWriter
from solenav.capture.sidecar import write_sidecar
from solenav.errors import SolenavError
from solenav.link import Frame, decode, unpack
from solenav_core import messages
from solenav_tools.recorder import Asker

_ASK_AGAIN_S = 5.0
_LOOKED_AT = (messages.HELLO, messages.PARAMS, messages.SNAPSHOT)
_HELD_MOST = 1024
_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "kb": 1e3, "mb": 1e6, "gb": 1e9}
_LEAST_S, _LEAST_BYTES = 1.0, 1e3


class Limit(NamedTuple):
    """When a file is full: after so many seconds, or a size in bytes."""

    seconds: float = float("inf")
    size: float = float("inf")


def limit(text: str) -> Limit:
    """A limit as a person writes it: 90s, 10m, 1h, 500kB, 100MB. SolenavError for anything else."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?) *([a-z]+)", text.strip().lower())
    if found is None or found[2] not in _UNITS:
        raise SolenavError(f"can't rotate by {text!r}", "give a time or a size: 10m, 1h, 100MB")
    amount = float(found[1]) * _UNITS[found[2]]
    timed = len(found[2]) == 1
    least = _LEAST_S if timed else _LEAST_BYTES
    if amount < least:
        raise SolenavError(f"{text} is too little for a file", "at least 1s or 1kB")
    return Limit(seconds=amount) if timed else Limit(size=amount)


def numbered(target: Path) -> Iterator[Path]:
    """NAME-001.solcap, NAME-002.solcap, ...; what is there already is left alone."""
    number = 0
    while True:
        number += 1
        path = target.with_name(f"{target.stem}-{number:03d}{target.suffix}")
        if not path.exists():
            yield path


class Rotation:
    """Writes what comes into one capture after the other. Use as a context manager.

    SolenavError as `CaptureWriter`.
    """

    def __init__(
        self,
        paths: Iterator[Path],
        notes: dict[str, Any],
        at: Limit | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.files: list[Path] = []
        self.written = 0  # bytes, in files that are closed
        self._paths = paths
        self._notes = notes
        self._limit = at or Limit()
        self._clock = clock
        self._writer: CaptureWriter | None = None
        self._opened = 0.0
        self._asked: float | None = None
        self._rest = b""  # of a frame that hasn't ended
        self._done = 0  # bytes of it that are in the file
        self._arrival = 0.0
        self._hello = b""
        self._params: list[bytes] = []

    def turn(self, asker: Asker) -> None:
        """Call it often: asks for what a new file begins with when this one is full."""
        now = self._clock()
        writer = self._writer
        if writer is None:
            return
        full = now - self._opened >= self._limit.seconds or writer.written >= self._limit.size
        if full and (self._asked is None or now - self._asked >= _ASK_AGAIN_S):
            self._asked = now
            asker.ask(messages.ASK_HELLO)
            asker.ask(messages.ASK_SNAPSHOT)

    def write(self, arrival: float, data: bytes) -> None:
        """Append what arrived at `arrival` (s)."""
        if self._writer is None:
            self._open()
        *ended, rest = (self._rest + data).split(b"\0")
        done = self._done
        out = b""
        for stuffed in ended:
            frame = self._keep(stuffed)
            if self._asked is not None and not done and _begins_snapshot(frame):
                self._put(arrival, out)
                self._open(arrival)
                out = b""
            out += (stuffed + b"\0")[done:]
            done = 0
        # While a seam is awaited, a frame goes to file when it has come whole: it may be the one.
        if self._asked is None or len(rest) > _HELD_MOST:
            out += rest[done:]
            done = len(rest)
        self._put(arrival, out)
        self._rest, self._done = rest, done

    def _put(self, arrival: float, data: bytes) -> None:
        if data and self._writer is not None:
            self._writer.write(arrival, data)
            self._arrival = arrival

    def _open(self, arrival: float | None = None) -> None:
        """The next file; with a time, from a seam on."""
        self._close()
        path = next(self._paths)
        self._writer = CaptureWriter(path)
        self.files.append(path)
        part = {"part": len(self.files)} if len(self.files) > 1 else {}
        write_sidecar(path, {**self._notes, **part, "started": time.time()})
        self._opened = self._clock()
        self._asked = None
        if arrival is not None:
            self._put(arrival, b"".join([self._hello, *self._params]))

    def _keep(self, stuffed: bytes) -> Frame | None:
        """A frame that a seam needs, if these bytes are one; HELLO and PARAMS are kept for it."""
        # The type stands behind COBS's first byte: the many others needn't be taken apart twice.
        if len(stuffed) < 2 or stuffed[1] not in _LOOKED_AT:
            return None
        frame = decode(stuffed)
        if not isinstance(frame, Frame):
            return None
        if frame.kind == messages.HELLO:
            self._hello = stuffed + b"\0"
        elif frame.kind == messages.PARAMS:
            if unpack(frame)["offset"] == 0:
                self._params = []
            self._params.append(stuffed + b"\0")
        return frame

    def next_file(self) -> None:
        """Go on in another file: the port was gone, and what comes now is another stretch."""
        self._put(self._arrival, self._rest[self._done :])
        self._close()
        self._rest, self._done = b"", 0

    def _close(self) -> None:
        if self._writer is None:
            return
        self.written += self._writer.written
        self._writer.close()
        self._writer = None

    def __enter__(self) -> Rotation:
        self._open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None or not issubclass(kind, SolenavError):
            self._put(self._arrival, self._rest[self._done :])
        self._close()


def _begins_snapshot(frame: Frame | None) -> bool:
    return frame is not None and frame.kind == messages.SNAPSHOT and unpack(frame)["offset"] == 0
