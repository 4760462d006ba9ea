"""MPU-9150 driver: registers in, raw counts out.

Registers as in the MPU-9150 register map 4.2, times as in its product specification. The bus is
an argument: a `bus.Bus`, or anything with its `read`, `write`, `read_into` and `write_from`.
"""

import time
from array import array

import ak8975

from solenav_core.compat import const, micropython, ptr8, ptr32
from solenav_core.messages import NOT_TESTED

# What `kind` says, an index into `messages.SENSORS`.
MPU6050 = 1
MPU9150 = 2

# Ways to the magnetometer.
NO_WAY = 0
AUXILIARY = 1
BYPASS = 2

ALIKE = 256  # of `decode`: the IMU's bytes are those of the sample before

_SELF_TEST_X = const(0x0D)
_SMPLRT_DIV = const(0x19)
_CONFIG = const(0x1A)
_GYRO_CONFIG = const(0x1B)
_ACCEL_CONFIG = const(0x1C)
_FIFO_EN = const(0x23)
_I2C_SLV4_CTRL = const(0x34)
_I2C_MST_STATUS = const(0x36)
_INT_PIN_CFG = const(0x37)
_INT_ENABLE = const(0x38)
_ACCEL_XOUT_H = const(0x3B)
_I2C_SLV1_DO = const(0x64)
_I2C_MST_DELAY_CTRL = const(0x67)
_USER_CTRL = const(0x6A)
_PWR_MGMT_1 = const(0x6B)
_FIFO_COUNTH = const(0x72)
_FIFO_R_W = const(0x74)
_WHO_AM_I = const(0x75)

_IDENTITY = const(0x68)
_RELATIVES = {
    0x12: "an ICM-20602",
    0x19: "an MPU-6886",
    0x70: "an MPU-6500",
    0x71: "an MPU-9250",
    0x73: "an MPU-9255",
    0x98: "an ICM-20689",
}

# USER_CTRL
_FIFO_ON = const(0x40)
_MASTER_ON = const(0x20)
_FIFO_RESET = const(0x04)

_IMU_SIZE = const(14)  # bytes: acceleration, temperature, rate
_FIFO_SIZE = const(1024)
_MEASURING_US = const(9475)  # 9 ms at most (AK8975 5.3.3), with the IMU's clock up to 5 % fast

_CLIPPED_ACC = const(1)
_CLIPPED_GYRO = const(2)
_ALIKE = const(256)

# Self-test: at ±8 g and ±250 °/s, where its factory trim holds.
_TEST_SAMPLES = const(32)
_TEST_TOLERANCE = const(14)  # % of the factory trim
_BUS_READS = const(500)
_BUS_ERRORS = const(20)
_TEST_TRIES = const(3)
_STILL_ACC = const(410)  # counts: 0.1 g
_STILL_GYRO = const(655)  # counts: 5 °/s


class SensorError(Exception):
    """The sensor can't be used; its text says what happened and what to look at."""


@micropython.viper
def decode(raw: ptr8, last: ptr8, sample: ptr32) -> int:
    """The 14 bytes from ACCEL_XOUT_H into `sample` (ax ay az gx gy gz, counts), and into `last`.

    Returns bits: 1 an accelerometer axis at full scale, 2 a gyro axis; 256 where no byte differs
    from `last`.
    """
    flags = _ALIKE
    i = 0
    while i < _IMU_SIZE:
        if raw[i] != last[i]:
            last[i] = raw[i]
            flags = 0
        i = i + 1
    i = 0
    while i < 6:
        at = i + i
        if i > 2:
            at = at + 2  # past the temperature
        value = (((raw[at] << 8) | raw[at + 1]) ^ 0x8000) - 0x8000
        sample[i] = value
        if value == 32767 or value == -32768:
            if i > 2:
                flags = flags | _CLIPPED_GYRO
            else:
                flags = flags | _CLIPPED_ACC
        i = i + 1
    return flags


def _grown(thousandths, ratio, code):
    """A trim that grows by `ratio` / 10**7 a code from the first on; 0 for code 0."""
    for _ in range(code - 1):
        thousandths = (thousandths * ratio + 5_000_000) // 10_000_000
    return (thousandths + 500) // 1000 if code else 0


def trims(codes):
    """Factory trims of accelerometer and gyro (x y z each, counts at ±8 g and ±250 °/s).

    `codes`: the four bytes from SELF_TEST_X (register map 4.1). 0 where the factory left none.
    """
    found = []
    for axis in range(3):
        code = (codes[axis] >> 5 << 2) | (codes[3] >> (4 - 2 * axis) & 3)
        # 4096 * 0.34 * (0.92 / 0.34)^((code - 1) / 30)
        found.append(_grown(1_392_640, 10_337_376, code))
    for axis in range(3):
        code = codes[axis] & 31
        trim = _grown(25 * 131 * 1000, 10_460_000, code)  # 25 * 131 * 1.046^(code - 1)
        found.append(-trim if axis == 1 else trim)
    return found


class Mpu9150:
    """The sensor at ±16 g (2048 counts a g) and ±2000 °/s (16.4 counts a °/s).

    Steps past ±8 g and 1000 °/s are everyday on a foot. `kind` is 0 until `wake` has found out;
    `test` are HELLO's bits; `way` says how the magnetometer is read: NO_WAY, AUXILIARY, BYPASS.
    `fifo` says whether samples come from the FIFO (`waiting`, `take`) or from the registers
    (`read`).
    """

    def __init__(self, bus, address=_IDENTITY):
        self.bus = bus
        self.kind = 0
        self.test = NOT_TESTED
        self.way = NO_WAY
        self.fifo = False
        self.compass = ak8975.Ak8975(bus)
        self.raw = bytearray(_IMU_SIZE)
        self._has_compass = False
        self._address = address
        self._last = bytearray(_IMU_SIZE)
        self._count = bytearray(2)
        self._status = bytearray(1)
        self._chosen = (0, 0, 0)  # divider, DLPF, samples in which to measure the field once
        self._wanted = False  # the magnetometer
        self._settings = ()  # of `check`: first register, values, room to read them

    def wake(self, test=False):
        """Reset the sensor, find out what it is, leave it awake but not sampling (175 ms).

        With `test` also its self-test (0.4 s, up to 1.2 s where it is moved), whose result is in
        `test` then. SensorError where nothing or something else answers.
        """
        known = self.kind
        self.kind = 0
        # Before the first write: whatever else sits at this address keeps its registers.
        self._identify()
        self._write(_PWR_MGMT_1, 0x80)
        time.sleep_ms(100)
        self._write(_PWR_MGMT_1, 0x00)
        time.sleep_ms(60)
        # The PLL may lock on the gyro only now that it runs; it takes up to 10 ms.
        self._write(_PWR_MGMT_1, 0x01)
        time.sleep_ms(10)
        self._write(_USER_CTRL, 0x00)
        self._write(_INT_PIN_CFG, 0x02)
        time.sleep_ms(2)
        self._has_compass = self._find_compass()
        # An AK8975 on the auxiliary bus is all that tells an MPU-9150 from an MPU-6050.
        kind = MPU9150 if self._has_compass or known == MPU9150 else MPU6050
        if test:
            self._run_test()
        self._write(_INT_PIN_CFG, 0x00)
        self.kind = kind

    def sample(self, rate_mhz, dlpf=1, fifo=True, compass=True):
        """Sample at 1 kHz / (1 + n), the rate nearest to `rate_mhz`, returned in mHz.

        `dlpf` 1 to 6: low pass of 188, 98, 42, 20, 10, 5 Hz. SensorError.
        """
        divider = max(0, min(255, (1_000_000 + rate_mhz // 2) // rate_mhz - 1))
        period = 1000 * (divider + 1)  # µs
        self._chosen = (divider, dlpf, -(-_MEASURING_US // period))
        self.fifo = fifo
        self._wanted = compass and self._has_compass
        self._go(AUXILIARY if self._wanted else NO_WAY)
        return 1_000_000 // (divider + 1)

    def sleep(self):
        """No more samples, least current. SensorError where it doesn't answer."""
        self._write(_INT_ENABLE, 0x00)
        self._write(_USER_CTRL, 0x00)
        self._write(_PWR_MGMT_1, 0x40)

    def read(self, sample):
        """The newest sample into `sample` (as the core's, without its last word).

        Returns SAMPLE's flags of clipping and magnetometer, and ALIKE. OSError where the transfer
        fails. Allocates nothing.
        """
        self.bus.read_into(self._address, _ACCEL_XOUT_H, self.raw)
        return self._decoded(sample)

    def again(self, sample):
        """Once more what `read` read, but for the magnetometer. OSError. Allocates nothing."""
        self.bus.read_into(self._address, _ACCEL_XOUT_H, self.raw)
        return decode(self.raw, self._last, sample)

    def waiting(self):
        """Whole samples in the FIFO; -1: it ran over; -2: it holds parts of samples. OSError.

        Allocates nothing.
        """
        size = len(self.raw)
        found = self._count
        self.bus.read_into(self._address, _FIFO_COUNTH, found)
        count = (found[0] << 8) | found[1]
        if count == size:
            return 1
        tries = 2
        while count % size and tries:
            # The sensor may be in the middle of writing one.
            self.bus.read_into(self._address, _FIFO_COUNTH, found)
            count = (found[0] << 8) | found[1]
            tries -= 1
        # With room for less than one more sample, the oldest may be overwritten while it's read.
        if count > _FIFO_SIZE - size:
            return -1
        return -2 if count % size else count // size

    def take(self, sample):
        """The oldest sample in the FIFO, where `waiting` has just said that there is one.

        Like `read`. After OSError it isn't known how much of it is left in the FIFO.
        """
        self.bus.read_into(self._address, _FIFO_R_W, self.raw)
        return self._decoded(sample)

    def drop(self):
        """Empty the FIFO. SensorError."""
        master = _MASTER_ON if self.way == AUXILIARY else 0
        # It takes the reset only while it's off.
        self._write(_USER_CTRL, _FIFO_RESET | master)
        self._write(_USER_CTRL, _FIFO_ON | master)

    def check(self):
        """Whether the registers still say what `sample` wrote: a dip of the supply resets them.

        1 ms. OSError. Allocates nothing. Not read: I2C_MST_STATUS, which reading clears.
        """
        for first, settings, found in self._settings:
            self.bus.read_into(self._address, first, found)
            if found != settings:
                # A bit may have been lost on the way.
                self.bus.read_into(self._address, first, found)
                if found != settings:
                    return False
        return True

    def compass_is_lost(self, samples):
        """Whether it should be read, and has been silent for so many samples."""
        return self.way != NO_WAY and self.compass.silent >= samples

    def compass_is_back(self):
        """Whether it answers again after it couldn't be read in any way."""
        return self.way == NO_WAY and self._wanted and self.compass.answers()

    def reroute(self):
        """Read the magnetometer by the next way: auxiliary master, bypass, none.

        Samples in the FIFO are lost. SensorError.
        """
        self._go((AUXILIARY, BYPASS, NO_WAY)[self.way])

    def answers(self):
        """Whether one read of its identity goes well."""
        try:
            self.bus.read_into(self._address, _WHO_AM_I, self._status)
        except OSError:
            return False
        return self._status[0] == _IDENTITY

    def temperature(self):
        """Of the sample read last: 340 counts a °C, 0 at 35 °C."""
        return (((self._last[6] << 8) | self._last[7]) ^ 0x8000) - 0x8000

    def _decoded(self, sample):
        flags = decode(self.raw, self._last, sample)
        if self.way == AUXILIARY:
            compass = self.compass
            news = compass.take(self.raw, sample)
            # The auxiliary master repeats a reading with each sample until it has the next one,
            # and for ever where nobody answers it; so one like the last may or may not be new.
            if not news and compass.is_due() and self._was_acknowledged():
                news = compass.take_equal(self.raw, sample)
            flags |= news
        elif self.way == BYPASS:
            flags |= self.compass.poll(sample)
        return flags

    def _was_acknowledged(self):
        """Whether all went well on the auxiliary bus since it was asked last."""
        try:
            self.bus.read_into(self._address, _I2C_MST_STATUS, self._status)
        except OSError:
            return False
        return not self._status[0] & 0x03

    def _identify(self):
        found = 0
        complaint = None
        # After power-up or a reset by itself it takes 100 ms until it answers rightly.
        for _ in range(5):
            try:
                found = self._read(_WHO_AM_I)
                complaint = None
                if found == _IDENTITY:
                    return
            except SensorError as error:
                complaint = error
            time.sleep_ms(30)
        raise complaint or SensorError(
            "WHO_AM_I 0x%02X at 0x%02X is %s, no MPU-9150 (0x68): check the sensor's type"
            % (found, self._address, _RELATIVES.get(found, "an unknown chip"))
        )

    def _find_compass(self):
        for _ in range(3):
            if self.compass.find():
                return True
        return False

    def _go(self, way):
        divider, dlpf, every = self._chosen
        self.way = way
        auxiliary = way == AUXILIARY
        bypass = self._wanted and not auxiliary
        self.raw = bytearray(_IMU_SIZE + (ak8975.SIZE if auxiliary else 0))
        self.compass.restart(every)
        self._write(_INT_ENABLE, 0x00)
        self._write(_USER_CTRL, 0x00)
        # Slave 0 reads a measurement, then slave 1 starts the next, in every n-th sample.
        slaves = (0x80 | ak8975.ADDRESS, ak8975.ST1, 0x80 | ak8975.SIZE)
        slaves += (ak8975.ADDRESS, ak8975.CNTL, 0x81)
        settings = [
            (_SMPLRT_DIV, (divider, dlpf, 3 << 3, 3 << 3)),
            # FIFO_EN: everything, in the registers' order: the same bytes in both modes.
            # I2C_MST_CTRL: data ready waits for the auxiliary master; 400 kHz there.
            (
                _FIFO_EN,
                ((0xF9 if auxiliary else 0xF8) if self.fifo else 0x00, 0x5D if auxiliary else 0x00)
                + (slaves if auxiliary else ()),
            ),
            # A pulse for each sample, not a latch: an edge also for a sample that nobody read,
            # so that lost samples are counted and a failed read doesn't end the edges.
            (_INT_PIN_CFG, (0x02 if bypass else 0x00,)),
        ]
        if auxiliary:
            settings += [
                (_I2C_SLV4_CTRL, (every - 1,)),
                (_I2C_SLV1_DO, (ak8975.SINGLE,)),
                (_I2C_MST_DELAY_CTRL, (0x83,)),
            ]
        self._settle(settings)
        if self.fifo:
            self.drop()
        elif auxiliary:
            self._write(_USER_CTRL, _MASTER_ON)
        self._write(_INT_ENABLE, 0x01)
        running = (_FIFO_ON if self.fifo else 0) | (_MASTER_ON if auxiliary else 0)
        settings += [(_INT_ENABLE, (0x01,)), (_USER_CTRL, (running, 0x01))]
        self._settings = tuple([(at, bytes(n), bytearray(len(n))) for at, n in settings])

    def _settle(self, settings):
        """Write (first register, values) until all of them read back. SensorError."""
        wrong = None
        for _ in range(3):
            for first, values in settings:
                for i, value in enumerate(values):
                    self._write(first + i, value)
            wrong = None
            for first, values in settings:
                for i, value in enumerate(values):
                    if self._read(first + i) != value:
                        wrong = (first + i, value)
            if not wrong:
                return
        raise SensorError(
            "register 0x%02X doesn't keep 0x%02X: check the sensor's power, SDA, SCL" % wrong
        )

    def _run_test(self):
        """All sensors against their limits, into `test`; at rest only (register map 4.1)."""
        codes = bytearray(4)
        failed = 0
        try:
            self.bus.read_into(self._address, _SELF_TEST_X, codes)
            if self._has_compass and not self.compass.test():
                failed = 4
        except OSError as error:
            raise self._silent(_SELF_TEST_X, error)
        self.test = failed | NOT_TESTED
        expected = trims(codes)
        if not all(expected):
            return
        self._write(_SMPLRT_DIV, 0)
        self._write(_CONFIG, 2)
        for _ in range(_TEST_TRIES):
            before = self._means(0)
            response = self._means(0xE0)
            after = self._means(0)
            if not (before and response and after and _still(before, after)):
                continue
            for i in range(6):
                twice = 2 * response[i] - before[i] - after[i]
                off = abs(twice - 2 * expected[i])
                if 100 * off > _TEST_TOLERANCE * abs(2 * expected[i]):
                    failed |= 1 if i < 3 else 2
            self.test = failed
            break

    def _means(self, test_bits):
        """Means at ±8 g and ±250 °/s with these self-test bits; None where it is moved."""
        self._write(_GYRO_CONFIG, test_bits)
        self._write(_ACCEL_CONFIG, test_bits | 2 << 3)
        time.sleep_ms(50)
        raw = bytearray(_IMU_SIZE)
        sample = array("i", bytes(4 * 6))
        least = [32767] * 6
        most = [-32768] * 6
        total = [0] * 6
        for _ in range(_TEST_SAMPLES):
            time.sleep_ms(1)
            try:
                self.bus.read_into(self._address, _ACCEL_XOUT_H, raw)
            except OSError as error:
                raise self._silent(_ACCEL_XOUT_H, error)
            decode(raw, self._last, sample)
            for i in range(6):
                least[i] = min(least[i], sample[i])
                most[i] = max(most[i], sample[i])
                total[i] += sample[i]
        if not _still(least, most):
            return None
        return [(n + _TEST_SAMPLES // 2) // _TEST_SAMPLES for n in total]

    def test_bus(self, khz, reads):
        """(reads done, errors among them) of the identity at a clock; the bus is then as before.

        At most 500 reads, and it gives up after 20 errors: the watchdog goes on counting.
        """
        before = self.bus.khz
        self.bus.open(khz)
        errors = done = 0
        while done < min(reads, _BUS_READS) and errors < _BUS_ERRORS:
            done += 1
            try:
                self.bus.read_into(self._address, _WHO_AM_I, self._status)
                errors += self._status[0] != _IDENTITY
            except OSError:
                errors += 1
        self.bus.open(before)
        return done, errors

    def _read(self, register):
        try:
            return self.bus.read(self._address, register)
        except OSError as error:
            raise self._silent(register, error)

    def _write(self, register, value):
        try:
            self.bus.write(self._address, register, value)
        except OSError as error:
            raise self._silent(register, error)

    def _silent(self, register, error):
        return SensorError(
            "no answer from 0x%02X, register 0x%02X (%s): check the sensor's power, SDA, SCL"
            % (self._address, register, error)
        )


def _still(one, other):
    """Whether two lists of six counts are as near to one another as at rest."""
    limits = [_STILL_ACC] * 3 + [_STILL_GYRO] * 3
    return all([abs(one[i] - other[i]) <= limits[i] for i in range(6)])
