"""The framed link to the host: frames out through the outbox, commands in, acknowledged once."""

from struct import pack_into
from time import sleep_ms, ticks_diff, ticks_ms

from outbox import Outbox, grow

from solenav_core.compat import const
from solenav_core.framing import (
    CRC,
    HEADER,
    PAYLOAD_MAX,
    STANDARD_SEED,
    crc16,
    seal,
    stuff,
    unstuff,
)
from solenav_core.messages import ACK, ASK_HELLO, FORMATS, OPEN, REPEATED, SCHEMA, SIZES

_COMMAND_MAX = const(64)  # longest stuffed command
_TURN_MAX = const(64)  # bytes looked at in a turn of the loop: a flood must not cost samples
_COST = const(50)  # ms of credit that a command takes: 20 a second
_CREDIT_MAX = const(2000)  # ms: a burst of 40


class Link:
    """Write a payload into `frame` from HEADER on, then `send`. Nothing is allocated per frame.

    The sequence number counts frames that were queued: a hole in it is a frame lost on the way,
    while frames dropped here are in `outbox.dropped`. `blackbox` is shown each frame as well.
    `damaged` counts received frames that were none, `refused` commands beyond 20 a second (after
    a burst of 40): they are neither carried out nor acknowledged, or a flood would have an echo.
    A command's payload is in `command` from HEADER on.
    """

    def __init__(self, uart):
        self.frame = bytearray(HEADER + PAYLOAD_MAX + CRC)
        self.outbox = Outbox()
        self.blackbox = None
        self.damaged = 0
        self.refused = 0
        self.command = bytearray(_COMMAND_MAX)
        self.unlimited = 0  # the type of commands that cost no credit: their sender waits
        self._uart = uart
        self._seq = 0
        self._chunk = bytearray(_TURN_MAX)
        self._stuffed = bytearray(_COMMAND_MAX)
        self._length = 0
        self._have = 0
        self._at = 0
        self._last_kind = 0
        self._last_seq = -1
        self._credit = _CREDIT_MAX
        self._counted = ticks_ms()  # when the credit was counted last
        # Ends whatever noise the line made while the board was off.
        self.outbox.buffer[self.outbox.place(ACK, 1)] = 0
        grow(self.outbox.words, 1)

    def send(self, kind, tick, end):
        """Queue frame[:end] as a message of type `kind`; dropped and counted if there's no room."""
        frame = self.frame
        outbox = self.outbox
        box = self.blackbox
        length = end + CRC + 2
        at = outbox.place(kind, length)
        kept = box.place(kind, tick, length) if box else -1
        if at < 0 and kept < 0:
            return
        seq = self._seq
        end = seal(frame, kind, seq, tick, end, STANDARD_SEED if kind in OPEN else SCHEMA)
        if at >= 0:
            self._seq = (seq + 1) & 255
            grow(outbox.words, stuff(frame, end, outbox.buffer, at))
        if kept >= 0:
            # Stuffed twice, as copying one stretch of bytes into another would allocate.
            ring = box.ring
            grow(ring.words, stuff(frame, end, ring.buffer, kept))

    def pump(self):
        """Let the UART take what it can."""
        self.outbox.drain(self._uart)

    def flush(self):
        """Wait until the UART has taken everything."""
        while not self.outbox.drain(self._uart):
            sleep_ms(1)

    def waiting(self):
        """Whether bytes have come that nobody has looked at."""
        return self._uart.any()

    def receive(self, tick):
        """The type of a command that has come in whole, or 0. Looks at 64 bytes at most.

        A command with the type and seq of the one before it is acknowledged here as repeated.
        """
        if self._at == self._have:
            waiting = self._uart.any()
            if not waiting:
                return 0
            self._at = 0
            # Only what is there: waiting for more would cost samples.
            self._have = self._uart.readinto(self._chunk, min(waiting, _TURN_MAX)) or 0
        while self._at < self._have:
            byte = self._chunk[self._at]
            self._at += 1
            if byte:
                # One more than fits is too long already: no need to count further.
                if self._length < _COMMAND_MAX:
                    self._stuffed[self._length] = byte
                    self._length += 1
                else:
                    self._length = _COMMAND_MAX + 1
            elif self._length:
                kind = self._opened(self._length)
                self._length = 0
                if kind < 0:
                    self.damaged += 1
                elif kind != self.unlimited and not self._affordable():
                    self.refused += 1
                elif kind == self._last_kind and self.command[1] == self._last_seq:
                    self.acknowledge(REPEATED, tick)
                else:
                    self._last_kind = kind
                    self._last_seq = self.command[1]
                    return kind
        return 0

    def acknowledge(self, result, tick):
        """ACK the last command with one of the results of `messages`."""
        pack_into(FORMATS[ACK], self.frame, HEADER, self._last_kind, self._last_seq, result)
        self.send(ACK, tick, HEADER + SIZES[ACK])

    def _affordable(self):
        """Whether the rate of commands allows another one."""
        now = ticks_ms()
        # Never less than before: the clock wraps in a long silence.
        passed = max(0, ticks_diff(now, self._counted))
        self._credit = min(self._credit + passed, _CREDIT_MAX)
        self._counted = now
        if self._credit < _COST:
            return False
        self._credit -= _COST
        return True

    def _opened(self, length):
        """Unstuff and check what came before a 0x00: its type, -1 if damaged."""
        if length > _COMMAND_MAX:
            return -1
        command = self.command
        end = unstuff(self._stuffed, length, command) - CRC
        if end < HEADER:
            return -1
        kind = command[0]
        crc = crc16(command, 0, end, STANDARD_SEED if kind in OPEN else SCHEMA)
        if command[end] | (command[end + 1] << 8) != crc:
            return -1
        if kind >= ASK_HELLO and end - HEADER < SIZES.get(kind, 0):
            return -1
        return kind
