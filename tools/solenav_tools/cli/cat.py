"""`solenav cat`: frames as JSON lines."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from solenav_tools import lines
from solenav_tools.cli.arguments import Baud


def cat(
    source: Annotated[str, typer.Argument(help="Port or capture.", metavar="PORT|CAPTURE")],
    only: Annotated[
        str | None, typer.Option(help="Message types, with commas between: pose,step.")
    ] = None,
    raw: Annotated[bool, typer.Option("--raw", help="The wire's integers, not units.")] = False,
    damaged: Annotated[bool, typer.Option(help="Damaged frames as well.")] = False,
    baud: Baud = None,
) -> None:
    """Print each message as a line of JSON as it comes, in SI units. Ctrl-C ends it."""
    chosen = None if only is None else only.split(",")
    try:
        for line in lines.cat(source, chosen, raw=raw, damaged=damaged, baud=baud):
            # A pipe's reader wants it now, not with the next 8 kB.
            print(json.dumps(line, ensure_ascii=False), flush=True)
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:
        # Whoever read has had enough: as with any filter, no error.
        sys.stderr.close()
        raise typer.Exit(0) from None
