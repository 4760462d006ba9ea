"""The capture file `.solcap`: bytes as they came, with arrival times.

A header of 8 bytes, then records ``arrival f64 (s), length u16, bytes``, little-endian, appended
and flushed one by one: after a crash, a full disk or a pulled cable everything up to the last
whole record is there. A record holds any piece of the stream; frames may span records.
"""

from __future__ import annotations

import struct
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from solenav.errors import SolenavError

MAGIC = b"SOLCAP1\n"
_RECORD = struct.Struct("<dH")
_RECORD_MAX = 65535


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


def scan(path: Path) -> tuple[list[tuple[float, bytes]], int]:
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
    records = []
    at = len(MAGIC)
    while at + _RECORD.size <= len(data):
        arrival, length = _RECORD.unpack_from(data, at)
        start = at + _RECORD.size
        records.append((arrival, data[start : start + length]))
        if start + length > len(data):
            break
        at = start + length
    return records, len(data) - at


def read_records(path: Path) -> list[tuple[float, bytes]]:
    """The capture's records (s, bytes); errors as `scan`."""
    return scan(path)[0]
