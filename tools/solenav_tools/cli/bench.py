"""`solenav bench`: what the core costs on a Pico, and what the firmware does around it."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from solenav_tools.cli.emulate import Uf2
from solenav_tools.cli.output import Json, is_quiet, progress, say, say_json, warn
from solenav_tools.emulator import uf2 as firmware


def bench(
    pico: Annotated[
        bool, typer.Option("--pico", help="The firmware on the emulated Pico as well.")
    ] = False,
    uf2: Uf2 = None,
    seconds: Annotated[
        float,
        typer.Option(min=4, help="Of the walk at 200 Hz; a third of it at the other rates."),
    ] = 30,
    rate: Annotated[
        list[float] | None, typer.Option(help="Sample rate, Hz; may be given again.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Cycles of a tick by stage on the Thumb engine; with --pico on the emulated board.

    On the board also: how long the processor was awake, latency from data ready to POSE on the
    wire, heap, garbage, samples lost. A second of a walk takes some 25 s of a core there.
    """
    from solenav_tools.emulator import bench as measuring

    image = firmware.find(uf2) if pico else None
    rates = rate or [200.0, 100.0, 400.0]
    total = int(1000 * (seconds + (len(rates) - 1) * seconds / 3 + 2 * len(rates) + 6))
    with progress("measuring", total) as done:
        result = measuring.measure(image, seconds, rates, done)
    if as_json:
        say_json(result)
        return
    for run in result.get("runs", []):
        _tell(run)
    if "heap" in result:
        heap = result["heap"]
        say(
            f"heap: {heap['free']:.0f} bytes free, {heap['allocated_per_tick']} allocated per tick,"
            f" a collection takes {heap['pause_ms']:.1f} ms"
        )
    _table("Thumb engine", result.get("thumb", {}))
    for run in result.get("runs", []):
        _table(f"emulated Pico, {run['rate_hz']:g} Hz", run["ticks"])


def _tell(run: dict[str, Any]) -> None:
    latency = run["latency_ms"]
    say(
        f"{run['rate_hz']:g} Hz, {run['seconds']:g} s: awake {run['awake']:.0%} of the time, "
        f"POSE {latency['median']:.1f} ms after data ready, {latency['worst']:.1f} at worst; "
        f"{run['proven']} of {run['samples']} samples proven"
    )
    if run["lost"]:
        warn(f"{run['lost']} of {run['samples']} samples were lost at {run['rate_hz']:g} Hz")
    if not run["verified"]:
        warn(f"at {run['rate_hz']:g} Hz the board and the host differ")


def _table(title: str, kinds: dict[str, dict[str, Any]]) -> None:
    if is_quiet() or not kinds:
        return
    names = [name for name in ("aligning", "swing", "stance") if name in kinds]
    stages = dict.fromkeys(stage for name in names for stage in kinds[name]["stages"])
    table = Table("cycles", *names, title=title)
    table.add_row("ticks", *(str(kinds[name]["ticks"]) for name in names))
    table.add_row("mean", *(str(kinds[name]["mean"]) for name in names))
    table.add_row("most", *(str(kinds[name]["most"]) for name in names))
    for stage in stages:
        table.add_row(stage, *(str(kinds[name]["stages"].get(stage, 0)) for name in names))
    Console().print(table)
