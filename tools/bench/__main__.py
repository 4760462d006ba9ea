"""What the core costs: `python tools/bench [--json]`, and on a board: `python tools/bench cycles`.

Prints, as ratios in one run or as counts that repeat: the speed of each engine as a multiple of
real time at 200 Hz, stance and swing apart; an hour on the fast engine; bytes per tick on the
link; the size of the state; the heap that a tick allocates on MicroPython.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from array import array
from pathlib import Path
from typing import Any

import cycles
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from solenav import capture, engines, importing, parameters, replaying
from solenav.sim.scenario import simulate
from solenav_core import layout, messages
from solenav_tools.board import find_micropython, stage

RATE = 200.0
_STANCE = layout.offsets(layout.STATE_FIELDS)["STANCE"]
# Enough for a ratio, little enough for the slowest engine.
_TICKS = {"pure": 4000, "checked": 600, "fast": 400_000, "thumb": 1200}

_HEAP_SCRIPT = """
import gc
from solenav_core import navigator
from solenav_core.tables.defaults import PARAMS
state = navigator.new_state()
work = navigator.new_work()
tables = navigator.new_tables()
sample = navigator.new_sample()
sample[2] = 2048

def run(ticks, rate):
    sample[3] = rate
    i = 0
    while i < ticks:
        navigator.tick(state, PARAMS, work, tables, sample)
        i += 1

def allocated(ticks, rate):
    gc.collect()
    gc.disable()
    before = gc.mem_alloc()
    run(ticks, rate)
    after = gc.mem_alloc()
    gc.enable()
    return after - before

run(300, 0)
# The difference of two lengths leaves out what the measurement itself takes.
for name, rate in (("stance", 0), ("swing", 3000)):
    run(1, rate)
    print(name, (allocated(600, rate) - allocated(100, rate)) / 500)
"""


def recorded() -> tuple[NDArray[np.int16], array[int], NDArray[np.bool_]]:
    """Samples of a simulated walk, its parameters, and which ticks are stance."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.solcap"
        importing.to_capture(simulate("loop", seed=1), path)
        source = capture.load(path)
    counts, params = source.sample_counts, source.params[0][1]
    engine = engines.create("fast", params)
    stance = np.zeros(len(counts), bool)
    for row in range(len(counts)):
        engine.advance(counts, row, row + 1)
        stance[row] = engine.state[_STANCE] == 1
    return counts, params, stance


def still(count: int) -> NDArray[np.int16]:
    counts = np.random.default_rng(1).normal(0, 3, (count, 6))
    counts[:, 2] += 2048
    return np.rint(counts).astype(np.int16)


def speed(name: str, counts: NDArray[np.int16], params: array[int]) -> float:
    """Multiple of real time over `counts` after a static start."""
    engine = engines.create(name, params)
    engine.advance(still(300))
    start = time.perf_counter()
    engine.advance(counts)
    return len(counts) / RATE / (time.perf_counter() - start)


def speeds() -> dict[str, dict[str, float]]:
    counts, params, stance = recorded()
    swing = counts[~stance]
    out: dict[str, dict[str, float]] = {}
    for name in engines.NAMES:
        ticks = _TICKS[name]
        out[name] = {
            "stance": speed(name, still(ticks), params),
            "swing": speed(name, np.resize(swing, (ticks // 2, counts.shape[1])), params),
            "walk": speed(name, np.resize(counts[2800:], (ticks, counts.shape[1])), params),
        }
    return out


def hour() -> float:
    """Seconds that an hour of walking takes on the fast engine, compiled beforehand."""
    counts, params, _stance = recorded()
    walk = np.resize(counts[2800:], (int(3600 * RATE), counts.shape[1]))
    return 3600 / speed("fast", walk, params)


def link_bytes() -> dict[str, float]:
    """Bytes per tick on the wire over a walk, by message; and with POSE on every 4th tick."""
    with tempfile.TemporaryDirectory() as folder:
        walk = Path(folder) / "walk.solcap"
        importing.to_capture(simulate("loop", seed=1), walk)
        source = capture.load(walk)
        out: dict[str, float] = {}
        for every in (1, 4):
            path = Path(folder) / f"every{every}.solcap"
            replaying.replay(source, path, engine="fast", pose_every=every)
            sent = sum(len(data) for _t, data in capture.read_records(path))
            out[f"pose_every_{every}"] = sent / len(source.samples)
    # Type, seq, tick, CRC, the byte of COBS and the delimiter.
    out["sample_frame"] = messages.SIZES[messages.SAMPLE] + 10
    out["pose_frame"] = messages.SIZES[messages.POSE] + 10
    return out


def heap() -> dict[str, float]:
    """Bytes of heap that one tick allocates on MicroPython."""
    with tempfile.TemporaryDirectory() as folder:
        stage(Path(folder), {})
        script = Path(folder) / "heap.py"
        script.write_text(_HEAP_SCRIPT, encoding="utf-8")
        done = subprocess.run(
            [find_micropython(), script.name],
            cwd=folder,
            check=True,
            capture_output=True,
            text=True,
        )
    lines = (line.split() for line in done.stdout.splitlines())
    return {name: float(count) for name, count in lines}


def measure() -> dict[str, Any]:
    return {
        "real_time_multiple_at_200_hz": speeds(),
        "hour_on_fast_s": hour(),
        "link_bytes_per_tick": link_bytes(),
        "state_bytes": 4 * layout.size(layout.STATE_FIELDS),
        "work_bytes": 4 * layout.size(layout.WORK_FIELDS),
        "table_bytes": 4 * layout.size(layout.TABLE_FIELDS),
        "parameter_bytes": 4 * len(parameters.LIMITS),
        "micropython_heap_bytes_per_tick": heap(),
    }


def main() -> None:
    if "cycles" in sys.argv[1:]:
        cycles.main()
        return
    result = measure()
    if "--json" in sys.argv[1:]:
        print(json.dumps(result, indent=2))
        return
    console = Console()
    table = Table("engine", "stance", "swing", "walk", title="multiples of real time at 200 Hz")
    for name, row in result.pop("real_time_multiple_at_200_hz").items():
        table.add_row(name, *(f"{row[k]:.3g}" for k in ("stance", "swing", "walk")))
    console.print(table)
    for key, value in result.items():
        parts = value.items() if isinstance(value, dict) else [("", value)]
        console.print(f"{key.replace('_', ' ')}:", *(f"{k} {v:.4g}".strip() for k, v in parts))


if __name__ == "__main__":
    main()
