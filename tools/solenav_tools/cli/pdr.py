"""`solenav pdr`: a phone's walk by dead reckoning."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from solenav import capture, evaluation
from solenav import pdr as reckoning
from solenav.pdr import step_table
from solenav.pdr.reckoning import HEADINGS
from solenav_tools.cli import traces
from solenav_tools.cli.output import Json, say, say_json

Heading = Enum("Heading", {name: name for name in HEADINGS}, type=str)  # type: ignore[misc]
_GYRO = Heading("gyro")


def pdr(
    trace: Annotated[Path, typer.Argument(help="A phone trace: kaist a folder, indoor a .txt.")],
    format: traces.Format,
    way_points: traces.WayPoints = None,
    heading: Annotated[Heading, typer.Option(help="Where the direction comes from.")] = _GYRO,
    adapt: Annotated[bool, typer.Option(help="Fit the step length to the way points.")] = False,
    foot: Annotated[
        Path | None,
        typer.Option(help="Capture of the foot on the same walk: the phone bridges its holes."),
    ] = None,
    later: Annotated[
        float, typer.Option(help="With --foot: seconds that the trace began after the capture.")
    ] = 0.0,
    output: traces.Steps = None,
    plot: traces.Picture = None,
    as_json: Json = False,
) -> None:
    """Steps, distance and track of a phone carried in the hand, pointing ahead.

    `solenav evaluate` and `solenav plot` take the table that --output writes.
    """
    traces.check_outputs(output, plot)
    recording = traces.read(trace, format, way_points)
    model = reckoning.GENERIC
    if adapt and recording.truth is not None:
        model, _ = reckoning.adapted(recording, recording.truth)
    walk = reckoning.reckon(recording, heading=heading.value, model=model)
    truth = recording.truth
    if foot is not None:
        run = capture.load(foot)
        walk = reckoning.joined(reckoning.of_capture(run), walk.after(later), reckoning.holes(run))
    if truth is not None:
        # The way points' axes are the map's, the walk's begin where the phone pointed.
        truth = replace(truth, frame="local", time_s=truth.time_s + later)
    result = evaluation.evaluate_steps(walk, truth)
    if output is not None:
        step_table.write(output, walk, truth)
    if plot is not None:
        from solenav import plotting

        plotting.plot_steps(walk, plot, truth=truth)
    if as_json:
        say_json(result.as_dict() | {"coefficients": model.coefficients.tolist()})
        return
    say(f"{result.steps} steps, {result.distance_m:.2f} m in {result.duration_s:.1f} s")
    if result.truth is not None:
        error = result.truth.position_rmse_m.horizontal
        say(f"RMSE {error:.2f} m at {result.truth.alignment.points} way points, turned to fit")
