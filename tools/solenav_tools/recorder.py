"""Recording a board: bytes from a port into a capture, as they come."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from typing import Protocol

import serial

from solenav.link import Damage, Frame, FrameReader, command
from solenav_core import messages
from solenav_tools.ports import read_some, send


class Writer(Protocol):
    """Takes bytes with the time (s) at which they came: a `CaptureWriter`, or several in turn."""

    def write(self, arrival: float, data: bytes) -> None: ...


LISTEN_S = 2.0  # the board records by itself when it has heard nothing for 5 s


class Asker:
    """Sends commands, and every 2 s that somebody listens.

    The first seq is drawn: a board answers the same command with the same seq only once.
    """

    def __init__(self, port: serial.Serial) -> None:
        self._port = port
        self._seq = random.randrange(256)
        self._listened = -LISTEN_S

    def ask(self, kind: int, *values: int) -> int:
        """Send a command; its seq. PortVanished."""
        self._seq = (self._seq + 1) & 255
        send(self._port, command(kind, self._seq, *values))
        return self._seq

    def listen(self) -> None:
        """Call it often. PortVanished."""
        now = time.monotonic()
        if now - self._listened >= LISTEN_S:
            self._listened = now
            self.ask(messages.ASK_LISTEN)


def join_in(port: serial.Serial) -> None:
    """Ask a running board for all that a recording needs to be verified from here on."""
    asker = Asker(port)
    asker.listen()
    asker.ask(messages.ASK_HELLO)
    asker.ask(messages.ASK_SNAPSHOT)


def stream(
    port: serial.Serial,
    writer: Writer | None,
    until: Callable[[], bool] = lambda: False,
    asker: Asker | None = None,
) -> Iterator[Frame | Damage | None]:
    """What the board sends, frame by frame; None after a quiet 50 ms. Tells it that we listen.

    Every byte goes to `writer` before anybody looks at it. Ends when `until` says so;
    PortVanished where the other end goes away.
    """
    reader = FrameReader()
    asker = asker or Asker(port)
    while not until():
        asker.listen()
        data = read_some(port)
        if not data:
            yield None
            continue
        if writer is not None:
            writer.write(time.time(), data)
        yield from reader.feed(data)
