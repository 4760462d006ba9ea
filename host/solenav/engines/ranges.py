"""How far every intermediate of the core goes, and how far that is from the end of its word.

The kernels run as in the `checked` engine, which raises at the first overflow; besides, each
operation notes the largest magnitude that it gave. Arithmetic inside an index is left out: the
arrays' sizes bound it, and the checks refuse what leaves them.
"""

from __future__ import annotations

import ast
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from solenav.engines import checked, source
from solenav_core import navigator


@dataclass(frozen=True)
class Site:
    """One operation in the source: its kernel, line and text."""

    kernel: str
    line: int
    text: str


@dataclass(frozen=True)
class Reached:
    """The largest magnitude that an operation gave, and the run that did it.

    None and "" for an operation that no run came to.
    """

    site: Site
    magnitude: int | None = None
    run: str = ""

    @property
    def margin(self) -> float:
        """Bits from the magnitude to 2**31, rounded down to tenths; 31 where there is none."""
        if not self.magnitude:
            return 31.0
        return (310 - (self.magnitude**10 - 1).bit_length()) / 10


class _Instrument(checked._Instrument):
    """Lets operations outside indexes go through functions that take notes as well."""

    def __init__(self, kernel: source.Kernel, text: str) -> None:
        super().__init__(kernel.module, kernel.definition.name)
        self.text = text
        self.sites: dict[str, Site] = {}
        self.indexes = {
            id(part)
            for node in ast.walk(kernel.definition)
            if isinstance(node, ast.Subscript)
            for part in ast.walk(node.slice)
        }

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        call = super().visit_BinOp(node)
        if id(node) not in self.indexes:
            assert isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
            place = call.args[-1]
            assert isinstance(place, ast.Constant) and isinstance(place.value, str)
            written = ast.get_source_segment(self.text, node) or ast.unparse(node)
            self.sites[place.value] = Site(self.where, node.lineno, " ".join(written.split()))
            call.func.id = f"_noted{call.func.id}"
        return call


class Recorder:
    """The kernels, by name in `kernels`, and what their operations gave so far."""

    def __init__(self) -> None:
        self._sites: dict[str, Site] = {}
        self._largest: dict[str, int] = {}
        self._reached: dict[str, Reached] = {}
        self.kernels = self._load()

    def _load(self) -> dict[str, Callable[..., int]]:
        namespace: dict[str, Any] = dict(checked.load())
        for name, operation in list(namespace.items()):
            if name.startswith("_op_"):
                namespace[f"_noted{name}"] = self._noted(operation)
        body: list[ast.stmt] = []
        for kernel in source.kernels():
            path = source.core_path() / f"{kernel.module}.py"
            instrument = _Instrument(kernel, path.read_text(encoding="utf-8"))
            body.append(instrument.visit(kernel.definition))
            self._sites |= instrument.sites
        self._largest |= dict.fromkeys(self._sites, -1)
        tree = ast.fix_missing_locations(ast.Module(body, []))
        exec(compile(tree, "<ranges of solenav_core>", "exec"), namespace)
        return namespace

    def _noted(self, operation: Callable[[int, int, str], int]) -> Callable[[int, int, str], int]:
        largest = self._largest

        def noted(a: int, b: int, at: str) -> int:
            result = operation(a, b, at)
            magnitude = result if result >= 0 else -result
            if magnitude > largest[at]:
                largest[at] = magnitude
            return result

        return noted

    def credit(self, run: str) -> None:
        """Attribute to `run` what the operations gave since the last call."""
        for at, magnitude in self._largest.items():
            before = self._reached.get(at)
            if magnitude >= 0 and (before is None or magnitude > (before.magnitude or 0)):
                self._reached[at] = Reached(self._sites[at], magnitude, run)
            self._largest[at] = -1

    def run(
        self,
        name: str,
        counts: NDArray[Any],
        params: array[int],
        prepare: Callable[[array[int]], None] | None = None,
    ) -> None:
        """Run samples (n, 6) through the navigator, from a state that `prepare` has set up.

        RangeError where a word would have overflowed.
        """
        state = navigator.new_state()
        work, sample, tables = navigator.new_work(), navigator.new_sample(), navigator.new_tables()
        if prepare is not None:
            prepare(state)
        tick = self.kernels["tick"]
        for row in counts.tolist():
            for i, value in enumerate(row):
                sample[i] = value
            tick(state, params, work, tables, sample)
        self.credit(name)

    def reached(self) -> dict[str, list[Reached]]:
        """By kernel, callees first: all of its operations in the order of the source."""
        out: dict[str, list[Reached]] = {}
        for at, site in self._sites.items():
            out.setdefault(site.kernel, []).append(self._reached.get(at, Reached(site)))
        for found in out.values():
            found.sort(key=lambda reached: reached.site.line)
        return out
