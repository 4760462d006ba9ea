"""What the firmware costs a Pico: measured on the emulated board, beside the Thumb engine."""

from __future__ import annotations

import tempfile
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import capture, importing
from solenav.capture import Capture
from solenav.engines.device_form import kernel_modules
from solenav.engines.thumb import ThumbEngine
from solenav.engines.thumb.compiler import compiled
from solenav.errors import SolenavError
from solenav.link import Damage, FrameReader
from solenav.verification import verify
from solenav_core import layout, messages
from solenav_tools.emulator import image, run
from solenav_tools.emulator.pico import EmulatedPico
from solenav_tools.emulator.profile import EACH, Profile, Tick
from solenav_tools.staging import board_tree, firmware_path

THUMB_TICKS = 1500  # it makes some twenty a second
_STANCE = layout.offsets(layout.STATE_FIELDS)["STANCE"]
_HEAP_S = 4.5  # of a walk, to look at the heap: two whole seconds after the static start

# Around STATUS, of which there is one a second and before which the firmware collects garbage.
_WATCH = """
    from time import ticks_diff, ticks_us

    tell = application.status
    last = [0, 0]

    def told():
        free, began = gc.mem_free(), ticks_us()
        gc.collect()
        spent, after = ticks_diff(ticks_us(), began), gc.mem_free()
        ticks = application.sampler.samples
        print("heap", last[0] - free, ticks - last[1], spent, after)
        last[:] = after, ticks
        tell()

    application.status = told
"""
_BEFORE = "    try:\n        application.run()"


def on_thumb(counts: NDArray[np.int16], params: array[int]) -> dict[str, dict[str, Any]]:
    """Cycles of each kind of tick over samples (n, 10), on the Thumb engine."""
    engine = ThumbEngine(params, sources=kernel_modules())
    found: dict[str, list[int]] = {}
    stages: dict[str, Counter[str]] = {}
    for row in range(len(counts)):
        before = engine.navigating
        engine.program.clear()
        engine.advance(counts, row, row + 1)
        cost = engine.cycles()
        kind = _kind(before, bool(engine.state[_STANCE]))
        found.setdefault(kind, []).append(cost.total)
        of_kind = stages.setdefault(kind, Counter())
        for kernel in cost.kernels:
            of_kind[kernel.name.split(".")[0]] += kernel.cycles
        of_kind["runtime's calls"] += cost.overhead
    return {kind: _figures(cycles, stages[kind]) for kind, cycles in found.items()}


def on_pico(
    uf2: Path,
    seconds: float,
    rate_hz: float,
    progress: Callable[[int], None] = lambda ms: None,
) -> dict[str, Any]:
    """A walk of so many seconds: the core's cycles, latency, what was lost.

    "awake" is the share of time in which the processor didn't sleep, polling included.

    The samples and parameters for the Thumb engine are in "counts" and "params". SolenavError
    where the firmware crashes, where it never navigates, or a tick isn't the host's.
    """
    with tempfile.TemporaryDirectory(prefix="solenav-bench-") as name:
        source, made_at = _walk(Path(name), seconds, rate_hz), Path(name) / "made.solcap"
        profiles: list[Profile] = []
        starts: set[int] = set()

        def watch(pico: EmulatedPico) -> None:
            if not profiles:
                profiles.append(Profile(pico))
            playback = pico.wiring.playback
            if playback and playback.start > 0:
                starts.add(playback.start)
                if not profiles[0].started and not profiles[0].start():
                    raise SolenavError(
                        "the core's machine code isn't in the board's memory", "report it"
                    )

        run.record(uf2, source, made_at, progress=progress, watch=watch)
        made = capture.load(made_at)
        if not len(made.poses):
            raise SolenavError("the board never navigated", "give it more seconds", 1)
        report = verify(made)
        rows = _rows(source.sample_counts, made.sample_counts)
        ready = min(starts) / 1e6 + run.feed_of(source).time_us[rows] / 1e6
        profile = profiles[0]
        status = made.statuses.rows[-1] if len(made.statuses) else None
        return {
            "rate_hz": rate_hz,
            "seconds": seconds,
            "samples": len(source.samples),
            "lost": len(source.samples) - len(made.samples),
            "proven": report.covered_ticks,
            "verified": bool(report.verified),
            "awake": round(1 - profile.idle / max(1, profile.looks), 4),
            "latency_ms": _latency(made, made_at, ready),
            "worst_tick_us": int(status["worst"]) if status is not None else None,
            "heap_free": int(status["heap"]) if status is not None else None,
            "ticks": _by_kind(profile.ticks, made),
            "counts": made.sample_counts,
            "params": made.params[0][1],
        }


def heap(uf2: Path, progress: Callable[[int], None] = lambda ms: None) -> dict[str, float]:
    """The heap in a walk at 200 Hz: bytes free, allocated per tick, and a collection's pause."""
    with tempfile.TemporaryDirectory(prefix="solenav-bench-") as name:
        source = _walk(Path(name), _HEAP_S, 200.0)
        settings = run.settings_for(source)
        text = (firmware_path() / "main.py").read_text(encoding="utf-8")
        if text.count(_BEFORE) != 1:
            raise SolenavError("the firmware's main.py is another than the bench knows", "mend it")
        watched = compiled("main", text.replace(_BEFORE, _WATCH + _BEFORE), run.MARCH)
        tree = {**board_tree(run.MARCH), "main.mpy": watched}
        said = bytearray()
        files = image.build(run.flashed(tree, settings))
        with EmulatedPico(uf2, files, run.feed_of(source)) as pico:
            pico.console.on_data = said.extend

            def ended() -> bool:
                progress(pico.ns // 1_000_000)
                return pico.over or b">>> " in said

            pico.run(ended)
    lines = [line.split() for line in said.decode("utf-8", "replace").splitlines()]
    found = [[int(n) for n in words[1:]] for words in lines if words[:1] == ["heap"]]
    # The first has nothing before it, and the static start in it.
    whole = found[2:]
    if not whole:
        raise SolenavError(f"nothing was said of the heap:\n{said.decode()}", "report it", 1)
    return {
        "free": whole[-1][3],
        "allocated_per_tick": round(sum(w[0] for w in whole) / sum(w[1] for w in whole), 2),
        "pause_ms": max(w[2] for w in whole) / 1000,
    }


def measure(
    uf2: Path | None,
    seconds: float,
    rates: Sequence[float],
    progress: Callable[[int], None] = lambda ms: None,
) -> dict[str, Any]:
    """All of it: at 200 Hz over `seconds`, at the other rates over a third of that.

    Without a UF2 only the Thumb engine, over a simulated walk.
    """
    if uf2 is None:
        with tempfile.TemporaryDirectory(prefix="solenav-bench-") as name:
            source = _walk(Path(name), seconds, 200.0)
            return {"thumb": on_thumb(source.sample_counts[:THUMB_TICKS], source.params[0][1])}
    out: dict[str, Any] = {"runs": []}
    for rate in rates:
        result = on_pico(uf2, seconds if rate == 200 else max(4.0, seconds / 3), rate, progress)
        counts, params = result.pop("counts"), result.pop("params")
        if rate == 200:
            out["thumb"] = on_thumb(counts[:THUMB_TICKS], params)
        out["runs"].append(result)
    return {**out, "heap": heap(uf2, progress)}


def _walk(folder: Path, seconds: float, rate_hz: float) -> Capture:
    path = folder / "walk.solcap"
    importing.to_capture(run.walk_of("loop", seconds, rate_hz=rate_hz), path)
    return capture.load(path)


def _kind(navigating: bool, stance: bool) -> str:
    return "aligning" if not navigating else "stance" if stance else "swing"


def _by_kind(ticks: Sequence[Tick], made: Capture) -> dict[str, dict[str, Any]]:
    """Figures of the ticks that were seen; a stance is known by the particles, which only it has.

    The first looks may come after the first ticks: what is aligned says by itself what it is.
    """
    found: dict[str, list[int]] = {}
    stages: dict[str, Counter[str]] = {}
    for tick in ticks:
        kind = _kind("align" not in tick.looks, "particles" in tick.looks)
        found.setdefault(kind, []).append(tick.cycles)
        of_kind = stages.setdefault(kind, Counter())
        for stage, looks in tick.looks.items():
            of_kind[stage] += EACH * looks
    return {kind: _figures(cycles, stages[kind]) for kind, cycles in found.items()}


def _figures(cycles: Sequence[int], stages: Counter[str]) -> dict[str, Any]:
    return {
        "ticks": len(cycles),
        "mean": round(sum(cycles) / len(cycles)),
        "most": max(cycles),
        "stages": {stage: round(n / len(cycles)) for stage, n in stages.most_common()},
    }


def _rows(sent: NDArray[np.int16], got: NDArray[np.int16]) -> NDArray[np.int64]:
    """Which sample of those measured each one is that came: they come in order."""
    rows = np.empty(len(got), np.int64)
    at = 0
    for i, sample in enumerate(got):
        while at < len(sent) and not np.array_equal(sent[at][:6], sample[:6]):
            at += 1
        if at == len(sent):
            raise SolenavError(f"sample {i} isn't one that the sensor measured", "report it", 1)
        rows[i] = at
        at += 1
    return rows


def _latency(made: Capture, path: Path, ready: NDArray[np.float64]) -> dict[str, float]:
    """From data ready to the last bit of the POSE made of it: median, worst."""
    first = int(made.samples.tick[0])
    reader = FrameReader()
    out = []
    for time_s, data in capture.read_records(path):
        for item in reader.feed(data):
            if isinstance(item, Damage) or item.kind != messages.POSE:
                continue
            if 0 <= item.tick - first < len(ready):
                out.append(time_s - ready[item.tick - first])
    return {
        "median": round(1000 * float(np.median(out)), 3),
        "worst": round(1000 * float(np.max(out)), 3),
    }
