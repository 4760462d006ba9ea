"""An MPU-9150 as the bus sees it: registers, modes, data-ready line; and its AK8975's identity.

Register map 4.2. Byte by byte, as an emulated I2C controller calls it: `connect`, `write_byte`,
`read_byte`, `stop`. It has no clock of its own: whoever owns it calls `sample` at the times of
the samples. Not modelled: FIFO, self-test, filters, auxiliary master, magnetometer data.
"""

from struct import pack_into

_ACCEL_CONFIG = 0x1C
_GYRO_CONFIG = 0x1B
_SMPLRT_DIV = 0x19
_CONFIG = 0x1A
_INT_PIN_CFG = 0x37
_INT_ENABLE = 0x38
_INT_STATUS = 0x3A
_DATA = 0x3B
_SIGNAL_PATH_RESET = 0x68
_USER_CTRL = 0x6A
_PWR_MGMT_1 = 0x6B
_WHO_AM_I = 0x75

_IDENTITY = 0x68
_SLEEP = 0x40
_DEVICE_RESET = 0x80
_BYPASS = 0x02
_CLEAR_ON_ANY_READ = 0x10
_LATCH = 0x20
_MASTER = 0x20
_DATA_READY = 0x01

_AK8975_ADDRESS = 0x0C
_AK8975_IDENTITY = bytes([0x48])  # WIA

# From, to: what the sensor alone writes.
_READ_ONLY = ((0x35, 0x36), (_INT_STATUS, 0x61), (0x72, 0x73), (_WHO_AM_I, 0x7F))


class Mpu9150:
    """`line` is the level of INT, active high. Without `compass` it is an MPU-6050."""

    def __init__(self, compass: bool = True, address: int = _IDENTITY) -> None:
        self.registers = bytearray(128)
        self.line = 0
        self._compass = compass
        self._address = address
        self._selected = 0  # address of the device that the master talks to
        self._pointer = 0
        self._pointing = False  # the next byte written is a register number
        self._reset()

    @property
    def sampling(self) -> bool:
        """Whether it is awake and announces its samples."""
        awake = not self.registers[_PWR_MGMT_1] & _SLEEP
        return awake and bool(self.registers[_INT_ENABLE] & _DATA_READY)

    @property
    def period_us(self) -> int:
        """Nominal time between samples."""
        unfiltered = self.registers[_CONFIG] & 7 in (0, 7)
        return (125 if unfiltered else 1000) * (1 + self.registers[_SMPLRT_DIV])

    def sample(self, values: tuple[int, ...]) -> bool:
        """New data: ax ay az temperature gx gy gz, counts at ±16 g and ±2000 °/s.

        At another full scale they are converted and clipped. True where INT goes up.
        """
        if self.registers[_PWR_MGMT_1] & _SLEEP:
            return False
        ax, ay, az, temperature, gx, gy, gz = values
        finer = 3 - (self.registers[_ACCEL_CONFIG] >> 3 & 3)
        if finer:
            ax, ay, az = _clip(ax << finer), _clip(ay << finer), _clip(az << finer)
        finer = 3 - (self.registers[_GYRO_CONFIG] >> 3 & 3)
        if finer:
            gx, gy, gz = _clip(gx << finer), _clip(gy << finer), _clip(gz << finer)
        pack_into(">7h", self.registers, _DATA, ax, ay, az, temperature, gx, gy, gz)
        self.registers[_INT_STATUS] |= _DATA_READY
        if not self.registers[_INT_ENABLE] & _DATA_READY or self.line:
            return False
        # Without the latch it is a pulse of 50 µs, which is over before anybody looks.
        self.line = 1 if self.registers[_INT_PIN_CFG] & _LATCH else 0
        return True

    def connect(self, address: int, reading: bool) -> bool:
        """A start condition with an address; False: nobody acknowledges."""
        self._selected = 0
        behind = self.registers[_INT_PIN_CFG] & _BYPASS and not (
            self.registers[_USER_CTRL] & _MASTER
        )
        if address == self._address or (address == _AK8975_ADDRESS and self._compass and behind):
            self._selected = address
            self._pointing = not reading
        return bool(self._selected)

    def write_byte(self, value: int) -> None:
        """The register number, then data for it and those after it."""
        if self._pointing:
            self._pointer = value & 127
            self._pointing = False
            return
        if self._selected == self._address:
            self._write(self._pointer, value)
        self._pointer = (self._pointer + 1) & 127

    def read_byte(self) -> int:
        """The next register's value."""
        at = self._pointer
        self._pointer = (at + 1) & 127
        if self._selected != self._address:
            return _AK8975_IDENTITY[at] if at < len(_AK8975_IDENTITY) else 0
        value = self.registers[at]
        if at == _INT_STATUS or self.registers[_INT_PIN_CFG] & _CLEAR_ON_ANY_READ:
            self.registers[_INT_STATUS] = 0
            self.line = 0
        return value

    def stop(self) -> None:
        """A stop condition."""
        self._selected = 0

    def _reset(self) -> None:
        for i in range(len(self.registers)):
            self.registers[i] = 0
        self.registers[_PWR_MGMT_1] = _SLEEP
        self.registers[_WHO_AM_I] = _IDENTITY
        self.line = 0

    def _write(self, register: int, value: int) -> None:
        if register == _PWR_MGMT_1 and value & _DEVICE_RESET:
            self._reset()
            return
        for first, last in _READ_ONLY:
            if first <= register <= last:
                return
        if register == _SIGNAL_PATH_RESET:
            return  # acts and clears itself
        if register == _USER_CTRL:
            value &= 0xF8  # the reset bits clear themselves
        self.registers[register] = value


def _clip(value: int) -> int:
    return max(-32768, min(32767, value))
