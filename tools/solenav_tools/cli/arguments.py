"""Arguments that several commands take."""

from __future__ import annotations

from typing import Annotated

import typer

from solenav_tools.ports import BAUD, known_names

Port = Annotated[
    str | None,
    typer.Argument(
        help="Serial port of the board, or its name in solenav.toml; default: the only one.",
        metavar="[PORT]",
        autocompletion=lambda: known_names(),
        show_default=False,
    ),
]
Baud = Annotated[
    int | None, typer.Option(help=f"Bits per second; default: {BAUD}.", show_default=False)
]
Seconds = Annotated[float | None, typer.Option(help="Stop after so many seconds.")]
