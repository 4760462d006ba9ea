"""The black box's files for the host: listed, sent, checked, erased, a piece a call."""

from binascii import crc32
from struct import pack_into, unpack_from
from time import ticks_diff, ticks_ms

from blackbox import path, size

from solenav_core.compat import const
from solenav_core.framing import HEADER, PAYLOAD_MAX
from solenav_core.messages import (
    ASK_CHECK,
    ASK_DATA,
    ASK_ERASE,
    ASK_FILES,
    ASK_LISTEN,
    DONE,
    FILE,
    FILE_CHECK,
    FILE_DATA,
    FORMATS,
    REFUSED,
    SIZES,
)

_PACE_MS = const(10)  # between two pieces: half of what 460800 baud carry
_CHECKED_PIECES = const(4)  # read in a call
_LONGEST = const(256)  # bytes of a frame at most


class Download:
    """Serves the files that are complete, while a host listens; each command says that one does.

    `commands` are the handlers by type, for the application: each returns a result of `messages`.
    Only one thing at a time is under way: a command replaces the one before.
    """

    def __init__(self, link, blackbox):
        self.commands = {
            ASK_LISTEN: self._listen,
            ASK_FILES: self._ask_files,
            ASK_DATA: self._ask_data,
            ASK_CHECK: self._ask_check,
            ASK_ERASE: self._ask_erase,
        }
        self._link = link
        self._blackbox = blackbox
        self._kind = 0  # of the message that is to be sent next, 0: none
        self._index = 0  # FILE: of the next
        self._number = 0  # of the file in hand
        self._file = None
        self._offset = 0
        self._stop = 0
        self._crc = 0
        self._checked = ()  # number, size, CRC of the last check
        self._sent = ticks_ms()
        begin = HEADER + SIZES[FILE_DATA]
        self._piece = memoryview(link.frame)[begin : HEADER + PAYLOAD_MAX]

    def step(self, tick):
        """One piece of what a host has asked for; False: there was nothing to do."""
        box = self._blackbox
        if not self._kind or box.busy():
            return False
        if not box.listening:
            self._end()
            return False
        if not self._link.outbox.has_room(_LONGEST):
            return False
        try:
            if self._kind == FILE:
                self._send_file(tick)
            elif self._kind == FILE_CHECK:
                self._check(tick)
            else:
                now = ticks_ms()
                if ticks_diff(now, self._sent) < _PACE_MS:
                    return False
                self._sent = now
                self._send_data(tick)
        except OSError:
            # The host asks again, and is refused where the file can't even be opened.
            self._end()
        return True

    def _listen(self):
        self._blackbox.listen()
        return DONE

    def _ask_files(self):
        self._begin(FILE)
        (self._index,) = self._arguments(ASK_FILES)
        return DONE

    def _ask_data(self):
        self._begin(FILE_DATA)
        number, self._offset, length = self._arguments(ASK_DATA)
        return self._open(number, length)

    def _ask_check(self):
        (number,) = self._arguments(ASK_CHECK)
        if self._kind == FILE_CHECK and number == self._number:
            # An impatient host: starting anew would never end.
            self._blackbox.listen()
            return DONE
        self._begin(FILE_CHECK)
        self._offset = 0
        self._crc = 0
        return self._open(number, 0xFFFFFFFF)

    def _ask_erase(self):
        self._begin(0)
        wanted = self._arguments(ASK_ERASE)
        if wanted != self._checked:
            return REFUSED
        if wanted[0] not in self._blackbox.numbers:
            return DONE  # before, and the host hasn't heard
        try:
            self._blackbox.erase(wanted[0])
        except OSError:
            return REFUSED
        return DONE

    def _arguments(self, kind):
        return unpack_from(FORMATS[kind], self._link.command, HEADER)

    def _begin(self, kind):
        self._end()
        self._blackbox.listen()
        self._kind = kind

    def _open(self, number, length):
        """Take a file in hand, from `_offset` on for at most `length` bytes."""
        self._number = number
        if number in self._blackbox.numbers and not self._blackbox.busy():
            try:
                total = size(number)
                if self._offset <= total:
                    self._stop = min(self._offset + length, total)
                    self._file = open(path(number), "rb")
                    self._file.seek(self._offset)
                    return DONE
            except OSError:
                pass
        self._end()
        return REFUSED

    def _end(self):
        self._kind = 0
        if self._file:
            self._file.close()
            self._file = None

    def _send_file(self, tick):
        box = self._blackbox
        count = len(box.numbers)
        number = box.numbers[self._index] if self._index < count else 0
        # fmt: off
        pack_into(
            FORMATS[FILE], self._link.frame, HEADER, self._index, count, number,
            size(number) if number else 0, min(max(box.free(), 0), 0xFFFFFFFF), box.longest,
        )
        # fmt: on
        self._link.send(FILE, tick, HEADER + SIZES[FILE])
        self._index += 1
        if self._index >= count:
            self._end()

    def _send_data(self, tick):
        length = self._read()
        if length:
            pack_into(FORMATS[FILE_DATA], self._link.frame, HEADER, self._number, self._offset)
            self._offset += length
            self._link.send(FILE_DATA, tick, HEADER + SIZES[FILE_DATA] + length)
        if not length or self._offset >= self._stop:
            self._end()

    def _check(self, tick):
        for _ in range(_CHECKED_PIECES):
            length = self._read()
            if not length:
                break
            self._crc = crc32(self._piece[:length], self._crc)
            self._offset += length
        if length:
            return
        self._checked = (self._number, self._offset, self._crc)
        pack_into(FORMATS[FILE_CHECK], self._link.frame, HEADER, *self._checked)
        self._link.send(FILE_CHECK, tick, HEADER + SIZES[FILE_CHECK])
        self._end()

    def _read(self):
        """The next bytes of the file into the frame; how many, at most up to `_stop`."""
        return min(self._file.readinto(self._piece), self._stop - self._offset)
