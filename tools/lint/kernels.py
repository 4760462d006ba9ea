"""Lint of the kernels: what would compute something else, or nothing, as viper code.

    python tools/lint/kernels.py [FILES]     all of shared/solenav_core and firmware by default

Reads every function under ``@micropython.viper`` and prints ``file:line: rule: what to write
instead``; exit code 1 where there is any. The rules, by name:

- negation: ``-a``, ``~a`` of what isn't constant; literal: a constant, or what the compiler
  folds constants to, past 2**30; shift: a constant count outside 0..31; operator: ``/ ** @``.
- division: ``//`` and ``%`` by what may be 0. Known not to be are a constant; ``x | 1``; a local
  under a comparison with a constant that leaves only positive values (``if d <= 0: return``,
  ``if d < 1: d = 1``, ``while d > 0``) until it is assigned anew, or one shifted right from it
  by less. For anything else the line says why: ``# > 0: the heaviest weighs 1``.
- mask: a byte (ptr8) or half word (ptr16) stored that may not fit.
- index: slices, tuples, negative constants. type: a pointer used as a number, or the reverse.
- annotation, arguments, return: every argument and the result annotated; at most ten
  arguments, none by default, keyword or star; every path returns a value.
- unassigned: a local that some path reads before it is assigned; loops may run no round.
- global: a name that is neither local nor ``_NAME = const(...)`` of the module; functions may
  only be called. uint: anywhere. cast: a call outside ``int(...)``. bool: a truth value used as
  a number. construct: anything else that viper, `checked` or numba has no word for.
"""

from __future__ import annotations

import ast
import io
import operator
import sys
import tokenize
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
DEFAULT = ("shared/solenav_core", "firmware")

LIMIT = 2**30
ARGUMENTS_MAX = 10
POINTERS = {"ptr8": 255, "ptr16": 65535, "ptr32": None}
REASON = "# > 0: "

_FOLDED: dict[type, Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
# name op constant: where it holds, the least value that the name has.
_LEAST: dict[type, Callable[[int], int]] = {
    ast.Gt: lambda c: c + 1,
    ast.GtE: lambda c: c,
    ast.Eq: lambda c: c,
}
_OPPOSITE: dict[type, type] = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.NotEq: ast.Eq}
_MIRRORED: dict[type, type] = {
    ast.Lt: ast.Gt,
    ast.LtE: ast.GtE,
    ast.Gt: ast.Lt,
    ast.GtE: ast.LtE,
}


class Finding(NamedTuple):
    """One violation: the file, its line, the rule and what to write instead."""

    name: str
    line: int
    rule: str
    advice: str

    def __str__(self) -> str:
        return f"{self.name}:{self.line}: {self.rule}: {self.advice}"


@dataclass
class _Module:
    """What a kernel may see of its module."""

    constants: dict[str, int] = field(default_factory=dict)
    functions: set[str] = field(default_factory=set)
    comments: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _State:
    """What holds at one place of a kernel on every path to it."""

    assigned: frozenset[str]
    least: dict[str, int]  # locals with a known lower limit

    def with_local(self, name: str, least: int | None) -> _State:
        limits = {k: v for k, v in self.least.items() if k != name}
        if least is not None:
            limits[name] = least
        return _State(self.assigned | {name}, limits)


def _merged(states: list[_State | None]) -> _State | None:
    """What holds after paths that meet; those that ended are None."""
    alive = [state for state in states if state is not None]
    if not alive:
        return None
    limits = {
        name: min(state.least[name] for state in alive)
        for name in alive[0].least
        if all(name in state.least for state in alive)
    }
    return _State(frozenset.intersection(*[state.assigned for state in alive]), limits)


def evaluate(node: ast.AST, constants: dict[str, int]) -> int | None:
    """The value that the compiler folds an expression to; None where it isn't constant."""
    match node:
        case ast.Constant(value=bool()):
            return None
        case ast.Constant(value=int(number)):
            return number
        case ast.Name(id=name):
            return constants.get(name)
        case ast.UnaryOp(op=ast.USub() | ast.Invert(), operand=operand):
            inner = evaluate(operand, constants)
            if inner is None:
                return None
            return -inner if isinstance(node.op, ast.USub) else ~inner
        case ast.BinOp():
            left, right = evaluate(node.left, constants), evaluate(node.right, constants)
            fold = _FOLDED.get(type(node.op))
            if left is None or right is None or fold is None:
                return None
            if isinstance(node.op, ast.LShift) and right > 64:
                return None
            try:
                return fold(left, right)
            except (ValueError, ZeroDivisionError):
                return None
    return None


def _assigned_names(body: list[ast.stmt]) -> set[str]:
    return {
        node.id
        for statement in body
        for node in ast.walk(statement)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def _spelled_out(node: ast.AugAssign) -> ast.BinOp:
    """``t op= v`` as the expression ``t op v``."""
    target = ast.parse(ast.unparse(node.target), mode="eval").body
    for part in ast.walk(target):
        ast.copy_location(part, node)
    return ast.copy_location(ast.BinOp(target, node.op, node.value), node)


def _is_truth(node: ast.expr) -> bool:
    """True for an expression whose value is a bool."""
    match node:
        case ast.Compare() | ast.UnaryOp(op=ast.Not()) | ast.Constant(value=bool()):
            return True
        case ast.BoolOp():
            return any(map(_is_truth, node.values))
        case ast.IfExp():
            return _is_truth(node.body) or _is_truth(node.orelse)
    return False


class _Kernel:
    """One kernel, walked once along its paths."""

    def __init__(self, node: ast.FunctionDef, module: _Module, name: str) -> None:
        self.node = node
        self.module = module
        self.name = name
        self.findings: list[Finding] = []
        self.breaks: list[list[_State | None]] = []
        self.state = _State(frozenset(), {})
        self.pointers: dict[str, str] = {}
        # Every value that a local gets; None for one that nothing is known of.
        self.values: dict[str, list[ast.expr | None]] = {}

    def found(self, node: ast.AST, rule: str, advice: str) -> None:
        self.findings.append(Finding(self.name, getattr(node, "lineno", 0), rule, advice))

    def check(self) -> list[Finding]:
        self.signature()
        self.collect()
        body = self.node.body
        if ast.get_docstring(self.node) is not None:
            body = body[1:]
        names = frozenset(argument.arg for argument in self.node.args.args)
        if self.block(body, _State(names, {})) is not None:
            self.found(self.node.body[-1], "return", "end every path with `return <int>`")
        return self.findings

    # Before the paths: the signature, and which locals are pointers

    def signature(self) -> None:
        node, arguments = self.node, self.node.args
        other = [*arguments.posonlyargs, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
        if arguments.defaults or any(other):
            self.found(node, "arguments", "only plain positional arguments, without defaults")
        if len(arguments.args) > ARGUMENTS_MAX:
            self.found(node, "arguments", f"at most {ARGUMENTS_MAX}: pass an array")
        for argument in arguments.args:
            kind = self.annotation(argument, argument.annotation, {"int", *POINTERS})
            if kind in POINTERS:
                self.pointers[argument.arg] = kind
            self.values[argument.arg] = [None]
        self.annotation(node, node.returns, {"int"})

    def annotation(self, at: ast.AST, node: ast.expr | None, allowed: set[str]) -> str:
        kind = node.id if isinstance(node, ast.Name) else ""
        if kind == "uint":
            self.found(at, "uint", "int: comparisons and divisions of uint don't compile")
        elif kind not in allowed:
            what = f"argument {at.arg}" if isinstance(at, ast.arg) else "result"
            self.found(at, "annotation", f"annotate the {what}: {', '.join(sorted(allowed))}")
        return kind

    def collect(self) -> None:
        numbers = {name for name in self.values if name not in self.pointers}
        for node in ast.walk(self.node):
            match node:
                case ast.Assign(targets=[ast.Name(id=name)]):
                    self.values.setdefault(name, []).append(node.value)
                    kind = self.pointer(node.value)
                    if kind:
                        self.pointers.setdefault(name, kind)
                    else:
                        numbers.add(name)
                case ast.AugAssign(target=ast.Name(id=name)):
                    self.values.setdefault(name, []).append(_spelled_out(node))
                    numbers.add(name)
                case ast.For(target=ast.Name(id=name)):
                    self.values.setdefault(name, []).append(None)
                    numbers.add(name)
        for name in sorted(numbers & set(self.pointers)):
            self.found(self.node, "type", f"{name} is a pointer and a number: use two locals")

    def pointer(self, node: ast.expr) -> str:
        """The pointer type of an expression, "" for a number."""
        match node:
            case ast.Name(id=name):
                return self.pointers.get(name, "")
            case ast.Call(func=ast.Name(id=name)) if name in POINTERS:
                return name
        return ""

    # Along the paths: statements

    def block(self, body: list[ast.stmt], state: _State) -> _State | None:
        """The state after a block, None where no path comes out of it."""
        ended = False
        for statement in body:
            after = self.statement(statement, state)
            ended = ended or after is None
            state = after or state
        return None if ended else state

    def statement(self, node: ast.stmt, state: _State) -> _State | None:
        self.state = state
        match node:
            case ast.Assign(targets=[target]):
                self.value(node.value)
                return self.store(target, node.value, state)
            case ast.AugAssign():
                value = _spelled_out(node)
                self.number(value)
                return self.store(node.target, value, state)
            case ast.Expr():
                self.number(node.value)
                return state
            case ast.Return():
                if node.value is None:
                    self.found(node, "return", "return a number")
                else:
                    self.number(node.value)
                return None
            case ast.If():
                self.truth(node.test)
                then = self.block(node.body, self.where(node.test, True, state))
                return _merged([then, self.block(node.orelse, self.where(node.test, False, state))])
            case ast.While(orelse=[]):
                return self.while_loop(node, state)
            case ast.For(target=ast.Name(id=name), orelse=[]):
                return self.for_loop(node, name, state)
            case ast.Break():
                self.breaks[-1].append(state)
                return None
            case ast.Continue():
                return None
            case ast.Pass():
                return state
        self.found(node, "construct", f"kernels have no `{ast.unparse(node).splitlines()[0]}`")
        return state

    def while_loop(self, node: ast.While, state: _State) -> _State | None:
        start = self.at_any_round(node, state)
        self.state = start
        self.truth(node.test)
        self.breaks.append([])
        self.block(node.body, self.where(node.test, True, start))
        forever = isinstance(node.test, ast.Constant) and bool(node.test.value)
        done = None if forever else self.where(node.test, False, start)
        return _merged([done, *self.breaks.pop()])

    def for_loop(self, node: ast.For, name: str, state: _State) -> _State | None:
        match node.iter:
            case ast.Call(func=ast.Name(id="range"), args=arguments, keywords=[]):
                for argument in arguments:
                    self.number(argument)
            case _:
                self.found(node, "construct", "loop over range(...), or use while")
        start = self.at_any_round(node, state)
        self.breaks.append([])
        self.block(node.body, start.with_local(name, None))
        return _merged([start, *self.breaks.pop()])

    @staticmethod
    def at_any_round(node: ast.While | ast.For, state: _State) -> _State:
        """What holds at the start of every round: limits of what the body assigns don't."""
        changed = _assigned_names(node.body)
        limits = {name: v for name, v in state.least.items() if name not in changed}
        return _State(state.assigned, limits)

    def store(self, target: ast.expr, value: ast.expr, state: _State) -> _State:
        match target:
            case ast.Name(id=name):
                if name in self.module.constants:
                    self.found(target, "global", f"{name} is a constant: another name for a local")
                return state.with_local(name, self.least(value))
            case ast.Subscript():
                kind = self.element(target)
                mask = POINTERS.get(kind)
                if mask is not None and not self.fits(value, mask, set()):
                    self.found(target, "mask", f"store `({ast.unparse(value)}) & {mask}`")
            case _:
                self.found(target, "construct", "assign one name or one element at a time")
        return state

    # What is known of values

    def where(self, test: ast.expr, holds: bool, state: _State) -> _State:
        """The state once `test` is known to hold or not."""
        match test:
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self.where(operand, not holds, state)
            case ast.BoolOp(op=op, values=values) if isinstance(op, ast.And) == holds:
                for value in values:
                    state = self.where(value, holds, state)
                return state
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                kind: type = type(op)
                limit = evaluate(right, self.module.constants)
                if limit is None:
                    left, limit = right, evaluate(left, self.module.constants)
                    kind = _MIRRORED.get(kind, kind)
                if not holds:
                    # What has no entry says nothing about the least value.
                    kind = _OPPOSITE.get(kind, ast.Is)
                if isinstance(left, ast.Name) and limit is not None and kind in _LEAST:
                    least = _LEAST[kind](limit)
                    return state.with_local(left.id, max(least, state.least.get(left.id, least)))
        return state

    def least(self, node: ast.expr) -> int | None:
        """A lower limit of a number, None where none is known."""
        known = evaluate(node, self.module.constants)
        if known is not None:
            return known
        match node:
            case ast.Name(id=name):
                return self.state.least.get(name)
            case ast.BinOp(op=ast.RShift(), left=left, right=right):
                base, count = self.least(left), evaluate(right, self.module.constants)
                if base is not None and count is not None and 0 <= count <= 31:
                    return base >> count
        return None

    def fits(self, node: ast.expr, mask: int, asked: set[str]) -> bool:
        """True for a number within 0..mask.

        `asked` are the locals in question: they may depend on themselves, as each round of
        such a dependence keeps what the round before had.
        """
        known = evaluate(node, self.module.constants)
        if known is not None:
            return 0 <= known <= mask
        match node:
            case ast.BinOp(op=ast.BitAnd()):
                return self.fits(node.left, mask, asked) or self.fits(node.right, mask, asked)
            case ast.BinOp(op=ast.BitOr() | ast.BitXor()):
                return self.fits(node.left, mask, asked) and self.fits(node.right, mask, asked)
            case ast.BinOp(op=ast.RShift()):
                return self.fits(node.left, mask, asked)
            case ast.Subscript():
                limit = POINTERS.get(self.pointer(node.value))
                return limit is not None and limit <= mask
            case ast.IfExp():
                return self.fits(node.body, mask, asked) and self.fits(node.orelse, mask, asked)
            case ast.Name(id=name) if name in asked:
                return True
            case ast.Name(id=name):
                values = self.values.get(name, [None])
                return all(v is not None and self.fits(v, mask, asked | {name}) for v in values)
        return False

    # Along the paths: expressions

    def value(self, node: ast.expr) -> None:
        """An expression that may be a pointer."""
        if isinstance(node, ast.Name) and node.id in self.pointers:
            self.read(node)
        else:
            self.number(node)

    def truth(self, node: ast.expr) -> None:
        """An expression of which only the truth is asked."""
        match node:
            case ast.Constant(value=bool()):
                pass
            case ast.BoolOp():
                for part in node.values:
                    self.truth(part)
            case ast.UnaryOp(op=ast.Not()):
                self.truth(node.operand)
            case ast.Compare():
                if any(isinstance(op, ast.Is | ast.IsNot | ast.In | ast.NotIn) for op in node.ops):
                    self.found(node, "construct", "compare numbers by == or !=")
                    return
                for part in (node.left, *node.comparators):
                    self.number(part)
            case ast.IfExp():
                for part in (node.test, node.body, node.orelse):
                    self.truth(part)
            case _:
                self.number(node)

    def number(self, node: ast.expr) -> None:
        """An expression of which the value is used."""
        if evaluate(node, self.module.constants) is not None:
            self.literal(node)
            return
        if _is_truth(node):
            self.found(node, "bool", f"int({ast.unparse(node)})")
            self.truth(node)
            return
        match node:
            case ast.Name():
                self.read(node)
                if node.id in self.pointers:
                    self.found(node, "type", f"{node.id} is a pointer: use an index")
            case ast.BinOp():
                self.operation(node)
            case ast.UnaryOp(op=ast.USub() | ast.Invert() as op):
                instead = "0" if isinstance(op, ast.USub) else "-1"
                self.found(node, "negation", f"{instead} - {ast.unparse(node.operand)}")
                self.number(node.operand)
            case ast.BoolOp():
                for part in node.values:
                    self.number(part)
            case ast.IfExp():
                self.truth(node.test)
                self.number(node.body)
                self.number(node.orelse)
            case ast.Subscript():
                self.element(node)
            case ast.Call():
                self.call(node, cast=False)
            case _:
                self.found(node, "construct", f"kernels have no `{ast.unparse(node)}`")

    def literal(self, node: ast.expr) -> bool:
        """Report the innermost part of a constant that is too large; True where there is one."""
        parts = [part for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr)]
        reported = [self.literal(part) for part in parts]
        if any(reported):
            return True
        number = evaluate(node, self.module.constants)
        if number is None or abs(number) < LIMIT:
            return False
        self.found(node, "literal", f"{ast.unparse(node)} = {number}: stay within +-(2**30 - 1)")
        return True

    def operation(self, node: ast.BinOp) -> None:
        match node.op:
            case ast.Div() | ast.Pow() | ast.MatMult():
                self.found(node, "operator", f"`{ast.unparse(node)}`: //, * or a shift")
            case ast.LShift() | ast.RShift():
                count = evaluate(node.right, self.module.constants)
                if count is not None and not 0 <= count <= 31:
                    self.found(node, "shift", f"a count within 0..31, not {count}")
            case ast.FloorDiv() | ast.Mod():
                if not self.may_divide(node):
                    divisor = ast.unparse(node.right)
                    self.found(
                        node,
                        "division",
                        f"`if {divisor} < 1: return ...` before it, or say `{REASON}why`",
                    )
        self.number(node.left)
        self.number(node.right)

    def may_divide(self, node: ast.BinOp) -> bool:
        known = evaluate(node.right, self.module.constants)
        if known is not None:
            return known != 0
        least = self.least(node.right)
        if least is not None and least > 0:
            return True
        match node.right:
            case ast.BinOp(op=ast.BitOr(), left=left, right=right):
                if any(evaluate(part, self.module.constants) for part in (left, right)):
                    return True
        lines = range(node.lineno, (node.end_lineno or node.lineno) + 1)
        return any(
            len(self.module.comments.get(line, "").partition(REASON)[2]) > 0 for line in lines
        )

    def element(self, node: ast.Subscript) -> str:
        """One element of a buffer; the buffer's pointer type."""
        kind = self.pointer(node.value)
        if not kind:
            self.found(node, "type", f"{ast.unparse(node.value)} is no pointer")
        elif isinstance(node.value, ast.Name):
            self.read(node.value)
        if isinstance(node.slice, ast.Slice | ast.Tuple):
            self.found(node, "index", "one index: pass start and stop to a loop")
            return kind
        index = evaluate(node.slice, self.module.constants)
        if index is not None and index < 0:
            self.found(node, "index", f"{index} reads before the buffer")
        self.number(node.slice)
        return kind

    def call(self, node: ast.Call, cast: bool) -> None:
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            self.found(node, "arguments", "only plain positional arguments")
            return
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name == "int" and len(node.args) == 1:
            inner = node.args[0]
            if isinstance(inner, ast.Call):
                self.call(inner, cast=True)
            else:
                self.truth(inner)
            return
        if name == "uint":
            self.found(node, "uint", "int: comparisons and divisions of uint don't compile")
        elif name in self.module.functions:
            if not cast:
                self.found(node, "cast", f"int({ast.unparse(node)})")
        elif name not in POINTERS:
            self.found(node, "global", f"{ast.unparse(node.func)} is no kernel or cast")
        for argument in node.args:
            self.value(argument)

    def read(self, node: ast.Name) -> None:
        if node.id in self.values:
            if node.id not in self.state.assigned:
                self.found(node, "unassigned", f"give {node.id} a value on every path")
        elif node.id in self.module.functions:
            self.found(node, "global", f"{node.id} may only be called")
        else:
            self.found(node, "global", f"{node.id}: a private `_NAME = const(...)` of this module")


def _is_viper(node: ast.expr) -> bool:
    return (isinstance(node, ast.Attribute) and node.attr == "viper") or (
        isinstance(node, ast.Name) and node.id == "viper"
    )


def _module(tree: ast.Module, source: str) -> _Module:
    module = _Module()
    for node in tree.body:
        match node:
            case ast.Assign(
                targets=[ast.Name(id=name)],
                value=ast.Call(func=ast.Name(id="const"), args=[argument]),
            ) if name.startswith("_"):
                number = evaluate(argument, module.constants)
                if number is not None:
                    module.constants[name] = number
            case ast.FunctionDef():
                module.functions.add(node.name)
            case ast.ImportFrom():
                module.functions |= {alias.asname or alias.name for alias in node.names}
    # What compat brings is read by the compiler, not called.
    module.functions -= {"const", "micropython", "int", "range", *POINTERS}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            module.comments[token.start[0]] = token.string
    return module


def lint(source: str, name: str) -> list[Finding]:
    """The violations in a module's text, in the order of their lines; `name` for the messages."""
    tree = ast.parse(source)
    module = _module(tree, source)
    findings: list[Finding] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any(map(_is_viper, node.decorator_list)):
            findings += _Kernel(node, module, name).check()
    return sorted(findings, key=lambda finding: finding.line)


def main(arguments: list[str]) -> int:
    files = [Path(argument) for argument in arguments]
    if not files:
        files = [path for folder in DEFAULT for path in sorted((ROOT / folder).rglob("*.py"))]
    findings = []
    for path in files:
        shown = path.resolve()
        shown = shown.relative_to(ROOT) if shown.is_relative_to(ROOT) else path
        findings += lint(path.read_text(encoding="utf-8"), shown.as_posix())
    print(*findings, sep="\n", end="\n" if findings else "")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
