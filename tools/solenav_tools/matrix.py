"""The matrix: every engine over the same samples, its digest compared on every tick.

The reference is `pure`, the core as CPython runs it. An engine that can't be had here is
skipped and says why.
"""

from __future__ import annotations

import dataclasses
import tempfile
from array import array
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from solenav.engines import Engine, create, device_form
from solenav.engines.source import MODULES
from solenav.errors import SolenavError
from solenav_core import navigator
from solenav_core.layout import STATE_FIELDS, locate
from solenav_tools import micropython32, micropython_engine
from solenav_tools.micropython import find_micropython

REFERENCE = "pure"
# MicroPython engines: what `micropython_engine.stage` makes for them.
_MODES = {
    "micropython": "bytecode",
    "micropython32-viper": "viper",
    "micropython32-mpy": "armv6m",
}
ALL = (REFERENCE, "checked", "fast", *_MODES, "thumb")
_STEP = 100  # ticks between two calls of `progress`

Counts = NDArray[np.int16]
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Run:
    """Samples (n, 6), and the state to begin with if it is not a fresh one."""

    counts: Counts
    start: array[int] | None = None
    name: str = ""


@dataclass
class Difference:
    """Where an engine first leaves the reference: the first word of the state that differs.

    `tick` is 1 after the run's first sample; `also` names the other words that differ.
    """

    run: str
    tick: int
    stage: str
    field: str
    value: int
    reference: int
    also: list[str] = dataclasses.field(default_factory=list)


@dataclass
class Outcome:
    """What an engine made of the runs: `ticks` whose digest is the reference's.

    `skipped` says why there is no such engine here, `failed` why it gave up on the way.
    """

    engine: str
    ticks: int = 0
    skipped: str = ""
    failed: str = ""
    difference: Difference | None = None

    @property
    def equal(self) -> bool:
        """True where something was compared, and all of it is equal."""
        return bool(self.ticks) and not (self.skipped or self.failed or self.difference)

    @property
    def wrong(self) -> bool:
        return bool(self.failed or self.difference)

    def as_dict(self) -> dict[str, Any]:
        return {"equal": self.equal, **dataclasses.asdict(self)}

    def __str__(self) -> str:
        if self.skipped:
            return f"skipped: {self.skipped}"
        if self.failed:
            return f"FAILED: {self.failed}"
        d = self.difference
        if d is None:
            return f"equal on {self.ticks} ticks"
        where = f"{d.run}, " if d.run else ""
        return (
            f"DIFFERENT at {where}tick {d.tick}, stage {d.stage}, field {d.field}: "
            f"{self.engine} {d.value}, {REFERENCE} {d.reference}"
        )


class _Failed(Exception):
    """The engine gave up: where and why."""


class _Backend(Protocol):
    """An engine as the matrix uses it. SolenavError from the constructor: can't be had."""

    def digests(
        self, runs: Sequence[Run], params: array[int], progress: Progress
    ) -> list[list[int]]: ...

    def state_after(self, run: Run, ticks: int, params: array[int]) -> array[int]: ...


class _Host:
    """An engine in this process."""

    def __init__(self, make: Callable[[array[int]], Engine]) -> None:
        self.make = make
        make(array("i", bytes(4 * 64)))  # what is missing shows here

    def digests(
        self, runs: Sequence[Run], params: array[int], progress: Progress
    ) -> list[list[int]]:
        engine = self.make(params)
        done = 0
        out = []
        for run in runs:
            engine.restore(_start(run).tobytes())
            found = []
            for row in range(len(run.counts)):
                self._advance(engine, run, row, row + 1)
                found.append(engine.digest())
                done += 1
                if done % _STEP == 0:
                    progress(done)
            out.append(found)
        return out

    def state_after(self, run: Run, ticks: int, params: array[int]) -> array[int]:
        engine = self.make(params)
        engine.restore(_start(run).tobytes())
        self._advance(engine, run, 0, ticks)
        return engine.state

    @staticmethod
    def _advance(engine: Engine, run: Run, start: int, stop: int) -> None:
        try:
            engine.advance(run.counts, start, stop)
        # A word that can't hold a value (ArithmeticError), and faults of the thumb engine.
        except (ArithmeticError, IndexError, RuntimeError) as error:
            raise _Failed(f"{run.name or 'run'}, tick {stop}: {error}") from None


class _MicroPython:
    """A MicroPython in a process of its own."""

    def __init__(self, mode: str, folder: Path, core: Path | None) -> None:
        self.interpreter = (
            [str(find_micropython())] if mode == "bytecode" else micropython32.command()
        )
        self.folder = folder
        micropython_engine.stage(folder, mode, core)

    def digests(
        self, runs: Sequence[Run], params: array[int], progress: Progress
    ) -> list[list[int]]:
        pairs = [(run.counts, run.start) for run in runs]
        try:
            return micropython_engine.digests_of_runs(self.interpreter, self.folder, pairs, params)
        except SolenavError as error:
            raise _Failed(error.message) from None

    def state_after(self, run: Run, ticks: int, params: array[int]) -> array[int]:
        return micropython_engine.state_after(
            self.interpreter, self.folder, run.counts[:ticks], params, run.start
        )


def _start(run: Run) -> array[int]:
    return navigator.new_state() if run.start is None else run.start


def _thumb(core: Path | None) -> _Host:
    try:
        from solenav.engines.thumb import ThumbEngine
    except ImportError as error:
        raise SolenavError(f"no thumb engine: {error}", "pip install 'solenav[thumb]'") from None
    files = device_form.modules(core)
    sources = {module: files[f"{module}.py"] for module in MODULES}
    return _Host(lambda params: ThumbEngine(params, sources))


class Matrix:
    """Engines set up once, to compare over any number of runs. A context: it keeps files.

    `core` is the folder of another core for the engines that take a copy of it (MicroPython,
    thumb); the reference stays the installed one. SolenavError for an unknown engine.
    """

    def __init__(self, engines: Sequence[str] = ALL, core: Path | None = None) -> None:
        for name in engines:
            if name not in ALL:
                raise SolenavError(
                    f"there is no engine {name!r} in the matrix", f"choose among {', '.join(ALL)}"
                )
        self.engines = tuple(dict.fromkeys(engines))
        self.skipped: dict[str, str] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="solenav-matrix-")
        self._reference: _Backend = _Host(lambda params: create(REFERENCE, params))
        self._backends: dict[str, _Backend] = {}
        for name in self.engines:
            try:
                self._backends[name] = self._backend(name, core)
            except SolenavError as error:
                self.skipped[name] = f"{error.message}; {error.remedy}".removesuffix("; ")

    def _backend(self, name: str, core: Path | None) -> _Backend:
        if name == REFERENCE:
            return self._reference
        if name in _MODES:
            return _MicroPython(_MODES[name], Path(self._folder.name) / name, core)
        if name == "thumb":
            return _thumb(core)
        return _Host(lambda params: create(name, params))

    def __enter__(self) -> Matrix:
        return self

    def __exit__(self, *error: object) -> None:
        self._folder.cleanup()

    def compare(
        self,
        runs: Sequence[Run],
        params: array[int],
        progress: Progress = lambda done: None,
    ) -> list[Outcome]:
        """Run every engine over all runs; an outcome for each, in the order asked for.

        `progress` gets the ticks done, of all engines together and the reference if it was not
        asked for. SolenavError where the reference itself fails.
        """
        ticks = sum(len(run.counts) for run in runs)
        outcomes = {name: Outcome(name, skipped=why) for name, why in self.skipped.items()}
        others = [name for name in self._backends if name != REFERENCE]
        away = [name for name in others if name in _MODES]
        # MicroPython's processes leave this one's core free for the other engines.
        with ThreadPoolExecutor(1) as pool:
            waiting = {
                name: pool.submit(self._backends[name].digests, runs, params, progress)
                for name in away
            }
            try:
                expected = self._reference.digests(runs, params, progress)
            except _Failed as error:
                raise SolenavError(f"the reference fails: {error}") from None
            done = ticks
            for name in [*(n for n in others if n not in away), *away]:
                try:
                    if name in waiting:
                        found = waiting[name].result()
                    else:
                        found = self._backends[name].digests(runs, params, _after(done, progress))
                    outcomes[name] = self._judge(name, runs, params, found, expected)
                except _Failed as error:
                    outcomes[name] = Outcome(name, failed=str(error))
                done += ticks
                progress(done)
        if REFERENCE in self._backends:
            outcomes[REFERENCE] = Outcome(REFERENCE, ticks)
        return [outcomes[name] for name in self.engines]

    def _judge(
        self,
        name: str,
        runs: Sequence[Run],
        params: array[int],
        found: list[list[int]],
        expected: list[list[int]],
    ) -> Outcome:
        outcome = Outcome(name)
        for run, ours, right in zip(runs, found, expected, strict=True):
            wrong = next(
                (row for row, (a, b) in enumerate(zip(ours, right, strict=True)) if a != b), None
            )
            if wrong is None:
                outcome.ticks += len(right)
                continue
            outcome.ticks += wrong
            states = [
                backend.state_after(run, wrong + 1, params)
                for backend in (self._backends[name], self._reference)
            ]
            outcome.difference = state_difference(run.name, wrong + 1, *states)
            if outcome.difference is None:
                # Equal the second time, so that it is the engine that is not to be relied on.
                d = Difference(run.name, wrong + 1, "state", "digest", ours[wrong], right[wrong])
                outcome.difference = d
            break
        return outcome


def _after(offset: int, progress: Progress) -> Progress:
    return lambda done: progress(offset + done)


def state_difference(
    name: str, tick: int, state: Sequence[int], reference: Sequence[int]
) -> Difference | None:
    """The words in which two states differ; None where they don't."""
    wrong = [i for i, (a, b) in enumerate(zip(state, reference, strict=True)) if a != b]
    if not wrong:
        return None
    names = [locate(STATE_FIELDS, i) for i in wrong]
    first = wrong[0]
    also = [name for _stage, name in names[1:]]
    stage, label = names[0]
    return Difference(name, tick, stage, label, state[first], reference[first], also)


def run(
    counts: Counts,
    params: array[int],
    engines: Sequence[str] = ALL,
    start: array[int] | None = None,
    progress: Progress = lambda done: None,
    core: Path | None = None,
) -> list[Outcome]:
    """Run `engines` over one run's samples (n, 6) from the state `start`; an outcome for each.

    `core` as for `Matrix`, which is for several runs.
    """
    with Matrix(engines, core) as matrix:
        return matrix.compare([Run(counts, start)], params, progress)
