"""Simulated flash: what the firmware sees as `os` and `open`, over a folder of the host.

littlefs as MicroPython makes it on the rp2: blocks of 4096 bytes, files of up to 512 bytes in
their directory's blocks. What was written reaches the flash with `flush` or `close`, all of it or
nothing: until then a restart leaves the file as it was (`torn` is the hostile variant, a FAT: the
bytes before a power cut are there). Names are made, removed and renamed at once.

Erasing a block takes 45 ms, programming a 256-byte page 0.4 ms, with interrupts disabled; a file
that goes on after a `flush` has its last block copied. `operations` counts erased blocks and
programmed pages, `written` bytes given to `write`: a power cut can be set to the n-th of either
(`cut`), which then doesn't take place.
"""

import io
import os as _os
from builtins import open as _open

from solenav.sim.board import simtime

try:
    from collections.abc import Callable, Iterator
    from typing import Any
except ImportError:  # MicroPython: annotations are never evaluated there
    pass

BLOCK = 4096
PAGE = 256
ERASE_US = 45_000
PROGRAM_US = 400

_CAPACITY = 1_441_792  # of the Pico's file system
_INLINE = 512
_COMMITS = 16  # into a directory's block until it is compacted
_SPARE = 2  # blocks that littlefs needs to copy on write
_DIRECTORY = 0x4000
_ENOENT, _ENOSPC = 2, 28
# The simulator's own files.
_HIDDEN = ("solenav", "feed.bin", "board.json", "board.state", "stderr")

operations = 0
written = 0
full = False  # a fault: nothing finds room

_root = ""
_capacity = _CAPACITY
_torn = False
_used = 0
_commits = 0
_cut_operation = 0
_cut_byte = 0
_on_cut: "Callable[[], None] | None" = None


def mount(root: str, settings: "dict[str, Any]") -> None:
    """Use a folder (its name ends in /; empty is the current one).

    `settings`: `capacity` in bytes, `torn`; and `counts`, what `counts` returned before a restart.
    """
    global _root, _capacity, _torn, _used, _commits, operations, written, full, _on_cut
    _root = root
    _capacity = settings.get("capacity", _CAPACITY)
    _torn = settings.get("torn", False)
    operations, written, _commits = settings.get("counts", (0, 0, 0))
    full = False
    _on_cut = None
    _used = _SPARE + _count("")


def counts() -> list[int]:
    return [operations, written, _commits]


def cut(operation: int, byte: int, on_cut: "Callable[[], None]") -> None:
    """Call `on_cut`, which ends the process, at an operation or byte; 0: at none."""
    global _cut_operation, _cut_byte, _on_cut
    _cut_operation, _cut_byte, _on_cut = operation, byte, on_cut


def open(path: str, mode: str = "r", *_more: "Any", **_options: "Any") -> "Any":
    real = _real(path)
    if "w" in mode or "a" in mode or "+" in mode:
        return _File(real, mode)
    simtime.check()
    return _open(real, mode)


def listdir(path: str = "") -> list[str]:
    return [entry[0] for entry in ilistdir(path)]


def ilistdir(path: str = "") -> "Iterator[tuple[str, int, int, int]]":
    """Name, type (0x4000 folder, 0x8000 file), 0, size."""
    real = _real(path)
    entries = []
    for name in sorted(_os.listdir(real or ".")):
        if real == _root and name in _HIDDEN:
            continue
        found = _os.stat(_join(real, name))
        is_folder = found[0] & 0xF000 == _DIRECTORY
        entries.append((name, _DIRECTORY if is_folder else 0x8000, 0, 0 if is_folder else found[6]))
    return iter(entries)


def stat(path: str) -> "tuple[int, ...]":
    found = _os.stat(_real(path) or ".")
    is_folder = found[0] & 0xF000 == _DIRECTORY
    mode = _DIRECTORY if is_folder else 0x8000
    return (mode, 0, 0, 0, 0, 0, 0 if is_folder else found[6], 0, 0, 0)


def statvfs(path: str = "") -> "tuple[int, ...]":
    total = _capacity // BLOCK
    free = 0 if full else max(0, total - _used)
    return (BLOCK, BLOCK, total, free, free, 0, 0, 0, 0, 255)


def mkdir(path: str) -> None:
    global _used
    real = _real(path)
    _need(2)
    _commit()
    _os.mkdir(real)
    _used += 2


def rmdir(path: str) -> None:
    global _used
    real = _real(path)
    _commit()
    _os.rmdir(real)
    _used -= 2


def remove(path: str) -> None:
    global _used
    real = _real(path)
    size = _os.stat(real)[6]
    _commit()
    _os.remove(real)
    _used -= _blocks(size)


unlink = remove


def rename(old: str, new: str) -> None:
    """Atomic; a file of the new name is replaced."""
    global _used
    source, target = _real(old), _real(new)
    _os.stat(source)
    try:
        replaced = _blocks(_os.stat(target)[6])
    except OSError:
        replaced = 0
    _commit()
    _os.rename(source, target)
    _used -= replaced


def getcwd() -> str:
    return "/"


def sync() -> None:
    """Every file is synchronised by its own `flush`."""


def _real(path: str) -> str:
    while path[:1] == "/":
        path = path[1:]
    while path[-1:] == "/":
        path = path[:-1]
    if path in (".", ""):
        return _root
    if path.split("/")[0] in _HIDDEN:
        raise OSError(_ENOENT)
    return _root + path


def _join(folder: str, name: str) -> str:
    return folder + name if folder == "" or folder[-1] == "/" else folder + "/" + name


def _blocks(size: int) -> int:
    return 0 if size <= _INLINE else -(-size // BLOCK)


def _count(path: str) -> int:
    """Blocks that a folder takes with all that is in it."""
    total = 2
    for name, kind, _inode, size in ilistdir(path):
        total += _count(_join(path, name)) if kind == _DIRECTORY else _blocks(size)
    return total


def _need(blocks: int) -> None:
    if blocks > 0 and (full or _used + blocks > _capacity // BLOCK):
        raise OSError(_ENOSPC)


def _operate(us: int) -> None:
    global operations
    simtime.check()
    operations += 1
    if operations == _cut_operation and _on_cut:
        _on_cut()
    simtime.hold_off(us)


def _commit(pages: int = 1) -> None:
    """Into a directory's block: its next pages, or all of it into another block."""
    global _commits
    _commits += pages
    if _commits >= _COMMITS:
        _commits = 0
        _operate(ERASE_US)
    for _ in range(pages):
        _operate(PROGRAM_US)


class _File(io.IOBase):
    """A file that is written."""

    def __init__(self, real: str, mode: str) -> None:
        global _used
        self._path = real
        self._text = "b" not in mode
        try:
            size = _os.stat(real)[6]
        except OSError:
            if "r" in mode:
                raise
            _commit()
            with _open(real, "wb"):
                pass
            size = 0
        self._kept = _blocks(size)  # of what is on the flash
        self._emptied = "w" in mode and size > 0
        self._size = 0 if self._emptied else size
        self._mine = 0 if self._emptied else self._kept  # of what will be
        self._pos = self._size if "a" in mode else 0
        self._append = "a" in mode
        self._pending: list[tuple[int, bytes]] = []
        self._writing = False  # into a block erased for it
        self._open = True

    def write(self, data: "Any", offset: int = 0, length: "int | None" = None) -> int:
        global _used, written
        if not self._open:
            raise ValueError("file is closed")
        if length is not None:
            data = memoryview(data)[offset : offset + length]
        taken = len(data)
        data = data.encode() if isinstance(data, str) else bytes(data)
        if self._append:
            self._pos = self._size
        start = self._pos
        end = start + len(data)
        more = _blocks(max(end, self._size)) - self._mine
        _need(more)
        if more > 0:
            self._mine += more
            _used += more
        if _cut_byte and written < _cut_byte <= written + len(data) and _on_cut:
            self._pending.append((start, data[: _cut_byte - written - 1]))
            written = _cut_byte
            if _torn:
                self._apply()
            _on_cut()
        written += len(data)
        try:
            self._program(start, end)
        except SystemExit:
            if _torn:
                self._apply()
            raise
        self._pending.append((start, data))
        self._pos = end
        self._size = max(self._size, end)
        return taken

    def readinto(self, buffer: bytearray) -> int:
        data = self._content()[self._pos : self._pos + len(buffer)]
        buffer[: len(data)] = data
        self._pos += len(data)
        return len(data)

    def read(self, most: int = -1) -> "Any":
        size = self._size - self._pos if most < 0 else most
        data = self._content()[self._pos : self._pos + size]
        self._pos += len(data)
        return data.decode() if self._text else data

    def seek(self, offset: int, whence: int = 0) -> int:
        self._pos = (0, self._pos, self._size)[whence] + offset
        return self._pos

    def tell(self) -> int:
        return self._pos

    def flush(self) -> None:
        """What was written is now on the flash."""
        global _used
        if not self._open or not (self._pending or self._emptied):
            return
        if self._size > _INLINE:
            if self._size % PAGE:
                _operate(PROGRAM_US)
            _commit()
        else:
            _commit(1 + self._size // PAGE)
        self._apply()
        if self._emptied:
            _used -= self._kept
            self._emptied = False
        self._kept = self._mine
        self._writing = False

    def close(self) -> None:
        self.flush()
        self._open = False

    def ioctl(self, request: int, _argument: int) -> int:
        """What MicroPython's own modules ask of a stream: 1 flush, 4 close."""
        if request == 1:
            self.flush()
        elif request == 4:
            self.close()
        return 0

    def __enter__(self) -> "_File":
        return self

    def __exit__(self, kind: "Any", error: "Any", traceback: "Any") -> None:
        self.close()

    def __del__(self) -> None:
        """A file that is forgotten loses what wasn't flushed."""

    def _program(self, start: int, end: int) -> None:
        if max(end, self._size) <= _INLINE:
            return
        if not self._writing:
            self._writing = True
            _operate(ERASE_US)
            for _ in range(-(-(start % BLOCK) // PAGE)):
                _operate(PROGRAM_US)
        for _ in range((end - 1) // BLOCK - max(start - 1, 0) // BLOCK):
            _operate(ERASE_US)
        for _ in range(end // PAGE - start // PAGE):
            _operate(PROGRAM_US)

    def _content(self) -> bytes:
        data = bytearray()
        if not self._emptied:
            with _open(self._path, "rb") as file:
                data = bytearray(file.read())
        for at, piece in self._pending:
            if len(data) < at + len(piece):
                data.extend(bytes(at + len(piece) - len(data)))
            data[at : at + len(piece)] = piece
        return bytes(data)

    def _apply(self) -> None:
        if self._emptied:
            with _open(self._path, "wb"):
                pass
        with _open(self._path, "r+b") as file:
            for at, piece in self._pending:
                file.seek(at)
                file.write(piece)
        self._pending.clear()
