"""AK8975, the magnetometer inside the MPU-9150: set up, self-test, readings into IMU axes.

Registers as in the AK8975 data sheet MS1187. It measures only when told to, 9 ms at most; its
data are indefinite meanwhile, so it is read no sooner (6.4.2.2), and a mode is left for another
by way of power-down, with 100 µs in between (6.3).
"""

import time
from array import array

from solenav_core.compat import const, micropython, ptr8, ptr32

ADDRESS = 0x0C
SIZE = 8  # bytes of a reading, ST1 to ST2

# SAMPLE flags of `messages`, for kernels, which know constants of their own file only.
_MAG_NEW = const(8)
_MAG_BAD = const(16)

_WIA = const(0x00)
ST1 = const(0x02)
CNTL = const(0x0A)
_ASTC = const(0x0C)
_ASAX = const(0x10)

SINGLE = const(0x01)  # modes of CNTL
_POWER_DOWN = const(0x00)
_SELF_TEST = const(0x08)
_FUSE_ROM = const(0x0F)

_IDENTITY = const(0x48)
_READY = const(0x01)  # ST1
_UNSOUND = const(0x0C)  # ST2: read error or overflow
_MEASUREMENT_MS = const(10)
_NEUTRAL = const(128)  # sensitivity adjustment of 1
_AT = const(14)  # a reading follows the IMU's 14 bytes
_TOP = const(0x3FFFFFFF)


@micropython.viper
def decode(raw: ptr8, last: ptr8, adjust: ptr8, sample: ptr32, due: int) -> int:
    """A reading in raw[14:22] (ST1 HX HY HZ ST2, little-endian) into sample[6:9]: SAMPLE's flags.

    0 for one like `last` (8 bytes, which take it over) unless `due`, and for one that isn't
    ready. Counts of 0.3 µT times (ASA + 128)/256 (8.3.11); axes: the IMU's x, y, z are y, x, -z
    here. After an unsound one (ST2, or out of -4096 to 4095) `sample` keeps what it has.
    """
    changed = due
    i = 0
    while i < 8:
        if raw[_AT + i] != last[i]:
            last[i] = raw[_AT + i]
            changed = 1
        i = i + 1
    if changed == 0 or (last[0] & _READY) == 0:
        return 0
    if last[7] & _UNSOUND:
        return _MAG_BAD
    x = ((last[1] | (last[2] << 8)) ^ 0x8000) - 0x8000
    y = ((last[3] | (last[4] << 8)) ^ 0x8000) - 0x8000
    z = ((last[5] | (last[6] << 8)) ^ 0x8000) - 0x8000
    if x < -4096 or x > 4095 or y < -4096 or y > 4095 or z < -4096 or z > 4095:
        return _MAG_BAD
    sample[6] = (y * (adjust[1] + 128) + 128) >> 8
    sample[7] = (x * (adjust[0] + 128) + 128) >> 8
    sample[8] = 0 - ((z * (adjust[2] + 128) + 128) >> 8)
    return _MAG_NEW


class Ak8975:
    """The magnetometer on `bus`, to which the bypass of the IMU connects it for all but `take`.

    `every`: a measurement in so many samples. `silent` counts samples since the last reading,
    `errors` its own share of the bus's while sampling.
    """

    def __init__(self, bus):
        self.every = 1
        self.silent = 0
        self.errors = 0
        self._bus = bus
        self._age = 0  # samples since the last reading
        self._adjust = bytearray([_NEUTRAL] * 3)
        self._last = bytearray(SIZE)
        self._raw = bytearray(_AT + SIZE)
        self._window = memoryview(self._raw)[_AT:]
        self._trigger = bytearray([SINGLE])
        self._identity = bytearray(1)

    def find(self):
        """Whether it answers; its sensitivities are read then, and it is left powered down."""
        try:
            if self._bus.read(ADDRESS, _WIA) != _IDENTITY:
                return False
            self._mode(_POWER_DOWN)
            self._mode(_FUSE_ROM)
            self._bus.read_into(ADDRESS, _ASAX, self._adjust)
            self._mode(_POWER_DOWN)
            # A reading from before, which would pass for a new one, is gone once it is read.
            self._bus.read_into(ADDRESS, ST1, self._window)
        except OSError:
            return False
        return True

    def test(self):
        """Its self-test (6.4.3, with the limits of 8.3.9): True where it passes. OSError."""
        raw = self._raw
        self._mode(_POWER_DOWN)
        self._bus.write(ADDRESS, _ASTC, 0x40)
        self._mode(_SELF_TEST)
        time.sleep_ms(_MEASUREMENT_MS)
        self._bus.read_into(ADDRESS, ST1, self._window)
        self._bus.write(ADDRESS, _ASTC, 0x00)
        self._mode(_POWER_DOWN)
        field = array("i", bytes(4 * 9))
        if decode(raw, bytearray(SIZE), self._adjust, field, 1) != _MAG_NEW:
            return False
        # HZ is -1000 to -300; the IMU's z points the other way.
        return abs(field[6]) <= 100 and abs(field[7]) <= 100 and 300 <= field[8] <= 1000

    def restart(self, every):
        """Forget what was read; from now on a measurement in `every` samples."""
        self.every = every
        self.silent = 0
        self._age = 0
        self._last[0] = 0  # not ready: nothing in it counts

    def take(self, raw, sample):
        """The reading that came with a sample, in raw[14:22], where a bit of it is new.

        SAMPLE's flags; 0 without one. Allocates nothing.
        """
        self._age += 1
        return self._heard(decode(raw, self._last, self._adjust, sample, 0))

    def is_due(self):
        """Whether a reading has come, for all that one can count; each is asked for once."""
        if self._age < self.every:
            return False
        self._age = 0
        return True

    def take_equal(self, raw, sample):
        """Like `take`, for a reading that is due and no different from the last one."""
        return self._heard(decode(raw, self._last, self._adjust, sample, 1))

    def poll(self, sample):
        """With each sample, through the bypass: read and measure again in `every` samples.

        SAMPLE's flags. A transfer that fails is counted. Allocates nothing.
        """
        self._age += 1
        if not self.is_due():
            return self._heard(0)
        self._window[0] = 0  # not ready, should the transfer fail
        try:
            self._bus.read_into(ADDRESS, ST1, self._window)
            self._bus.write_from(ADDRESS, CNTL, self._trigger)
        except OSError:
            self.errors += 1
        return self._heard(decode(self._raw, self._last, self._adjust, sample, 1))

    def answers(self):
        """Whether it is there, behind the bypass."""
        self._identity[0] = 0
        try:
            self._bus.read_into(ADDRESS, _WIA, self._identity)
        except OSError:
            self.errors += 1
        return self._identity[0] == _IDENTITY

    def _heard(self, flags):
        if flags:
            self._age = 0
            self.silent = 0
        elif self.silent < _TOP:
            self.silent += 1
        return flags

    def _mode(self, mode):
        self._bus.write(ADDRESS, CNTL, mode)
        time.sleep_us(100)
