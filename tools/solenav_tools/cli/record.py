"""`solenav record`: a board's bytes into a capture."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from solenav.capture import CaptureWriter
from solenav.capture.sidecar import write_sidecar
from solenav.errors import SolenavError
from solenav.link import Damage
from solenav_tools.cli.output import Json, check_output, say, say_json, warn
from solenav_tools.ports import BAUD, PortVanished, open_port
from solenav_tools.recorder import join_in, stream

Port = Annotated[str, typer.Argument(help="Serial port of the board.", metavar="PORT")]
Baud = Annotated[int, typer.Option(help="Bits per second.")]
Seconds = Annotated[float | None, typer.Option(help="Stop after so many seconds.")]


def record(
    port: Port,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Capture to write; default: by the time.")
    ] = None,
    duration: Seconds = None,
    baud: Baud = BAUD,
    as_json: Json = False,
) -> None:
    """Record what a board sends until Ctrl-C. A vanished port ends it; nothing read is lost."""
    target = check_output(output or Path(time.strftime("%Y%m%d-%H%M%S.solcap")), ".solcap")
    opened = open_port(port, baud)
    start = time.monotonic()
    frames = damaged = 0
    gone = ""
    with opened, CaptureWriter(target) as writer:
        write_sidecar(target, {"port": port, "baud": baud, "started": time.time()})
        try:
            join_in(opened)
            over = lambda: duration is not None and time.monotonic() - start >= duration  # noqa: E731
            for item in stream(opened, writer, over):
                damaged += isinstance(item, Damage)
                frames += item is not None and not isinstance(item, Damage)
        except PortVanished as error:
            gone = str(error)
        except KeyboardInterrupt:
            pass
    result = {
        "capture": str(target),
        "seconds": round(time.monotonic() - start, 3),
        "bytes": writer.written,
        "frames": frames,
        "damaged": damaged,
        "vanished": bool(gone),
    }
    if as_json:
        say_json(result)
    else:
        say(f"{target}: {frames} frames, {writer.written} bytes in {result['seconds']:.1f} s")
    if damaged:
        warn(f"{damaged} damaged frames (kept as they came)")
    if gone:
        raise SolenavError(
            f"{port} vanished after {result['seconds']:.1f} s; all that came is in {target}",
            "plug the board in again and record on into another file",
            1,
        )
    if not frames:
        raise SolenavError(
            f"no message came from {port} in {result['seconds']:.1f} s"
            + (f", but {writer.written} bytes of something else" if writer.written else ""),
            "check that it is the solenav board's port, and the baud rate",
            1,
        )
