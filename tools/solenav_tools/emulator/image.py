"""The Pico's file system as it lies in flash: littlefs, made of files, read back as files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

BLOCK = 4096
BLOCKS = 352  # MicroPython's share of a Pico's 2 MB
START = 0xA0000  # where in flash
_DISK_VERSION = 0x00020000  # MicroPython before 1.22 hangs on newer ones


def build(content: Mapping[str, bytes]) -> bytes:
    """An image of a file system with these files, by their paths."""
    fs = _mounted(None)
    for path, data in sorted(content.items()):
        fs.makedirs(path.rpartition("/")[0], exist_ok=True)
        with fs.open(path, "wb") as file:
            file.write(data)
    fs.unmount()
    return bytes(fs.context.buffer)


def files(image: bytes) -> dict[str, bytes]:
    """All files of an image, by name."""
    fs = _mounted(image)
    found = {}
    for base, _folders, names in fs.walk("/"):
        for name in names:
            path = f"{base.rstrip('/')}/{name}"
            with fs.open(path, "rb") as file:
                found[path.lstrip("/")] = bytes(file.read())
    return found


def _mounted(image: bytes | None) -> Any:
    from littlefs import LittleFS, UserContext

    context = UserContext(buffsize=BLOCK * BLOCKS)
    if image is not None:
        context.buffer = bytearray(image)
    return LittleFS(
        context=context,
        mount=True,
        block_size=BLOCK,
        block_count=BLOCKS,
        prog_size=256,
        disk_version=_DISK_VERSION,
    )
