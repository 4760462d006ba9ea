"""`solenav matrix`: all engines over a capture's samples, digest by digest."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

import typer

from solenav import capture
from solenav.errors import SolenavError
from solenav_tools.cli.output import CaptureFile, Json, progress, say, say_json
from solenav_tools.matrix import ALL, REFERENCE, Matrix, Outcome, Run

MatrixEngine = Enum("MatrixEngine", {name: name for name in ALL}, type=str)  # type: ignore[misc]


def matrix(
    file: CaptureFile,
    ticks: Annotated[int, typer.Option(min=0, help="Samples to run at most; 0: all.")] = 2000,
    engine: Annotated[
        list[MatrixEngine] | None, typer.Option(help="An engine; may be given again. Default: all.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare every engine's digest with plain Python's, on every tick of a capture's samples.

    Exit code 0: all that ran are equal. 1: one differs or failed. 2: nothing was compared, or an
    engine asked for can't be had.
    """
    source = capture.load(file)
    source.need_samples()
    counts = source.sample_counts[: ticks or None]
    names = [each.value for each in engine] if engine else list(ALL)
    total = len(counts) * len({REFERENCE, *names})
    with Matrix(names) as engines, progress("comparing engines", total) as done:
        outcomes = engines.compare([Run(counts)], source.params[0][1], done)
    if as_json:
        result = {"capture": str(file), "ticks": len(counts), "reference": REFERENCE}
        say_json({**result, "engines": [outcome.as_dict() for outcome in outcomes]})
    else:
        _tell(outcomes)
    if any(outcome.wrong for outcome in outcomes):
        raise typer.Exit(1)
    missing = [outcome.engine for outcome in outcomes if outcome.skipped]
    if engine and missing:
        raise SolenavError(f"asked for and not here: {', '.join(missing)}", "see the reasons above")
    if not any(outcome.equal for outcome in outcomes if outcome.engine != REFERENCE):
        raise SolenavError("nothing was compared", f"choose an engine besides {REFERENCE}")


def _tell(outcomes: list[Outcome]) -> None:
    width = max(len(outcome.engine) for outcome in outcomes)
    for outcome in outcomes:
        text = str(outcome)
        if outcome.engine == REFERENCE:
            text = f"the reference, {outcome.ticks} ticks"
        say(f"{outcome.engine:{width}}  {text}")
        also = outcome.difference.also if outcome.difference else []
        if also:
            rest = f" and {len(also) - 8} more" if len(also) > 8 else ""
            say(f"{'':{width}}  also different: {', '.join(also[:8])}{rest}")
