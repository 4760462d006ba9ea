"""Bytes on their way to the UART: a ring in which the least important frames go first."""

from solenav_core.compat import micropython, ptr8
from solenav_core.messages import FILE_DATA, POSE, SAMPLE, SNAPSHOT

_SIZE = 11264
# How full the ring may get by frames of a kind. A snapshot takes 3.8 kB: behind it there is room
# for samples; what is above a download's share holds one, what is above that is for steps, states,
# answers and the log alone.
_SAMPLE_SHARE = 4608
_POSE_SHARE = 6144
_DOWNLOAD_SHARE = 6656
_SNAPSHOT_SHARE = 10752


@micropython.viper
def frame_end(data: ptr8, at: int) -> int:
    """The end of the stuffed frame at `at`, its 0x00 included."""
    while data[at]:
        at = at + 1
    return at + 1


class Ring:
    """Whole frames in one buffer, never split at its end, so that each stretch is one piece.

    `used` bytes wait; the oldest are buffer[tail:stop()].
    """

    def __init__(self, size):
        self.buffer = bytearray(size)
        self.used = 0
        self.tail = 0  # first byte that hasn't been taken
        self._size = size
        self._head = 0  # where the next frame goes
        self._top = 0  # end of the bytes at the tail, while the head is before it
        self._wrapped = False

    def room(self, length):
        """Where in `buffer` a frame of `length` bytes may be written; -1: nowhere."""
        if self._wrapped:
            if self._head + length <= self.tail:
                return self._head
        elif self._head + length <= self._size:
            return self._head
        elif length <= self.tail:
            self._wrapped = True
            self._top = self._head
            self._head = 0
            return 0
        return -1

    def add(self, length):
        """`length` bytes were written where `room` said."""
        self._head += length
        self.used += length

    def stop(self):
        """Where the oldest stretch in one piece ends."""
        return self._top if self._wrapped else self._head

    def take(self, length):
        """Let go of the oldest `length` bytes, at most up to `stop`."""
        stop = self.stop()
        self.used -= length
        self.tail += length
        if self.tail == stop:
            self.tail = 0
            if self._wrapped:
                self._wrapped = False
            else:
                self._head = 0


class Outbox(Ring):
    """What the UART hasn't taken yet.

    `dropped` counts frames that found no room: SAMPLE, POSE, others.
    """

    def __init__(self):
        super().__init__(_SIZE)
        self.dropped = [0, 0, 0]

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
        elif kind == FILE_DATA:
            share = _DOWNLOAD_SHARE
        elif kind == SNAPSHOT:
            share = _SNAPSHOT_SHARE
        at = self.room(length) if self.used + length <= share else -1
        if at < 0:
            self.dropped[rank] += 1
        return at

    def has_room(self, length):
        """Whether a piece of a download would find room; it waits rather than being dropped."""
        return self.used + length <= _DOWNLOAD_SHARE

    def drain(self, uart):
        """Give the UART what it takes now; True when nothing is left."""
        while self.used:
            taken = uart.write(self.buffer, self.tail, self.stop() - self.tail)
            if not taken:
                return False
            self.take(taken)
        return True
