"""Reader of `.mpy` files, version 6.3 for armv6m: what mpy-cross makes of a kernel module.

A file holds the module's names and constant objects once, then a tree of code: the module's
bytecode and, below it, a node for each function; kernels are nodes of machine code. The format
is MicroPython's (`py/persistentcode.c`); numbers are big-endian groups of seven bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

VERSION = 6
SUB_VERSION = 3
ARMV6M = 4
SMALL_INT_BITS = 31

BYTECODE = 0
NATIVE = 1
VIPER = 2

# Constant objects: those without content, those with text of a known length, and the rest.
FUN_TABLE = 0
_EMPTY = (FUN_TABLE, 1, 2, 3, 4)  # the runtime's table, None, False, True, Ellipsis
_TERMINATED = (5, 6)  # str and bytes end in a zero byte
_TUPLE = 10

_RELOCATED = 0x70  # scope flags of code that needs addresses or data of its own filled in

# Bytecode: how long an instruction is follows from the upper half of its opcode.
_QSTR, _VARIABLE, _OFFSET = 1, 2, 3
_FORMATS = {1: _QSTR, 2: _VARIABLE, 3: _VARIABLE, 4: _OFFSET}
_EXTRA_BYTE = 0x9E  # an opcode without any of these bits has one byte more
_STORE_NAME = 0x16
_MAKE_FUNCTION = 0x32


class MpyError(ValueError):
    """The file is not one that this reader knows."""


@dataclass(frozen=True)
class Code:
    """A node of the code tree: kind (BYTECODE, NATIVE, VIPER), its bytes, the nodes below."""

    kind: int
    data: bytes
    children: tuple[Code, ...]


@dataclass(frozen=True)
class Module:
    """A compiled module.

    `names` are strings, or numbers for those names that every MicroPython numbers alike;
    `objects` the kinds of the constant objects (FUN_TABLE is the one that kernels use).
    """

    names: tuple[str | int, ...]
    objects: tuple[int, ...]
    body: Code


class _Reader:
    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    def take(self, count: int) -> bytes:
        part = self.data[self.at : self.at + count]
        if len(part) < count:
            raise MpyError("the .mpy file ends too early")
        self.at += count
        return part

    def byte(self) -> int:
        return self.take(1)[0]

    def number(self) -> int:
        value = 0
        while True:
            byte = self.byte()
            value = value << 7 | byte & 127
            if byte < 128:
                return value

    def name(self) -> str | int:
        length = self.number()
        if length & 1:
            return length >> 1
        return self.take((length >> 1) + 1)[:-1].decode()

    def object(self) -> int:
        """Skip a constant object; its kind."""
        kind = self.byte()
        if kind in _EMPTY:
            return kind
        length = self.number()
        if kind == _TUPLE:
            for _ in range(length):
                self.object()
        else:
            self.take(length + (kind in _TERMINATED))
        return kind

    def code(self) -> Code:
        head = self.number()
        kind = head & 3
        data = self.take(head >> 3)
        if kind == NATIVE:
            self.number()  # where the prelude begins
        elif kind == VIPER:
            if self.number() & _RELOCATED:
                raise MpyError("machine code with relocations")
        elif kind != BYTECODE:
            raise MpyError("inline assembler")
        count = self.number() if head & 4 else 0
        return Code(kind, data, tuple(self.code() for _ in range(count)))


def read(data: bytes) -> Module:
    """Read a whole file. MpyError for anything but version 6.3 for armv6m."""
    reader = _Reader(data)
    magic, version, feature, bits = reader.take(4)
    if magic != ord("M") or version != VERSION:
        raise MpyError(f"not a .mpy file of version {VERSION}")
    # A module without any machine code is for no architecture.
    if feature not in (0, ARMV6M << 2 | SUB_VERSION) or bits != SMALL_INT_BITS:
        raise MpyError(
            f"a .mpy file for architecture {feature >> 2 & 15}, sub-version {feature & 3}, ints "
            f"of {bits} bits; wanted {ARMV6M} (armv6m), {SUB_VERSION}, {SMALL_INT_BITS}"
        )
    names, objects = reader.number(), reader.number()
    return Module(
        tuple(reader.name() for _ in range(names)),
        tuple(reader.object() for _ in range(objects)),
        reader.code(),
    )


def functions(module: Module) -> dict[str | int, Code]:
    """The functions that the module's body defines, by name as in `names`."""
    found = {}
    made = None
    for opcode, argument in _instructions(module.body.data):
        if opcode == _STORE_NAME and made is not None:
            found[module.names[argument]] = module.body.children[made]
        # Only a function stored as soon as it is made goes by that name.
        made = argument if opcode == _MAKE_FUNCTION else None
    return found


def _instructions(data: bytes) -> Iterator[tuple[int, int]]:
    """Opcode and argument (of names and counts; else 0) of a function's bytecode."""
    reader = _Reader(data)
    while reader.byte() & 128:  # sizes of stack and arguments
        pass
    info = cells = shift = 0
    while True:
        byte = reader.byte()
        cells |= (byte & 1) << shift
        info |= (byte >> 1 & 63) << 6 * shift
        shift += 1
        if byte < 128:
            break
    reader.take(info + cells)
    while reader.at < len(data):
        opcode = reader.byte()
        form = _FORMATS.get(opcode >> 4)
        argument = 0
        if form in (_QSTR, _VARIABLE):
            argument = reader.number()
        elif form == _OFFSET and reader.byte() & 128:
            reader.byte()
        if not opcode & _EXTRA_BYTE:
            reader.byte()
        yield opcode, argument
