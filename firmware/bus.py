"""The sensor's I2C bus: transfers counted when they fail, lines freed, clock slowed."""

import time

from machine import Pin

from solenav_core.compat import const

# kHz. A metre of cable carries the fast clock with pull-ups near 2 kΩ, the slow one in any case.
FAST = 400
SLOW = 100

_TRIES = const(3)  # of a transfer while the sensor is set up
_HALF_CLOCK = const(5)  # µs, of a 100 kHz clock


def recover(scl, sda):
    """Nine clocks with SDA released, then a STOP: ends whatever a chip was sending.

    I2C specification UM10204, 3.1.16. `scl`, `sda`: pin numbers, which the I2C has to be opened
    on anew afterwards. True where both lines are high then.
    """
    clock = Pin(scl, Pin.OPEN_DRAIN, value=1)
    data = Pin(sda, Pin.OPEN_DRAIN, value=1)
    # All nine, also where SDA goes up before: it may be a 1 in the middle of a byte.
    for _ in range(9):
        clock.value(0)
        time.sleep_us(_HALF_CLOCK)
        clock.value(1)
        time.sleep_us(_HALF_CLOCK)
    clock.value(0)
    data.value(0)
    time.sleep_us(_HALF_CLOCK)
    clock.value(1)
    time.sleep_us(_HALF_CLOCK)
    data.value(1)
    time.sleep_us(_HALF_CLOCK)
    return bool(clock.value() and data.value())


class Bus:
    """Owns the I2C of a board (its `open_bus`, `scl`, `sda`, `power`).

    `khz` is its clock, `errors` counts failed transfers, also those that a further try mended.
    """

    def __init__(self, board):
        self.khz = FAST
        self.errors = 0
        self._board = board
        self._byte = bytearray(1)
        self._i2c = board.open_bus(1000 * FAST)

    def open(self, khz):
        """Free the lines and open the bus anew at `khz`; False where a line stays low."""
        free = recover(self._board.scl, self._board.sda)
        self.khz = khz
        self._i2c = self._board.open_bus(1000 * khz)
        return free

    def power_cycle(self):
        """Take the sensor's supply away and give it back; False where no pin switches it."""
        if self._board.power is None:
            return False
        supply = Pin(self._board.power, Pin.OUT, value=0)
        time.sleep_ms(50)
        supply.value(1)
        time.sleep_ms(100)  # start-up time for register access, MPU-9150 product specification 6.3
        return True

    def read_into(self, address, register, buffer):
        """Registers from `register` on, one burst, one try. OSError. Allocates nothing."""
        try:
            self._i2c.readfrom_mem_into(address, register, buffer)
        except OSError:
            self.errors += 1
            raise

    def write_from(self, address, register, buffer):
        """One burst, one try. OSError. Allocates nothing."""
        try:
            self._i2c.writeto_mem(address, register, buffer)
        except OSError:
            self.errors += 1
            raise

    def read(self, address, register):
        """One register's value, in up to three tries. OSError."""
        self._persist(self.read_into, address, register)
        return self._byte[0]

    def write(self, address, register, value):
        """One register, in up to three tries. OSError."""
        self._byte[0] = value
        self._persist(self.write_from, address, register)

    def _persist(self, transfer, address, register):
        for attempt in range(_TRIES):
            try:
                transfer(address, register, self._byte)
                return
            except OSError:
                if attempt == _TRIES - 1:
                    raise
