"""Another forest into a board, which keeps it in flash."""

from __future__ import annotations

from array import array
from binascii import crc32

import serial

from solenav import link
from solenav.errors import SolenavError
from solenav_core import forest, messages
from solenav_tools.conversation import Conversation

# Words in a command, as the schema has it.
_PIECE = next(count for name, _c, count, *_ in link.FIELDS[messages.ASK_FOREST] if name == "words")


def upload(port: serial.Serial, words: array[int]) -> None:
    """Send a forest (words as `forests.pack` makes) to a board that isn't sampling.

    No words: back to the shipped one. SolenavError where the board is of another schema, doesn't
    answer, or refuses: it samples, its flash is full, or these are no forest.
    """
    talk = Conversation(port)
    talk.hello()
    remedy = "stop it first, and look at its log for why"
    if not words:
        talk.asked(messages.ASK_FOREST, 0, 0, *[0] * _PIECE, remedy=remedy)
        return
    # The board checks as well; but a host should not send what it can tell is wrong.
    wrong = forest.objection(words)
    if wrong:
        raise SolenavError(f"no forest: {wrong}", "export it anew")
    for at in range(0, len(words), _PIECE):
        piece = words[at : at + _PIECE]
        padded = [*piece, *[0] * (_PIECE - len(piece))]
        talk.asked(messages.ASK_FOREST, at, len(words), *padded, remedy=remedy)
    if talk.hello()["forest"] != crc32(words):
        raise SolenavError("the board has another forest than was sent", "send it again", 1)
