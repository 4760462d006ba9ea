"""`solenav doctor`: whether a board is well."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from solenav.errors import SolenavError
from solenav_tools import doctor as examination
from solenav_tools.cli import output
from solenav_tools.cli.arguments import Baud, Port
from solenav_tools.cli.output import Json, say_json
from solenav_tools.ports import PortVanished, chosen_port, open_port

_STYLES = {
    examination.PASS: "green",
    examination.WARN: "yellow",
    examination.FAIL: "bold red",
    examination.SKIP: "dim",
}


def doctor(
    port: Port = None,
    seconds: Annotated[float, typer.Option(min=2.0, help="So long it is listened to.")] = 5.0,
    bus: Annotated[
        bool, typer.Option("--bus", help="Test the bus even where that ends a walk.")
    ] = False,
    baud: Baud = None,
    as_json: Json = False,
) -> None:
    """Examine a board: link, firmware, sensor, self-tests, sampling, bus, flash, parameters.

    Exit code 0: nothing fails. 1: something does; each line says what to do. 2: nobody answers.
    """
    name = chosen_port(port)
    console = Console(highlight=False, soft_wrap=True)
    checks = []
    with open_port(name, baud) as opened:
        try:
            for check in examination.Doctor(opened, seconds).examine(bus=bus):
                checks.append(check)
                if not as_json:
                    _tell(console, check)
        except PortVanished:
            raise SolenavError(
                f"{name} vanished in the middle", "plug it in and start again", 1
            ) from None
    failed = [check.name for check in checks if check.verdict == examination.FAIL]
    if as_json:
        say_json({"port": name, "well": not failed, "checks": [c._asdict() for c in checks]})
    if failed:
        raise typer.Exit(1)


def _tell(console: Console, check: examination.Check) -> None:
    if output.is_quiet() and check.verdict in (examination.PASS, examination.SKIP):
        return
    style = _STYLES[check.verdict]
    console.print(f"[{style}]{check.verdict:7}[/] {check.name:14} {escape(check.found)}")
    if check.remedy and check.verdict != examination.PASS:
        console.print(f"{'':22} try: {escape(check.remedy)}")
