"""The sensor's I2C bus: SDA and SCL, who drives them, what disturbs them.

Errors are those of MicroPython on the rp2: OSError(EIO) where nobody acknowledges,
OSError(ETIMEDOUT) after the controller's timeout where the bus is held or its pins belong to
somebody else. A transfer takes the time of its bits.
"""

from solenav.sim.board import simtime

try:
    from collections.abc import Callable
    from typing import Any

    from solenav.sim.board.mpu9150_registers import Mpu9150
except ImportError:  # MicroPython: annotations are never evaluated there
    pass

_EIO = 5
_ETIMEDOUT = 110
_LONG = 14  # bytes of a read in which noise is looked for, where its length isn't known


def randoms(seed: int) -> Callable[[], int]:
    """Random bytes, the same each time."""
    state = seed & 0xFFFFFFFF or 1

    def byte() -> int:
        nonlocal state
        state ^= state << 13 & 0xFFFFFFFF
        state ^= state >> 17
        state ^= state << 5 & 0xFFFFFFFF
        return state >> 24

    return byte


class Bus:
    """`sensor` sits on it; `written` is called after every write to it.

    For faults: `nack` (nothing acknowledges; keys `above` and `every` of the fault), `held` (SCL
    pulses until the slave lets go of SDA), `flip` (a bit of what is read is inverted; keys
    `byte`, `bit`, `count`), `disturb` (whether a random bit of what is read or written is
    inverted; keys `every`, `seed`). The controller has the pins while `claimed`.
    """

    def __init__(self) -> None:
        self.sensor: Mpu9150 | None = None
        self.written: Callable[[], None] | None = None
        self.frequency = 400_000
        self.timeout_us = 50_000
        self.claimed = True
        self.sda = 1  # what a pin drives: 0 low, 1 released
        self.scl = 1
        self.nack: dict[str, Any] | None = None
        self.held = 0
        self.flip: dict[str, Any] | None = None
        self.reading = False  # a slave is sending
        self._flipped = 0
        self._transfers = 0
        self._every = 0
        self._random: Callable[[], int] | None = None
        self._at = 0  # bytes of the transfer so far, where they come one by one
        self._spoiled = -1  # bytes until the one that noise hits

    @property
    def sda_level(self) -> int:
        return 0 if self.held or not self.sda else 1

    def drive_scl(self, level: int) -> None:
        """By hand: each rising edge takes one bit out of a slave that holds SDA."""
        if level and not self.scl and self.held:
            self.held -= 1
        self.scl = level

    def disturb(self, fault: dict[str, Any] | None) -> None:
        """From now on, or no more."""
        self._every = fault.get("every", 50) if fault else 0
        self._random = randoms(fault.get("seed", 1)) if fault else None

    def claim(self, frequency: int, timeout_us: int) -> None:
        """The controller takes the pins."""
        self.frequency = frequency
        self.timeout_us = timeout_us
        self.claimed = True
        self.sda = self.scl = 1

    def read(self, address: int, register: int, buffer: bytearray) -> None:
        """A write of the register number (none for -1), then a read after a repeated start."""
        if register >= 0:
            sensor = self._select(address, False)
            sensor.write_byte(register)
            sensor.connect(address, True)
        else:
            sensor = self._select(address, True)
        sensor.read_into(buffer)
        sensor.stop()
        if self.flip:
            self._invert(buffer)
        if self._every:
            self._spoil(buffer, 0)
        self.reading = True
        # After the read: a burst returns one sample, also while the next one arrives.
        self._pass_bits(9 * ((3 if register >= 0 else 1) + len(buffer)))
        self.reading = False

    def write(self, address: int, data: bytes) -> None:
        """A write of a register number and what follows it."""
        sensor = self._select(address, False)
        if self._every:
            data = bytearray(data)
            self._spoil(data, 1)
        for value in data:
            sensor.write_byte(value)
        sensor.stop()
        self._pass_bits(9 * (1 + len(data)))
        if self.written:
            self.written()

    def select(self, address: int, reading: bool) -> bool:
        """For a controller that works byte by byte and passes the time itself: an address.

        False where nobody acknowledges. Then `give` and `take`, and `end`.
        """
        self._at = 0
        if self._every:
            self._transfers += 1
            if self._transfers % self._every == 0:
                self._spoiled = self._random() % _LONG
        if self.nack and self._refused(self.nack):
            return False
        return bool(self.sensor and self.sensor.connect(address, reading))

    def give(self, value: int) -> None:
        """A byte to the device."""
        first = self._at == 0
        self._at += 1
        if not first:
            value = self._noisy(value)
        self.sensor.write_byte(value)

    def take(self) -> int:
        """A byte from the device."""
        self.reading = True
        value = self.sensor.read_byte()
        if self.flip and self._at == self.flip.get("byte", 0):
            value ^= 1 << self.flip.get("bit", 0)
            self._count_flip()
        self._at += 1
        return self._noisy(value)

    def end(self) -> None:
        """A stop condition."""
        self.reading = False
        if self.sensor:
            self.sensor.stop()
        if self.written:
            self.written()

    def answers(self, address: int) -> bool:
        """Whether a device acknowledges."""
        try:
            self._select(address, False).stop()
        except OSError as error:
            if error.args[0] == _EIO:
                return False
            raise
        self._pass_bits(9)
        return True

    def _select(self, address: int, reading: bool) -> Mpu9150:
        if not self.claimed or self.held or not self.scl:
            simtime.advance(self.timeout_us)
            raise OSError(_ETIMEDOUT)
        if (self.nack and self._refused(self.nack)) or not (
            self.sensor and self.sensor.connect(address, reading)
        ):
            self._pass_bits(9)
            raise OSError(_EIO)
        return self.sensor

    def _refused(self, fault: dict[str, Any]) -> bool:
        self._transfers += 1
        if self.frequency <= fault.get("above", 0):
            return False
        return self._transfers % fault.get("every", 1) == 0

    def _invert(self, buffer: bytearray) -> None:
        fault = self.flip
        if fault.get("byte", 0) < len(buffer):
            buffer[fault.get("byte", 0)] ^= 1 << fault.get("bit", 0)
            self._count_flip()

    def _count_flip(self) -> None:
        self._flipped += 1
        if self._flipped >= self.flip.get("count", 1):
            self.flip = None
            self._flipped = 0

    def _noisy(self, value: int) -> int:
        """A byte, perhaps spoilt: the one that was chosen, of this transfer or of the next."""
        if self._spoiled < 0:
            return value
        self._spoiled -= 1
        return value ^ 1 << self._random() % 8 if self._spoiled < 0 else value

    def _spoil(self, buffer: bytearray, first: int) -> None:
        self._transfers += 1
        if self._transfers % self._every == 0 and len(buffer) > first:
            at = first + self._random() % (len(buffer) - first)
            buffer[at] ^= 1 << self._random() % 8

    def _pass_bits(self, bits: int) -> None:
        """With start, repeated start and stop."""
        simtime.advance((bits + 3) * 1_000_000 // self.frequency)
