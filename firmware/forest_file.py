"""Another forest than the one in the core: from the host, into `forest.bin`, from there at boot."""

import gc
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
_NEW = "forest.new"
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
    except MemoryError:
        problems.append("%s: no room for %d words: the shipped forest is used" % (FILE, size // 4))
        return None
    wrong = objection(words)
    if wrong:
        problems.append("%s: %s: the shipped forest is used" % (FILE, wrong))
        return None
    return words


def tables(forest):
    """The core's tables with a forest; None: the shipped one. MemoryError.

    What the tables are made of doesn't stay in the heap: a Pico hasn't got room for it twice.
    """
    made = navigator.new_tables(forest)
    for module in ("forest", "lookup"):
        del sys.modules["solenav_core.tables." + module]
    del solenav_core.tables.forest, solenav_core.tables.lookup
    return made


def planted(tables, forest):
    """`tables` with another forest (None: the shipped one). MemoryError.

    Beside the ones in use a Pico has room for the new ones, but not for making them as at boot.
    """
    if forest is None:
        from solenav_core.tables.forest import FOREST

        forest = array("i", FOREST)
        del sys.modules["solenav_core.tables.forest"], solenav_core.tables.forest, FOREST
    gc.collect()
    return navigator.with_forest(tables, forest)


def _remove(path):
    try:
        os.remove(path)
    except OSError:
        pass  # there was none


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
        self._ended = None  # place of the last piece, total, and what became of the forest

    def _take(self):
        arguments = unpack_from(FORMATS[ASK_FOREST], self._link.command, HEADER)
        at, total = arguments[:2]
        piece = arguments[2:]
        if not self._idle():
            return self._end(REFUSED)
        if total == 0:
            self._plant(None)
            _remove(FILE)
            return self._end(DONE)
        if at == 0 and total <= WORDS_MAX:
            try:
                self._words = array("i", bytes(4 * total))
            except MemoryError:
                self._log(_ERROR, "no room for a forest of %d words" % total)
                return self._end(REFUSED)
            self._have = 0
            self._ended = None
            # Each piece is answered before the next: a budget would only slow it down.
            self._link.unlimited = ASK_FOREST
        # A piece may come twice, where its answer was lost: the last one as well.
        if self._ended and self._ended[:2] == (at, total):
            return self._ended[2]
        words = self._words
        if words is None or total != len(words) or not at <= self._have <= at + len(piece):
            return self._end(REFUSED)
        for i in range(min(len(piece), total - at)):
            words[at + i] = piece[i]
        self._have = min(at + len(piece), total)
        if self._have < total:
            return DONE
        result = self._keep(words)
        self._ended = at, total, result
        return self._end(result)

    def _keep(self, words):
        """What becomes of a whole forest."""
        wrong = objection(words)
        if wrong:
            self._log(_ERROR, "that is no forest: " + wrong)
            return REFUSED
        try:
            with open(_NEW, "wb") as file:
                file.write(words)
            # Only a whole one takes the old one's place.
            os.rename(_NEW, FILE)
        except OSError as error:
            _remove(_NEW)
            self._log(_ERROR, "can't keep the forest in flash: %s" % error)
            return REFUSED
        self._plant(words)
        return DONE

    def _end(self, result):
        self._words = None
        self._link.unlimited = 0
        return result
