"""`solenav pdr`: a phone's walk by dead reckoning."""

from __future__ import annotations

import math
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from solenav import evaluation
from solenav import pdr as reckoning
from solenav.pdr.reckoning import HEADINGS
from solenav.pdr.track import StepTrack
from solenav_tools.cli import traces
from solenav_tools.cli.output import Json, say, say_json, write_text

Heading = Enum("Heading", {name: name for name in HEADINGS}, type=str)  # type: ignore[misc]
_GYRO = Heading("gyro")


def pdr(
    trace: Annotated[Path, typer.Argument(help="A phone trace: kaist a folder, indoor a .txt.")],
    format: traces.Format,
    way_points: traces.WayPoints = None,
    heading: Annotated[Heading, typer.Option(help="Where the direction comes from.")] = _GYRO,
    adapt: Annotated[bool, typer.Option(help="Fit the step length to the way points.")] = False,
    output: traces.Steps = None,
    plot: traces.Picture = None,
    as_json: Json = False,
) -> None:
    """Steps, distance and track of a phone carried in the hand, pointing ahead."""
    traces.check_outputs(output, plot)
    recording = traces.read(trace, format, way_points)
    model = reckoning.GENERIC
    if adapt and recording.truth is not None:
        model, _ = reckoning.adapted(recording, recording.truth)
    walk = reckoning.reckon(recording, heading=heading.value, model=model)
    result = evaluation.evaluate_steps(walk, recording.truth, align="yaw")
    if output is not None:
        write_text(output, table(walk))
    if plot is not None:
        from solenav import plotting

        plotting.plot_steps(walk, plot)
    if as_json:
        say_json(result.as_dict() | {"coefficients": model.coefficients.tolist()})
        return
    say(f"{result.steps} steps, {result.distance_m:.2f} m in {result.duration_s:.1f} s")
    if result.truth is not None:
        error = result.truth.position_rmse_m.horizontal
        say(f"RMSE {error:.2f} m at {result.truth.alignment.points} way points, turned to fit")


def table(walk: StepTrack) -> str:
    """A line a step: when and where it ended, its length, heading and deviations."""
    lines = ["time_s,x_m,y_m,length_m,heading_deg,deviation_x_m,deviation_y_m"]
    for k in range(len(walk)):
        x, y = walk.position[k + 1, :2]
        length = math.hypot(*walk.displacement[k, :2])
        cov = walk.covariance[k]
        lines.append(
            f"{walk.time_s[k]:.3f},{x:.3f},{y:.3f},{length:.3f},"
            f"{math.degrees(walk.heading[k]) % 360:.1f},{cov[0, 0] ** 0.5:.3f},"
            f"{cov[1, 1] ** 0.5:.3f}"
        )
    return "\n".join(lines) + "\n"
