"""Recording a board: bytes from a port into a capture, as they come."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator

import serial

from solenav.capture import CaptureWriter
from solenav.link import Damage, Frame, FrameReader, FrameWriter
from solenav_core import messages
from solenav_tools.ports import read_some, send


def ask(port: serial.Serial, *commands: int) -> None:
    """Send commands to the board.

    The first seq is drawn: a board answers the same command with the same seq only once.
    """
    frames = FrameWriter(random.randrange(256))
    for command in commands:
        send(port, frames.frame(command, 0))


def join_in(port: serial.Serial) -> None:
    """Ask a running board for all that a recording needs to be verified from here on."""
    ask(port, messages.ASK_HELLO, messages.ASK_SNAPSHOT)


def stream(
    port: serial.Serial,
    writer: CaptureWriter | None,
    until: Callable[[], bool] = lambda: False,
) -> Iterator[Frame | Damage | None]:
    """What the board sends, frame by frame; None after a quiet 50 ms.

    Every byte goes to `writer` before anybody looks at it. Ends when `until` says so;
    PortVanished where the other end goes away.
    """
    reader = FrameReader()
    while not until():
        data = read_some(port)
        if not data:
            yield None
            continue
        if writer is not None:
            writer.write(time.time(), data)
        yield from reader.feed(data)
