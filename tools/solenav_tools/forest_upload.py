"""Another forest into a board, which keeps it in flash."""

from __future__ import annotations

import time
from array import array
from binascii import crc32
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from solenav import forests, link
from solenav.errors import SolenavError
from solenav.progress import Progress, unseen
from solenav_core import messages
from solenav_core.tables.forest import FOREST
from solenav_tools.conversation import Conversation, Refused
from solenav_tools.ports import PortVanished, open_port

# Words in a command, as the schema has it.
_PIECE = next(count for name, _c, count, *_ in link.FIELDS[messages.ASK_FOREST] if name == "words")
_WHAT = "a forest"


@dataclass(frozen=True)
class Sent:
    """Which forest a board had and has now, as CRC-32; `words` were sent, 0: back to the shipped.

    `restarted`: the board has begun a fresh run with it.
    """

    port: str
    board: str
    had: int
    has: int
    words: int
    restarted: bool
    seconds: float

    @property
    def shipped(self) -> bool:
        """Whether the board has now the forest that ships with this version."""
        return self.has == crc32(FOREST)

    def as_dict(self) -> dict[str, Any]:
        crcs = {"had": f"{self.had:08x}", "has": f"{self.has:08x}"}
        return {**self.__dict__, **crcs, "shipped": self.shipped}


def send(
    port: str,
    words: array[int] | None,
    *,
    restart: bool = False,
    baud: int | None = None,
    progress: Progress = unseen,
) -> Sent:
    """Send a forest to the board at a port; None: back to the one in its firmware.

    `words` are what `train_forest` gives, or `forests.load` of a file. `restart` ends the board's
    run first and begins a fresh one afterwards, whatever became of the forest; without it a board
    that samples refuses. SolenavError where they are no forest of this core, nobody answers, the
    board speaks another schema or refuses, or the port vanishes.
    """
    words = words or array("i")
    # The board checks as well; but a host should not send what it can tell is wrong.
    if words:
        forests.check(words)
    began = time.monotonic()
    with open_port(port, baud) as opened:
        try:
            talk = Conversation(opened)
            hello = talk.hello()
            if restart:
                talk.asked(messages.ASK_STOP)
            try:
                with progress("sending", len(words)) as done:
                    has = _send(talk, words, done)
            except SolenavError:
                if restart:
                    with suppress(SolenavError):
                        talk.asked(messages.ASK_START)
                raise
            if restart:
                talk.asked(messages.ASK_START)
        except PortVanished:
            raise SolenavError(
                f"{port} vanished in the middle: the board has the forest that it had, or all of "
                "the new one" + "; it stands still" * restart,
                "plug it in and send it again",
                1,
            ) from None
    board = hello["text"].decode("utf-8", "replace")
    seconds = round(time.monotonic() - began, 3)
    return Sent(port, board, hello["forest"], has, len(words), restart, seconds)


def _send(talk: Conversation, words: array[int], progress: Callable[[int], None]) -> int:
    """The forest, piece by piece; the CRC-32 of what HELLO then says that the board has."""
    for at in range(0, len(words), _PIECE) if words else (0,):
        piece = words[at : at + _PIECE]
        padded = [*piece, *[0] * (_PIECE - len(piece))]
        try:
            talk.asked(messages.ASK_FOREST, at, len(words), *padded, what=_WHAT)
        except Refused as error:
            # What is wrong with a forest, or with its flash, the board would have logged.
            if at == 0 and not error.said:
                raise SolenavError(
                    f"{talk.where}: the board takes no forest while it samples",
                    "--restart ends its run, and begins a fresh one with the forest",
                    1,
                ) from None
            remedy = "send it again; `solenav doctor` shows how full its flash is"
            raise Refused(_WHAT, error.said, remedy) from None
        progress(at + len(piece))
    has: int = talk.hello()["forest"]
    if words and has != crc32(words):
        raise SolenavError(
            f"the board has the forest {has:08x}, and {crc32(words):08x} was sent",
            "restart the board: its memory may hold no second forest beside the one in use",
            1,
        )
    return has
