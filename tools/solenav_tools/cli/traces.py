"""Phone traces as commands take them: format, way points, a place."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from solenav.datasets import indoor, kaist
from solenav.errors import SolenavError
from solenav.recording import Recording
from solenav_tools.cli.output import check_output


class TraceFormat(str, Enum):
    """Whose format a phone trace has."""

    kaist = "kaist"
    indoor = "indoor"


Format = Annotated[TraceFormat, typer.Option("--format", "-f", help="Whose format it has.")]
WayPoints = Annotated[
    Path | None, typer.Option(help="kaist: the file (.json) of the way points' places.")
]

Steps = Annotated[
    Path | None, typer.Option("-o", "--output", help="Table of the steps (.csv) to write.")
]
Picture = Annotated[Path | None, typer.Option(help="PNG to draw.")]


def check_outputs(output: Path | None, plot: Path | None) -> None:
    """SolenavError, before any long work, for files that can't be written."""
    for path, suffix in ((output, ".csv"), (plot, ".png")):
        if path is not None:
            check_output(path, suffix)


def read(path: Path, format: TraceFormat, way_points: Path | None) -> Recording:
    """The trace. SolenavError for whatever is wrong with it."""
    if format is TraceFormat.kaist:
        return kaist.read(path, way_points=way_points)
    if way_points is not None:
        raise SolenavError("an indoor trace has its own way points", "leave out --way-points")
    return indoor.read(path)


def place(text: str) -> tuple[float, float]:
    """A place "x,y" in m. SolenavError otherwise."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise SolenavError(f"{text!r} is no place", "write x,y in m: 34.5,7.5") from None
    return x, y
