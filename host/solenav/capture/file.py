"""The capture file `.solcap`: bytes as they came, with arrival times.

A header of 8 bytes, then records ``arrival f64 (s), length u16, bytes``, little-endian, appended
and flushed one by one: after a crash, a full disk or a pulled cable everything up to the last
whole record is there. A record holds any piece of the stream; frames may span records.

A record's header has no check of its own. Where one is damaged, the chain of lengths breaks; the
reader then looks for the place where a chain goes on, and gives what is between as it stands. Only
a wrong length that leads to the header of another record, to the byte, can't be told.
"""

from __future__ import annotations

import struct
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from solenav.errors import SolenavError, unreadable
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
_DOUBTED = 3  # records before a broken length that may have a part in it
_NEAR = 16  # records around damage that are looked at to judge how it is best read


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

    def close(self) -> None:
        """No more comes."""
        self._file.close()

    def __enter__(self) -> CaptureWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


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
        raise unreadable(path, error) from None
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

    def __init__(self, data: bytes, *, doubting: bool = True) -> None:
        self.data = data
        self._doubting = doubting  # whether a chain that goes back in time is laid beside another
        self._found = (0, 0)  # from, to: no chain begins in between, one begins at `to`

    def records(self) -> Records:
        """What `scan` returns: by the lengths alone unless looking for damage finds more frames."""
        plain = self._by_lengths(len(MAGIC), len(self.data))
        if not plain[1] and _in_order(plain[0]):
            return plain
        mended = self._by_chains(len(MAGIC))
        return mended if _frames(mended[0]) > _frames(plain[0]) else plain

    def _by_chains(self, at: int) -> Records:
        """The records from `at` on; a length that leads astray is mended by the next chain."""
        data = self.data
        out: list[tuple[float, bytes]] = []
        begins: list[int] = []
        settled = 0
        while at + _RECORD.size <= len(data):
            arrival, length = _RECORD.unpack_from(data, at)
            start = at + _RECORD.size
            end = start + length
            if end == len(data) or self._follows(arrival, end) or self._chained(end):
                out.append((arrival, data[start:end]))
                begins.append(at)
                at = end
                continue
            # A length may have led to something like a header: look from a few records before.
            since = max(len(out) - _DOUBTED, settled)
            founds = self._next_chains(start, out[-1][0] if out else arrival)
            records, left, at = self._mended([*begins, at][since], founds, out[:since][-_NEAR:])
            out[since:] = records
            settled = len(out)
            begins[since:] = [at] * len(records)
            if at == len(data):
                return out, left
        return out, len(data) - at

    def _mended(
        self, at: int, founds: list[int], before: list[tuple[float, bytes]]
    ) -> tuple[list[tuple[float, bytes]], int, int]:
        """The best reading from `at` to a chain at one of `founds`, what is left, where to go on.

        The frames that come out whole decide, with those that reach in from before and out to
        behind. A chain's own first header may be an accident, so it is doubted as well.
        """
        choices: list[tuple[Records, int]] = []
        for found in founds:
            between = self._between(at, found)
            stop = found
            if found < len(self.data):
                arrival, length = _RECORD.unpack_from(self.data, found)
                start = found + _RECORD.size
                stop = min(start + length, len(self.data))
                first = arrival, self.data[start:stop]
                between = [([*records, first], left) for records, left in between]
                between += self._between(at, stop)
            choices += [(choice, stop) for choice in between]
        # All are judged by the frames up to the same byte.
        last = max(stop for _choice, stop in choices)
        near = self._by_lengths(last, last + _RECORD_MAX)[0][:_NEAR]
        end = last + sum(_RECORD.size + len(data) for _arrival, data in near)

        # With one chain what follows is the same for all; with two, damage behind the nearer one
        # must not speak for the farther.
        read = self._by_lengths if len(founds) == 1 else self._by_chains_between
        after = {stop: read(stop, end)[0] for _choice, stop in choices}

        def frames(choice: Records, stop: int) -> int:
            return _frames([*before, *choice[0], *after[stop]])

        (records, left), stop = max(choices, key=lambda choice: frames(*choice))
        return records, left, stop

    def _by_chains_between(self, at: int, end: int) -> Records:
        """The records between two places, damage mended where lengths and times show some."""
        plain = self._by_lengths(at, end)
        if _in_order(plain[0]):
            return plain
        return _Scan(self.data[at:end], doubting=False)._by_chains(0)

    def _follows(self, arrival: float, at: int) -> bool:
        """Whether a header at `at` goes on from a record that arrived at `arrival`."""
        if at + _RECORD.size > len(self.data):
            return False
        later, length = _RECORD.unpack_from(self.data, at)
        return length > 0 and _likely(later) and 0 <= later - arrival <= _PAUSE_MAX

    def _between(self, at: int, found: int) -> list[Records]:
        """What the bytes from the header at `at` to the chain at `found` may be.

        The lengths are right and only times are wrong; or one of the next lengths is wrong and
        all that follows is data; or it leads to a header that is damaged and to be left out.
        """
        choices: list[Records] = []
        by_lengths = self._by_lengths(at, found)
        if not by_lengths[1] or found == len(self.data):
            choices.append(by_lengths)
        sound: list[tuple[float, bytes]] = []
        for _ in range(_DOUBTED + 1):
            if at + _RECORD.size > found:
                break
            arrival, length = _RECORD.unpack_from(self.data, at)
            start = at + _RECORD.size
            end = start + length
            choices.append(([*sound, (arrival, self.data[start:found])], 0))
            if end + _RECORD.size > found:
                break
            parted = self.data[start:end] + self.data[end + _RECORD.size : found]
            choices.append(([*sound, (arrival, parted)], 0))
            sound.append((arrival, self.data[start:end]))
            at = end
        return choices

    def _chained(self, at: int) -> bool:
        """Whether a chain of sound headers begins at `at`.

        At the file's end two will do, or one whose record ends there to the byte.
        """
        last = 0.0
        for count in range(_CHAIN):
            if at + _RECORD.size > len(self.data):
                return count >= 2 or (count == 1 and at == len(self.data))
            arrival, length = _RECORD.unpack_from(self.data, at)
            follows = count == 0 or 0 <= arrival - last <= _PAUSE_MAX
            if not (length and _likely(arrival) and follows):
                return False
            last = arrival
            at += _RECORD.size + length
        return True

    def _next_chains(self, start: int, last: float) -> list[int]:
        """Where a chain at or after `start` may begin; the end of the file if none does.

        The first one, and where its time doesn't go on from `last` (s), which in noise is easily
        met, the first one near it whose time does.
        """
        searched, found = self._found
        if not searched <= start <= found:
            found = self._search(start, len(self.data))
            self._found = start, found
        if not self._doubting or found == len(self.data) or self._follows(last, found):
            return [found]
        reach = min(found + _CHAIN * (_RECORD_MAX + _RECORD.size), len(self.data))
        follower = self._search(found, reach, last)
        return [found] if follower == reach else [found, follower]

    def _search(self, start: int, stop: int, last: float | None = None) -> int:
        """The first place before `stop` where a chain begins, one that goes on from `last`."""
        for block in range(start, stop - _RECORD.size + 1, _BLOCK):
            piece = np.frombuffer(self.data[block : min(block + _BLOCK + 7, stop)], np.uint8)
            windows = np.lib.stride_tricks.sliding_window_view(piece, 8)
            times = np.ascontiguousarray(windows).view("<f8")[:, 0]
            with np.errstate(invalid="ignore"):
                likely = _likely(times)
                if last is not None:
                    likely &= (times >= last) & (times <= last + _PAUSE_MAX)
            for offset in np.flatnonzero(likely).tolist():
                if self._chained(block + offset):
                    return block + int(offset)
        return stop

    def _by_lengths(self, at: int, stop: int) -> Records:
        """The records between two places as their lengths say, and what is left of a last one."""
        data = self.data[:stop]
        out = []
        while at + _RECORD.size <= len(data):
            arrival, length = _RECORD.unpack_from(data, at)
            start = at + _RECORD.size
            out.append((arrival, data[start : start + length]))
            if start + length > len(data):
                break
            at = start + length
        return out, len(data) - at


def _likely(arrival: Any) -> Any:
    """Whether this may be a time. Most bytes that are none give a tiny or a huge number."""
    return (arrival == 0) | ((arrival > _ARRIVAL_MIN) & (arrival < _ARRIVAL_MAX))


def _in_order(records: list[tuple[float, bytes]]) -> bool:
    """Whether these have the times of a sound file: nobody looks for damage then."""
    times = np.array([arrival for arrival, _data in records])
    with np.errstate(invalid="ignore"):
        steps = np.diff(times)
        return bool(_likely(times).all() and ((steps >= 0) & (steps <= _PAUSE_MAX)).all())


def _frames(records: list[tuple[float, bytes]]) -> int:
    """How many frames are intact in a stream."""
    reader = FrameReader()
    items = (item for _arrival, data in records for item in reader.feed(data))
    return sum(isinstance(item, Frame) for item in items)


def read_records(path: Path) -> list[tuple[float, bytes]]:
    """The capture's records (s, bytes); errors as `scan`."""
    return scan(path)[0]
