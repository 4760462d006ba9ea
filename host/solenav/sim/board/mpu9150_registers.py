"""An MPU-9150 as the bus sees it: registers, modes, FIFO, auxiliary master, data-ready line.

MPU-9150 register map 4.x and product specification. Byte by byte, as an emulated I2C controller
calls it: `connect`, `write_byte`, `read_byte` (or `read_into` for a whole burst), `stop`. It has
no sampling clock: whoever owns it calls `sample` at the times of the samples.

Writes that have no effect on the hardware have none here and go into `rejected`, as (time in µs,
address, register, value, reason): read-only and unknown registers, reserved bits, anything within
100 ms of a device reset, measurement settings in sleep (the register map is silent there; on real
parts they don't stick), a FIFO reset while the FIFO is enabled, a master reset while the master
is, and what `ak8975_registers` refuses. The slave registers may be written while the master is
off, as drivers must to set it up; their transfers take place once it is on.

Simplified: auxiliary transfers take no time; without WAIT_FOR_ES they follow the data-ready
interrupt, with it they come before it. Filters only decide the sample rate. No cycle mode (it
doesn't sample), motion detection or DMP.
"""

from struct import pack_into

from solenav.sim.board import simtime
from solenav.sim.board.ak8975_registers import ADDRESS as _AK8975
from solenav.sim.board.ak8975_registers import Ak8975

FIFO_SIZE = 1024
RESET_US = 100_000  # until registers may be written after a device reset
POWER_UP_US = 100_000  # until it answers; the longest of the product specification
GYRO_SETTLES_US = 60_000  # after sleep, with some margin over the typical 30 ms
ACCEL_SETTLES_US = 20_000

# Factory trim codes of the self-test: accelerometer x y z, gyro x y z; 0x0D to 0x10 hold them.
ACCEL_TRIM = (16, 13, 19)
GYRO_TRIM = (17, 20, 14)
# A healthy sensor's response against its factory trim, in thousandths; within 14 %.
RESPONSE = (31, -46, 12, -25, 58, 40)

_SMPLRT_DIV = 0x19
_CONFIG = 0x1A
_GYRO_CONFIG = 0x1B
_ACCEL_CONFIG = 0x1C
_FIFO_EN = 0x23
_I2C_MST_CTRL = 0x24
_SLV0_ADDR = 0x25
_SLV4_ADDR = 0x31
_SLV4_REG = 0x32
_SLV4_DO = 0x33
_SLV4_CTRL = 0x34
_SLV4_DI = 0x35
_I2C_MST_STATUS = 0x36
_INT_PIN_CFG = 0x37
_INT_ENABLE = 0x38
_INT_STATUS = 0x3A
_DATA = 0x3B
_EXT_SENS_DATA = 0x49
_EXT_END = 0x61
_SLV0_DO = 0x63
_MST_DELAY = 0x67
_SIGNAL_PATH_RESET = 0x68
_USER_CTRL = 0x6A
_PWR_MGMT_1 = 0x6B
_PWR_MGMT_2 = 0x6C
_FIFO_COUNT_H = 0x72
_FIFO_COUNT_L = 0x73
_FIFO_R_W = 0x74
_WHO_AM_I = 0x75

_IDENTITY = 0x68
_DEVICE_RESET = 0x80
_SLEEP = 0x40
_CYCLE = 0x20
_TEMP_DIS = 0x08
_ACTIVE_LOW = 0x80
_OPEN_DRAIN = 0x40
_LATCH = 0x20
_CLEAR_ON_ANY_READ = 0x10
_BYPASS = 0x02
_FIFO_ON = 0x40
_MASTER = 0x20
_FIFO_RESET = 0x04
_MASTER_RESET = 0x02
_SIGNAL_RESET = 0x01
_WAIT_FOR_ES = 0x40
_SLV3_FIFO = 0x20
_DATA_READY = 0x01
_MASTER_INT = 0x08
_OVERFLOW = 0x10
_ENABLED = 0x80  # of a slave, and of a slave's read
_SWAP = 0x40
_NO_REGISTER = 0x20
_ODD_PAIRS = 0x10
_SLV4_INT = 0x40
_SLV4_DONE = 0x40
_SLV4_NACK = 0x10

# Bits that can be written; all others are read-only or reserved.
_WRITABLE = bytearray(128)
for _first, _last, _bits in (
    (0x0D, 0x0F, 0xFF),
    (0x10, 0x10, 0x3F),
    (_SMPLRT_DIV, _SMPLRT_DIV, 0xFF),
    (_CONFIG, _CONFIG, 0x3F),
    (_GYRO_CONFIG, _ACCEL_CONFIG, 0xF8),
    (0x1F, 0x22, 0xFF),
    (_FIFO_EN, _SLV4_CTRL, 0xFF),
    (_INT_PIN_CFG, _INT_PIN_CFG, 0xFE),
    (_INT_ENABLE, _INT_ENABLE, 0x79),
    (_SLV0_DO, _SLV0_DO + 3, 0xFF),
    (_MST_DELAY, _MST_DELAY, 0x9F),
    (_SIGNAL_PATH_RESET, _SIGNAL_PATH_RESET, 0x07),
    (0x69, 0x69, 0x3F),
    (_USER_CTRL, _USER_CTRL, 0x67),
    (_PWR_MGMT_1, _PWR_MGMT_1, 0xEF),
    (_PWR_MGMT_2, _PWR_MGMT_2, 0xFF),
    (_FIFO_R_W, _FIFO_R_W, 0xFF),
):
    for _register in range(_first, _last + 1):
        _WRITABLE[_register] = _bits

_REJECTED_MAX = 500  # kept; all are counted


def factory_trim() -> tuple[list[float], list[float]]:
    """The self-test response at manufacture.

    Accelerometer x y z in counts at ±8 g, gyro x y z in counts at ±250 °/s (its y negative).
    """
    accel = [4096 * 0.34 * (0.92 / 0.34) ** ((n - 1) / 30) for n in ACCEL_TRIM]
    gyro = [25 * 131 * 1.046 ** (n - 1) for n in GYRO_TRIM]
    gyro[1] = -gyro[1]
    return accel, gyro


class Mpu9150:
    """`line` is the level of INT. Without `compass` it is an MPU-6050.

    For faults: `identity` is what WHO_AM_I reads as, `frozen` keeps the data registers as they
    are (with `mends` until a reset), `failing` holds the axes (0-2 accelerometer, 3-5 gyro)
    without self-test response, `cut` and `power_up` switch it off and on. `rejections` counts
    all of `rejected`.
    """

    def __init__(self, compass: bool = True, address: int = _IDENTITY) -> None:
        self.registers = bytearray(128)
        self.line = 0
        self.rejected: list[tuple[int, int, int, int, str]] = []
        self.rejections = 0
        self.identity = _IDENTITY
        self.frozen = False
        self.mends = False
        self.failing: set[int] = set()
        self.powered = True
        self.compass = Ak8975(self._reject_compass) if compass else None
        self._address = address
        self._selected = 0  # address of the device that the master talks to
        self._pointer = 0
        self._pointing = False  # the next byte written is a register number
        self._shown: bytes | None = None  # measurements, while a burst that began before goes on
        self._answers_at = 0
        self._writable_at = 0
        self._reset()

    @property
    def running(self) -> bool:
        """Whether it takes samples: awake, with a clock."""
        return self._runs

    @property
    def sampling(self) -> bool:
        """Whether it takes samples for the host: announces them or puts them into the FIFO."""
        if not self._runs:
            return False
        registers = self.registers
        if (registers[_GYRO_CONFIG] | registers[_ACCEL_CONFIG]) & 0xE0:
            return False  # the self-test
        if registers[_INT_ENABLE] & _DATA_READY:
            return True
        return bool(registers[_USER_CTRL] & _FIFO_ON and self._stretches)

    @property
    def period_us(self) -> int:
        """Nominal time between samples."""
        unfiltered = self.registers[_CONFIG] & 7 in (0, 7)
        return (125 if unfiltered else 1000) * (1 + self.registers[_SMPLRT_DIV])

    @property
    def waiting(self) -> int:
        """Bytes in the FIFO, if it is enabled."""
        return len(self._fifo) - self._taken if self.registers[_USER_CTRL] & _FIFO_ON else 0

    def cut(self) -> None:
        """No power: nothing answers, INT is low, all is forgotten."""
        self.powered = False
        self._runs = False
        self.line = 0

    def power_up(self) -> None:
        """Power is back: reset values; it answers after its start-up time."""
        self.powered = True
        self._answers_at = simtime.now() + POWER_UP_US
        self._writable_at = self._answers_at
        self._reset()
        if self.compass:
            self.compass.power_up()

    def reset(self) -> None:
        """A device reset, whoever asked for it. The AK8975 stays as it is."""
        self._reset()
        self._writable_at = simtime.now() + RESET_US

    def corrupt(self, register: int, value: int) -> None:
        """A fault: the register holds something else than was written."""
        self.registers[register] = value
        self._configured()

    def save(self) -> dict:
        """All that it keeps while only the processor restarts."""
        return {
            "registers": list(self.registers),
            "fifo": list(self._fifo[self._taken :]),
            "state": [
                self.line,
                self.powered,
                self._answers_at,
                self._writable_at,
                self._awake_at,
                self._count,
                self._last_byte,
                self._rounds,
            ],
            "compass": self.compass.save() if self.compass else None,
            "rejected": self.rejected,
            "rejections": self.rejections,
        }

    def load(self, saved: dict) -> None:
        self.registers[:] = bytes(saved["registers"])
        self._fifo = bytearray(saved["fifo"])
        self._taken = 0
        # fmt: off
        (
            self.line, self.powered, self._answers_at, self._writable_at, self._awake_at,
            self._count, self._last_byte, self._rounds,
        ) = saved["state"]
        # fmt: on
        if self.compass:
            self.compass.load(saved["compass"])
        self.rejected = [tuple(entry) for entry in saved["rejected"]]
        self.rejections = saved["rejections"]
        self._configured()

    def sample(self, values: tuple[int, ...]) -> bool:
        """New data: ax ay az temperature gx gy gz, counts at ±16 g and ±2000 °/s; mx my mz.

        At another full scale they are converted and clipped. The field, which may be left out,
        is in 0.3 µT counts in the accelerometer's axes. True where INT goes up.
        """
        compass = self.compass
        if compass and len(values) > 7:
            compass.settle()
            compass.field = values[7:10]
        if not self._runs:
            return False
        registers = self.registers
        if self._selected:
            # A burst returns one sample, also while the next one arrives.
            if self._shown is None:
                self._shown = bytes(registers[_DATA:_EXT_END])
        if not self.frozen:
            self._measure(values)
        status = _DATA_READY
        control = registers[_USER_CTRL]
        first = registers[_I2C_MST_CTRL] & _WAIT_FOR_ES
        if control & _MASTER and first:
            status |= self._run_master()
        if control & _FIFO_ON and self._stretches and self._fill():
            status |= _OVERFLOW
        rises = self._raise(status)
        if control & _MASTER and not first:
            status = self._run_master()
            if status:
                rises = self._raise(status) or rises
        return rises

    def connect(self, address: int, reading: bool) -> bool:
        """A start condition with an address; False: nobody acknowledges."""
        self.stop()
        if not self.powered or simtime.now() < self._answers_at:
            return False
        if address == self._address:
            self._selected = address
        elif address == _AK8975 and self.compass and not self.compass.disabled:
            if not self.registers[_INT_PIN_CFG] & _BYPASS:
                return False
            if self.registers[_USER_CTRL] & _MASTER:
                return False
            self._selected = address
        self._pointing = not reading
        return bool(self._selected)

    def write_byte(self, value: int) -> None:
        """The register number, then data for it and those after it."""
        behind = self._selected != self._address
        if self._pointing:
            self._pointing = False
            if behind:
                self.compass.point(value)
            else:
                self._pointer = value & 127
        elif behind:
            self.compass.write_byte(value)
        else:
            at = self._pointer
            if at != _FIFO_R_W:
                self._pointer = (at + 1) & 127
            self._write(at, value)

    def read_byte(self) -> int:
        """The next register's value."""
        if self._selected != self._address:
            return self.compass.read_byte()
        at = self._pointer
        if at != _FIFO_R_W:
            self._pointer = (at + 1) & 127
        registers = self.registers
        if simtime.now() < self._writable_at:
            return _DEVICE_RESET | _SLEEP if at == _PWR_MGMT_1 else 0
        value = registers[at]
        if at == _INT_STATUS or registers[_INT_PIN_CFG] & _CLEAR_ON_ANY_READ:
            self._clear_status()
        if self._shown is not None and _DATA <= at < _EXT_END:
            return self._shown[at - _DATA]
        if at < _I2C_MST_STATUS:
            return value
        if at == _I2C_MST_STATUS:
            registers[at] = 0
        elif at == _FIFO_COUNT_H:
            self._count = len(self._fifo) - self._taken
            value = self._count >> 8
        elif at == _FIFO_COUNT_L:
            value = self._count & 255
        elif at == _FIFO_R_W:
            value = self._pull()
        elif at == _WHO_AM_I:
            value = self.identity
        return value

    def read_into(self, buffer: bytearray) -> None:
        """As many bytes as the buffer holds, as one burst."""
        at = self._pointer
        n = len(buffer)
        plain = (
            self._selected == self._address
            and self._shown is None
            and not self.registers[_INT_PIN_CFG] & _CLEAR_ON_ANY_READ
            and simtime.now() >= self._writable_at
        )
        if plain and _INT_STATUS < at and at + n <= _EXT_END:
            buffer[:] = self.registers[at : at + n]
            self._pointer = at + n
        elif plain and at == _FIFO_R_W and n <= self.waiting:
            taken = self._taken
            buffer[:] = self._fifo[taken : taken + n]
            self._taken = taken + n
            self._last_byte = buffer[n - 1]
        else:
            for i in range(n):
                buffer[i] = self.read_byte()

    def stop(self) -> None:
        """A stop condition."""
        self._selected = 0
        self._shown = None

    def _reset(self) -> None:
        if self.mends:
            self.frozen = self.mends = False
        registers = self.registers
        for i in range(len(registers)):
            registers[i] = 0
        for i in range(3):
            registers[0x0D + i] = (ACCEL_TRIM[i] >> 2) << 5 | GYRO_TRIM[i]
            registers[0x10] |= (ACCEL_TRIM[i] & 3) << (4 - 2 * i)
        registers[_PWR_MGMT_1] = _SLEEP
        registers[_WHO_AM_I] = _IDENTITY
        self.line = 0
        self._fifo = bytearray()
        self._taken = 0
        self._count = 0
        self._last_byte = 0
        self._rounds = 0
        self._awake_at = 0
        self._configured()

    def _configured(self) -> None:
        """What is derived from the registers, after they were written."""
        registers = self.registers
        power = registers[_PWR_MGMT_1]
        clock = power & 7
        # No external clock is wired; 7 stops it.
        asleep = power & (_SLEEP | _CYCLE) or clock > 3
        standby = registers[_PWR_MGMT_2]
        if clock and clock < 4 and standby & (8 >> clock):
            asleep = True  # the gyro axis that gives the clock is off
        self._runs = self.powered and not asleep
        self._plain = not (power & _TEMP_DIS or standby & 0x3F)
        wanted = registers[_FIFO_EN]
        stretches = []
        if wanted & 0x08:
            stretches.append((_DATA, _DATA + 6))
        for bit, at in ((0x80, 0x41), (0x40, 0x43), (0x20, 0x45), (0x10, 0x47)):
            if wanted & bit:
                stretches.append((at, at + 2))
        self._slaves = []  # (first register of its settings, where its data go, length)
        at = _EXT_SENS_DATA
        for slave in range(4):
            base = _SLV0_ADDR + 3 * slave
            if not registers[base + 2] & _ENABLED:
                continue
            length = registers[base + 2] & 15
            if not registers[base] & _ENABLED:
                self._slaves.append((slave, 0, 0))
                continue
            length = min(length, _EXT_END - at)
            self._slaves.append((slave, at, length))
            into = registers[_I2C_MST_CTRL] & _SLV3_FIFO if slave == 3 else wanted & (1 << slave)
            if into and length:
                stretches.append((at, at + length))
            at += length
        joined: list[tuple[int, int]] = []
        for first, end in stretches:
            if joined and joined[-1][1] == first:
                joined[-1] = (joined[-1][0], end)
            else:
                joined.append((first, end))
        self._stretches = joined

    def _write(self, register: int, value: int) -> None:
        if simtime.now() < self._writable_at:
            self._reject(register, value, "within 100 ms of a device reset")
            return
        bits = _WRITABLE[register]
        if not bits:
            self._reject(register, value, "no register that can be written")
            return
        if value & ~bits:
            self._reject(register, value, "reserved bits set")
            value &= bits
        registers = self.registers
        asleep = registers[_PWR_MGMT_1] & _SLEEP
        if asleep and _SMPLRT_DIV <= register <= _FIFO_EN:
            self._reject(register, value, "measurement settings in sleep")
            return
        if register == _PWR_MGMT_1:
            if value & _DEVICE_RESET:
                self.reset()
                return
            if asleep and not value & _SLEEP:
                self._awake_at = simtime.now()
        elif register == _SIGNAL_PATH_RESET:
            self._forget(value)
            return
        elif register == _FIFO_R_W:
            self._push(value)
            return
        elif register == _USER_CTRL:
            value = self._command(value)
        registers[register] = value
        self._configured()

    def _command(self, value: int) -> int:
        """The bits of USER_CTRL that act and clear themselves."""
        if value & _FIFO_RESET:
            if value & _FIFO_ON:
                self._reject(_USER_CTRL, value, "FIFO reset while the FIFO is enabled")
            else:
                self._fifo = bytearray()
                self._taken = 0
        if value & _MASTER_RESET:
            if value & _MASTER:
                self._reject(_USER_CTRL, value, "master reset while the master is enabled")
            else:
                self.registers[_I2C_MST_STATUS] = 0
                self._rounds = 0
        if value & _SIGNAL_RESET:
            self._forget(7)
        return value & ~(_FIFO_RESET | _MASTER_RESET | _SIGNAL_RESET)

    def _forget(self, which: int) -> None:
        """Reset signal paths: 1 temperature, 2 accelerometer, 4 gyro."""
        for bit, first, end in ((2, _DATA, 0x41), (1, 0x41, 0x43), (4, 0x43, 0x49)):
            if which & bit:
                for i in range(first, end):
                    self.registers[i] = 0

    def _measure(self, values: tuple[int, ...]) -> None:
        registers = self.registers
        ax, ay, az, temperature, gx, gy, gz = values[:7]
        accel = registers[_ACCEL_CONFIG]
        gyro = registers[_GYRO_CONFIG]
        age = simtime.now() - self._awake_at
        if accel == 0x18 and gyro == 0x18 and self._plain and age >= GYRO_SETTLES_US:
            pack_into(">7h", registers, _DATA, ax, ay, az, temperature, gx, gy, gz)
            return
        before = registers[_DATA : _DATA + 14]
        made = [ax, ay, az, gx, gy, gz]
        for i in range(6):
            config = accel if i < 3 else gyro
            scale = config >> 3 & 3
            value = made[i] << (3 - scale)
            if age < GYRO_SETTLES_US and i > 2:
                value += (4000 >> scale) * (GYRO_SETTLES_US - age) // GYRO_SETTLES_US
            elif age < ACCEL_SETTLES_US:
                value = value * age // ACCEL_SETTLES_US
            if config & (0x80 >> i % 3) and i not in self.failing:
                value += _response(i, scale)
            made[i] = _clip(value)
        ax, ay, az, gx, gy, gz = made
        pack_into(">7h", registers, _DATA, ax, ay, az, temperature, gx, gy, gz)
        standby = registers[_PWR_MGMT_2]
        for i in range(6):
            if standby & (0x20 >> i):
                at = 2 * i + (2 if i > 2 else 0)
                registers[_DATA + at : _DATA + at + 2] = before[at : at + 2]
        if registers[_PWR_MGMT_1] & _TEMP_DIS:
            registers[0x41:0x43] = before[6:8]

    def _raise(self, status: int) -> bool:
        """Set interrupt status bits; True where INT goes up."""
        registers = self.registers
        registers[_INT_STATUS] |= status
        pins = registers[_INT_PIN_CFG]
        if not registers[_INT_ENABLE] & status or pins & _OPEN_DRAIN:
            return False  # nothing on the board pulls an open drain up
        if not pins & _LATCH:
            return True  # a pulse of 50 µs, which is over before anybody looks
        if pins & _ACTIVE_LOW:
            self.line = 0
            return False  # it will rise when the status is cleared
        rises = not self.line
        self.line = 1
        return rises

    def _clear_status(self) -> None:
        self.registers[_INT_STATUS] = 0
        pins = self.registers[_INT_PIN_CFG]
        self.line = 1 if pins & _ACTIVE_LOW and not pins & _OPEN_DRAIN else 0

    def _fill(self) -> bool:
        """A sample into the FIFO; True where older data were lost."""
        fifo = self._fifo
        for first, end in self._stretches:
            fifo.extend(self.registers[first:end])
        return self._trim()

    def _trim(self) -> bool:
        excess = len(self._fifo) - self._taken - FIFO_SIZE
        if excess > 0:
            self._taken += excess
        if self._taken > 2 * FIFO_SIZE or self._taken == len(self._fifo):
            self._fifo = self._fifo[self._taken :]
            self._taken = 0
        return excess > 0

    def _push(self, value: int) -> None:
        if not self.registers[_USER_CTRL] & _FIFO_ON:
            self._reject(_FIFO_R_W, value, "the FIFO is disabled")
            return
        self._fifo.append(value)
        if self._trim():
            self.registers[_INT_STATUS] |= _OVERFLOW

    def _pull(self) -> int:
        if self.waiting:
            self._last_byte = self._fifo[self._taken]
            self._taken += 1
        return self._last_byte

    def _run_master(self) -> int:
        """The auxiliary master's transfers after a sample; interrupt status bits."""
        registers = self.registers
        self._rounds += 1
        delay = registers[_MST_DELAY]
        rests = self._rounds % (1 + (registers[_SLV4_CTRL] & 31)) != 0
        failed = 0
        for slave, at, length in self._slaves:
            if rests and delay & (1 << slave):
                continue
            base = _SLV0_ADDR + 3 * slave
            if not self._transfer(base, registers[_SLV0_DO + slave], at, length):
                failed |= 1 << slave
        done = 0
        if registers[_SLV4_CTRL] & _ENABLED and not (rests and delay & 16):
            done = _SLV4_DONE
            if not self._transfer_fourth():
                failed |= _SLV4_NACK
            registers[_SLV4_CTRL] &= ~_ENABLED & 255
        if not failed | done:
            return 0
        registers[_I2C_MST_STATUS] |= failed | done
        tells = failed or registers[_SLV4_CTRL] & _SLV4_INT
        return _MASTER_INT if tells else 0

    def _transfer(self, base: int, out: int, at: int, length: int) -> bool:
        registers = self.registers
        address = registers[base]
        compass = self.compass
        if address & 127 != _AK8975 or not compass or compass.disabled:
            return False
        control = registers[base + 2]
        if not control & _NO_REGISTER:
            compass.point(registers[base + 1])
        if not address & _ENABLED:
            compass.write_byte(out)
            return True
        read = bytearray(length)
        for i in range(length):
            read[i] = compass.read_byte()
        if control & _SWAP:
            # Pairs of an even register and the next, or with ODD_PAIRS of an odd one.
            i = (registers[base + 1] & 1) ^ (1 if control & _ODD_PAIRS else 0)
            while i + 1 < length:
                read[i], read[i + 1] = read[i + 1], read[i]
                i += 2
        registers[at : at + length] = read
        return True

    def _transfer_fourth(self) -> bool:
        registers = self.registers
        compass = self.compass
        if registers[_SLV4_ADDR] & 127 != _AK8975 or not compass or compass.disabled:
            return False
        if not registers[_SLV4_CTRL] & _NO_REGISTER:
            compass.point(registers[_SLV4_REG])
        if registers[_SLV4_ADDR] & _ENABLED:
            registers[_SLV4_DI] = compass.read_byte()
        else:
            compass.write_byte(registers[_SLV4_DO])
        return True

    def _reject(self, register: int, value: int, reason: str, address: int = 0) -> None:
        self.rejections += 1
        if len(self.rejected) < _REJECTED_MAX:
            entry = (simtime.now(), address or self._address, register, value, reason)
            self.rejected.append(entry)

    def _reject_compass(self, register: int, value: int, reason: str) -> None:
        self._reject(register, value, reason, _AK8975)


def _response(axis: int, scale: int) -> int:
    """An axis's self-test response (0-2 accelerometer, 3-5 gyro) in counts at a full scale."""
    accel, gyro = factory_trim()
    trim = accel[axis] if axis < 3 else gyro[axis - 3]
    # The trims are at ±8 g and ±250 °/s.
    full = trim * (1000 + RESPONSE[axis]) / 1000 * (4 if axis < 3 else 1)
    return round(full / (1 << scale))


def _clip(value: int) -> int:
    return max(-32768, min(32767, value))
