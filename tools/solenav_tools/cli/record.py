"""`solenav record`: a board's bytes into captures."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from solenav.errors import SolenavError
from solenav_tools import recording
from solenav_tools.cli.arguments import Baud, Port, Seconds
from solenav_tools.cli.output import Json, check_output, say, say_json, warn
from solenav_tools.ports import chosen_port
from solenav_tools.rotation import limit


def record(
    port: Port = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Capture to write; default: by the time.")
    ] = None,
    duration: Seconds = None,
    rotate: Annotated[
        str | None,
        typer.Option(help="Begin another file (NAME-002, ...) after so much: 10m, 1h, 100MB."),
    ] = None,
    reconnect: Annotated[
        bool, typer.Option(help="Wait for a vanished port, and go on in another file.")
    ] = False,
    baud: Baud = None,
    as_json: Json = False,
) -> None:
    """Record what a board sends until Ctrl-C. A vanished port ends it; nothing read is lost."""
    target = check_output(output or Path(time.strftime("%Y%m%d-%H%M%S.solcap")), ".solcap")
    at = limit(rotate) if rotate is not None else None
    name = chosen_port(port)
    found = recording.record(
        name, target, seconds=duration, rotate=at, reconnect=reconnect, baud=baud, tell=warn
    )
    files = [str(path) for path in found.files]
    if as_json:
        say_json({**asdict(found), "files": files, "capture": files[0]})
    else:
        shown = files[0] if len(files) == 1 else f"{files[0]} to {found.files[-1].name}"
        say(f"{shown}: {found.frames} frames, {found.bytes} bytes in {found.seconds:.1f} s")
    if found.damaged:
        warn(f"{found.damaged} damaged frames (kept as they came)")
    if found.vanished:
        raise SolenavError(
            f"{name} vanished after {found.seconds:.1f} s; all that came is in {files[-1]}",
            "plug the board in again and record on into another file, or use --reconnect",
            1,
        )
    if not found.frames:
        raise SolenavError(
            f"no message came from {name} in {found.seconds:.1f} s"
            + (f", but {found.bytes} bytes of something else" if found.bytes else ""),
            "check that it is the solenav board's port, and the baud rate",
            1,
        )
