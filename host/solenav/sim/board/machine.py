"""Simulated `machine`: the sensor's bus, pins, a UART, watchdog, resets, idling; as on the rp2.

As much of MicroPython's module as the firmware uses, with the rp2's constants and errors:

- `I2C(0, scl=, sda=, freq=, timeout=)` takes the bus's pins; transfers through any I2C object use
  the one controller. `Pin(4)`, `Pin(5)` (SDA, SCL) with a mode take them away from it, so that a
  program can clock SCL by hand; `Pin(6)` is the sensor's INT, `Pin(7)` switches the sensor's
  power: low is off. Other pins are there and do nothing.
- `WDT(timeout=)` bites unless fed; as on the rp2 it can't be stopped and 8388 ms are the most.
- A bite, `reset()` and a power cut end the process with one of `RESTARTS`; the host starts it
  again over the same flash. As on the rp2, `reset_cause()` is WDT_RESET also after `reset()`.

The UART is the process's standard input and output, which the host connects to a
pseudo-terminal.
"""

import select
import sys

from solenav.sim.board import simtime
from solenav.sim.board.bus import Bus, randoms
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav.sim.board.playback import Playback

try:
    from collections.abc import Callable
except ImportError:  # MicroPython: annotations are never evaluated there
    pass

PWRON_RESET = 1
WDT_RESET = 3

SDA_PIN = 4
SCL_PIN = 5
READY_PIN = 6
POWER_PIN = 7

# Exit codes after which the host starts the process again.
RESET, BITE, POWER_CUT = 81, 82, 83
RESTARTS = {RESET: "reset", BITE: "watchdog", POWER_CUT: "power"}

_BYTE = 22  # µs at 460800 baud
_IDLE_MAX = 5000  # µs: on hardware, too, something always wakes an idle processor soon
_DRAIN_US = 100_000  # after the last sample, to empty the FIFO
_WDT_MAX = 8388  # ms
_CHUNK = 256  # bytes that the host gets at a time

bus = Bus()
cause = PWRON_RESET
off_us = 0  # how long the power is to be away, after a cut
cut_wire = False  # INT doesn't reach the processor
scripted = False  # faults are: time never waits for a person

_sensor: Mpu9150 | None = None
_playback: Playback | None = None
_handlers: dict[int, tuple[Callable[["Pin"], None], int]] = {}
_uart: "UART | None" = None
_over_at = -1
_supplied = True
_unplugged = False
_line: "Line | None" = None


def wire(sensor: Mpu9150 | None, playback: Playback | None) -> None:
    """Connect a sensor and its recording, or leave the bus empty; nothing disturbs it."""
    global _sensor, _playback, _over_at, _supplied, _unplugged, bus, cut_wire
    cut_wire = False
    _supplied = True
    _unplugged = False
    _sensor = sensor
    _playback = playback
    _over_at = -1
    bus = Bus()
    bus.sensor = sensor
    bus.written = playback.look if playback else None


def rise(number: int) -> None:
    """A rising edge on a pin."""
    if cut_wire:
        return
    entry = _handlers.get(number)
    if entry and entry[1] & Pin.IRQ_RISING:
        simtime.interrupt(entry[2])


def power(on: bool) -> None:
    """The sensor's supply, as the board gives it."""
    global _supplied
    _supplied = on
    _supply()


def unplug(off: bool) -> None:
    """A fault: the supply doesn't reach the sensor, whatever the board gives."""
    global _unplugged
    _unplugged = off
    _supply()


def _supply() -> None:
    on = _supplied and not _unplugged
    if not on:
        bus.held = 0
    if _sensor and on and not _sensor.powered:
        _sensor.power_up()
    elif _sensor and not on:
        _sensor.cut()


def inject(line: "Line | None") -> None:
    """Bytes that come in on the UART beside the host's."""
    global _line
    _line = line


def injected(room: int) -> bytes:
    """What a disturbed RX line has delivered since the last call, up to `room` bytes."""
    return _line.arrived(room) if _line else b""


def cut_power(us: int) -> None:
    """The whole board loses its power, for so long."""
    global off_us
    off_us = us
    simtime.end(POWER_CUT)


def hang_up(restarts: bool) -> None:
    """The process ends: what the UART still holds leaves, or is lost in a restart."""
    if _uart and restarts:
        _uart.release(1)
    elif _uart:
        _uart.finish()


def reset_cause() -> int:
    return cause


def reset() -> None:
    """The processor starts anew."""
    simtime.end(RESET)


def disable_irq() -> int:
    return simtime.disable()


def enable_irq(state: int) -> None:
    simtime.enable(state)


def idle() -> None:
    """Until something may have happened. SystemExit when the recording is over.

    Before it starts, and where no fault is scripted also while the sensor doesn't sample, the
    board waits for a person: time then passes no faster than theirs.
    """
    if _uart:
        _uart.release(_CHUNK)
    # As with WFE: an interrupt just before is not slept over, nor is the last sample.
    if simtime.woken():
        return
    playback = _playback
    if playback and playback.over:
        _finish()
    if playback and (_sensor.sampling or (scripted and playback.start >= 0)):
        simtime.wait(_IDLE_MAX)
    else:
        # What a host sends comes a byte a look, so another one is due at once.
        simtime.advance(_BYTE if _uart and _uart.wait(1) else 1000)


def _finish() -> None:
    """The recording is over: SystemExit as soon as the FIFO is empty."""
    global _over_at
    now = simtime.now()
    if _over_at < 0:
        _over_at = now
    if not _sensor.waiting or now - _over_at > _DRAIN_US:
        raise SystemExit


class Pin:
    """A pin. IN at first; OPEN_DRAIN lets go of the line for 1."""

    IN = 0
    OUT = 1
    OPEN_DRAIN = 2
    PULL_UP = 1
    PULL_DOWN = 2
    IRQ_FALLING = 4
    IRQ_RISING = 8

    def __init__(
        self, number: int, mode: int = -1, pull: int = -1, value: int | None = None
    ) -> None:
        self._number = number
        self._mode = Pin.IN
        self._output = 1
        if mode >= 0 or value is not None:
            self.init(mode, pull, value)

    def init(self, mode: int = -1, pull: int = -1, value: int | None = None) -> None:
        if mode >= 0:
            self._mode = mode
        if self._number in (SDA_PIN, SCL_PIN):
            bus.claimed = False
        if value is not None:
            self._output = 1 if value else 0
        self._drive()

    def value(self, level: int | None = None) -> int | None:
        """The line's level, or set what the pin drives."""
        if level is None:
            return self._level()
        self._output = 1 if level else 0
        self._drive()
        return None

    def __call__(self, level: int | None = None) -> int | None:
        return self.value(level)

    def on(self) -> None:
        self.value(1)

    def off(self) -> None:
        self.value(0)

    high = on
    low = off

    def irq(
        self,
        handler: Callable[["Pin"], None] | None = None,
        trigger: int = IRQ_RISING | IRQ_FALLING,
        hard: bool = False,
    ) -> None:
        """Call `handler` at each rising edge; none ends it."""
        if handler is None:
            _handlers.pop(self._number, None)
        else:
            _handlers[self._number] = (handler, trigger, lambda: handler(self))

    def _level(self) -> int:
        if self._number == SDA_PIN:
            return bus.sda_level
        if self._number == SCL_PIN:
            return bus.scl
        if self._number == READY_PIN:
            return _sensor.line if _sensor else 0
        return self._output if self._mode != Pin.IN else 0

    def _drive(self) -> None:
        level = 1 if self._mode == Pin.IN else self._output
        if self._number == SDA_PIN and not bus.claimed:
            bus.sda = level
        elif self._number == SCL_PIN and not bus.claimed:
            bus.drive_scl(level)
        elif self._number == POWER_PIN and self._mode != Pin.IN:
            power(bool(level))


class I2C:
    """A bus whose transfers take the time that their bits take."""

    def __init__(
        self,
        id: int = 0,
        *,
        scl: Pin | None = None,
        sda: Pin | None = None,
        freq: int = 400_000,
        timeout: int = 50_000,
    ) -> None:
        bus.claim(freq, timeout)

    def readfrom_mem_into(self, address: int, register: int, buffer: bytearray) -> None:
        bus.read(address, register, buffer)

    def readfrom_mem(self, address: int, register: int, length: int) -> bytes:
        buffer = bytearray(length)
        bus.read(address, register, buffer)
        return bytes(buffer)

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        bus.write(address, bytes([register]) + bytes(data))

    def readfrom_into(self, address: int, buffer: bytearray, stop: bool = True) -> None:
        bus.read(address, -1, buffer)

    def readfrom(self, address: int, length: int, stop: bool = True) -> bytes:
        buffer = bytearray(length)
        bus.read(address, -1, buffer)
        return bytes(buffer)

    def writeto(self, address: int, data: bytes, stop: bool = True) -> int:
        bus.write(address, data)
        return len(data)

    def scan(self) -> list[int]:
        return [address for address in range(0x08, 0x78) if bus.answers(address)]


class WDT:
    """Resets the processor unless fed every `timeout` ms."""

    def __init__(self, id: int = 0, timeout: int = 5000) -> None:
        if not 1 <= timeout <= _WDT_MAX:
            raise ValueError("timeout must be 1 to %d ms" % _WDT_MAX)
        self._timeout = 1000 * timeout
        self._due = simtime.now() + self._timeout
        simtime.at(self._due, self._look)

    def feed(self) -> None:
        self._due = simtime.now() + self._timeout

    def _look(self) -> None:
        if simtime.now() >= self._due:
            simtime.end(BITE)
        simtime.at(self._due, self._look)


class Line:
    """What a disturbed RX line delivers: `rate` bytes a second for `us`, from now on.

    The bytes of `data` again and again; without it random ones from `seed`.
    """

    def __init__(self, rate: int, us: int, data: bytes = b"", seed: int = 1) -> None:
        self._begin = simtime.now()
        self._rate = rate
        self._us = us
        self._data = data
        self._random = randoms(seed)
        self._sent = 0

    def arrived(self, room: int) -> bytes:
        """What came since the last call; what doesn't fit into `room` is lost."""
        elapsed = min(simtime.now() - self._begin, self._us)
        count = elapsed * self._rate // 1_000_000 - self._sent
        taken = bytearray(min(count, room))
        for i in range(len(taken)):
            if self._data:
                taken[i] = self._data[(self._sent + i) % len(self._data)]
            else:
                taken[i] = self._random()
        self._sent += count
        return taken


class UART:
    """Sends ten bits a byte out of a buffer of `txbuf`; non-blocking, as with timeout=0.

    The simulated line holds writers up in simulated time; what is still in the buffer when the
    processor restarts is lost. The real line, where the host doesn't read, stops the program:
    nothing is lost then, and simulated time stands still.
    """

    def __init__(self, baudrate: int, txbuf: int = 2048, rxbuf: int = 256) -> None:
        self._byte_ns = 10_000_000_000 // baudrate
        self._txbuf = txbuf
        self._rxbuf = rxbuf
        self._injected = bytearray()
        self._out = bytearray()
        self._empty_at = 0  # ns, when the last byte will be out
        self._poll = select.poll()
        self._poll.register(sys.stdin, select.POLLIN)
        global _uart
        _uart = self

    def write(self, buffer: bytearray, offset: int, length: int) -> int | None:
        """How many of the `length` bytes at `offset` found room; None for none."""
        simtime.check()
        taken = min(length, self._txbuf - self._waiting())
        if taken <= 0:
            return None
        self._empty_at = max(self._empty_at, 1000 * simtime.now()) + taken * self._byte_ns
        self._out += memoryview(buffer)[offset : offset + taken]
        self.release(_CHUNK)
        return taken

    def txdone(self) -> bool:
        """Whether everything has left."""
        return not self._waiting()

    def flush(self) -> None:
        """Until everything has left."""
        while not self.txdone():
            simtime.advance(1000)

    def release(self, least: int) -> None:
        """Hand over what has left; less than `least` bytes only when it is all."""
        waiting = self._waiting()
        sent = len(self._out) - waiting
        if sent > 0 and (sent >= least or not waiting):
            sys.stdout.buffer.write(self._out[:sent])
            self._out = self._out[sent:]

    def finish(self) -> None:
        """The program is over, the board stays on: everything leaves."""
        sys.stdout.buffer.write(self._out)
        self._out = bytearray()

    def any(self) -> int:
        """How many bytes have come in; of the host's no more than one is counted."""
        self._injected += injected(self._rxbuf - len(self._injected))
        return len(self._injected) or int(self.wait(0))

    def readinto(self, buffer: bytearray, length: int) -> int | None:
        """Bytes that `any` has counted into `buffer`; None where there are none."""
        if self._injected:
            taken = min(length, len(self._injected))
            buffer[:taken] = self._injected[:taken]
            self._injected = self._injected[taken:]
            return taken
        byte = sys.stdin.buffer.read(1)
        if not byte:
            self._poll.unregister(sys.stdin)  # closed: it would stay readable for ever
            return None
        buffer[0] = byte[0]
        return 1

    def _waiting(self) -> int:
        """Bytes that haven't left."""
        ahead = self._empty_at - 1000 * simtime.now()
        return -(-ahead // self._byte_ns) if ahead > 0 else 0

    def wait(self, ms: int) -> bool:
        """Whether a byte has come in, after at most `ms` of real time."""
        return bool(self._poll.poll(ms))
