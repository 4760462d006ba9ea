"""What a tick costs on a Raspberry Pi Pico: `python tools/bench cycles [--json | --write]`.

The core's device form, compiled for the Cortex-M0+, runs a fixed walk on the Thumb engine, which
counts instructions and cycles; calls and divisions of the runtime come from its model. Swing and
stance are the dearest ticks of their kind that draw no particles; worst is the dearest of all.
--write keeps the figures in docs/cycles.json, from which a test allows no rise of over 2 %.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from solenav import engines, parameters
from solenav.engines.device_form import kernel_modules
from solenav.engines.thumb import Cost, ThumbEngine
from solenav.engines.thumb.compiler import compile_modules, compiled
from solenav.sim import torture
from solenav_core import layout

TARGET = Path(__file__).resolve().parents[2] / "docs" / "cycles.json"
CLOCK_MHZ = 125
BUDGET = {"swing": 60_000, "stance": 190_000, "worst": 250_000}
_AT = layout.offsets(layout.STATE_FIELDS)


def dearest() -> dict[str, Cost]:
    """The dearest tick of each kind over the walk of the torture set."""
    engine = ThumbEngine(
        parameters.to_integers(parameters.Settings(), 200.0), sources=kernel_modules()
    )
    reference = engines.create("fast", engine.params)
    counts = torture.walks()[0].counts
    found: dict[str, Cost] = {}
    for row in range(len(counts)):
        engine.program.clear()
        engine.advance(counts, row, row + 1)
        reference.advance(counts, row, row + 1)
        assert engine.digest() == reference.digest(), f"tick {row + 1} differs"
        cost = engine.cycles()
        for kind in ("worst", _kind(engine, cost)):
            if kind not in found or cost.total > found[kind].total:
                found[kind] = cost
    return {kind: found[kind] for kind in ("swing", "stance", "worst")}


def _kind(engine: ThumbEngine, cost: Cost) -> str:
    if not engine.navigating or any(k.name.startswith("align.") for k in cost.kernels):
        return "aligning"
    if any(k.name == "particles.draw" for k in cost.kernels):
        return "drawing"
    return "stance" if engine.state[_AT["STANCE"]] else "swing"


def by_stage(cost: Cost) -> dict[str, dict[str, int]]:
    """Instructions and cycles of each module's kernels; the runtime's share by itself."""
    out: dict[str, dict[str, int]] = {}
    for kernel in cost.kernels:
        stage = out.setdefault(kernel.name.split(".")[0], {"instructions": 0, "cycles": 0})
        stage["instructions"] += kernel.instructions
        stage["cycles"] += kernel.cycles
    out["runtime's calls"] = {"instructions": 0, "cycles": cost.overhead}
    return out


def kernel_bytes() -> dict[str, int]:
    """Machine code of each kernel, largest first."""
    sizes = {
        f"{module.name}.{kernel}": len(code)
        for module in compile_modules(kernel_modules())
        for kernel, code in module.kernels.items()
    }
    return dict(sorted(sizes.items(), key=lambda item: -item[1]))


def measure() -> dict[str, Any]:
    costs = dearest()
    return {
        "ticks": {
            kind: {
                "cycles": cost.total,
                "instructions": cost.instructions,
                "boxed": cost.boxed,
                "stages": by_stage(cost),
            }
            for kind, cost in costs.items()
        },
        "mpy_bytes": {name: len(compiled(name, text)) for name, text in kernel_modules().items()},
        "kernel_bytes": kernel_bytes(),
        "mpy_bytes_by_architecture": {
            march: sum(len(compiled(n, text, march)) for n, text in kernel_modules().items())
            for march in ("armv6m", "armv7emsp", "armv7emdp", "xtensawin", "rv32imc")
        },
        "ram_bytes": {
            name: 4 * layout.size(fields)
            for name, fields in (
                ("state", layout.STATE_FIELDS),
                ("work", layout.WORK_FIELDS),
                ("tables", layout.TABLE_FIELDS),
            )
        },
    }


def main() -> None:
    result = measure()
    if "--write" in sys.argv[1:]:
        TARGET.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if "--json" in sys.argv[1:]:
        print(json.dumps(result, indent=1))
        return
    console = Console()
    for kind, tick in result["ticks"].items():
        ms = tick["cycles"] / CLOCK_MHZ / 1000
        title = f"{kind} tick: {tick['cycles']} cycles, {ms:.2f} ms (budget {BUDGET[kind]})"
        table = Table("stage", "instructions", "cycles", title=title)
        for stage, row in tick["stages"].items():
            table.add_row(stage, str(row["instructions"]), str(row["cycles"]))
        console.print(table)
    console.print(".mpy bytes:", result["mpy_bytes"], "total", sum(result["mpy_bytes"].values()))
    console.print("on each architecture:", result["mpy_bytes_by_architecture"])
    largest = list(result["kernel_bytes"].items())[:6]
    console.print("largest kernels:", ", ".join(f"{name} {size}" for name, size in largest))
    console.print("RAM bytes:", result["ram_bytes"])


if __name__ == "__main__":
    main()
