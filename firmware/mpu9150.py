"""MPU-9150 driver: registers in, raw counts out.

Registers as in the MPU-9150 register map 4.2 and the AK8975 data sheet. The bus is an argument,
anything with `machine.I2C`'s `readfrom_mem`, `readfrom_mem_into` and `writeto_mem`.
"""

import time

from solenav_core.compat import const, micropython, ptr8, ptr32

# What `kind` says, an index into `messages.SENSORS`.
MPU6050 = 1
MPU9150 = 2

_SMPLRT_DIV = const(0x19)
_CONFIG = const(0x1A)
_GYRO_CONFIG = const(0x1B)
_ACCEL_CONFIG = const(0x1C)
_INT_PIN_CFG = const(0x37)
_INT_ENABLE = const(0x38)
_ACCEL_XOUT_H = const(0x3B)
_USER_CTRL = const(0x6A)
_PWR_MGMT_1 = const(0x6B)
_WHO_AM_I = const(0x75)

_AK8975 = const(0x0C)
_AK8975_WIA = const(0x00)

_CLIPPED_ACC = const(1)
_CLIPPED_GYRO = const(2)


class SensorError(Exception):
    """The sensor can't be used; its text says what happened and what to look at."""


@micropython.viper
def decode(raw: ptr8, sample: ptr32) -> int:
    """The 14 bytes from ACCEL_XOUT_H into `sample` (ax ay az gx gy gz, counts).

    Returns bits: 1 an accelerometer axis at full scale, 2 a gyro axis.
    """
    flags = 0
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


class Mpu9150:
    """The sensor at ±16 g (2048 counts a g) and ±2000 °/s (16.4 counts a °/s).

    Steps past ±8 g and 1000 °/s are everyday on a foot. `kind` is 0 until `wake` has found out.
    """

    def __init__(self, bus, address=0x68):
        self.kind = 0
        self.raw = bytearray(14)
        self._bus = bus
        self._address = address
        self._byte = bytearray(1)

    def wake(self):
        """Reset the sensor, find out what it is, leave it awake but not sampling (165 ms).

        SensorError where nothing or something else answers.
        """
        self.kind = 0
        # Before the first write: whatever else sits at this address keeps its registers.
        found = self._read(_WHO_AM_I)
        if found != 0x68:
            raise SensorError(
                "WHO_AM_I 0x%02X at 0x%02X is no MPU-9150 (0x68): check the sensor's type"
                % (found, self._address)
            )
        self._write(_PWR_MGMT_1, 0x80)
        time.sleep_ms(100)
        self._write(_PWR_MGMT_1, 0x00)
        time.sleep_ms(60)
        # The PLL may lock on the gyro only now that it runs.
        self._write(_PWR_MGMT_1, 0x01)
        self.kind = MPU9150 if self._has_compass() else MPU6050

    def sample(self, rate_mhz):
        """Sample at 1 kHz / (1 + n), the rate nearest to `rate_mhz`, returned in mHz."""
        divider = max(0, min(255, (1_000_000 + rate_mhz // 2) // rate_mhz - 1))
        self._write(_CONFIG, 1)  # 188 Hz, 1.9 ms
        self._write(_SMPLRT_DIV, divider)
        self._write(_GYRO_CONFIG, 3 << 3)
        self._write(_ACCEL_CONFIG, 3 << 3)
        # A pulse for each sample, not a latch: an edge also for a sample that nobody read,
        # so that lost samples are counted and a failed read doesn't end the edges.
        self._write(_INT_PIN_CFG, 0x00)
        self._write(_INT_ENABLE, 0x01)
        return 1_000_000 // (divider + 1)

    def sleep(self):
        """No more samples, least current. SensorError where it doesn't answer."""
        self._write(_INT_ENABLE, 0x00)
        self._write(_PWR_MGMT_1, 0x40)

    def read(self, sample):
        """The newest sample into `sample` (`array('i')`, six counts); clip bits of `decode`.

        OSError where the transfer fails. Allocates nothing.
        """
        self._bus.readfrom_mem_into(self._address, _ACCEL_XOUT_H, self.raw)
        return decode(self.raw, sample)

    def temperature(self):
        """Of the sample read last: 340 counts a °C, 0 at 35 °C."""
        return (((self.raw[6] << 8) | self.raw[7]) ^ 0x8000) - 0x8000

    def _has_compass(self):
        """An AK8975 on the auxiliary bus is all that tells an MPU-9150 from an MPU-6050."""
        self._write(_USER_CTRL, 0x00)
        self._write(_INT_PIN_CFG, 0x02)
        time.sleep_ms(2)
        found = False
        for _ in range(3):
            try:
                found = self._bus.readfrom_mem(_AK8975, _AK8975_WIA, 1)[0] == 0x48
                break
            except OSError:
                continue
        self._write(_INT_PIN_CFG, 0x00)
        return found

    def _read(self, register):
        try:
            self._bus.readfrom_mem_into(self._address, register, self._byte)
        except OSError as error:
            raise self._silent(register, error)
        return self._byte[0]

    def _write(self, register, value):
        self._byte[0] = value
        try:
            self._bus.writeto_mem(self._address, register, self._byte)
        except OSError as error:
            raise self._silent(register, error)

    def _silent(self, register, error):
        return SensorError(
            "no answer from 0x%02X, register 0x%02X (%s): check the sensor's power, SDA, SCL"
            % (self._address, register, error)
        )
