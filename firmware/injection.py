"""A host's samples instead of the sensor's: what this board's processor makes of them.

The board's own run waits meanwhile and is gone on with afterwards, as after a hole in its samples,
also where the host falls silent.
"""

from struct import pack_into, unpack_from
from time import ticks_diff, ticks_ms

from solenav_core import navigator
from solenav_core.compat import const
from solenav_core.framing import HEADER
from solenav_core.layout import STATE_FIELDS, offsets
from solenav_core.messages import (
    ASK_INJECT,
    ASK_PARAM,
    DONE,
    FORMATS,
    INJECT,
    INJECTED,
    REFUSED,
    SIZES,
    UNANSWERED,
)
from solenav_core.params import conflict
from solenav_core.tables.defaults import LARGEST, LEAST

_TICK = offsets(STATE_FIELDS)["TICK"]
_SILENCE = const(5000)  # ms after which the host counts as gone


class Injection:
    """`lend` ends the board's own sampling, `resume` goes on with it.

    `state`, `params`, `work`, `tables` are the core's; the first two are put back at the end, the
    last may be exchanged.
    """

    def __init__(self, link, state, params, work, tables, lend, resume):
        self.active = False
        self.tables = tables
        self.commands = {
            ASK_INJECT: self._ask,
            ASK_PARAM: self._set,
            INJECT: self._inject,
        }
        self._link = link
        self._state = state
        self._params = params
        self._work = work
        self._lend = lend
        self._resume = resume
        self._kept = None
        self._sample = navigator.new_sample()
        self._heard = 0
        self._checked = False

    def watch(self):
        """Whether the host fell silent; then the board is its own again."""
        if self.active and ticks_diff(ticks_ms(), self._heard) > _SILENCE:
            self._end()
            return True
        return False

    def _ask(self):
        (begin,) = self._arguments(ASK_INJECT)
        if not begin:
            if self.active:
                self._end()
            return DONE
        if not self.active:
            # Copies: both hold the board's own run.
            self._kept = self._state[:], self._params[:]
            self._lend()
            self.active = True
            # Each one is answered before the next: a budget would only slow it down.
            self._link.unlimited = INJECT
        navigator.reset(self._state)
        self._checked = False
        self._heard = ticks_ms()
        return DONE

    def _set(self):
        index, value = self._arguments(ASK_PARAM)
        if not self.active or index >= len(self._params):
            return REFUSED
        if not LEAST[index] <= value <= LARGEST[index]:
            return REFUSED
        self._params[index] = value
        self._checked = False
        self._heard = ticks_ms()
        return DONE

    def _inject(self):
        """One tick; one that isn't the next only tells where the run is."""
        if not self.active:
            return REFUSED
        if not self._checked:
            # Only now: each parameter by itself may be at odds with one that is still to come.
            if conflict(self._params):
                return REFUSED
            self._checked = True
        self._heard = ticks_ms()
        state = self._state
        words = self._arguments(INJECT)
        if words[0] == state[_TICK]:
            sample = self._sample
            for i in range(len(sample)):
                sample[i] = words[1 + i]
            navigator.tick(state, self._params, self._work, self.tables, sample)
        link = self._link
        pack_into(FORMATS[INJECTED], link.frame, HEADER, navigator.digest(state))
        link.send(INJECTED, state[_TICK], HEADER + SIZES[INJECTED])
        return UNANSWERED

    def _end(self):
        self.active = False
        self._link.unlimited = 0
        state, params = self._kept
        self._kept = None
        for i in range(len(state)):
            self._state[i] = state[i]
        for i in range(len(params)):
            self._params[i] = params[i]
        self._resume()

    def _arguments(self, kind):
        return unpack_from(FORMATS[kind], self._link.command, HEADER)
