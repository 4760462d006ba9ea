"""`solenav export`: a capture in the formats of others."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from solenav import exporting
from solenav_tools.cli.output import CaptureFile, Json, say, say_json, warn

_FORMATS = exporting.FORMATS.items()
Format = Enum("Format", {name: name for name in exporting.FORMATS}, type=str)  # type: ignore[misc]


def export(
    file: CaptureFile,
    to: Annotated[
        Format,
        typer.Option(
            "--to", help="; ".join(f"{n}: {f.about}" for n, f in exporting.FORMATS.items())
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="File, for tables a folder; default: beside CAPTURE."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a capture as CSV, TUM, MCAP or Parquet; what the format can't hold is said."""
    suffix = exporting.FORMATS[to.value].suffix or f".{to.value}"
    written = exporting.export(file, to.value, output or file.with_suffix(suffix))
    if as_json:
        say_json(
            {
                "files": [str(path) for path in written.files],
                "items": written.items,
                "losses": written.losses,
            }
        )
        return
    for path in written.files:
        say(str(path))
    for loss in written.losses:
        warn(f"not in {to.value}: {loss}")
