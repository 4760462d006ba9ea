"""Where the emulated processor's time goes: what it executes, looked at every microsecond.

The core's kernels are found in RAM by their machine code, which the host has compiled as well. A
tick lasts from the first look that finds `navigator.tick` to the first at which the stack has
shrunk past its frame; what is neither a kernel nor an interrupt within it is MicroPython's
runtime: calls between kernels, divisions.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, field

from solenav.engines.device_form import kernel_modules
from solenav.engines.thumb.compiler import compile_modules
from solenav_tools.emulator.pico import EmulatedPico

CLOCK_HZ = 125_000_000
EACH = 127  # cycles from one look to the next: no multiple of any loop's
_NS = EACH * 1e9 / CLOCK_HZ
_RAM = 0x20000000
_TICK = ("navigator", "tick")
RUNTIME, INTERRUPTS = "runtime's calls", "interrupts"


@dataclass
class Tick:
    """A tick as it was seen: when it ended, looks by stage."""

    ended_ns: int
    looks: Counter[str] = field(default_factory=Counter)

    @property
    def cycles(self) -> int:
        """Of the core: without what interrupts took."""
        return EACH * sum(n for stage, n in self.looks.items() if stage != INTERRUPTS)


class Profile:
    """Looks at a board's processor from the first tick that `run` is told of; see the module.

    `looks` and `idle` count since then; `ticks` are those that were seen whole.
    """

    def __init__(self, pico: EmulatedPico) -> None:
        self.ticks: list[Tick] = []
        self.looks = self.idle = 0
        self._pico = pico
        self._core = pico.mcu.core
        self._alarm = pico.mcu.clock.create_alarm(self._look)
        self._starts: list[int] = []
        self._pieces: list[tuple[int, tuple[str, str]]] = []  # end, module and kernel
        self._tick: Tick | None = None
        self._frame = 0

    @property
    def started(self) -> bool:
        return bool(self._starts)

    def start(self) -> bool:
        """Find the kernels, if the board has loaded all of them by now, and begin to look."""
        ram = bytes(self._pico.mcu.sram)
        found = []
        for module in compile_modules(kernel_modules()):
            for name, code in module.kernels.items():
                at = ram.find(code)
                if at < 0:
                    return False
                found.append((_RAM + at, _RAM + at + len(code), (module.name, name)))
        found.sort()
        self._starts = [start for start, _end, _name in found]
        self._pieces = [(end, name) for _start, end, name in found]
        self._alarm.schedule(_NS)
        return True

    def _look(self) -> None:
        self._alarm.schedule(_NS)
        self.looks += 1
        core = self._core
        if core.waiting:
            self.idle += 1
            return
        if core.ipsr:
            if self._tick is not None:
                self._tick.looks[INTERRUPTS] += 1
            return
        pc = core.pc
        stage = RUNTIME
        if pc >= _RAM:
            at = bisect_right(self._starts, pc) - 1
            if at >= 0 and pc < self._pieces[at][0]:
                name = self._pieces[at][1]
                stage = name[0]
                if name == _TICK:
                    if self._tick is None:
                        self._tick, self._frame = Tick(0), 0
                    self._frame = max(self._frame, core.sp)
        tick = self._tick
        if tick is None:
            return
        if core.sp > self._frame:
            tick.ended_ns = self._pico.ns
            self.ticks.append(tick)
            self._tick = None
            return
        tick.looks[stage] += 1
