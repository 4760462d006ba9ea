"""`solenav record`: a board's bytes into captures."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import serial
import typer

from solenav.errors import SolenavError
from solenav.link import Damage
from solenav_tools.cli.arguments import Baud, Port, Seconds
from solenav_tools.cli.output import Json, check_output, say, say_json, tell, warn
from solenav_tools.ports import PortVanished, chosen_port, open_port, reopen
from solenav_tools.recorder import Asker, join_in, stream
from solenav_tools.rotation import Rotation, limit, numbered


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
    paths = numbered(target) if rotate is not None or reconnect else iter([target])
    port = chosen_port(port)
    opened = open_port(port, baud)
    start = time.monotonic()
    over = lambda: duration is not None and time.monotonic() - start >= duration  # noqa: E731
    counts = {"frames": 0, "damaged": 0}
    gone = False
    with Rotation(paths, {"port": opened.port, "baud": opened.baudrate}, at) as writer:
        try:
            while True:
                try:
                    with opened:
                        _follow(opened, writer, over, counts)
                    break
                except PortVanished:
                    if not reconnect:
                        gone = True
                        break
                    warn(f"{port} vanished after {time.monotonic() - start:.1f} s: waiting for it")
                    again = reopen(port, baud, over)
                    if again is None:
                        break
                    opened = again
                    tell(f"{port} is back")
                    writer.next_file()
        except KeyboardInterrupt:
            pass
    seconds = round(time.monotonic() - start, 3)
    _tell(writer, counts, seconds, gone, as_json)
    if gone:
        raise SolenavError(
            f"{port} vanished after {seconds:.1f} s; all that came is in {writer.files[-1]}",
            "plug the board in again and record on into another file, or use --reconnect",
            1,
        )
    if not counts["frames"]:
        raise SolenavError(
            f"no message came from {port} in {seconds:.1f} s"
            + (f", but {writer.written} bytes of something else" if writer.written else ""),
            "check that it is the solenav board's port, and the baud rate",
            1,
        )


def _follow(
    port: serial.Serial, writer: Rotation, over: Callable[[], bool], counts: dict[str, int]
) -> None:
    """Record until it is over. PortVanished."""
    join_in(port)
    asker = Asker(port)
    for item in stream(port, writer, over, asker):
        counts["damaged"] += isinstance(item, Damage)
        counts["frames"] += item is not None and not isinstance(item, Damage)
        writer.turn(asker)


def _tell(
    writer: Rotation, counts: dict[str, int], seconds: float, gone: bool, as_json: bool
) -> None:
    files = [str(path) for path in writer.files]
    if as_json:
        result = {"capture": files[0], "captures": files, "seconds": seconds}
        say_json({**result, "bytes": writer.written, **counts, "vanished": gone})
    else:
        name = files[0] if len(files) == 1 else f"{files[0]} to {Path(files[-1]).name}"
        say(f"{name}: {counts['frames']} frames, {writer.written} bytes in {seconds:.1f} s")
    if counts["damaged"]:
        warn(f"{counts['damaged']} damaged frames (kept as they came)")
