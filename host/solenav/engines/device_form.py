"""The device form of the core: the same modules with the small helpers expanded in place.

A call costs a microcontroller some 650 cycles, a multiply-shift a third of that, and an integer
past 2**30 that goes through a call becomes an object on the heap. So before the core goes to a
board, calls of the helpers in INLINE are replaced by their bodies: arguments become locals,
constant arguments are folded, returns become assignments. What is computed stays the same to
the bit, which the engines' comparison shows; kernels stay readable where people read them.

The helpers themselves stay for the self-test. `EXPANDED` of a module names those that nothing else
in it calls any more: the firmware then lets go of them, 17 kB of a Pico's heap.
"""

from __future__ import annotations

import ast
import copy
from dataclasses import dataclass
from pathlib import Path

from solenav.engines.source import MODULES, constants, core_path, is_viper
from solenav_core import messages, params

INLINE = {
    "qmath": ("mulshift", "mulsat", "clamp", "isqrt", "div"),
    "calibration": ("mounted",),
    "heading": ("strength", "error", "apart"),
    "detector": ("push", "unrest"),
    "features": ("sense", "describe", "relate"),
    "forest": ("elect",),
    "particles": (
        "row",
        "stir",
        "ratio",
        "scales",
        "widen",
        "scattered",
        "adapt",
        "estimate",
    ),
    "navigator": ("rest",),
}


@dataclass
class _Helper:
    """A kernel to expand: its parameters and its body, private constants put in."""

    name: str
    parameters: list[str]
    body: list[ast.stmt]


class _Names(ast.NodeTransformer):
    """Replaces names by expressions."""

    def __init__(self, values: dict[str, ast.expr]) -> None:
        self.values = values

    def visit_Name(self, node: ast.Name) -> ast.expr:
        found = self.values.get(node.id)
        if found is None:
            return node
        if isinstance(found, ast.Name):
            return ast.Name(found.id, node.ctx)
        return copy.deepcopy(found)


def _literals(values: dict[str, int]) -> dict[str, ast.expr]:
    return {name: ast.Constant(value) for name, value in values.items()}


def _helpers(folder: Path) -> dict[str, _Helper]:
    found = {}
    for module, inline in INLINE.items():
        tree = ast.parse((folder / f"{module}.py").read_text(encoding="utf-8"))
        names = _Names(_literals(constants(tree)))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name in inline:
                parameters = [argument.arg for argument in node.args.args]
                body = [names.visit(s) for s in _without_docstring(node.body)]
                found[node.name] = _Helper(node.name, parameters, body)
    return found


def _without_docstring(body: list[ast.stmt]) -> list[ast.stmt]:
    first = body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        return body[1:]
    return body


def _assigned(body: list[ast.stmt]) -> list[str]:
    """Names that a body assigns, once for each time."""
    return [
        node.id
        for statement in body
        for node in ast.walk(statement)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    ]


class _Fold(ast.NodeTransformer):
    """Computes operations and comparisons of constants."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.left, ast.Constant) and isinstance(node.right, ast.Constant):
            value = eval(compile(ast.Expression(ast.fix_missing_locations(node)), "", "eval"))
            if abs(value) < 2**30:  # a larger literal is an object on the board
                return _constant(value)
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        if all(isinstance(e, ast.Constant) for e in (node.left, *node.comparators)):
            expression = ast.Expression(ast.fix_missing_locations(node))
            return ast.Constant(eval(compile(expression, "", "eval")))
        return node


def _constant(value: int) -> ast.expr:
    if value < 0:
        return ast.UnaryOp(ast.USub(), ast.Constant(-value))
    return ast.Constant(value)


def _folded(body: list[ast.stmt]) -> list[ast.stmt]:
    """The body with constants carried forward and branches on them decided."""
    once = {name for name in _assigned(body) if _assigned(body).count(name) == 1}
    known: dict[str, ast.expr] = {}
    out: list[ast.stmt] = []
    for statement in body:
        statement = _Fold().visit(_Names(known).visit(statement))
        match statement:
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Constant()) if name in once:
                known[name] = statement.value
                continue
            case ast.If(test=ast.Constant(value=True)):
                out += _folded(statement.body)
                continue
            case ast.If(test=ast.Constant(value=False)):
                out += _folded(statement.orelse)
                continue
        out.append(statement)
    return out


def _returns_into(body: list[ast.stmt], result: str) -> list[ast.stmt]:
    """The body with each ``return x`` as ``result = x``, the rest of the body as the else."""
    out: list[ast.stmt] = []
    for i, statement in enumerate(body):
        if isinstance(statement, ast.Return):
            assert statement.value is not None
            return [*out, _assign(result, statement.value)]
        if isinstance(statement, ast.If) and any(
            isinstance(node, ast.Return) for node in ast.walk(statement)
        ):
            rest = body[i + 1 :]
            then = _returns_into([*statement.body, *rest], result)
            other = _returns_into([*statement.orelse, *rest], result)
            return [*out, ast.If(statement.test, then, other)]
        if any(isinstance(node, ast.Return) for node in ast.walk(statement)):
            raise SyntaxError(f"a helper returns from inside a loop: {ast.unparse(statement)}")
        out.append(statement)
    return out


def _assign(name: str, value: ast.expr) -> ast.stmt:
    return ast.Assign([ast.Name(name, ast.Store())], value)


class _Expand:
    """Expands helper calls in one kernel."""

    def __init__(self, helpers: dict[str, _Helper]) -> None:
        self.helpers = helpers
        self.results = 0
        self.before: list[ast.stmt] = []

    def block(self, body: list[ast.stmt]) -> list[ast.stmt]:
        out: list[ast.stmt] = []
        for statement in body:
            out += self.statement(statement)
        return out

    def statement(self, statement: ast.stmt) -> list[ast.stmt]:
        # Results are numbered anew for each statement: none is used after it.
        outer, self.before, self.results = (self.before, self.results), [], 0
        match statement:
            case ast.If():
                statement.test = self.expression(statement.test)
                before = self.before
                statement.body = self.block(statement.body)
                statement.orelse = self.block(statement.orelse)
            case ast.While():
                if any(self._helper(node) for node in ast.walk(statement.test)):
                    raise SyntaxError(f"a loop's condition calls {ast.unparse(statement.test)}")
                before = []
                statement.body = self.block(statement.body)
            case ast.For():
                statement.iter = self.expression(statement.iter)
                before = self.before
                statement.body = self.block(statement.body)
            case ast.Assign() | ast.Return() | ast.Expr():
                assert statement.value is not None
                statement.value = self.expression(statement.value)
                if isinstance(statement, ast.Assign):
                    statement.targets = [self.expression(t) for t in statement.targets]
                before = self.before
            case _:
                before = []
        self.before, self.results = outer
        return [*before, statement]

    def _helper(self, node: ast.AST) -> _Helper | None:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return self.helpers.get(node.func.id)
        return None

    def expression(self, node: ast.expr) -> ast.expr:
        """The expression with its helper calls replaced by results computed in `before`."""
        for field, value in ast.iter_fields(node):
            if isinstance(value, ast.expr):
                setattr(node, field, self.expression(value))
            elif isinstance(value, list):
                setattr(
                    node,
                    field,
                    [self.expression(v) if isinstance(v, ast.expr) else v for v in value],
                )
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            helper = self._helper(node)
            if helper is not None:
                return self.expanded(helper, node.args)
            # int(name): the cast of a call that is gone.
            if node.func.id == "int" and isinstance(node.args[0], ast.Name):
                return node.args[0]
        return node

    def expanded(self, helper: _Helper, arguments: list[ast.expr]) -> ast.expr:
        written = set(_assigned(helper.body))
        values: dict[str, ast.expr] = {}
        for parameter, argument in zip(helper.parameters, arguments, strict=True):
            simple = isinstance(argument, ast.Name | ast.Constant)
            if simple and parameter not in written:
                values[parameter] = argument
                continue
            own = f"{helper.name}_{parameter}"
            self.before.append(_assign(own, argument))
            values[parameter] = ast.Name(own, ast.Load())
        for name in written:
            values.setdefault(name, ast.Name(f"{helper.name}_{name}", ast.Load()))
        body = [_Names(values).visit(copy.deepcopy(s)) for s in helper.body]
        result = f"result{self.results}"
        self.results += 1
        # A helper may call another one.
        inner = _Expand({k: v for k, v in self.helpers.items() if k != helper.name})
        inner.results = self.results
        self.before += inner.block(_returns_into(_folded(body), result))
        return ast.Name(result, ast.Load())


def _expanded_module(text: str, helpers: dict[str, _Helper]) -> str:
    tree = ast.parse(text)
    literals = _literals(constants(tree))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and any(map(is_viper, node.decorator_list)):
            body = [_Names(literals).visit(s) for s in _without_docstring(node.body)]
            node.body = _Expand(helpers).block(body)
    spare = _spare(tree)
    if spare:
        tree.body += ast.parse(f"EXPANDED = {spare!r}").body
    return ast.unparse(ast.fix_missing_locations(tree)) + "\n"


def _spare(tree: ast.Module) -> tuple[str, ...]:
    """The helpers that the module has, its own or imported, and calls in no other function."""
    inlined = {name for names in INLINE.values() for name in names}
    had: set[str] = set()
    used: set[str] = set()
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            had |= {alias.name for alias in node.names} & inlined
        elif isinstance(node, ast.FunctionDef) and node.name in inlined:
            had.add(node.name)
        else:
            used |= {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}
    return tuple(sorted(had - used))


def kernel_modules() -> dict[str, str]:
    """The modules that hold kernels, by module name: what an emulated CPU needs."""
    files = modules()
    return {name: files[f"{name}.py"] for name in MODULES}


def modules(core: Path | None = None) -> dict[str, str]:
    """Every file of the core in folder `core` by its path inside the package, in device form."""
    folder = core or core_path()
    helpers = _helpers(folder)
    texts = {
        path.relative_to(folder).as_posix(): _expanded_module(
            path.read_text(encoding="utf-8"), helpers
        )
        for path in sorted(folder.rglob("*.py"))
    }
    return {name: _without_notes(name, text) for name, text in texts.items()}


def _without_notes(name: str, text: str) -> str:
    """A module without what only people read; its lists' results in place of the lists."""
    if name not in ("layout.py", "params.py", "messages.py"):
        return text
    tree = ast.parse(text)
    results: dict[str, object] = {}
    if name == "params.py":
        results = {"PARAM_FIELDS": None, "NAMES": params.NAMES}
    elif name == "messages.py":
        results = {"MESSAGES": None, "form": None, "schema_hash": None}
        results |= {key: getattr(messages, key) for key in ("FORMATS", "SIZES", "SCHEMA")}
    body: list[ast.stmt] = []
    for node in tree.body:
        named = getattr(node, "name", None)
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            named = node.targets[0].id
            if name == "layout.py" and named.endswith("_FIELDS"):
                _keep_sizes(node.value)
            elif results.get(named) is not None:
                node.value = ast.parse(repr(results[named]), mode="eval").body
        if named not in results or results[named] is not None:
            body.append(node)
    tree.body = body
    return ast.unparse(tree) + "\n"


def _keep_sizes(fields: ast.expr) -> None:
    """Of the fields of a layout (name, words, stage, format) keep name and words."""
    assert isinstance(fields, ast.Tuple)
    for field in fields.elts:
        assert isinstance(field, ast.Tuple)
        field.elts[2:] = [ast.Constant(""), ast.Constant("")]
