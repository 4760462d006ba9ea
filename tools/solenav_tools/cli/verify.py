"""`solenav verify`: the proof."""

from __future__ import annotations

from typing import Annotated

import typer

from solenav import capture, engines, verification
from solenav_tools.cli.output import CaptureFile, Json, progress, say, say_json, warn
from solenav_tools.cli.replay import EngineName


def verify(
    file: CaptureFile,
    engine: Annotated[
        EngineName | None, typer.Option(help="Default: fast where numba is installed, else pure.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Rebuild a run from its samples and compare every pose, step, snapshot and digest.

    Exit code 0: every compared tick is equal. 1: the first difference. 2: can't be compared.
    """
    source = capture.load(file)
    name = engine.value if engine else engines.default_name()
    with progress(f"verifying on {name}", len(source.samples)) as done:
        report = verification.verify(source, name, done)
    if as_json:
        say_json(report.as_dict())
    else:
        _tell(report)
    if source.damaged:
        warn(f"{sum(source.damaged.values())} damaged frames were left out")
    if not report.verified:
        raise typer.Exit(1 if report.difference else 2)


def _tell(report: verification.Report) -> None:
    if report.gaps:
        say(
            f"{report.gaps} gaps: {report.missing_samples} samples missing, "
            f"{report.unchecked_samples} more before the next snapshot unchecked"
        )
    messages = ", ".join(f"{count} {name}" for name, count in report.compared.items())
    d = report.difference
    if d is not None:
        say(
            f"DIFFERENT at tick {d.tick}, stage {d.stage}, field {d.field} ({d.message}): "
            f"capture {d.capture}, host {d.host}"
        )
        if d.also:
            rest = f" and {len(d.also) - 8} more" if len(d.also) > 8 else ""
            say(f"  also different: {', '.join(d.also[:8])}{rest}")
        say(f"  equal before that: {report.compared_ticks} ticks ({messages or 'nothing'})")
    elif report.compared_ticks == 0:
        say("NOTHING COMPARED: no message has the samples that lead to it")
    else:
        share = 100 * report.covered_ticks / report.samples
        say(
            f"VERIFIED on {report.engine}: {report.compared_ticks} ticks compared, all equal; "
            f"{report.covered_ticks} of {report.samples} samples proven ({share:.2f} %)"
        )
        say(f"  {messages}")
