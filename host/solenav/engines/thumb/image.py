"""The image: kernels, and the objects around them, laid out in RAM as MicroPython's loader does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from solenav.engines.thumb import mpy, services
from solenav.engines.thumb.compiler import CompiledModule
from solenav.engines.thumb.memory import BASE, IMAGE_MAX


@dataclass(frozen=True)
class Kernel:
    """A kernel in RAM: its function object and where its machine code starts and stops."""

    name: str
    object: int
    start: int
    stop: int


@dataclass
class Image:
    """What to write to BASE, and where things are in it.

    `services` is where the runtime's code starts and stops, `globals_in_use` a word that the
    runtime changes, `names` the names by the numbers that kernels load globals with.
    """

    data: bytearray = field(default_factory=bytearray)
    kernels: dict[str, Kernel] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    services: tuple[int, int] = (0, 0)
    globals_in_use: int = 0

    def reserve(self, size: int) -> int:
        """Room for `size` bytes, on a word's boundary; its address."""
        self.data += bytes(-len(self.data) % 4)
        address = BASE + len(self.data)
        self.data += bytes(size)
        if len(self.data) > IMAGE_MAX:
            raise MemoryError(f"kernels of more than {IMAGE_MAX} bytes")
        return address

    def put(self, address: int, data: bytes) -> None:
        self.data[address - BASE : address - BASE + len(data)] = data

    def words(self, address: int, *words: int) -> None:
        self.put(address, b"".join(word.to_bytes(4, "little") for word in words))


def build(modules: Iterable[CompiledModule]) -> Image:
    """Lay out modules. Kernels go by ``module.kernel``."""
    modules = list(modules)
    image = Image()
    image.globals_in_use = image.reserve(4)
    count = sum(len(module.names) for module in modules)
    global_objects = image.reserve(4 * count)
    size = len(services.build(0, 0, 0)[0])
    start = image.reserve(size)
    code, table = services.build(start, image.globals_in_use, global_objects)
    image.put(start, code)
    image.services = (start, start + size)
    fun_table = image.reserve(4 * len(table))
    image.words(fun_table, *table)
    for module in modules:
        _place(image, module, fun_table)
    objects = [_object(image, module, name) for module in modules for name in module.names]
    image.words(global_objects, *objects)
    return image


def _place(image: Image, module: CompiledModule, fun_table: int) -> None:
    """A module's context (type, globals, names, objects) and its kernels."""
    first = len(image.names)
    image.names += [f"{module.name}.{name}" for name in module.names]
    numbers = image.reserve(2 * len(module.names))
    image.put(
        numbers, b"".join((first + i).to_bytes(2, "little") for i in range(len(module.names)))
    )
    objects = image.reserve(4 * len(module.objects))
    image.words(objects, *(fun_table if kind == mpy.FUN_TABLE else 0 for kind in module.objects))
    context = image.reserve(16)
    # The module's globals are never looked into: their address only tells modules apart.
    image.words(context, 0, context, numbers, objects)
    for name, code in module.kernels.items():
        function = image.reserve(16)
        start = image.reserve(len(code))
        image.words(function, 0, context, 0, start | 1)
        image.put(start, code)
        full = f"{module.name}.{name}"
        image.kernels[full] = Kernel(full, function, start, start + len(code))


def _object(image: Image, module: CompiledModule, name: str) -> int:
    """The kernel that a module knows by a name; 0 where it knows none."""
    kernel = image.kernels.get(f"{module.name}.{name}")
    if kernel is None and name in module.imports:
        kernel = image.kernels.get(".".join(module.imports[name]))
    return kernel.object if kernel else 0
