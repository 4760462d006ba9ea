"""`solenav emulate`: real MicroPython on an emulated Raspberry Pi Pico, with the sensor on it."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from solenav import capture, importing
from solenav.errors import SolenavError, unreadable
from solenav.sim.gait import SCENARIOS
from solenav_tools import emulated_run
from solenav_tools.cli.output import (
    Json,
    check_output,
    progress,
    say,
    say_json,
    tell,
    warn,
)
from solenav_tools.emulator import uf2 as firmware
from solenav_tools.outcome import need_alignment

if TYPE_CHECKING:
    from solenav_tools.emulator.ports import Port

Uf2 = Annotated[
    str | None,
    typer.Option(
        envvar="SOLENAV_UF2", help="MicroPython for the Pico: a UF2, or a version to download."
    ),
]


def emulate(
    uf2: Uf2 = None,
    walk: Annotated[
        str,
        typer.Option(help=f"What the sensor measures: a capture, or {', '.join(SCENARIOS)}."),
    ] = "loop",
    seconds: Annotated[
        float | None,
        typer.Option(min=3, help="Of a scenario: so long, from 2 s before the first step."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Record the walk here, as fast as it goes; no ports."),
    ] = None,
    pose_every: Annotated[
        int | None,
        typer.Option(min=1, help="A POSE on every n-th tick.  [default: as a board: 4]"),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="More of the firmware's config.json, as a file.")
    ] = None,
    faults: Annotated[
        Path | None, typer.Option(help="A script of faults, as for the simulated board (JSON).")
    ] = None,
    pty: Annotated[
        bool, typer.Option("--pty", help="Ports as pseudo-terminals, the default.")
    ] = False,
    tcp: Annotated[
        int | None,
        typer.Option(min=0, max=65534, help="UART on this TCP port, the console on the next."),
    ] = None,
    empty: Annotated[
        bool, typer.Option("--empty", help="No files on the board: for `solenav flash`.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Run the firmware on an emulated Pico, for flash, monitor, record and verify.

    Prints the port of the UART and that of the USB console, and runs, no faster than a board,
    until the walk is over or Ctrl-C; with -o it records the walk instead.
    """
    if pty and tcp is not None:
        raise SolenavError("--pty and --tcp exclude each other", "choose one")
    if output is not None:
        if empty:
            raise SolenavError("an empty board has nothing to record", "leave out --empty or -o")
        check_output(output, ".solcap")
    image = firmware.find(uf2)
    source = _source(walk, seconds)
    more = _json_file(config, dict, "an object") if config else {}
    script = _json_file(faults, list, "a list of faults") if faults else []
    if output is not None:
        _record(image, source, output, pose_every, more, script, as_json)
    else:
        _serve(image, source, pose_every, more, script, tcp, empty, as_json)


def _source(walk: str, seconds: float | None) -> capture.Capture:
    """A capture, from a file or simulated."""
    from solenav_tools.emulator import run

    if walk not in SCENARIOS:
        if not Path(walk).exists():
            raise SolenavError(
                f"there is no capture {walk}, nor such a scenario",
                f"name a file or one of {', '.join(SCENARIOS)}",
            )
        if seconds is not None:
            raise SolenavError("--seconds is for scenarios", "leave it out")
        return capture.load(Path(walk))
    with tempfile.TemporaryDirectory(prefix="solenav-walk-") as folder:
        path = Path(folder) / "walk.solcap"
        importing.to_capture(run.walk_of(walk, seconds), path)
        return capture.load(path)


def _json_file(path: Path, kind: type, what: str) -> Any:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise unreadable(path, error) from None
    except ValueError as error:
        raise SolenavError(f"{path} is no JSON: {error}", "mend it") from None
    if not isinstance(found, kind):
        raise SolenavError(f"{path} holds no JSON {what}", "mend it")
    return found


def _record(
    uf2: Path,
    source: capture.Capture,
    output: Path,
    pose_every: int | None,
    config: dict[str, Any],
    faults: list[dict[str, Any]],
    as_json: bool,
) -> None:
    span = float(source.samples.rows["time"][-1] - source.samples.rows["time"][0])
    with progress("emulating", int(1000 * (span + 2))) as done:
        outcome = emulated_run.run(
            source,
            output,
            uf2=uf2,
            pose_every=pose_every,
            config=config,
            faults=faults,
            progress=done,
        )
    made = capture.load(output)
    lost = len(source.samples) - len(made.samples)
    result = {"capture": str(output), "samples": len(made.samples), "lost": lost}
    result |= {"emulated_s": round(outcome.seconds, 6), "messages": dict(made.counts)}
    need_alignment(bool(len(made.aligns)), source, output)
    if as_json:
        say_json(result)
    else:
        say(f"{output}: {len(made.samples)} samples through the firmware on an emulated Pico")
        say("  " + ", ".join(f"{count} {name}" for name, count in made.counts.items()))
    if lost:
        warn(f"{lost} samples were lost on the board: `solenav info {output}`")


def _serve(
    uf2: Path,
    source: capture.Capture,
    pose_every: int | None,
    config: dict[str, Any],
    faults: list[dict[str, Any]],
    tcp: int | None,
    empty: bool,
    as_json: bool,
) -> None:
    from solenav_tools.emulator import ports, run
    from solenav_tools.emulator.pico import EmulatedPico

    settings = {**run.settings_for(source, pose_every), **config}
    files = None if empty else run.file_system(settings)
    with EmulatedPico(uf2, files, run.feed_of(source), faults=faults) as pico:
        opened: list[Port] = []
        try:
            for offset in (0, 1):
                opened.append(
                    ports.PseudoTerminal()
                    if tcp is None
                    else ports.TcpPort(tcp + offset if tcp else 0)
                )
            uart, console = opened
            if as_json:
                say_json({"uart": uart.name, "console": console.name})
            else:
                say(f"UART     {uart.name}")
                say(f"console  {console.name}")
            ports.serve(pico, uart, console)
        except KeyboardInterrupt:
            tell(f"switched off after {pico.ns * 1e-9:.1f} s of the board's time")
        finally:
            for port in opened:
                port.close()
