"""The simulated board's sensor on the emulated RP2040: I2C0, its pins, the data-ready pin.

Registers, playback and faults are those of `solenav.sim.board`, which keep their time in
`simtime`. Here that clock follows the emulated processor's: it is set by whatever happens on the
bus, and an alarm of the processor's clock stands for the next of its events.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rp2040py.gpio_pin import GPIOPinState
from rp2040py.peripherals.i2c import I2CMode
from rp2040py.rp2040 import RP2040

from solenav.sim.board import machine, simtime
from solenav.sim.board.faults import World
from solenav.sim.board.feed import Feed
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav.sim.board.playback import Playback
from solenav_tools.emulator import workarounds

_I2C_FUNCTION = 3  # of a pin
_PULSE_NS = 50_000  # of INT, where it isn't latched
_WAIT_NS = 20_000  # until a bus that isn't free is looked at again
_NOISE_NS = 1_000_000  # between looks at what a disturbed line has delivered


class Wiring:
    """A sensor that measures what the feed file `feed` says (None: no sensor), on the pins.

    `faults`: a script. There is one clock in `simtime`: one emulated board in a process at a
    time. `ended` is set where a fault ended the processor: the exit code of the simulated board.
    """

    def __init__(
        self,
        rp2040: RP2040,
        uart: workarounds.PacedUart,
        feed: Path | None,
        sensor: str,
        faults: Sequence[dict[str, Any]],
        stop: Callable[[], None],
    ) -> None:
        self.ended = -1
        self._clock = rp2040.clock
        self._i2c = rp2040.i2c[0]
        workarounds.pass_polls(self._i2c)
        self._pins = {n: rp2040.gpio[n] for n in (machine.SDA_PIN, machine.SCL_PIN)}
        self._ready = rp2040.gpio[machine.READY_PIN]
        self._uart = uart
        self._stop = stop
        self._then: Callable[[], None] = lambda: None
        self._bus_alarm = self._clock.create_alarm(self._go_on)
        self._event_alarm = self._clock.create_alarm(self.follow)
        self._pulse_alarm = self._clock.create_alarm(self._end_pulse)
        self._noise_alarm = self._clock.create_alarm(self._make_noise)
        simtime.clear()
        self.sensor: Mpu9150 | None = None
        self.playback: Playback | None = None
        if feed is not None and sensor != "none":
            self.sensor = Mpu9150(compass=sensor == "MPU-9150")
            self.playback = Playback(
                self.sensor, Feed(str(feed)), self._rise, lambda: self._world.start()
            )
        machine.wire(self.sensor, self.playback)
        machine.inject(None)
        self._world = World(list(faults), self.sensor, self.playback)
        self._world.switch_on()
        for number, pin in self._pins.items():
            pin.set_input_value(True)
            pin.add_listener(partial(self._changed, number))
        self._ready.set_input_value(False)
        self._i2c.on_start = self._start
        self._i2c.on_connect = self._connect
        self._i2c.on_write_byte = self._write
        self._i2c.on_read_byte = self._read
        self._i2c.on_stop = self._end
        workarounds.follow_resets(rp2040, self._abandon)
        if any(fault["kind"].startswith("uart_") for fault in faults):
            self._noise_alarm.schedule(_NOISE_NS)
        self.follow()

    @property
    def behind_ns(self) -> float:
        """How far the processor's clock is behind: a fault has stopped the processor so long."""
        return 1000.0 * simtime.now() - self._clock.nanos

    def follow(self) -> None:
        """Bring the simulated board's clock to the processor's; what is due happens."""
        try:
            # Time stamps are sums of 8 ns: what rounding could leave of them is far less than 1.
            simtime.advance(max(0, int(self._clock.nanos + 0.5) // 1000 - simtime.now()))
        except SystemExit as end:
            self.ended = int(end.code or 0)
        self._settled()

    def _settled(self) -> None:
        """After anything that may have changed what comes next, or INT."""
        if self.sensor and not self._pulsing and bool(self.sensor.line) != self._level:
            self._show(bool(self.sensor.line))
        if self.ended >= 0 or self.behind_ns >= 1000:
            self._stop()
            return
        ns = 1000.0 * simtime.due() - self._clock.nanos
        self._event_alarm.cancel()
        if ns < 1e15:
            self._event_alarm.schedule(max(0.0, ns))

    # The interrupt pin.

    _pulsing = False
    _level = False

    def _rise(self) -> None:
        if machine.cut_wire:
            return
        self._show(True)
        if not (self.sensor and self.sensor.line):
            self._pulsing = True
            self._pulse_alarm.schedule(_PULSE_NS)

    def _end_pulse(self) -> None:
        self._pulsing = False
        self._show(bool(self.sensor and self.sensor.line))

    def _show(self, level: bool) -> None:
        self._level = level
        self._ready.set_input_value(level)

    # SDA and SCL as pins of the program.

    def _changed(self, number: int, new: Any, _old: Any) -> None:
        self._driven(number, new)

    def _driven(self, number: int, state: GPIOPinState) -> None:
        bus = machine.bus
        bus.claimed = all(p.function_select == _I2C_FUNCTION for p in self._pins.values())
        self.follow()
        if bus.claimed:
            bus.sda = bus.scl = 1
        elif number == machine.SDA_PIN:
            bus.sda = int(state != GPIOPinState.LOW)
        else:
            bus.drive_scl(int(state != GPIOPinState.LOW))
        for pin, level in ((machine.SDA_PIN, bus.sda_level), (machine.SCL_PIN, bus.scl)):
            if self._pins[pin].input_value != bool(level):
                self._pins[pin].set_input_value(bool(level))

    # The controller. Each step is done when its bits have passed.

    def _after(self, bits: int, then: Callable[[], None]) -> None:
        self._then = then
        self._bus_alarm.schedule(bits * workarounds.bit_ns(self._i2c))

    def _go_on(self) -> None:
        self.follow()
        self._then()
        self._settled()

    def _abandon(self) -> None:
        """The controller has been reset in the middle of whatever it did."""
        self._bus_alarm.cancel()
        machine.bus.end()

    def _start(self, _repeated: bool) -> None:
        self._after(1, self._started)

    def _started(self) -> None:
        bus = machine.bus
        bus.frequency = round(1e9 / workarounds.bit_ns(self._i2c))
        free = bus.sda_level and bus.scl
        if not free and workarounds.starting(self._i2c):
            # It waits until the bus is free, however long that takes.
            self._bus_alarm.schedule(_WAIT_NS)
            return
        self._i2c.complete_start()

    def _connect(self, address: int, mode: I2CMode) -> None:
        reading = mode == I2CMode.READ

        def connected() -> None:
            if machine.bus.select(address, reading):
                self._i2c.complete_connect(True)
            else:
                workarounds.refuse(self._i2c)

        self._after(9, connected)

    def _write(self, value: int) -> None:
        def written() -> None:
            machine.bus.give(value)
            self._i2c.complete_write(True)

        self._after(9, written)

    def _read(self, _ack: bool) -> None:
        self._after(9, lambda: self._i2c.complete_read(machine.bus.take()))

    def _end(self) -> None:
        def ended() -> None:
            machine.bus.end()
            self._i2c.complete_stop()

        self._after(1, ended)

    def _make_noise(self) -> None:
        self.follow()
        self._uart.receive(machine.injected(256))
        self._noise_alarm.schedule(_NOISE_NS)
