"""`solenav tune`: detector parameters for one's own recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from solenav import capture
from solenav.capture.sidecar import sidecar_path
from solenav.errors import SolenavError
from solenav_tools.cli.output import Json, check_output, progress, say, say_json, warn, write_text

if TYPE_CHECKING:
    # It needs numba, which the other commands do without.
    from solenav.modes.thresholds import Report as ByMode
    from solenav.tuning import Dimension, Judged, Report

_VERDICTS = {
    "better": "better on walks like these",
    "unproven": "better on this walk, unproven on any other",
    "no better": "no better, keep those you have",
}


def tune(
    files: Annotated[list[Path], typer.Argument(help="Captures (.solcap).", metavar="CAPTURE...")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Part of a config.json to write.")
    ] = None,
    closed_loop: Annotated[
        bool, typer.Option("--closed-loop", help="Every walk ends where it began.")
    ] = False,
    free_band: Annotated[
        bool, typer.Option("--free-band", help="Let the force's band be wider on one side of g.")
    ] = False,
    also: Annotated[
        list[str] | None,
        typer.Option(metavar="SETTING", help="Another setting to search; may be given again."),
    ] = None,
    modes: Annotated[
        bool, typer.Option("--modes", help="Thresholds of the GLRT detector, one for each motion.")
    ] = False,
    budget: Annotated[
        int, typer.Option(min=16, help="Parameter sets that the search tries.")
    ] = 400,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: a core each.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find detector parameters by truth or closure, and say how far they may be trusted."""
    if not find_spec("numba"):
        raise SolenavError("tuning needs numba", "pip install 'solenav[fast]'")
    from solenav import tuning

    if output is not None:
        check_output(output, ".json")
        if output.resolve() in {sidecar_path(file).resolve() for file in files}:
            raise SolenavError(
                f"{output} is what stands beside the capture", "choose another file for -o"
            )
    unique = list({file.resolve(): file for file in files}.values())
    walks = [tuning.from_capture(capture.load(file), closed_loop=closed_loop) for file in unique]
    if modes:
        from solenav.modes import thresholds

        with progress("trying thresholds", len(thresholds.FIELDS)) as done:
            by_mode = thresholds.tune(walks, jobs=jobs, progress=done)
        _give(by_mode, lambda: _tell_modes(by_mode), output, as_json)
        return
    extra = also or []
    planned = tuning.planned(budget, 4 + free_band + len(extra))
    with progress("trying parameters", planned) as done:
        report = tuning.tune(
            walks, symmetric=not free_band, also=extra, budget=budget, jobs=jobs, progress=done
        )
    _give(report, lambda: _tell(report), output, as_json)


def _give(
    report: Report | ByMode, told: Callable[[], None], output: Path | None, as_json: bool
) -> None:
    """The report as a file, and as JSON or `told`."""
    if output is not None:
        write_text(output, json.dumps(report.config(), indent=2) + "\n")
    if as_json:
        say_json(report.as_dict())
        return
    told()
    if output is not None:
        say(f"{output}: put it beside main.py as config.json, or its params into yours")


def _tell_modes(report: ByMode) -> None:
    say("motion          before         now  between the minima of T  cycles  recordings")
    for one in report.thresholds:
        between = one.why if one.lowest is None else f"{one.lowest:.0f} to {one.second:.0f}"
        numbers = f"{one.strides:6}  {len(one.recordings):10}"
        say(f"{one.mode:10} {one.start:11.0f} {one.value:11.0f}  {between:>23}  {numbers}")
    say("recording                            distance    C1 to C3   fixed GLRT     adaptive")
    for judged in report.recordings:
        errors = (judged.start_m, judged.fixed_m, judged.adaptive_m)
        shown = "".join(f"{error:11.3f} m" for error in errors)
        say(f"{judged.name:34.34} {judged.distance_m:8.1f} m{shown}")
    say(
        f"error before / now: {report.gain_over_start:.2f} on the detector in use, "
        f"{report.gain_over_fixed:.2f} on one GLRT threshold"
    )
    if report.gain_over_start <= 1.0:
        warn("keep the detector you have: on these walks the thresholds of motions do no better")


def _tell(report: Report) -> None:
    say("parameter                  before       now  within 10 % of the best")
    for dimension in report.dimensions:
        say(_dimension(dimension))
    say("recording                            distance      before         now  by the others")
    for judged in report.recordings:
        say(_recording(judged))
    least, largest = report.moved
    say(
        f"error before / now {report.gain:.2f}; another seed of the particles makes "
        f"{report.seed_spread:.2f}, thresholds moved by 10 % {least:.2f} to {largest:.2f}"
    )
    if report.held_out_gain is not None:
        what = "a recording" if report.held_out == "recordings" else "half of the truth"
        say(f"chosen without {what} and judged by it: before / now {report.held_out_gain:.2f}")
    for text in report.warnings:
        warn(text)
    say(f"after {report.evaluations} parameter sets: {_VERDICTS[report.verdict]}")


def _dimension(found: Dimension) -> str:
    span = "any value" if found.inert else f"{found.low:.3g} to {found.high:.3g}"
    note = ", at the bound" if found.at_bound else ""
    return f"{found.name:22} {found.start:10.3g}{found.value:10.3g}  {span}{note}"


def _recording(judged: Judged) -> str:
    held = "" if judged.held_out_m is None else f"{judged.held_out_m:13.3f} m"
    return (
        f"{judged.name:34.34} {judged.distance_m:8.1f} m {judged.start_m:9.3f} m "
        f"{judged.tuned_m:9.3f} m{held} ({judged.kind})"
    )
