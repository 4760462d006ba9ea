"""The firmware on the simulated board, and a client of it that shares nothing with the host's."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import serial
import wire
from wire import Message

from solenav_core import messages
from solenav_tools.board import Samples, SimulatedBoard


class Client:
    """What a recorder sees of the board."""

    def __init__(self, port: serial.Serial) -> None:
        self.port = port
        self.data = b""
        self._decoded = 0  # bytes
        self._seen = 0  # messages
        self.messages: list[Message] = []

    def read(self) -> bool:
        """Whatever comes within half a second; False once the board is gone."""
        try:
            self.data += self.port.read(max(1, min(self.port.in_waiting, 4096)))
        except (serial.SerialException, OSError):
            return False
        whole = self.data.rfind(b"\0") + 1
        self.messages += wire.decode(self.data[self._decoded : whole])
        self._decoded = max(whole, self._decoded)
        return True

    def to_the_end(self, seconds: float = 60) -> None:
        """All that comes until the board is gone."""
        deadline = time.monotonic() + seconds
        while self.read():
            assert time.monotonic() < deadline, "the board doesn't end"

    def until(self, wanted: Callable[[Message], bool], seconds: float = 20) -> Message:
        """The first message that is wanted, after the one that was returned last."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            while self._seen < len(self.messages):
                self._seen += 1
                if wanted(self.messages[self._seen - 1]):
                    return self.messages[self._seen - 1]
            if not self.read():
                break
        raise AssertionError(f"it never came; last: {self.messages[-3:]}")

    def ask(self, kind: int, seq: int, payload: bytes = b"") -> int:
        """Send a command; its result."""
        self.port.write(wire.command(kind, seq, payload))
        return self.until(
            lambda m: (
                m.name == "ACK" and (m.fields["command"], m.fields["command_seq"]) == (kind, seq)
            )
        ).fields["result"]

    def named(self, name: str) -> list[Message]:
        return [m for m in self.messages if m.name == name]

    def texts(self) -> list[tuple[str, str]]:
        return [
            (messages.LEVELS[m.fields["level"]], m.fields["text"].decode())
            for m in self.named("LOG")
        ]


@contextmanager
def on(
    feed: Samples | Path, config: dict[str, Any] | None = None, **options: Any
) -> Iterator[tuple[SimulatedBoard, Client]]:
    """A board, switched on, and its client."""
    with (
        SimulatedBoard(feed, config, **options) as board,
        serial.Serial(board.port, 460800, timeout=0.5) as port,
    ):
        yield board, Client(port)


def run(feed: Samples | Path, config: dict[str, Any] | None = None, **options: Any) -> Client:
    """A whole run, from switching on to the feed's end."""
    with on(feed, config, **options) as (board, client):
        client.to_the_end()
        assert board.wait(5) == 0
        assert board.stderr == ""
        board.check()
    return client
