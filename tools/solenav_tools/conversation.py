"""A conversation with a board: commands go out, what it sends comes in, in its order."""

from __future__ import annotations

import time
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import serial

from solenav.capture.contents import Fragments
from solenav.errors import SolenavError
from solenav.link import NAMES, Damage, Frame, FrameReader, unpack
from solenav.link.schema import need_schema
from solenav_core import messages
from solenav_tools.ports import read_some
from solenav_tools.recorder import Asker

PATIENCE_S = 1.0
"""So long an answer is waited for before the same is asked again."""
TRIES = 10
FLASH = "flash the firmware that goes with this host version"
_HELLO_S = 5.0
_PARAMS_S = 3.0
_ERROR = messages.LEVELS.index("error")


class Refused(SolenavError):
    """The board won't do what it was asked to; `said`: what it logged about that, or ""."""

    def __init__(self, what: str, said: str, remedy: str) -> None:
        super().__init__(f"the board refuses {what}" + f": {said}" * bool(said), remedy, 1)
        self.said = said


class Conversation:
    """With the board at an open port. PortVanished where the other end goes away.

    `seen` is shown each frame and each damage once, whatever is being waited for.
    """

    def __init__(
        self, port: serial.Serial, seen: Callable[[Frame | Damage], None] = lambda item: None
    ) -> None:
        self.where = str(port.name)
        self._port = port
        self._asker = Asker(port)
        self._reader = FrameReader()
        self._seen = seen
        self._waiting: deque[Frame | Damage] = deque()
        self._damaged = 0

    def ask(self, kind: int, *values: int) -> int:
        """Send a command, without waiting for what becomes of it; its seq."""
        return self._asker.ask(kind, *values)

    def items(self) -> Iterator[Frame | Damage]:
        """What has come, perhaps nothing within 50 ms; what isn't taken stays for the next call.

        Call it often: it tells the board that somebody listens.
        """
        self._asker.listen()
        if not self._waiting:
            self._waiting.extend(self._reader.feed(read_some(self._port)))
        while self._waiting:
            item = self._waiting.popleft()
            self._damaged += isinstance(item, Damage)
            self._seen(item)
            yield item

    def frames(self) -> Iterator[Frame]:
        """The whole frames among `items`."""
        return (item for item in self.items() if isinstance(item, Frame))

    def answer(self, kind: int, seconds: float) -> Frame | None:
        """The first frame of a kind that comes within so many seconds; None where none does."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for frame in self.frames():
                if frame.kind == kind:
                    return frame
        return None

    def hellos(self, seconds: float, *, quiet_s: float = 0.0) -> Iterator[dict[str, Any]]:
        """The fields of each HELLO within so many seconds, which is asked for again and again.

        Nothing is asked in the first `quiet_s`: a board that boots speaks by itself.
        """
        began = time.monotonic()
        again = began + quiet_s
        while (now := time.monotonic()) < began + seconds:
            if now >= again:
                again = now + PATIENCE_S
                self.ask(messages.ASK_HELLO)
            for frame in self.frames():
                if frame.kind == messages.HELLO:
                    yield unpack(frame)

    def hello(self) -> dict[str, Any]:
        """Who is there. SolenavError where that is nobody, or one of another schema."""
        for hello in self.hellos(_HELLO_S):
            need_schema(hello, self.where)
            return hello
        raise SolenavError(
            f"nobody says HELLO at {self.where}"
            + f", but {self._damaged} bursts of something else came" * bool(self._damaged),
            "check that it is the UART's port and not the REPL's, TX and RX, the baud rate; "
            "flash the firmware",
        )

    def params(self) -> array[int] | None:
        """The parameters that follow HELLO, asked for again where they don't; None: in vain."""
        fragments = Fragments()
        end = time.monotonic() + _PARAMS_S
        again = time.monotonic() + PATIENCE_S
        while (now := time.monotonic()) < end:
            if now >= again:
                again = now + PATIENCE_S
                self.ask(messages.ASK_HELLO)
            for frame in self.frames():
                whole = fragments.add(frame) if frame.kind == messages.PARAMS else None
                if whole is not None and len(whole) == 4 * len(messages.NAMES):
                    return array("i", whole)
        return None

    def asked(self, kind: int, *values: int, what: str = "", remedy: str = FLASH) -> None:
        """A command, carried out. Refused, or SolenavError where it isn't heard.

        `what`: the command in words.
        """
        what = what or NAMES[kind]
        said: list[str] = []
        for _try in range(TRIES):
            seq = self.ask(kind, *values)
            end = time.monotonic() + PATIENCE_S
            while time.monotonic() < end:
                for frame in self.frames():
                    if frame.kind not in (messages.ACK, messages.LOG):
                        continue
                    fields = unpack(frame)
                    if frame.kind == messages.LOG:
                        if fields["level"] == _ERROR:
                            said.append(fields["text"].decode("utf-8", "replace"))
                    elif (fields["command"], fields["command_seq"]) == (kind, seq):
                        if fields["result"] in (messages.DONE, messages.REPEATED):
                            return
                        raise Refused(what, "; ".join(said), remedy)
        raise unheard(self.where, what)


def unheard(where: str, what: str) -> SolenavError:
    """The error where a board that was there has no answer to a command."""
    return SolenavError(f"{where}: no answer to {what}", "look at it with `solenav doctor`", 1)
