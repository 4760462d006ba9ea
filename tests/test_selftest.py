"""The power-up self-test passes on a sound machine and finds a broken compiler."""

from __future__ import annotations

import ast
import copy
import signal
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from solenav import link
from solenav.engines import checked
from solenav.engines.source import Kernel, kernels
from solenav_core import (
    align,
    calibration,
    covariance,
    detector,
    features,
    forest,
    heading,
    messages,
    navigator,
    particles,
    qmath,
    selftest,
    steps,
    strapdown,
)
from solenav_core.tables.selftest import EXPECTED
from solenav_tools.board import Samples, SimulatedBoard
from solenav_tools.ports import open_port, read_some
from solenav_tools.recorder import Asker

MODULES: tuple[ModuleType, ...] = (
    align,
    calibration,
    covariance,
    detector,
    features,
    forest,
    heading,
    navigator,
    particles,
    qmath,
    steps,
    strapdown,
)
PROGRAM = kernels()


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A function that puts other kernels in place of the core's."""

    def plant(namespace: dict[str, Any]) -> None:
        for module in MODULES:
            for kernel in PROGRAM:
                name = kernel.definition.name
                if hasattr(module, name):
                    monkeypatch.setattr(module, name, namespace[name])

    yield plant


def built(program: list[Kernel]) -> dict[str, Any]:
    tree = ast.Module([kernel.definition for kernel in program], [])
    namespace: dict[str, Any] = {"ptr32": None}
    exec(compile(ast.fix_missing_locations(tree), "planted", "exec"), namespace)
    return namespace


class _Hangs(Exception):
    """A broken loop counter: on the board the watchdog would end it."""


def fails() -> bool:
    """Whether the self-test fails, hanging included."""

    def stop(_signal: int, _frame: Any) -> None:
        raise _Hangs

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, 1.5)
    try:
        return selftest.first_failure(EXPECTED) != 0
    except _Hangs:
        return True
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_it_passes_here() -> None:
    assert selftest.first_failure(EXPECTED) == 0


def test_its_vectors_overflow_nothing(planted: Any) -> None:
    planted(checked.load())
    assert selftest.measure() == list(EXPECTED)


class _Overwrite(ast.NodeTransformer):
    """The negation bug of viper's emitter up to 1.28: ``-a`` leaves -a in a.

    The core writes ``0 - a`` to keep clear of it; this is what would happen without.
    """

    def visit_Assign(self, node: ast.Assign) -> list[ast.stmt]:
        return [node, *_spoil(node.value, {ast.unparse(t) for t in node.targets})]

    def visit_If(self, node: ast.If) -> ast.If:
        self.generic_visit(node)
        node.body = [*_spoil(node.test), *node.body]
        node.orelse = [*_spoil(node.test), *node.orelse]
        return node


def _spoil(expression: ast.expr, but: Iterable[str] = ()) -> list[ast.stmt]:
    """What the bug does to the operands of the negations in an expression."""
    names = {
        node.right.id
        for node in ast.walk(expression)
        if isinstance(node, ast.BinOp)
        and ast.unparse(node.left) == "0"
        and isinstance(node.op, ast.Sub)
        and isinstance(node.right, ast.Name)
    }
    return [
        statement
        for name in sorted(names - set(but))
        for statement in ast.parse(f"{name} = 0 - {name}").body
    ]


def test_it_finds_the_negation_bug(planted: Any) -> None:
    """Kernels whose operand is read again after ``0 - x`` fail with the buggy emitter's ``-x``."""
    found = set()
    for i, kernel in enumerate(PROGRAM):
        program = list(PROGRAM)
        spoilt = _Overwrite().visit(copy.deepcopy(kernel.definition))
        program[i] = replace(kernel, definition=spoilt)
        planted(built(program))
        if fails():
            found.add(kernel.definition.name)
    assert found >= {"clamp", "slower"}


_SWAP: dict[type[ast.AST], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.FloorDiv: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
}


def test_a_wrong_operation_anywhere_is_found(planted: Any) -> None:
    """Every sixth operation of all kernels in turn replaced by another one."""
    found = missed = at = 0
    for i, kernel in enumerate(PROGRAM):
        size = sum(isinstance(node, ast.BinOp) for node in ast.walk(kernel.definition))
        for site in range(size):
            at += 1
            definition = copy.deepcopy(kernel.definition)
            nodes = [n for n in ast.walk(definition) if isinstance(n, ast.BinOp)]
            # A spoilt loop counter only hangs.
            if at % 6 or ast.unparse(nodes[site]) == "i + 1":
                continue
            nodes[site].op = _SWAP[type(nodes[site].op)]()
            program = list(PROGRAM)
            program[i] = replace(kernel, definition=definition)
            planted(built(program))
            if fails():
                found += 1
            else:
                missed += 1
    assert found > 90
    assert missed <= 0.05 * found


class _BrokenBoard(SimulatedBoard):
    """A board whose compiler has the negation bug in one place."""

    def _fill(self, folder: Path) -> None:
        super()._fill(folder)
        path = folder / "solenav_core" / "qmath.py"
        sound = path.read_text(encoding="utf-8")
        line = "        return 0 - limit\n"
        assert line in sound
        path.write_text(sound.replace(line, "        limit = 0 - limit\n" + line))


def test_a_board_that_fails_says_so_and_does_not_navigate() -> None:
    counts = np.tile(np.array([0, 0, 2048, 0, 0, 0], np.int16), (600, 1))
    feed = Samples(np.arange(600) * 5000, counts, np.zeros(600, np.int16))
    frames: list[link.Frame] = []
    with _BrokenBoard(feed) as board, open_port(board.port) as port:
        Asker(port).ask(messages.ASK_START)
        end = time.monotonic() + 4
        reader = link.FrameReader()
        while time.monotonic() < end:
            frames += [f for f in reader.feed(read_some(port)) if isinstance(f, link.Frame)]
    said = {link.NAMES[f.kind]: link.unpack(f) for f in frames}
    failed = said["HELLO"]["self_test"]
    assert selftest.TESTS[failed - 1][0] == "clamp"
    assert b"self-test" in said["LOG"]["text"]
    assert said["ACK"]["result"] == messages.REFUSED
    assert said["STATUS"]["mode"] == messages.FAULT
    assert "SAMPLE" not in said and "POSE" not in said
