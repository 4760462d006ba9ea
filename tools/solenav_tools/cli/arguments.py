"""Arguments that several commands take."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Annotated

import typer

from solenav import forests
from solenav_tools.ports import BAUD, known_names

_PORT = "Serial port of the board, or its name in solenav.toml; default: the only one."
Port = Annotated[
    str | None,
    typer.Argument(
        help=_PORT,
        metavar="[PORT]",
        autocompletion=lambda: known_names(),
        show_default=False,
    ),
]
PortOption = Annotated[
    str | None,
    typer.Option("--port", help=_PORT, autocompletion=lambda: known_names(), show_default=False),
]
Baud = Annotated[
    int | None, typer.Option(help=f"Bits per second; default: {BAUD}.", show_default=False)
]
Seconds = Annotated[float | None, typer.Option(help="Stop after so many seconds.")]
ForestFile = Annotated[
    Path | None,
    typer.Option(
        "--forest",
        help="File of the forest that the board had, where it isn't the shipped one.",
        show_default=False,
    ),
]


def forest_from(path: Path | None) -> array[int] | None:
    """The words in a forest's file; None without a file. SolenavError where they are no forest."""
    return None if path is None else forests.load(path)
