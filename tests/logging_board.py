"""The firmware's link, black box and download on CPython, over simulated flash."""

from __future__ import annotations

from pathlib import Path
from struct import pack_into
from types import SimpleNamespace
from typing import Any

import device

from solenav import link
from solenav.sim.board import flash, simtime
from solenav_core import messages
from solenav_core.framing import HEADER

TURN_US = 50_000
TICKS = TURN_US // 5000  # a turn of this board's loop
SECOND = 200  # ticks

_log: list[str] = []
LINK, BLACKBOX, DOWNLOAD = device.load(
    "link",
    "blackbox",
    "download",
    os=flash,
    reports=SimpleNamespace(log=lambda _link, _tick, _level, text: _log.append(text)),
)
BLACKBOX.open = DOWNLOAD.open = flash.open

Frame = tuple[int, int]  # type, tick


class Board:
    """A board that walks: frames of all types, as the application would send them.

    `folder` is the flash. `cut`: (operation, byte) of the flash at which the power goes. `line`:
    the UART takes what it gets; else it is stuck, which saves the work of framing for it. `sent`
    are all frames, in order.
    """

    def __init__(
        self,
        folder: Path,
        policy: str = "stop",
        everything: bool = False,
        *,
        capacity: int = 1_400_000,
        torn: bool = False,
        cut: tuple[int, int] = (0, 0),
        line: bool = False,
    ) -> None:
        folder.mkdir(exist_ok=True)
        simtime.clear()
        flash.mount(f"{folder}/", {"capacity": capacity, "torn": torn})
        flash.cut(*cut, lambda: simtime.end(1))
        _log.clear()
        self.log = _log
        self.folder = folder
        self.uart = device.Uart()
        self.uart.takes = 1 << 30 if line else 0
        self.sent: list[Frame] = []
        self.tick = 0
        self.link: Any = LINK.Link(self.uart)
        arguments = (self.link, policy, everything, SECOND, self.describe)
        self.box: Any = BLACKBOX.BlackBox(*arguments)
        self.download: Any = DOWNLOAD.Download(self.link, self.box)
        self.describe()

    def send(self, kind: int) -> None:
        self.sent.append((kind, self.tick))
        # HELLO says the schema first; what the other fields are is nobody's business here.
        pack_into("<H", self.link.frame, HEADER, messages.SCHEMA)
        self.link.send(kind, self.tick, HEADER + messages.SIZES[kind])

    def describe(self) -> None:
        self.send(messages.HELLO)
        self.send(messages.PARAMS)

    def turn(self) -> None:
        """50 ms: ten samples."""
        for _ in range(TICKS):
            self.tick += 1
            self.send(messages.SAMPLE)
            if self.tick % 4 == 0:
                self.send(messages.POSE)
            if self.tick % 210 == 0:
                self.send(messages.STEP)
            if self.tick % SECOND == 0:
                self.send(messages.STATUS)
            if self.tick % 2000 == 0:
                self.send(messages.SNAPSHOT)
        command = self.link.receive(self.tick)
        while command:
            handler = self.download.commands.get(command, self.describe)
            self.link.acknowledge(handler() or messages.DONE, self.tick)
            command = self.link.receive(self.tick)
        simtime.advance(TURN_US)
        # As in the loop: again and again until the next sample.
        for _ in range(8):
            self.download.step(self.tick) or self.box.step(self.tick)
            self.link.pump()

    def run(self, seconds: float, *, listening: bool = False) -> None:
        """Walk on, with a host that says every 2 s that it listens, or without one."""
        for turn in range(round(seconds * 1_000_000 / TURN_US)):
            if listening and turn % 40 == 0:
                self.box.listen()
            self.turn()

    def files(self) -> list[list[link.Frame | link.Damage]]:
        """What the files hold, oldest first."""
        out = []
        for path in sorted((self.folder / "log").glob("*.frames")):
            reader = link.FrameReader()
            out.append([*reader.feed(path.read_bytes()), *reader.close()])
        return out

    def kept(self) -> list[Frame]:
        """Type and tick of all frames in the files; AssertionError where one is damaged."""
        items = [item for file in self.files() for item in file]
        assert not any(isinstance(item, link.Damage) for item in items)
        return [item[:3:2] for item in items]


def wanted(sent: list[Frame]) -> list[Frame]:
    """What of all frames the black box takes: no samples, no snapshots, a pose a second."""
    out = []
    last = -SECOND
    for kind, tick in sent:
        if kind in (messages.SAMPLE, messages.SNAPSHOT):
            continue
        if kind == messages.POSE:
            if tick - last < SECOND:
                continue
            last = tick
        out.append((kind, tick))
    return out
