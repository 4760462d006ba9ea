"""The framed link to the host: frames out through the outbox, commands in, acknowledged once."""

from struct import pack_into
from time import sleep_ms

from outbox import Outbox

from solenav_core.framing import CRC, HEADER, PAYLOAD_MAX, STANDARD_SEED, crc16, stuff, unstuff
from solenav_core.messages import ACK, FORMATS, OPEN, REPEATED, SCHEMA, SIZES

_COMMAND_MAX = 64  # longest stuffed command; none has a payload yet


class Link:
    """Write a payload into `frame` from HEADER on, then `send`. Nothing is allocated per frame.

    The sequence number counts frames that were queued: a hole in it is a frame lost on the way,
    while frames dropped here are in `outbox.dropped`. `damaged` counts received frames that
    were none.
    """

    def __init__(self, uart):
        self.frame = bytearray(HEADER + PAYLOAD_MAX + CRC)
        self.outbox = Outbox()
        self.damaged = 0
        self._uart = uart
        self._seq = 0
        self._chunk = bytearray(_COMMAND_MAX)
        self._have = 0
        self._at = 0
        self._stuffed = bytearray(_COMMAND_MAX)
        self._length = 0
        self._command = bytearray(_COMMAND_MAX)
        self._last_kind = 0
        self._last_seq = -1
        # Ends whatever noise the line made while the board was off.
        self.outbox.buffer[self.outbox.place(ACK, 1)] = 0
        self.outbox.add(1)

    def send(self, kind, tick, end):
        """Queue frame[:end] as a message of type `kind`; dropped and counted if there's no room."""
        frame = self.frame
        at = self.outbox.place(kind, end + CRC + 2)
        if at < 0:
            return
        pack_into("<BBI", frame, 0, kind, self._seq, tick)
        self._seq = (self._seq + 1) & 255
        crc = crc16(frame, 0, end, STANDARD_SEED if kind in OPEN else SCHEMA)
        frame[end] = crc & 255
        frame[end + 1] = crc >> 8
        self.outbox.add(stuff(frame, end + CRC, self.outbox.buffer, at) - at)

    def pump(self):
        """Let the UART take what it can."""
        self.outbox.drain(self._uart)

    def flush(self):
        """Wait until the UART has taken everything."""
        while not self.outbox.drain(self._uart):
            sleep_ms(1)

    def receive(self, tick):
        """The type of a command that has come in whole, or 0.

        A command with the type and seq of the one before it is acknowledged here as repeated.
        """
        while True:
            if self._at == self._have:
                self._at = 0
                waiting = min(self._uart.any(), _COMMAND_MAX)
                # Only what is there: waiting for more would cost samples.
                self._have = self._uart.readinto(self._chunk, waiting) or 0 if waiting else 0
                if not self._have:
                    return 0
            byte = self._chunk[self._at]
            self._at += 1
            if byte:
                if self._length < _COMMAND_MAX:
                    self._stuffed[self._length] = byte
                self._length += 1
            elif self._length:
                kind = self._opened(self._length)
                self._length = 0
                if kind < 0:
                    self.damaged += 1
                elif kind == self._last_kind and self._command[1] == self._last_seq:
                    self.acknowledge(REPEATED, tick)
                else:
                    self._last_kind = kind
                    self._last_seq = self._command[1]
                    return kind

    def acknowledge(self, result, tick):
        """ACK the last command with one of the results of `messages`."""
        pack_into(FORMATS[ACK], self.frame, HEADER, self._last_kind, self._last_seq, result)
        self.send(ACK, tick, HEADER + SIZES[ACK])

    def _opened(self, length):
        """Unstuff and check what came before a 0x00: its type, -1 if damaged."""
        if length > _COMMAND_MAX:
            return -1
        command = self._command
        end = unstuff(self._stuffed, length, command) - CRC
        if end < HEADER:
            return -1
        crc = crc16(command, 0, end, STANDARD_SEED if command[0] in OPEN else SCHEMA)
        if command[end] | (command[end + 1] << 8) != crc:
            return -1
        return command[0]
