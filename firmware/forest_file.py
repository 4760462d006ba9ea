"""Another forest than the one in the core: from the host, into `forest.bin`, from there at boot."""

import os
import sys
from array import array
from struct import unpack_from

import solenav_core.tables
from solenav_core import navigator
from solenav_core.compat import const
from solenav_core.forest import WORDS_MAX, objection
from solenav_core.framing import HEADER
from solenav_core.messages import ASK_FOREST, DONE, FORMATS, REFUSED

FILE = "forest.bin"
_PIECE = const(12)  # words in a command
_ERROR = const(2)


def load(problems):
    """The words in the file; None without one. What is no forest goes to `problems` as a text."""
    try:
        size = os.stat(FILE)[6]
        if size % 4 or size > 4 * WORDS_MAX:
            problems.append("%s: %d bytes are no forest: the shipped one is used" % (FILE, size))
            return None
        words = array("i", bytes(size))
        with open(FILE, "rb") as file:
            file.readinto(words)
    except OSError:
        return None
    wrong = objection(words)
    if wrong:
        problems.append("%s: %s: the shipped forest is used" % (FILE, wrong))
        return None
    return words


def tables(forest):
    """The core's tables with a forest; None: the shipped one.

    What the tables are made of doesn't stay in the heap: a Pico hasn't got room for it twice.
    """
    made = navigator.new_tables(forest)
    for module in ("forest", "lookup"):
        del sys.modules["solenav_core.tables." + module]
    del solenav_core.tables.forest, solenav_core.tables.lookup
    return made


class Upload:
    """Pieces of a forest, in order; the last one is answered by what became of it.

    `idle()` says whether nothing is being sampled, `plant(words)` puts a forest (None: the shipped
    one) into the core, `log(level, text)` tells people.
    """

    def __init__(self, link, idle, plant, log):
        self.commands = {ASK_FOREST: self._take}
        self._link = link
        self._idle = idle
        self._plant = plant
        self._log = log
        self._words = None
        self._have = 0

    def _take(self):
        arguments = unpack_from(FORMATS[ASK_FOREST], self._link.command, HEADER)
        at, total = arguments[:2]
        if not self._idle():
            return self._end(REFUSED)
        if total == 0:
            self._plant(None)
            self._forget()
            return self._end(DONE)
        if at == 0 and total <= WORDS_MAX:
            self._words = array("i", bytes(4 * total))
            self._have = 0
            # Each piece is answered before the next: a budget would only slow it down.
            self._link.unlimited = ASK_FOREST
        words = self._words
        if words is None or total != len(words) or not at <= self._have <= at + _PIECE:
            return self._end(REFUSED)
        # A piece may come twice, where its answer was lost.
        for i in range(min(_PIECE, total - at)):
            words[at + i] = arguments[2 + i]
        self._have = min(at + _PIECE, total)
        if self._have < total:
            return DONE
        return self._end(self._keep(words))

    def _keep(self, words):
        """What becomes of a whole forest."""
        wrong = objection(words)
        if wrong:
            self._log(_ERROR, "that is no forest: " + wrong)
            return REFUSED
        try:
            # The old one goes first: half a file would be told at each boot.
            self._forget()
            with open(FILE + ".new", "wb") as file:
                file.write(words)
            os.rename(FILE + ".new", FILE)
        except OSError as error:
            self._log(_ERROR, "can't keep the forest in flash: %s" % error)
            return REFUSED
        self._plant(words)
        return DONE

    @staticmethod
    def _forget():
        try:
            os.remove(FILE)
        except OSError:
            pass  # there was none

    def _end(self, result):
        self._words = None
        self._link.unlimited = 0
        return result
