"""The `thumb` engine: the machine code that boards run, executed on the host.

mpy-cross compiles the kernels for the Raspberry Pi Pico's CPU, unicorn executes them, one whole
tick after the other. It shows the bits that a board computes, what they cost there, and every
access outside the buffers.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.engines import Engine
from solenav.engines.source import MODULES, core_path
from solenav.engines.thumb import image
from solenav.engines.thumb.accounting import Cost, KernelCost
from solenav.engines.thumb.compiler import compile_modules
from solenav.engines.thumb.cpu import Machine, ThumbFault

__all__ = ["Cost", "KernelCost", "ThumbEngine", "ThumbFault", "ThumbProgram", "core_sources"]


def core_sources() -> dict[str, str]:
    """The core's kernel modules, by name, as they are."""
    return {m: (core_path() / f"{m}.py").read_text(encoding="utf-8") for m in MODULES}


class ThumbProgram:
    """Kernels as machine code on an emulated CPU.

    `sources` are module texts by module name, the core's own by default. They import each
    other's kernels as ``from solenav_core.module import kernel``; of their other Python nothing
    is executed. SyntaxError where mpy-cross refuses a text, SolenavError where a package is
    missing.
    """

    def __init__(self, sources: Mapping[str, str] | None = None) -> None:
        modules = compile_modules(core_sources() if sources is None else sources)
        self.machine = Machine(image.build(modules))

    def call(self, kernel: str, *arguments: Any) -> int:
        """Call ``module.kernel`` with ints and writable buffers, which it may change.

        ThumbFault: it would crash or corrupt a board.
        """
        buffers = {
            i: memoryview(argument).cast("B")
            for i, argument in enumerate(arguments)
            if not isinstance(argument, int)
        }
        words = list(arguments)
        addresses = self.machine.place([len(buffer) for buffer in buffers.values()])
        for (i, buffer), address in zip(buffers.items(), addresses, strict=True):
            words[i] = address
            self.machine.write(address, bytes(buffer))
        result = self.machine.run(self.machine.image.kernels[kernel], words)
        for (_, buffer), address in zip(buffers.items(), addresses, strict=True):
            buffer[:] = self.machine.read(address, len(buffer))
        return result

    def advance(
        self,
        s: array[int],
        p: array[int],
        w: array[int],
        t: array[int],
        m: array[int],
        counts: NDArray[np.int16],
        start: int,
        stop: int,
        mask: int,
    ) -> tuple[int, int]:
        """Tick over rows of `counts`: `Engine.advance` over the core's five arrays."""
        arrays = [memoryview(each).cast("B") for each in (s, p, w, t, m)]
        addresses = self.machine.place([len(each) for each in arrays])
        for each, address in zip(arrays, addresses, strict=True):
            self.machine.write(address, bytes(each))
        tick = self.machine.image.kernels["navigator.tick"]
        events = 0
        row = start
        while row < stop:
            self.machine.write(addresses[-1], counts[row].astype("<i4").tobytes())
            row += 1
            events = self.machine.run(tick, addresses)
            if events & mask:
                break
        for each, address in zip(arrays, addresses, strict=True):
            each[:] = self.machine.read(address, len(each))
        return row, events

    def cycles(self) -> Cost:
        """What ran since the program was made or `clear` was called."""
        return self.machine.cost()

    def clear(self) -> None:
        """Count from nothing."""
        self.machine.clear()


class ThumbEngine(Engine):
    """A navigator whose ticks run as machine code; `sources` as for `ThumbProgram`."""

    def __init__(
        self,
        params: array[int],
        sources: Mapping[str, str] | None = None,
        forest: array[int] | None = None,
    ) -> None:
        super().__init__("thumb", params, forest)
        self.program = ThumbProgram(sources)
        self._advance = self.program.advance

    def cycles(self) -> Cost:
        """What this engine's ticks have cost so far."""
        return self.program.cycles()
