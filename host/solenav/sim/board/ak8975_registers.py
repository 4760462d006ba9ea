"""An AK8975 as its bus sees it: registers, modes, measuring times, fuse ROM, self-test.

AK8975 data sheet, MS1187-E-02. What the data sheet forbids or calls without effect is not done
and goes into `rejected`. Measuring takes 7.3 ms, each fourth time the longest that the data
sheet allows, 9 ms. Data read during a measurement are wrong and set DERR. Only a loss of power
resets it; the MPU-9150's own reset doesn't reach it.
"""

from solenav.sim.board import simtime

ADDRESS = 0x0C
SENSITIVITY = (170, 174, 162)  # ASAX to ASAZ: H·(ASA + 128) / 256 is in 0.3 µT
MEASURING_US = (7300, 7300, 7300, 9000)
SELF_TEST = (14, -23, -640)  # counts after adjustment; within ±100, ±100, -1000 to -300
NO_FIELD = -32768
QUIET_FIELD = (20, 70, -145)  # where the recording knows none: 49 µT, fixed to the sensor

_WIA = 0x48
_ST1 = 0x02
_HXL = 0x03
_HZH = 0x08
_ST2 = 0x09
_CNTL = 0x0A
_ASTC = 0x0C
_I2CDIS = 0x0F
_ASAX = 0x10
_ASAZ = 0x12

_DRDY = 0x01
_DERR = 0x04
_HOFL = 0x08
_SELF = 0x40

_POWER_DOWN = 0
_SINGLE = 1
_SELF_TEST_MODE = 8
_FUSE_ROM = 15

_MODE_CHANGE_US = 100  # power-down to any other mode
_OVERFLOW = 8000  # |X| + |Y| + |Z| in 0.3 µT counts: 2400 µT
_FIRST, _LAST = -4096, 4095


class Ak8975:
    """`field`: in the axes of the MPU-9150's accelerometer, 0.3 µT counts.

    `reject(register, value, reason)` is called for writes without effect. `failing`: its
    self-test shows no response.
    """

    def __init__(self, reject) -> None:
        self.field = QUIET_FIELD
        self.failing = False
        self._reject = reject
        self.power_up()

    def power_up(self) -> None:
        """As after power-on reset."""
        self.mode = _POWER_DOWN
        self.disabled = False  # by I2CDIS
        self._astc = 0
        self._data = bytearray(6)
        self._st1 = 0
        self._st2 = 0
        self._count = 0  # measurements
        self._due = 0  # when the measurement ends
        self._down_at = simtime.now() - _MODE_CHANGE_US
        self._pointer = 0

    def save(self) -> list:
        """All that it must keep while only the processor restarts."""
        # fmt: off
        return [
            self.mode, self.disabled, self._astc, list(self._data), self._st1, self._st2,
            self._count, self._due, self._down_at, self._pointer, list(self.field),
        ]
        # fmt: on

    def load(self, saved: list) -> None:
        # fmt: off
        (
            self.mode, self.disabled, self._astc, data, self._st1, self._st2,
            self._count, self._due, self._down_at, self._pointer, field,
        ) = saved
        # fmt: on
        self._data = bytearray(data)
        self.field = tuple(field)

    def settle(self) -> None:
        """End a measurement whose time is over, with the field as it is now."""
        if self.mode in (_SINGLE, _SELF_TEST_MODE) and simtime.now() >= self._due:
            self._measure()
            self.mode = _POWER_DOWN
            self._down_at = self._due
            self._st1 = _DRDY

    def point(self, register: int) -> None:
        """The register that the next byte is read from or written to."""
        self._pointer = register

    def read_byte(self) -> int:
        self.settle()
        at = self._pointer
        self._advance()
        if at == 0:
            return _WIA
        if at == _ST1:
            return self._st1
        if _HXL <= at <= _HZH:
            self._st1 = 0
            if self.mode == _SINGLE or self.mode == _SELF_TEST_MODE:
                self._st2 |= _DERR
                return self._data[at - _HXL] ^ 0x55
            return self._data[at - _HXL]
        if at == _ST2:
            value = self._st2
            self._st1 = 0
            self._st2 &= ~_DERR
            return value
        if at == _CNTL:
            return self.mode
        if at == _ASTC:
            return self._astc
        if _ASAX <= at <= _ASAZ and self.mode == _FUSE_ROM:
            return SENSITIVITY[at - _ASAX]
        return 0

    def write_byte(self, value: int) -> None:
        self.settle()
        at = self._pointer
        self._advance()
        if at == _CNTL:
            self._set_mode(value)
        elif at == _ASTC:
            if value & ~_SELF:
                self._reject(at, value, "only SELF may be set in ASTC")
            else:
                self._astc = value
        elif at == _I2CDIS and value == 0x1B:
            self.disabled = True
        else:
            self._reject(at, value, "the AK8975 has no such register to write")

    def _advance(self) -> None:
        at = self._pointer
        self._pointer = 0 if at == _ASTC else _ASAX if at == _ASAZ else (at + 1) & 255

    def _set_mode(self, mode: int) -> None:
        if mode not in (_POWER_DOWN, _SINGLE, _SELF_TEST_MODE, _FUSE_ROM):
            self._reject(_CNTL, mode, "no such mode")
        elif mode == _POWER_DOWN:
            if self.mode != _POWER_DOWN:
                self._down_at = simtime.now()
            self.mode = mode
        elif self.mode != _POWER_DOWN:
            self._reject(_CNTL, mode, "mode %d changed without power-down" % self.mode)
        elif simtime.now() - self._down_at < _MODE_CHANGE_US:
            self._reject(_CNTL, mode, "less than 100 us after power-down")
        else:
            self.mode = mode
            if mode != _FUSE_ROM:
                self._due = simtime.now() + MEASURING_US[self._count % 4]
                self._count += 1
                self._st1 = 0
                self._st2 = 0

    def _measure(self) -> None:
        if self.mode == _SELF_TEST_MODE:
            made = (0, 0, 0) if self.failing or not self._astc & _SELF else SELF_TEST
        else:
            x, y, z = QUIET_FIELD if self.field[0] == NO_FIELD else self.field
            made = (y, x, -z)
        if abs(made[0]) + abs(made[1]) + abs(made[2]) > _OVERFLOW:
            self._st2 = _HOFL
        for i in range(3):
            finer = SENSITIVITY[i] + 128
            raw = max(_FIRST, min(_LAST, (made[i] * 256 + finer // 2) // finer)) & 0xFFFF
            self._data[2 * i] = raw & 255
            self._data[2 * i + 1] = raw >> 8
