"""The firmware's sensor files on CPython, wired to the register-level model of the sensor.

The bench is the board: it has the bus with its faults, the INT line with interrupts that can be
held up, and the sensor's sample clock. `on` makes one.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from errno import EIO
from types import ModuleType
from typing import Any
from unittest import mock

from solenav.sim.board import simtime
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav_tools.staging import firmware_path

MODULES = ("bus", "ak8975", "mpu9150", "sampler", "boards")
SCL, SDA, READY, POWER = 5, 4, 6, 7

Values = tuple[int, ...]


def still(index: int) -> Values:
    """Standing, with the sample's number as its temperature, and a field that moves a little."""
    wobble = index * 7 % 5
    field_ = (100 + index % 50, -50, -140 + index // 50 % 50)
    return (wobble, -3, 2048 - wobble, index % 30000, 1, -2, wobble, *field_)


class Pin:
    """A pin of the bench; `machine.Pin` for the firmware."""

    IN, OUT, OPEN_DRAIN, IRQ_RISING = 0, 1, 2, 1
    bench: Bench

    def __init__(self, number: int, mode: int = IN, value: int | None = None) -> None:
        self._number = number
        if value is not None:
            self.value(value)

    def value(self, level: int | None = None) -> int | None:
        if level is not None:
            self.bench.drive(self._number, level)
            return None
        return self.bench.level(self._number)

    def irq(
        self,
        handler: Callable[[Pin], None] | None = None,
        trigger: int = IRQ_RISING,
        hard: bool = False,
    ) -> None:
        self.bench.handler = handler


class I2C:
    """The bus at some clock: each transfer takes its bits' time."""

    def __init__(self, bench: Bench, freq: int) -> None:
        self._bench = bench
        self._freq = freq

    def readfrom_mem_into(self, address: int, register: int, buffer: Any) -> None:
        bench = self._bench
        bench.meet_faults(address, register)
        model = bench.model
        self._select(address, register)
        model.connect(address, True)
        for i in range(len(buffer)):
            if bench.breaks_after == i:
                bench.breaks_after = -1
                model.stop()
                raise OSError(EIO)
            buffer[i] = model.read_byte() ^ bench.flips.pop((register, i), 0)
        model.stop()
        # After the read: a burst returns one sample, also while the next one arrives.
        self._pass_bits(9 * (3 + len(buffer)))

    def writeto_mem(self, address: int, register: int, data: Any) -> None:
        self._bench.meet_faults(address, register)
        self._select(address, register)
        for value in data:
            self._bench.model.write_byte(value)
            self._bench.writes.append((simtime.now(), address, register, value))
        self._bench.model.stop()
        self._pass_bits(9 * (2 + len(data)))

    def _select(self, address: int, register: int) -> None:
        if not self._bench.model.connect(address, False):
            self._pass_bits(9)
            raise OSError(EIO)
        self._bench.model.write_byte(register)

    def _pass_bits(self, bits: int) -> None:
        simtime.advance((bits + 3) * 1_000_000 // self._freq)


@dataclass
class Taken:
    """A sample that the sampler gave."""

    words: list[int]
    time: int
    flags: int
    lost: int
    number: int  # the bench's, out of the temperature


@dataclass
class Bench:
    """`clock`: the sensor's sample period against the nominal one. `values`: sample by number.

    `made`: times of the samples that the sensor made for the host, by number; `restarts`: the
    first ones after it was set up, `late` those whose pulse was held up. Faults: `nacks`
    transfers that nobody acknowledges (with `error`); `breaks_after`: bytes of the next burst
    after which it breaks off; `flips`: bits turned over in the next read, by (register, byte);
    `stuck` clocks of SCL until somebody lets go of SDA.
    """

    model: Mpu9150
    values: Callable[[int], Values] = still
    clock: float = 1.0
    made: dict[int, int] = field(default_factory=dict)
    writes: list[tuple[int, int, int, int]] = field(default_factory=list)
    nacks: int = 0
    refuses: Callable[[int, int], bool] = lambda address, register: False
    error: int = EIO
    breaks_after: int = -1
    flips: dict[tuple[int, int], int] = field(default_factory=dict)
    stuck: int = 0
    has_power_pin: bool = False
    handler: Callable[[Pin], None] | None = None
    taken: list[Taken] = field(default_factory=list)
    opened: list[int] = field(default_factory=list)
    pins: list[tuple[int, int]] = field(default_factory=list)
    modules: dict[str, ModuleType] = field(default_factory=dict)
    levels: dict[int, int] = field(default_factory=lambda: {SCL: 1, SDA: 1, POWER: 1})
    number: int = -1
    restarts: set[int] = field(default_factory=set)
    late: set[int] = field(default_factory=set)
    _sampled: bool = False
    _last: int = 0
    _due: float = 0.0
    _held: bool = False
    _pending: bool = False

    def board(self) -> Any:
        power = POWER if self.has_power_pin else None
        return self.modules["boards"].Board(
            self.open_bus, SCL, SDA, Pin(READY), None, "bench", 0, power
        )

    def open_bus(self, freq: int) -> I2C:
        self.opened.append(freq)
        return I2C(self, freq)

    def sensor(self) -> Any:
        """The driver, not yet awake."""
        return self.modules["mpu9150"].Mpu9150(self.modules["bus"].Bus(self.board()))

    def sampler(self, rate_mhz: int = 200_000, **options: Any) -> Any:
        """A sampler that has just started."""
        sensor = self.sensor()
        sensor.wake()
        made = self.modules["sampler"].Sampler(sensor, Pin(READY), rate_mhz, **options)
        made.start()
        return made

    @property
    def SensorError(self) -> type[Exception]:
        return self.modules["mpu9150"].SensorError  # type: ignore[no-any-return]

    def meet_faults(self, address: int, register: int) -> None:
        if self.nacks or self.stuck or self.refuses(address, register):
            self.nacks = max(0, self.nacks - 1)
            simtime.advance(100)
            raise OSError(self.error)

    def drive(self, number: int, level: int) -> None:
        if number == SCL and level and not self.levels[SCL] and self.stuck:
            self.stuck -= 1
        if number == POWER and level != self.levels[POWER]:
            if level:
                self.model.power_up()
            else:
                self.model.cut()
        self.pins.append((number, level))
        self.levels[number] = level

    def level(self, number: int) -> int:
        if number == SDA and self.stuck:
            return 0
        return self.levels[number]

    def tick(self) -> None:
        """The sensor's sample clock."""
        period = self.model.period_us * self.clock
        if self.model.sampling:
            steps = 1
            if not self._sampled:
                # Numbers go on as if it had never stopped.
                steps = max(1, int((simtime.now() - self._last) / period + 1 / 8))
                self.restarts.add(self.number + steps)
            self.number += steps
            self._last = simtime.now()
            self.made[self.number] = simtime.now()
        self._sampled = self.model.sampling
        rises = self.model.sample(self.values(self.number))
        if rises and self._held:
            self._pending = True
        elif rises and self.handler:
            self.handler(Pin(READY))
        self._due += period
        simtime.at(round(self._due), self.tick)

    def hold_interrupts(self, us: int) -> None:
        """Nothing runs meanwhile, as while a Pico's flash is erased."""
        self._held = True
        simtime.advance(us)
        self._held = False
        if self._pending and self.handler:
            self._pending = False
            self.late.add(self.number)
            self.handler(Pin(READY))

    def run(self, sampler: Any, samples: int, work_us: int = 300, seconds: float = 60.0) -> None:
        """Take so many more samples, as the application does."""
        end = simtime.now() + round(1_000_000 * seconds)
        wanted = len(self.taken) + samples
        while len(self.taken) < wanted:
            assert simtime.now() < end, "the samples don't come"
            if sampler.ready() and sampler.read():
                self.taken.append(
                    Taken(
                        list(sampler.sample),
                        sampler.time,
                        sampler.flags,
                        sampler.lost,
                        sampler.temperature(),
                    )
                )
                simtime.advance(work_us)
            else:
                simtime.advance(20)

    def numbers(self) -> list[int]:
        return [t.number for t in self.taken]


@contextmanager
def on(model: Mpu9150 | None = None) -> Iterator[Bench]:
    """A bench with a sensor, whose clock runs, and the firmware's modules."""
    simtime.clear()
    bench = Bench(model or Mpu9150())
    machine = ModuleType("machine")
    machine.Pin = Pin  # type: ignore[attr-defined]
    Pin.bench = bench
    simtime.at(500, bench.tick)
    bench._due = 500.0
    path = [str(firmware_path()), *sys.path]
    replaced = {"time": simtime, "machine": machine}
    with mock.patch.object(sys, "path", path), mock.patch.dict(sys.modules, replaced):
        for name in MODULES:
            sys.modules.pop(name, None)
            bench.modules[name] = importlib.import_module(name)
        yield bench
    simtime.clear()
