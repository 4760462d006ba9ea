"""The capture file `.solcap`: bytes as they came, with arrival times.

A header of 8 bytes, then records ``arrival f64 (s), length u16, bytes``, little-endian, appended
and flushed one by one: after a crash, a full disk or a pulled cable everything up to the last
whole record is there. A record holds any piece of the stream; frames may span records.

A record's header has no check of its own. Where one is damaged, the chain of lengths breaks; the
reader then looks for the place where a chain goes on, and gives what is between as it stands.
"""

from __future__ import annotations

import struct
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np

from solenav.errors import SolenavError
from solenav.link import Frame, FrameReader

MAGIC = b"SOLCAP1\n"
_RECORD = struct.Struct("<dH")
_RECORD_MAX = 65535
# So many headers in a row, each where the one before says, with times that go on, are no accident.
_CHAIN = 4
# Seconds from one record to the next, at most, for a header to be recognised after damage.
_PAUSE_MAX = 3600.0
_ARRIVAL_MIN, _ARRIVAL_MAX = 1e-6, 1e11
_BLOCK = 1 << 16


class CaptureWriter:
    """Writes a capture. Use as a context manager.

    Raises SolenavError where the file can't be made or the disk is full; what was written
    before stays readable.
    """

    def __init__(self, path: Path, *, flush: bool = True) -> None:
        self.path = path
        self.written = 0
        self._flush = flush
        try:
            self._file: BinaryIO = path.open("wb")
            self._put(MAGIC)
        except OSError as error:
            raise SolenavError(
                f"can't write {path}: {error.strerror}", "choose another file with -o", 1
            ) from None

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        if self._flush:
            self._file.flush()

    def write(self, arrival: float, data: bytes) -> None:
        """Append what arrived at `arrival` (s, on any clock that doesn't step back)."""
        try:
            for start in range(0, len(data), _RECORD_MAX):
                piece = data[start : start + _RECORD_MAX]
                self._put(_RECORD.pack(arrival, len(piece)) + piece)
        except OSError as error:
            raise SolenavError(
                f"{self.path}: {error.strerror} after {self.written} bytes",
                "free some space; what was written so far can be read",
                1,
            ) from None
        self.written += len(data)

    def __enter__(self) -> CaptureWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()


Records = tuple[list[tuple[float, bytes]], int]
"""Arrival times (s) with the bytes that came, and how many bytes of an unfinished record."""


def scan(path: Path) -> Records:
    """The capture's records, and how many bytes of an unfinished one stand at its end.

    What is there of an unfinished record comes as the last one. SolenavError where the file is
    missing, empty or no capture.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SolenavError(f"can't read {path}: {error.strerror}", "check the name") from None
    if not data:
        raise SolenavError(
            f"{path} is empty", "the recording ended before a byte came: record again"
        )
    if not data.startswith(MAGIC):
        raise SolenavError(
            f"{path} is no solenav capture (it begins with {data[:8]!r})",
            "make captures with `solenav record`, `simulate` or `import`",
        )
    return _Scan(data).records()


class _Scan:
    """The walk along the headers of a capture's bytes."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self._found = (0, 0)  # from, to: no chain begins in between, one begins at `to`

    def records(self) -> Records:
        """What `scan` returns: by the lengths alone unless looking for damage finds more frames."""
        plain = self._by_lengths(len(MAGIC))
        if _in_order(plain):
            return plain
        mended = self._by_chains()
        return mended if _frames(mended) > _frames(plain) else plain

    def _by_chains(self) -> Records:
        """The records, where a length that leads astray is mended by the next chain."""
        data = self.data
        out: list[tuple[float, bytes]] = []
        at = len(MAGIC)
        while at + _RECORD.size <= len(data):
            arrival, length = _RECORD.unpack_from(data, at)
            start = at + _RECORD.size
            end = start + length
            if self._goes_on(end):
                out.append((arrival, data[start:end]))
                at = end
                continue
            found = self._next_chain(start)
            if found == len(data):
                rest = max(self._by_lengths(at), ([(arrival, data[start:])], 0), key=_frames)
                return out + rest[0], rest[1]
            out.append((arrival, self._between(start, end, found)))
            at = found
        return out, len(data) - at

    def _goes_on(self, at: int) -> bool:
        """Whether headers follow from `at`. Some may have lost their times."""
        for _ in range(_CHAIN):
            if at == len(self.data) or self._chained(at):
                return True
            if at + _RECORD.size > len(self.data):
                return False
            (length,) = struct.unpack_from("<H", self.data, at + 8)
            at += _RECORD.size + length
        return False

    def _chained(self, at: int) -> bool:
        """Whether a chain of sound headers begins at `at`; at the file's end two will do."""
        last = 0.0
        for count in range(_CHAIN):
            if at + _RECORD.size > len(self.data):
                return count >= 2
            arrival, length = _RECORD.unpack_from(self.data, at)
            likely = arrival == 0 or _ARRIVAL_MIN < arrival < _ARRIVAL_MAX
            follows = count == 0 or 0 <= arrival - last <= _PAUSE_MAX
            if not (length and likely and follows):
                return False
            last = arrival
            at += _RECORD.size + length
        return True

    def _by_lengths(self, at: int) -> Records:
        """The records from `at` on as their lengths say, and what is there of a last one."""
        data = self.data
        out = []
        while at + _RECORD.size <= len(data):
            arrival, length = _RECORD.unpack_from(data, at)
            start = at + _RECORD.size
            out.append((arrival, data[start : start + length]))
            if start + length > len(data):
                break
            at = start + length
        return out, len(data) - at

    def _next_chain(self, start: int) -> int:
        """Where the first chain at or after `start` begins; the end of the file if none does."""
        searched, found = self._found
        if not searched <= start <= found:
            found = self._search(start)
            self._found = start, found
        return found

    def _search(self, start: int) -> int:
        for block in range(start, len(self.data) - _RECORD.size + 1, _BLOCK):
            piece = np.frombuffer(self.data[block : block + _BLOCK + 7], np.uint8)
            if len(piece) < 8:
                break
            windows = np.lib.stride_tricks.sliding_window_view(piece, 8)
            times = np.ascontiguousarray(windows).view("<f8")[:, 0]
            with np.errstate(invalid="ignore"):
                likely = (times == 0) | ((times > _ARRIVAL_MIN) & (times < _ARRIVAL_MAX))
            for offset in np.flatnonzero(likely).tolist():
                if self._chained(block + offset):
                    return block + int(offset)
        return len(self.data)

    def _between(self, start: int, end: int, found: int) -> bytes:
        """The stream's bytes from `start` to the chain at `found`.

        Either the length that led to `end` is wrong, and all of them are; or the header there is
        damaged and to be left out. The frames that come out whole decide.
        """
        whole = self.data[start:found]
        if end + _RECORD.size > found:
            return whole
        parted = self.data[start:end] + self.data[end + _RECORD.size : found]
        return max(whole, parted, key=lambda stream: _frames(([(0.0, stream)], 0)))


def _in_order(records: Records) -> bool:
    """Whether these have the times of a sound file: nobody looks for damage then."""
    times = np.array([arrival for arrival, _data in records[0]])
    with np.errstate(invalid="ignore"):
        steps = np.diff(times)
        return bool(
            (np.abs(times) < _ARRIVAL_MAX).all() and ((steps >= 0) & (steps <= _PAUSE_MAX)).all()
        )


def _frames(records: Records) -> int:
    """How many frames are intact in a stream."""
    reader = FrameReader()
    items = (item for _arrival, data in records[0] for item in reader.feed(data))
    return sum(isinstance(item, Frame) for item in items)


def read_records(path: Path) -> list[tuple[float, bytes]]:
    """The capture's records (s, bytes); errors as `scan`."""
    return scan(path)[0]
