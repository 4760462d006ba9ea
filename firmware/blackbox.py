"""The black box: what no host hears goes to flash, as a ring of numbered files.

A file is the byte stream as on the wire, whole frames only. Nothing else is kept: the numbers
in the names are the order, so a power cut can tear no index, only what was not flushed.
"""

import os
from errno import EEXIST
from time import ticks_diff, ticks_ms, ticks_us

import reports
from outbox import Ring, frame_end, room

from solenav_core.compat import const
from solenav_core.messages import (
    ACK,
    FILE,
    FILE_CHECK,
    HELLO,
    PARAMS,
    POSE,
    SAMPLE,
    SNAPSHOT,
    STATUS,
)

_FOLDER = "log"
_SUFFIX = ".frames"

_RING = const(2048)  # bytes: more than 7 s of frames without samples
_RING_SAMPLES = const(7168)  # a whole snapshot, and the samples of a slow flash access
_HEAD = const(1024)  # bytes of the ring that HELLO and PARAMS may take
_HEAD_SAMPLES = const(4608)  # and a snapshot
_CHUNK = const(1024)  # bytes of a write: it erases one block of flash at most
_FILE_MAX = const(65536)  # bytes
_FILE_MIN = const(4096)  # a smaller one isn't worth its block
_RESERVE = const(65536)  # bytes of flash kept free for checkpoints and the file system's copies
_NOTHING = const(-0x3FFFFFFF)  # less than is ever free
_LISTEN_MS = const(5000)  # without ASK_LISTEN for so long nobody listens
_FLUSH_MS = const(5000)
_REST_MS = const(40)  # after an access that writes: the sensor's FIFO is emptied meanwhile
_FAILURES_MAX = const(3)

_ENOSPC = const(28)  # MicroPython's errno doesn't have it
_WARNING = const(1)

_ASKED_AGAIN = (HELLO, PARAMS, SNAPSHOT, STATUS, ACK)  # what a host that joins misses nothing of


class BlackBox:
    """Takes frames from `Link.send`, writes them in `step`, at most one access to flash a call.

    Frames are kept in RAM also while a host listens: when it has left, the last ones before that
    go to flash as well. From the boot on until ASK_LISTEN comes nobody listens.

    `policy`: "off", "stop" (the oldest files stay) or "overwrite" (they go). `everything`: with
    samples, snapshots and all poses; else one pose in `second` ticks. `describe` is called when a
    file has begun: it must send HELLO, PARAMS and, with `everything`, a snapshot.

    `logged` counts the bytes that are safe in flash since power-up, `lost` the frames that were
    to go there and didn't; `longest` is the longest access in µs. `numbers` are the files',
    oldest first.
    """

    def __init__(self, link, policy, everything, second, describe):
        size = _RING_SAMPLES if everything else _RING
        self.ring = Ring(size)
        self._view = memoryview(self.ring.buffer)
        self.listening = False
        self.logged = 0
        self.lost = 0
        self.longest = 0
        self.numbers = []
        self._link = link
        self._on = policy != "off"
        self._full = False
        self._memory = size * 3 // 4  # bytes of frames kept while a host listens
        self._calm = size - (_HEAD_SAMPLES if everything else _HEAD)
        self._overwrite = policy == "overwrite"
        self._everything = everything
        self._second = second
        self._describe = describe
        self._pose = -second  # tick of the last pose taken
        self._heard = ticks_ms()  # ASK_LISTEN
        self._file = None
        self._number = 0  # of the last file
        self._freed = _NOTHING  # free bytes before the last file was erased for a new one
        self._size = 0
        self._most = 0  # that the file may get
        self._unsafe = 0  # bytes written and not flushed
        self._frames = 0  # in them
        self._topped = False  # what was left in RAM has been written for the flush that is due
        self._flushed = self._heard
        self._rested = self._heard
        self._left = 0  # bytes still to be written although a host listens
        self._dear = False  # the ring holds what a host can't ask for again
        self._described = False  # a HELLO is in the file or on its way there
        self._failures = 0
        self._complaint = ""
        if self._on:
            try:
                self._recover()
            except OSError as error:
                self._give_up(error)
        link.blackbox = self

    def place(self, kind, tick, length):
        """Where in `ring.buffer` the frame may be written; -1: nowhere."""
        if not self._on or FILE <= kind <= FILE_CHECK:
            return -1
        if not self._everything:
            if kind == SAMPLE or kind == SNAPSHOT:
                return -1
            if kind == POSE and 0 <= tick - self._pose < self._second:
                return -1
        if self._full:
            if not self.listening:
                self.lost += 1
            return -1
        ring = self.ring
        at = room(ring.words, length, len(ring.buffer))
        if self.listening and not self._left:
            # Old frames go, and so many that there is room for new ones until the file is open.
            while at < 0 or ring.used + length > self._memory:
                self._forget()
                at = room(ring.words, length, len(ring.buffer))
        if at < 0:
            self.lost += 1
            return -1
        if kind == POSE:
            self._pose = tick
        if kind == HELLO:
            self._described = True
        elif kind not in _ASKED_AGAIN:
            self._dear = True
        return at

    def listen(self):
        """A host listens. What it has missed is still written."""
        self._heard = ticks_ms()
        if not self.listening:
            self.listening = True
            if self._file or self._dear:
                self._left = self.ring.used

    def busy(self):
        """Whether what a listening host has missed is still being written."""
        return self._file is not None or self._left > 0

    def step(self, tick):
        """Call it when the sensor has nothing waiting. False: there was nothing to do."""
        now = ticks_ms()
        if self.listening and ticks_diff(now, self._heard) >= _LISTEN_MS:
            self.listening = False
            self._left = 0
            self._described = False
        if self._complaint:
            # Here and not where it came up: a LOG needs room in the ring as well.
            text, self._complaint = self._complaint, ""
            reports.log(self._link, tick, _WARNING, text)
        if self._full or not self._on or ticks_diff(now, self._rested) < _REST_MS:
            return False
        began = ticks_us()
        worked = self._try(now)
        if worked:
            self.longest = max(self.longest, ticks_diff(ticks_us(), began))
            self._rested = ticks_ms()
        return worked

    def close(self):
        """Write what is left; for the moment before a restart."""
        self.listen()
        while self._on and not self._full and self._try(self._heard):
            pass

    def free(self):
        """Bytes of flash that may still be written, below 0 inside the reserve. OSError."""
        status = os.statvfs(_FOLDER)
        return status[1] * status[4] - _RESERVE

    def erase(self, number):
        """OSError where that fails."""
        os.remove(path(number))
        self.numbers.remove(number)
        self._full = False

    def _try(self, now):
        """Work; True when something was done, though it may have failed."""
        try:
            return self._work(now)
        except OSError as error:
            self._fail(error)
            return True

    def _work(self, now):
        due = ticks_diff(now, self._flushed) >= _FLUSH_MS
        used = self.ring.used
        if self.listening:
            wanted = self._left > 0
        else:
            if self._file and not self._described and used <= self._calm:
                self._described = True
                self._describe()
                return True
            wanted = used >= _CHUNK or (due and used and not self._topped)
        if wanted:
            if self._file is None:
                self._begin()
            else:
                self._write()
                self._topped = due
            return True
        if self._file is None:
            return False
        if self.listening:
            self._end()
        elif due:
            self._file.flush()
            self._acknowledge(now)
        else:
            return False
        return True

    def _begin(self):
        """Open a file, if there is space; with "overwrite" make some, a file a call."""
        free = self.free()
        # The last whole file goes only where there is no room at all. Where erasing made none it
        # isn't the black box that takes it.
        least = _FILE_MAX if len(self.numbers) > 1 else _FILE_MIN
        if self._overwrite and self._freed < free < least and self.numbers:
            self._freed = free
            self.erase(self.numbers[0])
            return
        self._freed = _NOTHING
        if free < _FILE_MIN:
            self._stop("is full")
            return
        self._file = open(path(self._number + 1), "wb")
        self._number += 1
        self.numbers.append(self._number)
        self._size = 0
        self._most = min(free, _FILE_MAX)

    def _write(self):
        """A chunk of whole frames; a full file is closed instead."""
        ring = self.ring
        buffer = ring.buffer
        end = ring.tail
        stop = ring.stop()
        most = end + min(_CHUNK, self._most - self._size)
        frames = 0
        while end < stop:
            after = frame_end(buffer, end)
            if after > most:
                break
            end = after
            frames += 1
        length = end - ring.tail
        if not length:
            self._end()
            return
        self._file.write(self._view[ring.tail : end])
        ring.take(length)
        self._size += length
        self._unsafe += length
        self._frames += frames
        self._left = max(0, self._left - length)

    def _end(self):
        """Close the file."""
        self._file.close()
        self._file = None
        self._described = False
        self._dear = not self.listening
        self._acknowledge(ticks_ms())

    def _acknowledge(self, now):
        """All that was written is safe."""
        self.logged += self._unsafe
        self._unsafe = 0
        self._frames = 0
        self._topped = False
        self._flushed = now
        self._failures = 0

    def _fail(self, error):
        """The flash refused an access: what was not flushed is lost, the file is done with."""
        self.lost += self._frames
        self._unsafe = 0
        self._frames = 0
        file = self._file
        self._file = None
        if file:
            try:
                file.close()
            except OSError:
                pass
        self._described = False
        if error.args[:1] == (_ENOSPC,):
            if not (self._overwrite and len(self.numbers) > 1):
                self._stop("is full")
                return
            try:
                self.erase(self.numbers[0])
            except OSError as refused:
                error = refused
        self._failures += 1
        if self._failures >= _FAILURES_MAX:
            self._give_up(error)

    def _give_up(self, error):
        self._stop("can't write to flash (%s)" % error)

    def _stop(self, why):
        """Nothing more is written."""
        while self.ring.used:
            self._forget()
            self.lost += 1
        self._left = 0
        self._full = True
        kept = "%d files are kept, frames that no host hears are lost" % len(self.numbers)
        self._complaint = "the black box %s: %s" % (why, kept)

    def _forget(self):
        """Let the oldest frame in RAM go."""
        ring = self.ring
        ring.take(frame_end(ring.buffer, ring.tail) - ring.tail)

    def _recover(self):
        """Find the files that are there; what never got a byte is removed. OSError."""
        try:
            os.mkdir(_FOLDER)
        except OSError as error:
            if error.args[:1] != (EEXIST,):
                raise
        for name in os.listdir(_FOLDER):
            digits = name[: -len(_SUFFIX)]
            if not (name.endswith(_SUFFIX) and digits.isdigit()):
                continue
            if size(int(digits)):
                self.numbers.append(int(digits))
            else:
                os.remove(path(int(digits)))
        self.numbers.sort()
        if self.numbers:
            self._number = self.numbers[-1]


def path(number):
    """The file of that number."""
    return "%s/%06d%s" % (_FOLDER, number, _SUFFIX)


def size(number):
    """Bytes of the file. OSError where there is none."""
    return os.stat(path(number))[6]
