"""Bytes on their way to the UART: a ring in which the least important frames go first."""

from array import array

from solenav_core.compat import const, micropython, ptr8, ptr32
from solenav_core.messages import FILE_DATA, POSE, SAMPLE, SNAPSHOT

_SIZE = 11264
# How full the ring may get by frames of a kind. A snapshot takes 3.8 kB: behind it there is room
# for samples; what is above a download's share holds one, what is above that is for steps, states,
# answers and the log alone.
_SAMPLE_SHARE = 4608
_POSE_SHARE = 6144
_DOWNLOAD_SHARE = 6656
_SNAPSHOT_SHARE = 10752

# What a ring knows, in words: each frame is placed by machine code.
_USED = const(0)  # bytes that wait
_TAIL = const(1)  # first byte that hasn't been taken
_HEAD = const(2)  # where the next frame goes
_TOP = const(3)  # end of the bytes at the tail, while the head is before it
_WRAPPED = const(4)
_CAPACITY = const(5)
_WORDS = const(6)


@micropython.viper
def frame_end(data: ptr8, at: int) -> int:
    """The end of the stuffed frame at `at`, its 0x00 included."""
    while data[at]:
        at = at + 1
    return at + 1


@micropython.viper
def room(words: ptr32, length: int, share: int) -> int:
    """Where a frame of `length` bytes may be written; -1: nowhere, or past `share` bytes in all."""
    if words[_USED] + length > share:
        return -1
    head = words[_HEAD]
    if words[_WRAPPED]:
        if head + length <= words[_TAIL]:
            return head
        return -1
    if head + length <= words[_CAPACITY]:
        return head
    if length <= words[_TAIL]:
        words[_WRAPPED] = 1
        words[_TOP] = head
        words[_HEAD] = 0
        return 0
    return -1


@micropython.viper
def grow(words: ptr32, end: int) -> int:
    """A frame was written where `room` said, up to `end`; the bytes that wait now."""
    used = words[_USED] + end - words[_HEAD]
    words[_USED] = used
    words[_HEAD] = end
    return used


class Ring:
    """Whole frames in one buffer, never split at its end, so that each stretch is one piece.

    `used` bytes wait; the oldest are buffer[tail:stop()]. `room` and `grow` take `words`.
    """

    def __init__(self, size):
        self.buffer = bytearray(size)
        self.words = array("i", bytes(4 * _WORDS))
        self.words[_CAPACITY] = size

    @property
    def used(self):
        """Bytes that wait."""
        return self.words[_USED]

    @property
    def tail(self):
        """Place of the first byte that hasn't been taken."""
        return self.words[_TAIL]

    def stop(self):
        """Where the oldest stretch in one piece ends."""
        words = self.words
        return words[_TOP] if words[_WRAPPED] else words[_HEAD]

    def take(self, length):
        """Let go of the oldest `length` bytes, at most up to `stop`."""
        words = self.words
        stop = self.stop()
        words[_USED] -= length
        words[_TAIL] += length
        if words[_TAIL] == stop:
            words[_TAIL] = 0
            if words[_WRAPPED]:
                words[_WRAPPED] = 0
            else:
                words[_HEAD] = 0


class Outbox(Ring):
    """What the UART hasn't taken yet.

    `dropped` counts frames that found no room, and poses left out: SAMPLE, POSE, others.
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
        at = room(self.words, length, share)
        if at < 0:
            self.dropped[rank] += 1
        return at

    def has_room(self, length):
        """Whether a piece of a download would find room; it waits rather than being dropped."""
        return self.used + length <= _DOWNLOAD_SHARE

    def drain(self, uart):
        """Give the UART what it takes now; True when nothing is left."""
        words = self.words
        while words[_USED]:
            tail = words[_TAIL]
            taken = uart.write(self.buffer, tail, self.stop() - tail)
            if not taken:
                return False
            self.take(taken)
        return True
