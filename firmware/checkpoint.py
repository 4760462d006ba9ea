"""What a run is gone on from: the navigator's lasting state in flash, safe at any power cut.

Two small files take turns, so that a torn write leaves the one before. They are so small that
littlefs keeps them in the log of their directory: a rewrite appends there, and a block of flash
is erased only now and then, another one each time (figures: README).
"""

from array import array
from binascii import crc32
from struct import pack_into, unpack_from

from solenav_core.compat import const
from solenav_core.layout import STATE_FIELDS, offsets
from solenav_core.navigator import SAVED, load, save

FILES = ("state0.bin", "state1.bin")

_RUNNING, _OVER = const(1), const(2)  # kinds of records: a run to go on with, the end of one
_MAGIC = const(0x314E4C53)  # SLN1
_HEAD = "<8I"  # magic, serial, identity, kind, tries, ticks, period, steps
_BODY = const(32)  # bytes of the head
_PATIENCE_S = const(2)  # so long a checkpoint waits for a stance
_SLACK_S = const(4)  # and for a moment without samples to read
_TRIES = const(3)

_AT = offsets(STATE_FIELDS)
_TICK = _AT["TICK"]
_STANCE = _AT["STANCE"]
_STEPS = _AT["STEPS"]


class Checkpoint:
    """Records of a run, one in `every` ticks (0: none), `second` ticks being a second.

    `identity`: a hash of all that must be the same for a record to mean the same. `period`: the
    sample period of the newest record, Q8 µs, 0 if there is none.
    """

    def __init__(self, identity, every, second):
        self.identity = identity
        self._every = every
        self._patience = _PATIENCE_S * second
        self._outlives = every + (_PATIENCE_S + _SLACK_S) * second
        self._words = array("i", bytes(4 * SAVED))
        self._record = bytearray(_BODY + 4 * SAVED + 4)
        self._slot = 1  # index of the file with the newest record
        self._serial = 0
        self._kind = _OVER
        self._mine = True  # the newest record is of this identity
        self._tries = 0  # boots that have gone on from it
        self._ticks = 0  # most ticks that the run went on after it
        self.period = 0
        self._steps = 0
        self._last = 0  # tick of the last record
        for slot in range(2):
            self._read(slot)

    def cut_off(self):
        """Whether the last run ended without anybody stopping it."""
        return self._kind == _RUNNING

    def objection(self):
        """Why a run that was cut off can't be gone on with; "" if it can."""
        if not self._mine:
            return "parameters or firmware are others now"
        if not self._steps:
            return "no step had been made"
        if self._tries >= _TRIES:
            return "that was tried %d times and got no further" % _TRIES
        return ""

    def restore(self, state):
        """The run that was cut off into `state`, with a gap.

        OSError where the try can't be noted in flash; `state` is right all the same.
        """
        self._tries += 1
        # Each try may have gone as far as it takes to the next record.
        load(state, self._words, self._ticks * self._tries)
        self._last = state[_TICK]
        self._write()

    def due(self, state):
        """Whether it is time, and a good one: in stance, unless there was none for 2 s."""
        passed = state[_TICK] - self._last
        if not self._every or passed < self._every:
            return False
        return state[_STANCE] != 0 or passed >= self._every + self._patience

    def save(self, state, period):
        """Note the run as it is now, if it has had its static start. OSError."""
        self._last = state[_TICK]
        if save(state, self._words):
            self._note(_RUNNING, state, period)

    def close(self, state, period):
        """Note that the run is over: nothing will be gone on with. OSError."""
        self._last = 0
        if save(state, self._words) or self._kind == _RUNNING:
            self._note(_OVER, state, period)

    def _note(self, kind, state, period):
        self._kind = kind
        self._mine = True
        self._tries = 0
        self._ticks = self._outlives
        self.period = period
        self._steps = state[_STEPS]
        self._write()

    def _write(self):
        """The record into the file whose turn it is, which it stays if that fails."""
        self._serial += 1
        record = self._record
        # fmt: off
        pack_into(
            _HEAD, record, 0, _MAGIC, self._serial, self.identity, self._kind, self._tries,
            self._ticks, self.period, self._steps,
        )
        # fmt: on
        record[_BODY:-4] = bytes(self._words)
        pack_into("<I", record, len(record) - 4, crc32(memoryview(record)[:-4]))
        with open(FILES[1 - self._slot], "wb") as file:
            file.write(record)
        self._slot = 1 - self._slot

    def _read(self, slot):
        """Take a file's record if it is sound and newer."""
        try:
            with open(FILES[slot], "rb") as file:
                record = file.read()
        except OSError:
            return
        if len(record) != len(self._record):
            return
        (found,) = unpack_from("<I", record, len(record) - 4)
        magic, serial, identity, kind, tries, ticks, period, steps = unpack_from(_HEAD, record)
        if magic != _MAGIC or found != crc32(memoryview(record)[:-4]) or serial <= self._serial:
            return
        self._slot = slot
        self._serial = serial
        self._kind = kind
        self._mine = identity == self.identity
        self._tries = tries
        self._ticks = ticks
        self.period = period
        self._steps = steps
        self._words = array("i", record[_BODY:-4])
