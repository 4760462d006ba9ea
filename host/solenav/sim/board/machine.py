"""Simulated `machine`: an I2C bus with the sensor, pins with interrupts, a UART, idling.

As much of MicroPython's module as the firmware uses. The UART is the process's standard input
and output, which the host connects to a pseudo-terminal.
"""

import select
import sys

from solenav.sim.board import simtime
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav.sim.board.playback import Playback

try:
    from collections.abc import Callable
except ImportError:  # MicroPython: annotations are never evaluated there
    pass

PWRON_RESET = 1

_EIO = 5
_IDLE_MAX = 5000  # µs: on hardware, too, something always wakes an idle processor soon

_sensor: Mpu9150 | None = None
_playback: Playback | None = None
_handlers: dict[int, Callable[["Pin"], None]] = {}
_uart: "UART | None" = None


def wire(sensor: Mpu9150 | None, playback: Playback | None) -> None:
    """Connect a sensor and its recording, or leave the bus empty."""
    global _sensor, _playback
    _sensor = sensor
    _playback = playback


def rise(number: int) -> None:
    """A rising edge on a pin."""
    handler = _handlers.get(number)
    if handler:
        handler(Pin(number))


def reset_cause() -> int:
    return PWRON_RESET


def idle() -> None:
    """Until something may have happened. SystemExit when the recording is over.

    With nothing sampled the board waits for a person: time then passes no faster than theirs.
    """
    # As with WFE: an interrupt just before is not slept over, nor is the last sample.
    if simtime.woken():
        return
    if _playback and _playback.over:
        raise SystemExit
    if _sensor and _sensor.sampling:
        simtime.wait(_IDLE_MAX)
    else:
        if _uart:
            _uart.wait(1)
        simtime.advance(1000)


class Pin:
    """An input pin."""

    IN = 0
    IRQ_RISING = 1

    def __init__(self, number: int, mode: int = IN) -> None:
        self._number = number

    def irq(
        self,
        handler: Callable[["Pin"], None] | None = None,
        trigger: int = IRQ_RISING,
        hard: bool = False,
    ) -> None:
        """Call `handler` at each rising edge; none ends it."""
        if handler is None:
            _handlers.pop(self._number, None)
        else:
            _handlers[self._number] = handler


class I2C:
    """A bus whose transfers take the time that their bits take. OSError(EIO) without an answer."""

    def __init__(self, freq: int = 400_000) -> None:
        self._freq = freq

    def readfrom_mem_into(self, address: int, register: int, buffer: bytearray) -> None:
        sensor = self._select(address, register)
        sensor.connect(address, True)
        for i in range(len(buffer)):
            buffer[i] = sensor.read_byte()
        sensor.stop()
        # After the read: a burst returns one sample, also while the next one arrives.
        self._pass_bits(9 * (3 + len(buffer)))

    def readfrom_mem(self, address: int, register: int, length: int) -> bytes:
        buffer = bytearray(length)
        self.readfrom_mem_into(address, register, buffer)
        return bytes(buffer)

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        sensor = self._select(address, register)
        for value in data:
            sensor.write_byte(value)
        sensor.stop()
        self._pass_bits(9 * (2 + len(data)))
        if _playback:
            _playback.look()

    def _select(self, address: int, register: int) -> Mpu9150:
        silent = _playback and _playback.silent()
        if _sensor is None or silent or not _sensor.connect(address, False):
            self._pass_bits(9)
            raise OSError(_EIO)
        _sensor.write_byte(register)
        return _sensor

    def _pass_bits(self, bits: int) -> None:
        """With start, repeated start and stop."""
        simtime.advance((bits + 3) * 1_000_000 // self._freq)


class UART:
    """Sends ten bits a byte out of a buffer of `txbuf`; non-blocking, as with timeout=0.

    The simulated line holds writers up in simulated time. The real one, where the host doesn't
    read, stops the program: nothing is lost then, and simulated time stands still.
    """

    def __init__(self, baudrate: int, txbuf: int = 2048) -> None:
        self._byte_ns = 10_000_000_000 // baudrate
        self._txbuf = txbuf
        self._empty_at = 0  # ns, when the last byte will be out
        self._poll = select.poll()
        self._poll.register(sys.stdin, select.POLLIN)
        global _uart
        _uart = self

    def write(self, buffer: bytearray, offset: int, length: int) -> int | None:
        """How many of the `length` bytes at `offset` found room; None for none."""
        now = 1000 * simtime.now()
        waiting = -((now - self._empty_at) // self._byte_ns) if self._empty_at > now else 0
        taken = min(length, self._txbuf - waiting)
        if taken <= 0:
            return None
        self._empty_at = max(self._empty_at, now) + taken * self._byte_ns
        sys.stdout.buffer.write(memoryview(buffer)[offset : offset + taken])
        return taken

    def any(self) -> int:
        """1 if a byte has come in."""
        return int(self.wait(0))

    def readinto(self, buffer: bytearray, length: int) -> int | None:
        """One byte into `buffer`; None where there is none."""
        byte = sys.stdin.buffer.read(1)
        if not byte:
            self._poll.unregister(sys.stdin)  # closed: it would stay readable for ever
            return None
        buffer[0] = byte[0]
        return 1

    def wait(self, ms: int) -> bool:
        """Whether a byte has come in, after at most `ms` of real time."""
        return bool(self._poll.poll(ms))
