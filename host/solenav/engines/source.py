"""The core's kernels as syntax trees: the one source that the host's engines are made from.

A kernel is a function of `solenav_core` under ``@micropython.viper``. Modules keep private
constants, some of the same name, so a module's constants are put in as literals; after that all
kernels can live in one namespace.
"""

from __future__ import annotations

import ast
import hashlib
from dataclasses import dataclass
from pathlib import Path

import solenav_core

# In the order in which they import each other.
MODULES = (
    "qmath",
    "strapdown",
    "calibration",
    "heading",
    "align",
    "detector",
    "features",
    "forest",
    "covariance",
    "particles",
    "steps",
    "navigator",
)


@dataclass(frozen=True)
class Kernel:
    """One kernel: the module that it comes from and its definition, bare of decorators."""

    module: str
    definition: ast.FunctionDef


class _Literals(ast.NodeTransformer):
    def __init__(self, values: dict[str, int]) -> None:
        self.values = values

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id not in self.values:
            return node
        return ast.copy_location(ast.Constant(self.values[node.id]), node)


def core_path() -> Path:
    """The folder of the installed `solenav_core`."""
    return Path(solenav_core.__path__[0])


def constants(tree: ast.Module) -> dict[str, int]:
    """The module's ``NAME = const(value)`` lines."""
    found = {}
    for node in tree.body:
        match node:
            case ast.Assign(
                targets=[ast.Name(id=name)],
                value=ast.Call(func=ast.Name(id="const"), args=[argument]),
            ):
                found[name] = ast.literal_eval(argument)
    return found


def is_viper(node: ast.expr) -> bool:
    return isinstance(node, ast.Attribute) and node.attr == "viper"


def kernels() -> list[Kernel]:
    """Every kernel of the core, callees before callers. Line numbers are those of the files."""
    out = []
    for module in MODULES:
        tree = ast.parse((core_path() / f"{module}.py").read_text(encoding="utf-8"))
        literals = _Literals(constants(tree))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and any(map(is_viper, node.decorator_list)):
                node.decorator_list = []
                out.append(Kernel(module, literals.visit(node)))
    return out


def fingerprint() -> str:
    """A hash of all the core's files: which core this is."""
    digest = hashlib.sha256()
    for path in sorted(core_path().rglob("*.py")):
        digest.update(path.relative_to(core_path()).as_posix().encode())
        digest.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()
