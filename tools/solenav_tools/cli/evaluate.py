"""`solenav evaluate`: how good the estimate is."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

import typer

from solenav import capture, evaluation
from solenav.pdr import step_table
from solenav_tools.cli.output import Json, WalkFile, say, say_json, warn

Align = Enum("Align", {name: name for name in evaluation.ALIGNMENTS}, type=str)  # type: ignore[misc]
_AUTO = Align("auto")


def evaluate(
    file: WalkFile,
    align: Annotated[
        Align, typer.Option(help="How the truth is laid on; auto: not at all where it is ENU.")
    ] = _AUTO,
    require_truth: Annotated[bool, typer.Option(help="No truth is an error.")] = False,
    as_json: Json = False,
) -> None:
    """Distance, closure, and errors against the truth where it is known."""
    if file.suffix.lower() == step_table.SUFFIX:
        walk, truth = step_table.read(file)
        result = evaluation.evaluate_steps(
            walk, truth, align=align.value, require_truth=require_truth
        )
    else:
        run = capture.load(file)
        result = evaluation.evaluate(run, align=align.value, require_truth=require_truth)
    if result.left_out:
        warn(f"{result.left_out} poses leap away from those around them and were left out")
    if as_json:
        say_json(result.as_dict())
        return
    say(
        f"{result.steps} steps, {result.distance_m:.2f} m in {result.duration_s:.1f} s"
        + (f", after {result.restarts} restarts" if result.restarts else "")
    )
    closure = result.closure
    share = closure.horizontal_share
    of_distance = f" ({100 * share:.2f} % of the distance)" if share is not None else ""
    what = "closure" if closure.meaningful else "from start to end (not known to be a closed loop)"
    say(
        f"{what}: {closure.horizontal_m:.3f} m horizontal{of_distance}, "
        f"{closure.vertical_m:+.3f} m vertical"
    )
    if result.truth is None:
        say("no positions to compare with")
    else:
        _tell(result.truth)


def _tell(truth: evaluation.TruthErrors) -> None:
    laid = truth.alignment
    how = {
        "none": "as it stands",
        "origin": "shifted to the first point",
        "yaw": "turned and shifted for the best fit",
    }[laid.mode]
    say(f"against the truth, {how}, {laid.points} points:")
    say(f"  position RMSE      {_axes(truth.position_rmse_m)} m")
    if truth.stance_position_rmse_m is not None:
        say(f"  in stance          {_axes(truth.stance_position_rmse_m)} m")
    if truth.stance_velocity_rmse_mps is not None:
        say(f"  velocity in stance {_axes(truth.stance_velocity_rmse_mps)} m/s")
    share = f" ({100 * truth.final_share:.2f} %)" if truth.final_share is not None else ""
    say(f"  at the end         {_axes(truth.final_m)} m{share}")


def _axes(e: evaluation.Errors) -> str:
    up = "      ?" if e.up is None else f"{e.up:7.4f}"
    return f"E {e.east:7.4f}  N {e.north:7.4f}  U {up}  horizontal {e.horizontal:7.4f}"
