"""`solenav batch`: every capture below a folder."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from solenav import batching
from solenav_tools.cli.output import Json, check_output, progress, say, say_json, write_text
from solenav_tools.cli.replay import EngineName


def batch(
    folder: Annotated[
        Path, typer.Argument(help="Captures are looked for below it.", metavar="DIR")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The table as CSV as well.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one a processor.")
    ] = None,
    dask: Annotated[
        str | None, typer.Option(help="Dask scheduler whose workers see the same folder.")
    ] = None,
    engine: Annotated[EngineName | None, typer.Option(help="Default: fast, else pure.")] = None,
    as_json: Json = False,
) -> None:
    """Verify and evaluate every capture below a folder, in parallel.

    Exit code 0: all are verified. 1: one isn't.
    """
    if output is not None:
        check_output(output, ".csv")
    captures = batching.find(folder)
    with progress("verifying", len(captures)) as done:
        rows = batching.batch(
            captures,
            jobs=jobs,
            dask=dask,
            engine=engine.value if engine else None,
            progress=done,
        )
    if output is not None:
        write_text(output, _csv(rows))
    proven = sum(bool(row.verified) for row in rows)
    if as_json:
        say_json({"verified": proven, "captures": [row.as_dict() for row in rows]})
    else:
        say(_table(rows, folder))
        say(f"{proven} of {len(rows)} verified")
    if proven < len(rows):
        raise typer.Exit(1)


def _csv(rows: list[batching.Row]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0].as_dict()))
    writer.writeheader()
    writer.writerows(row.as_dict() for row in rows)
    return text.getvalue()


def _table(rows: list[batching.Row], folder: Path) -> str:
    table = Table("capture", "verified", "proven", "distance", "steps", "error", "problem")
    for row in rows:
        path = Path(row.capture)
        name = path.relative_to(folder) if path.is_relative_to(folder) else path
        verdict = {True: "yes", False: "NO", None: "-"}[row.verified]
        share = "-" if row.proven_share is None else f"{100 * row.proven_share:.2f} %"
        distance = "-" if row.distance_m is None else f"{row.distance_m:.1f} m"
        steps = "-" if row.steps is None else str(row.steps)
        why = row.difference or row.problem
        table.add_row(escape(str(name)), verdict, share, distance, steps, _error(row), escape(why))
    console = Console(width=160 if any(row.difference or row.problem for row in rows) else 110)
    with console.capture() as captured:
        console.print(table)
    return captured.get().rstrip("\n")


def _error(row: batching.Row) -> str:
    if row.rmse_m is not None:
        return f"RMSE {row.rmse_m:.3f} m"
    return "-" if row.closure_m is None else f"closes {row.closure_m:.3f} m"
