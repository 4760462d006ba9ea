"""Reading a feed file: what a sensor will measure, and when.

Records of 24 bytes, little-endian: time in µs from the moment when sampling starts (u32, goes on
from 0 after 2**32), then ax ay az temperature gx gy gz mx my mz (i16): counts at ±16 g and
±2000 °/s in the order of the sensor's registers, and the magnetic field in the accelerometer's
axes in counts of 0.3 µT; -32768 where it isn't known. `solenav.sim.feed_file` writes them.
"""

from struct import unpack_from

AXES = ("ax", "ay", "az", "temperature", "gx", "gy", "gz", "mx", "my", "mz")

_FORMAT = "<I10h"
_SIZE = 24
_RECORDS = 256


class Feed:
    """Records one by one, in little memory."""

    def __init__(self, path: str) -> None:
        self.values: tuple[int, ...] = ()
        self._file = open(path, "rb")
        self._chunk = bytearray(_SIZE * _RECORDS)
        self._have = 0
        self._at = 0
        self._time = 0
        self._read = 0
        self._before = 0  # time of the record before

    def next(self) -> int:
        """Time in µs of the next record, whose values are then in `values`; -1 at the end."""
        if self._at + _SIZE > self._have:
            self._have = self._file.readinto(self._chunk) or 0
            self._at = 0
            if self._have < _SIZE:
                self._have = 0
                return -1
        record = unpack_from(_FORMAT, self._chunk, self._at)
        self._at += _SIZE
        self._read += 1
        self._before = self._time
        self._time += (record[0] - self._time) & 0xFFFFFFFF
        self.values = record[1:]
        return self._time

    def place(self) -> list[int]:
        """Where the record is that was read last, for `seek`."""
        return [max(0, self._read - 1), self._before]

    def seek(self, place: list[int]) -> None:
        """Read that record next."""
        self._read, self._time = place
        self._file.seek(_SIZE * self._read)
        self._have = self._at = 0
