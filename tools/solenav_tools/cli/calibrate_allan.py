"""`solenav calibrate allan`: what the sensor's noise is made of, from a long rest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from solenav import capture
from solenav.calibration import allan
from solenav.calibration.still import from_capture
from solenav_tools.cli.output import CaptureFile, Json, check_output, say, say_json


def calibrate_allan(
    file: CaptureFile,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG to draw the deviations into.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Random walk, bias instability and bias walk of each axis, from ten minutes of rest."""
    if output is not None:
        check_output(output, ".png")
    report = allan.of_recording(from_capture(capture.load(file)))
    if output is not None:
        allan.draw(report, output)
    if as_json:
        say_json(report.as_dict())
        return
    say(f"longest rest: {report.rest.start_s:.0f} to {report.rest.end_s:.0f} s")
    table = Table("axis", "at 1 s", "random walk N", "bias instability B", "bias walk K")
    for axis in report.axes:
        unit = axis.unit
        table.add_row(
            axis.name,
            f"{axis.at(1.0):.4g} {unit}",
            f"{_figure(axis.walk)} {unit}/√Hz",
            f"{_figure(axis.instability)} {unit}",
            f"{_figure(axis.drift)} {unit}/√s",
        )
    Console(soft_wrap=True).print(table)
    if output is not None:
        say(str(output))


def _figure(figure: tuple[float, float]) -> str:
    """A value with its standard error, or how large at most where it wasn't seen."""
    value, error = figure
    return f"{value:.3g} ± {error:.1g}" if value else f"below {2 * error:.1g}"
