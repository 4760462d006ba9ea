"""`solenav verify`: the proof."""

from __future__ import annotations

from array import array
from typing import Annotated

import typer

from solenav import capture, engines, verification
from solenav.errors import SolenavError
from solenav_tools.cli.arguments import Baud, ForestFile, forest_from
from solenav_tools.cli.output import CaptureFile, Json, progress, say, say_json, warn
from solenav_tools.cli.replay import EngineName
from solenav_tools.injection import inject
from solenav_tools.ports import PortVanished, known_names, open_port


def verify(
    file: CaptureFile,
    engine: Annotated[
        EngineName | None, typer.Option(help="Default: fast where numba is installed, else pure.")
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(
            "--device",
            help="Port of a live board: its processor runs the samples instead.",
            autocompletion=lambda: known_names(),
        ),
    ] = None,
    baud: Baud = None,
    forest: ForestFile = None,
    as_json: Json = False,
) -> None:
    """Rebuild a run from its samples and compare every pose, step, snapshot and digest.

    With --device the samples go into a live board, and its state after each of them is compared
    with the host's; its own run goes on afterwards, as after a hole.

    Exit code 0: every compared tick is equal. 1: the first difference. 2: can't be compared.
    """
    source = capture.load(file)
    name = engine.value if engine else engines.default_name()
    words = forest_from(forest)
    if device is not None:
        _on_device(source, device, baud, name, words, as_json)
        return
    with progress(f"verifying on {name}", len(source.samples)) as done:
        report = verification.verify(source, name, done, words)
    if as_json:
        say_json(report.as_dict())
    else:
        _tell(report)
    if source.damaged:
        warn(f"{sum(source.damaged.values())} damaged frames were left out")
    if not report.verified:
        raise typer.Exit(1 if report.difference else 2)


def _on_device(
    source: capture.Capture,
    device: str,
    baud: int | None,
    engine: str,
    forest: array[int] | None,
    as_json: bool,
) -> None:
    with open_port(device, baud) as port:
        try:
            with progress(f"running on {device}", len(source.samples)) as done:
                report = inject(port, source, engine, done, forest)
        except PortVanished:
            raise SolenavError(
                f"{device} vanished in the middle",
                "plug it in and start again; the board goes on with its own run within 5 s",
                1,
            ) from None
    if as_json:
        say_json(report.as_dict())
    elif report.verified:
        speed = report.samples / max(source.rate_hz(), 1e-9) / max(report.seconds, 1e-9)
        say(
            f"VERIFIED on {report.board}: {report.ticks} ticks, each equal to {report.engine}; "
            f"{speed:.1f} times real time, {report.resent} samples sent again"
        )
    else:
        d = report.difference
        assert d is not None
        say(
            f"DIFFERENT at tick {d.tick}, stage {d.stage}, field {d.field}: "
            f"{report.board} {d.value}, {report.engine} {d.reference}"
        )
        say(f"  equal before that: {report.ticks} ticks")
    if not report.verified:
        raise typer.Exit(1)


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
