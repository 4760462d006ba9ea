"""`record`: a board's bytes into captures, from the opening of the port to its end."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import serial

from solenav.link import Damage
from solenav_tools.ports import PortVanished, open_port, reopen
from solenav_tools.recorder import Asker, join_in, stream
from solenav_tools.rotation import Limit, Rotation, numbered


@dataclass
class Recorded:
    """What a recording came to; `vanished`: the port went away, and nobody waited for it."""

    files: list[Path] = field(default_factory=list)
    bytes: int = 0
    frames: int = 0
    damaged: int = 0  # frames, kept as they came
    seconds: float = 0.0
    vanished: bool = False


def record(
    port: str,
    output: Path | str,
    *,
    seconds: float | None = None,
    rotate: Limit | None = None,
    reconnect: bool = False,
    baud: int | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Recorded:
    """Record the board at a port until `seconds` are over, the port vanishes, or Ctrl-C.

    With `rotate` or `reconnect` the files are NAME-001.solcap and so on. `tell` hears of ports that
    vanish and come back. SolenavError where the port or a file can't be opened, or the disk is
    full.
    """
    target = Path(output)
    several = rotate is not None or reconnect
    opened = open_port(port, baud)
    start = time.monotonic()
    over = lambda: seconds is not None and time.monotonic() - start >= seconds  # noqa: E731
    notes = {"port": opened.port, "baud": opened.baudrate}
    found = Recorded()
    with Rotation(numbered(target) if several else iter([target]), notes, rotate) as writer:
        try:
            while True:
                try:
                    with opened:
                        _follow(opened, writer, over, found)
                    break
                except PortVanished:
                    if not reconnect:
                        found.vanished = True
                        break
                    tell(f"{port} vanished after {time.monotonic() - start:.1f} s: waiting for it")
                    again = reopen(port, baud, over)
                    if again is None:
                        break
                    opened = again
                    tell(f"{port} is back")
                    writer.next_file()
        except KeyboardInterrupt:
            pass
    found.files, found.bytes = writer.files, writer.written
    found.seconds = round(time.monotonic() - start, 3)
    return found


def _follow(
    port: serial.Serial, writer: Rotation, over: Callable[[], bool], found: Recorded
) -> None:
    """Record until it is over. PortVanished."""
    join_in(port)
    asker = Asker(port)
    for item in stream(port, writer, over, asker):
        found.damaged += isinstance(item, Damage)
        found.frames += item is not None and not isinstance(item, Damage)
        writer.turn(asker)
