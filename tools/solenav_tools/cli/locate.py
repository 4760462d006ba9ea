"""`solenav locate`: where a phone walks on a magnetic map."""

from __future__ import annotations

import math
from enum import Enum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from solenav import magmap as maps
from solenav.errors import SolenavError
from solenav.pdr.step_table import table
from solenav_tools.cli import traces
from solenav_tools.cli.output import Json, say, say_json, write_text

Filter = Enum("Filter", {name: name for name in maps.FILTERS}, type=str)  # type: ignore[misc]
_FIREFLY = Filter("firefly")


def locate(
    trace: Annotated[Path, typer.Argument(help="A phone trace: kaist a folder, indoor a .txt.")],
    map_file: Annotated[Path, typer.Option("--map", "-m", help="Map of the floor.")],
    format: traces.Format,
    start: Annotated[
        str | None, typer.Option(help="Where it began, x,y in m; default: the first way point.")
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            help="Where the phone points then, ° counterclockwise from x; default: field."
        ),
    ] = None,
    way_points: traces.WayPoints = None,
    filter: Annotated[Filter, typer.Option(help="Which particle filter.")] = _FIREFLY,
    seed: Annotated[int, typer.Option(help="Of the particles.")] = 1,
    output: traces.Steps = None,
    plot: traces.Picture = None,
    as_json: Json = False,
) -> None:
    """Find a phone's walk on a magnetic map by a particle filter."""
    traces.check_outputs(output, plot)
    floor = maps.load(map_file)
    recording = traces.read(trace, format, way_points)
    truth = recording.truth
    if start is not None:
        begin = traces.place(start)
        begin_s = 0.0
    elif truth is not None:
        x, y = truth.position_enu[0, :2].tolist()
        begin, begin_s = (x, y), max(0.0, float(truth.time_s[0]))
    else:
        raise SolenavError(f"{trace} says nothing of where it began", "give --start x,y")
    found = maps.locate(
        recording,
        floor,
        begin,
        filter=filter.value,
        start_heading=None if heading is None else math.radians(heading),
        seed=seed,
        begin_s=begin_s,
    )
    if output is not None:
        write_text(output, table(found.track))
    if plot is not None:
        from solenav.magmap import figures

        figures.draw_tracks(floor, {filter.value: found}, plot, truth=truth)
    result = {
        "filter": filter.value,
        "steps": len(found.track),
        "distance_m": found.track.distance_m,
        "end_m": found.track.position[-1, :2].tolist(),
        "spread_m": float(found.spread[-1]),
        "ms_per_step": 1e3 * found.seconds_per_step,
    }
    if truth is not None:
        error = np.hypot(*(found.at(truth.time_s) - truth.position_enu[:, :2]).T)
        result["error_m"] = {
            "mean": float(error.mean()),
            "p75": float(np.percentile(error, 75)),
            "points": len(error),
        }
    if as_json:
        say_json(result)
        return
    x, y = found.track.position[-1, :2]
    say(
        f"{len(found.track)} steps, {found.track.distance_m:.1f} m, end ({x:.1f}, {y:.1f}) m, "
        f"spread {found.spread[-1]:.1f} m"
    )
    if truth is not None:
        say(
            f"error at {len(error)} way points: mean {error.mean():.2f} m, "
            f"75 % {np.percentile(error, 75):.2f} m"
        )
