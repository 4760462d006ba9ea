"""What kernels cost: counts of the emulated CPU, and a model of the runtime around them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solenav.engines.thumb.costs import cycles, is_conditional, is_instruction
from solenav.engines.thumb.image import Image
from solenav.engines.thumb.memory import BASE

# The runtime's own code is not on the emulated CPU. Cycles of it on a Cortex-M0+, as measured
# around whole calls: a kernel called by a kernel, a kernel called by bytecode, a division.
VIPER_CALL = 650
BYTECODE_CALL = 1150
DIVISION = 60


@dataclass(frozen=True)
class KernelCost:
    """One kernel, without the kernels that it calls.

    `divisions` went to the runtime; `boxed` ints did not fit 31 bits and so were allocated.
    """

    name: str
    calls: int
    instructions: int
    cycles: int
    divisions: int
    boxed: int


@dataclass(frozen=True)
class Cost:
    """What ran: every kernel that was called, dearest first, and how many calls came from outside.

    `cycles` are exact for the machine code. `overhead` is the model of the runtime. The machine
    code that packs and unpacks arguments, about 80 cycles a call and 20 for each argument after
    the first, is in both, so `total` is a little high.
    """

    kernels: tuple[KernelCost, ...]
    entries: int

    @property
    def instructions(self) -> int:
        return sum(kernel.instructions for kernel in self.kernels)

    @property
    def cycles(self) -> int:
        return sum(kernel.cycles for kernel in self.kernels)

    @property
    def overhead(self) -> int:
        inner = sum(kernel.calls for kernel in self.kernels) - self.entries
        divisions = sum(kernel.divisions for kernel in self.kernels)
        return inner * VIPER_CALL + self.entries * BYTECODE_CALL + divisions * DIVISION

    @property
    def total(self) -> int:
        return self.cycles + self.overhead

    @property
    def boxed(self) -> int:
        return sum(kernel.boxed for kernel in self.kernels)


def cost(
    image: Image,
    runs: NDArray[np.int64],
    taken: NDArray[np.int64],
    divisions: Counter[str],
    boxed: Counter[str],
    entries: int,
) -> Cost:
    """The cost of a tally (`hooks.TALLY`) over an image."""
    code = np.frombuffer(bytes(image.data) + bytes(len(image.data) % 2), "<u2")
    executed = np.cumsum(runs)
    rows = []
    for kernel in image.kernels.values():
        start, stop = (kernel.start - BASE) // 2, (kernel.stop - BASE) // 2
        if not executed[start]:
            continue
        ops = code[start:stop].tolist()
        times = executed[start:stop]
        away = taken[start + 1 : stop + 1]
        rows.append(
            KernelCost(
                kernel.name,
                int(times[0]),
                _weighted(times, map(is_instruction, ops)),
                _weighted(times, map(cycles, ops)) + _weighted(away, map(is_conditional, ops)),
                divisions[kernel.name],
                boxed[kernel.name],
            )
        )
    return Cost(tuple(sorted(rows, key=lambda row: -row.cycles)), entries)


def _weighted(times: NDArray[np.int64], weights: Iterable[int]) -> int:
    return int(times @ np.fromiter(weights, np.int64, len(times)))
