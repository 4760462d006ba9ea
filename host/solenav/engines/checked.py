"""The `checked` engine: plain Python that refuses what a 32-bit word can't hold.

Every operation of every kernel goes through a check: results outside a signed 32-bit word,
shift counts outside 0 to 31, indexes outside the array, division by zero. A kernel that passes
here computes the same on a microcontroller, where such things wrap or read stray memory.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

from solenav.engines.source import Kernel, kernels

LOW, HIGH = -(2**31), 2**31 - 1


class RangeError(ArithmeticError):
    """A kernel left what a 32-bit word can hold; says where and with which operands."""


_SYMBOLS = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.FloorDiv: "//",
    ast.Mod: "%",
    ast.LShift: "<<",
    ast.RShift: ">>",
    ast.BitAnd: "&",
    ast.BitOr: "|",
    ast.BitXor: "^",
}


def _operation(symbol: str) -> Callable[[int, int, str], int]:
    """A function that applies `symbol` and checks it."""
    guard = ""
    if symbol in ("<<", ">>"):
        guard = "    if not 0 <= b <= 31:\n        fail('shift count', a, b, at)\n"
    elif symbol in ("//", "%"):
        guard = "    if b == 0:\n        fail('division by zero', a, b, at)\n"
    text = (
        "def operation(a, b, at):\n"
        f"{guard}"
        f"    r = a {symbol} b\n"
        f"    if {LOW} <= r <= {HIGH}:\n"
        "        return r\n"
        f"    fail('overflow of {symbol}', a, b, at)\n"
    )
    namespace: dict[str, Any] = {"fail": _fail}
    exec(text, namespace)
    return namespace["operation"]


def _fail(what: str, a: int, b: int, at: str) -> None:
    raise RangeError(f"{at}: {what} with {a} and {b}")


def _load(array: Any, index: int, at: str) -> int:
    if 0 <= index < len(array):
        return array[index]
    raise RangeError(f"{at}: index {index} of {len(array)}")


def _store(array: Any, index: int, value: int, at: str) -> None:
    if not 0 <= index < len(array):
        raise RangeError(f"{at}: index {index} of {len(array)}")
    if not LOW <= value <= HIGH:
        raise RangeError(f"{at}: {value} stored")
    array[index] = value


class _Instrument(ast.NodeTransformer):
    """Turns operators, loads and stores into calls of the checks above."""

    def __init__(self, module: str, kernel: str) -> None:
        self.where = f"{module}.{kernel}"

    def call(self, name: str, node: ast.AST, *arguments: ast.expr) -> ast.Call:
        line = getattr(node, "lineno", 0)
        at = ast.Constant(f"{self.where} line {line}: {ast.unparse(node)}")
        return ast.Call(ast.Name(name, ast.Load()), [*arguments, at], [])

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        name = f"_op_{type(node.op).__name__}"
        return self.call(name, node, self.visit(node.left), self.visit(node.right))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        if isinstance(node.op, ast.Not) or isinstance(node.operand, ast.Constant):
            return node
        raise SyntaxError(f"{self.where}: {ast.unparse(node)}: viper may overwrite the operand")

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        return self.call("_load", node, self.visit(node.value), self.visit(node.slice))

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        # The target is read as well as written: the plain form has both.
        read = ast.parse(ast.unparse(node.target), mode="eval").body
        value = ast.copy_location(ast.BinOp(read, node.op, node.value), node)
        return self.visit_Assign(ast.copy_location(ast.Assign([node.target], value), node))

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:
        value = self.visit(node.value)
        target = node.targets[0]
        if not isinstance(target, ast.Subscript):
            node.value = value
            return node
        store = self.call(
            "_store", target, self.visit(target.value), self.visit(target.slice), value
        )
        return ast.Expr(store)


def _instrumented(kernel: Kernel) -> ast.FunctionDef:
    return _Instrument(kernel.module, kernel.definition.name).visit(kernel.definition)


def load() -> dict[str, Callable[..., int]]:
    """The kernels by name, checked."""
    namespace: dict[str, Any] = {
        f"_op_{kind.__name__}": _operation(symbol) for kind, symbol in _SYMBOLS.items()
    }
    namespace |= {"_load": _load, "_store": _store, "ptr32": None, "ptr8": None}
    body: list[ast.stmt] = [_instrumented(kernel) for kernel in kernels()]
    tree = ast.fix_missing_locations(ast.Module(body, []))
    exec(compile(tree, "<checked solenav_core>", "exec"), namespace)
    return namespace
