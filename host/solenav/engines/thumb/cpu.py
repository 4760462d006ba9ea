"""The machine: a Cortex-M0 with the RAM of an RP2040, running kernels.

Memory outside code, stack and the buffers that were placed is out of bounds, down to the byte.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from solenav.engines.thumb import hooks, services
from solenav.engines.thumb.accounting import Cost, cost
from solenav.engines.thumb.compiler import REMEDY
from solenav.engines.thumb.image import Image, Kernel
from solenav.engines.thumb.memory import BASE, GAP, IMAGE_MAX, SIZE, STACK_SIZE, STACK_TOP
from solenav.errors import SolenavError

_SVC = 2  # the interrupt that an SVC raises
_SIGN = 1 << 31
_WORD = (1 << 32) - 1


class ThumbFault(RuntimeError):
    """A kernel did what would crash or corrupt a board; says which kernel, and what."""


def signed(word: int) -> int:
    """A 32-bit word as a signed int, wrapped."""
    return ((word + _SIGN) & _WORD) - _SIGN


def floor_divide(num: int, den: int) -> int:
    """num // den as MicroPython's runtime computes it, in words that wrap."""
    if num >= 0 > den:
        num = signed(num - den - 1)
    elif num < 0 <= den:
        num = signed(num - den + 1)
    quotient = abs(num) // abs(den)
    return signed(quotient if (num < 0) == (den < 0) else -quotient)


class Machine:
    """An emulated CPU with an image of kernels in its RAM."""

    def __init__(self, image: Image) -> None:
        try:
            import numba  # noqa: F401
            import unicorn
            from unicorn import arm_const as arm
        except ImportError as missing:
            raise SolenavError(f"the thumb engine needs {missing.name}", REMEDY) from None
        self.image = image
        self._error = unicorn.UcError
        self._uc: Any = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB)
        # With the mode for microcontrollers this model would run Thumb-2 as well.
        self._uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M0)
        self._r = [arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3]
        self._sp, self._lr, self._pc = arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR, arm.UC_ARM_REG_PC
        self._uc.mem_map(BASE, SIZE)
        self._uc.mem_write(BASE, bytes(image.data))
        self._tally = np.zeros(1, hooks.TALLY)
        self._access = self._tally["access"][0]
        self._access[: len(image.data)] = hooks.READ
        self._allow(image.globals_in_use, 4)
        hooks.attach(self._uc, self._tally, (image.services[1], BASE + len(image.data)))
        self._uc.hook_add(unicorn.UC_HOOK_INTR, self._on_interrupt)
        self._buffers: list[tuple[int, int]] = []
        self._values: dict[int, int] = {}
        self.clear()

    def clear(self) -> None:
        """Count from nothing."""
        self._tally["runs"] = 0
        self._tally["taken"] = 0
        self._divisions: Counter[str] = Counter()
        self._boxed: Counter[str] = Counter()
        self._entries = 0

    def cost(self) -> Cost:
        """What ran since `clear`."""
        runs, taken = self._tally["runs"][0], self._tally["taken"][0]
        return cost(self.image, runs, taken, self._divisions, self._boxed, self._entries)

    def place(self, sizes: Sequence[int]) -> list[int]:
        """Addresses of buffers of these sizes in bytes; those placed before are gone."""
        for address, size in self._buffers:
            self._access[address - BASE : address - BASE + size] = 0
        self._buffers = []
        at = BASE + IMAGE_MAX
        for size in sizes:
            at = (at + GAP + 7) & ~7
            self._buffers.append((at, size))
            at += size
            if at + GAP > STACK_TOP - STACK_SIZE:
                raise MemoryError("the buffers don't fit the machine's RAM")
            self._allow(*self._buffers[-1])
        return [address for address, _size in self._buffers]

    def _allow(self, address: int, size: int) -> None:
        self._access[address - BASE : address - BASE + size] = hooks.READ | hooks.WRITE

    def write(self, address: int, data: bytes) -> None:
        self._uc.mem_write(address, data)

    def read(self, address: int, size: int) -> bytes:
        return bytes(self._uc.mem_read(address, size))

    def run(self, kernel: Kernel, arguments: Sequence[int]) -> int:
        """Call a kernel as bytecode would, with ints (addresses of buffers are ints); its result.

        ThumbFault: it left its buffers, divided by zero or asked for what kernels may not.
        """
        self._values = {services.FALSE: 0, services.TRUE: 1}
        objects = [self._object(signed(value)) for value in arguments]
        sp = (STACK_TOP - 4 * len(objects)) & ~7
        self.write(sp, b"".join(word.to_bytes(4, "little") for word in objects))
        self.write(self.image.globals_in_use, bytes(4))
        # Any address does to return to, as long as nothing else runs there.
        home = self.image.globals_in_use
        registers = [*self._r, self._sp, self._lr]
        values = [kernel.object, len(objects), 0, sp, sp, home | 1]
        for register, value in zip(registers, values, strict=True):
            self._uc.reg_write(register, value)
        self._tally["last"] = (kernel.start - BASE) // 2
        self._tally["fault"] = 0
        self._entries += 1
        try:
            self._uc.emu_start(kernel.start | 1, home)
        except self._error as error:
            self._check_access()
            raise ThumbFault(f"{self._running()}: {error}") from None
        self._check_access()
        return self._value(self._uc.reg_read(self._r[0]))

    def _running(self) -> str:
        """The kernel whose code ran last."""
        at = BASE + 2 * int(self._tally["last"][0]) - 2
        for kernel in self.image.kernels.values():
            if kernel.start <= at < kernel.stop:
                return kernel.name
        return "no kernel"

    def _check_access(self) -> None:
        if not self._tally["fault"][0]:
            return
        address, size = int(self._tally["address"][0]), int(self._tally["size"][0])
        what = "read" if self._tally["fault"][0] == hooks.READ else "write"
        where = f"at {address:#x}"
        for number, (start, length) in enumerate(self._buffers):
            if start - GAP // 2 <= address < start + length + GAP // 2:
                where = f"at byte {address - start} of buffer {number}, which has {length}"
        raise ThumbFault(f"{self._running()}: {what} of {size} bytes {where}")

    # Services that the image's own code leaves to the host.

    def _on_interrupt(self, _uc: Any, number: int, _data: Any) -> None:
        if number != _SVC:
            raise ThumbFault(f"{self._running()}: processor exception {number}")
        pc = self._uc.reg_read(self._pc)
        service = self.image.data[pc - 2 - BASE]
        a, b = (self._uc.reg_read(register) for register in self._r[:2])
        self._uc.reg_write(self._r[0], self._serve(service, a, b) & _WORD)

    def _serve(self, service: int, a: int, b: int) -> int:
        if service == services.FROM_OBJECT:
            if b == services.OBJECT_TYPE:
                return a
            value = self._value(a)
            return int(value != 0) if b == services.BOOL_TYPE else value
        if service == services.TO_OBJECT:
            if b == services.OBJECT_TYPE:
                return a
            if b == services.BOOL_TYPE:
                return services.TRUE if a else services.FALSE
            self._boxed[self._running()] += 1
            return self._object(signed(a) if b == services.INT_TYPE else a)
        if service in (services.FLOOR_DIVIDE, services.MODULO):
            if b == 0:
                raise ThumbFault(f"{self._running()}: division by zero")
            self._divisions[self._running()] += 1
            num, den = signed(a), signed(b)
            return floor_divide(num, den) if service == services.FLOOR_DIVIDE else num % den
        if service == services.LOAD_GLOBAL:
            raise ThumbFault(f"{self._running()}: {self.image.names[a]} is no kernel")
        if service == services.ARGUMENTS:
            raise ThumbFault(f"{self._running()}: called with {a} arguments")
        name = services.NAMES.get(service, f"number {service}")
        raise ThumbFault(f"{self._running()}: needs the runtime's service {name}")

    def _object(self, value: int) -> int:
        """The word for an int: a small int, or a place in the table of larger ones."""
        if -(1 << 30) <= value < 1 << 30:
            return (value << 1 | 1) & _WORD
        address = services.BOXED + 4 * len(self._values)
        self._values[address] = value
        return address

    def _value(self, word: int) -> int:
        if word & 1:
            return signed(word) >> 1
        if word not in self._values:
            raise ThumbFault(f"{self._running()}: an object that is no int")
        return self._values[word]
