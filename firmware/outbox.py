"""Bytes on their way to the UART: a ring in which the least important frames go first."""

from solenav_core.messages import POSE, SAMPLE

_SIZE = 8192
# How full the ring may get by frames of a kind. What is above POSE's share holds a snapshot.
_SAMPLE_SHARE = 3072
_POSE_SHARE = 4608


class Outbox:
    """Whole frames in one buffer, never split at its end, so that each write is one stretch.

    `dropped` counts frames that found no room: SAMPLE, POSE, others.
    """

    def __init__(self):
        self.buffer = bytearray(_SIZE)
        self.dropped = [0, 0, 0]
        self._head = 0  # where the next frame goes
        self._tail = 0  # first byte that the UART hasn't taken
        self._top = 0  # end of the bytes at the tail, while the head is before it
        self._wrapped = False
        self._used = 0

    def place(self, kind, length):
        """Where in `buffer` a frame of `length` bytes may be written; -1: dropped and counted."""
        share = _SIZE
        rank = 2
        if kind == SAMPLE:
            share = _SAMPLE_SHARE
            rank = 0
        elif kind == POSE:
            share = _POSE_SHARE
            rank = 1
        if self._used + length <= share:
            if self._wrapped:
                if self._head + length <= self._tail:
                    return self._head
            elif self._head + length <= _SIZE:
                return self._head
            elif length <= self._tail:
                self._wrapped = True
                self._top = self._head
                self._head = 0
                return 0
        self.dropped[rank] += 1
        return -1

    def add(self, length):
        """`length` bytes were written where `place` said."""
        self._head += length
        self._used += length

    def drain(self, uart):
        """Give the UART what it takes now; True when nothing is left."""
        while self._used:
            stop = self._top if self._wrapped else self._head
            taken = uart.write(self.buffer, self._tail, stop - self._tail)
            if not taken:
                return False
            self._used -= taken
            self._tail += taken
            if self._tail == stop:
                self._tail = 0
                if self._wrapped:
                    self._wrapped = False
                else:
                    self._head = 0
        return True
