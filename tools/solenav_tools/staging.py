"""What goes onto a board: firmware, core, configuration, in one folder."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import solenav.sim.board
import solenav_core
from solenav.engines import device_form
from solenav.engines.thumb.compiler import compiled
from solenav.errors import SolenavError

SWITCH = "switch.py"
_SIMULATED = "solenav.sim.board.simulated"


def firmware_path() -> Path:
    """The folder of the firmware's files: in the installed package, else in the checkout."""
    here = Path(__file__).resolve()
    for folder in (here.parent / "firmware", here.parents[2] / "firmware"):
        if (folder / "main.py").is_file():
            return folder
    raise SolenavError("the firmware's files are missing", "install solenav again")


def _files() -> Iterator[tuple[str, Path]]:
    """Firmware and core: the name on the board, the file here."""
    firmware = firmware_path()
    core = Path(solenav_core.__path__[0])
    for base, prefix in ((firmware, ""), (core, "solenav_core/")):
        for path in sorted(base.rglob("*.py")):
            yield prefix + path.relative_to(base).as_posix(), path


def build_hash() -> int:
    """32 bits of a SHA-256 over firmware and core, whatever the line ends."""
    digest = hashlib.sha256()
    for name, path in _files():
        data = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name}\0{len(data)}\0".encode())
        digest.update(data)
    return int.from_bytes(digest.digest()[:4], "big")


def _version() -> str:
    try:
        return metadata.version("solenav")
    except metadata.PackageNotFoundError:
        return "unversioned"


def stage(folder: Path, config: Mapping[str, Any]) -> None:
    """Put what the simulated board runs into `folder`; `config` is the firmware's config.json.

    Kernels lose their viper decorator: on 64-bit MicroPython viper has 64-bit words and proves
    nothing, as bytecode they compute what the microcontroller computes.
    """
    for name, path in _files():
        text = path.read_text(encoding="utf-8").replace("@micropython.viper\n", "")
        _write(folder / name, text)
    for path in sorted(Path(solenav.sim.board.__path__[0]).glob("*.py")):
        _write(folder / "solenav" / "sim" / "board" / path.name, path.read_text(encoding="utf-8"))
    _write(folder / "config.json", json.dumps({**config, "board": _SIMULATED}))
    _write(folder / "build.json", json.dumps({"hash": build_hash(), "version": _version()}))


def stage_board(folder: Path, march: str) -> None:
    """Put what a real board runs into `folder`, all but main.py compiled by mpy-cross.

    Compiling on the board would take seconds of each boot and more heap than a Pico has. The core
    goes as its device form. `march`: armv6m for the Raspberry Pi Pico. SolenavError where
    mpy-cross is missing or refuses.
    """
    for name, data in board_tree(march).items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
    # MicroPython looks for it by this name.
    (folder / "main.mpy").unlink()
    _write(folder / "main.py", (firmware_path() / "main.py").read_text(encoding="utf-8"))


def board_tree(march: str) -> dict[str, bytes]:
    """What `solenav flash` writes into a tree of a board, by name there: all of it compiled.

    SolenavError where mpy-cross is missing or refuses.
    """
    texts = {f"solenav_core/{name}": text for name, text in device_form.modules().items()}
    for name, path in _files():
        if not name.startswith("solenav_core/") and name != SWITCH:
            texts[name] = path.read_text(encoding="utf-8")
    tree = {
        name[: -len("py")] + "mpy": compiled(Path(name).stem, text, march)
        for name, text in texts.items()
    }
    tree["build.json"] = json.dumps({"hash": build_hash(), "version": _version()}).encode()
    return tree


def switch() -> bytes:
    """The `main.py` at a board's root, which picks the tree to run."""
    return (firmware_path() / SWITCH).read_bytes().replace(b"\r\n", b"\n")


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m solenav_tools.staging FOLDER ARCHITECTURE (Pico: armv6m)")
    stage_board(Path(sys.argv[1]), sys.argv[2])
