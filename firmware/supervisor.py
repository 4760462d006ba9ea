"""What keeps a run honest: the sensor's clock, the sensor's settings, progress of the loop.

What is tried with a sensor that fails, and in which order, is `Sampler.resume`'s; when that is
called, and what becomes of the run meanwhile, is the application's.
"""

from array import array
from time import ticks_diff, ticks_ms

import machine

from solenav_core import navigator
from solenav_core.compat import const
from solenav_core.layout import STATE_FIELDS, offsets
from solenav_core.params import NAMES, retimed

_TICK = offsets(STATE_FIELDS)["TICK"]
_DT = NAMES.index("DT")

_FIRST_LOOK = const(256)  # samples after which the learned period is worth something
_LOOKS_MAX = const(2048)  # most samples from one look to the next
_OFF = const(1000)  # a clock that is off by one part in so many gets parameters of its own
_WRONG = const(10)  # off by one part in so few, it is no clock: something else is wrong

_BOOT_WINDOW_MS = const(8000)
_BITTEN_WINDOW_MS = const(2000)
_TIMEOUT_MS = const(8388)  # the longest that an RP2040's watchdog waits


class Clock:
    """The sensor's time: `params` are the core's, for the sample period as it really is.

    They are made of `base`, which is for the nominal rate, by `params.retimed`.
    """

    def __init__(self, base):
        self.params = base[:]
        self.base = base
        self._next = _FIRST_LOOK

    def restart(self):
        """Samples are counted anew. What was learned holds until more is known."""
        self._next = _FIRST_LOOK

    def follow(self, sampler):
        """After each sample: whether the parameters have just changed.

        Looks after 256, 1024, then every 2048 samples, and allocates only then.
        """
        if sampler.samples < self._next:
            return False
        self._next += min(3 * self._next, _LOOKS_MAX)
        # Not every sample has a time of its own.
        return sampler.intervals >= _FIRST_LOOK // 2 and self.set(sampler.period())

    def set(self, period_q8):
        """Samples come every `period_q8` / 256 µs (0: unknown): whether that changes anything."""
        if not _apart(period_q8, self.params, _OFF) or _apart(period_q8, self.base, _WRONG):
            return False
        retimed(self.params, self.base, period_q8)
        return True


def _apart(period_q8, params, parts):
    """Whether a period is off by more than 1 / `parts` of what the parameters say."""
    said = params[_DT] * 15625 >> 16  # Q30 s in Q8 µs
    return abs(period_q8 - said) * parts > said


class Trust:
    """Whether the sensor measures as it was told to: it may lose that to a dip of its supply.

    At another scale a g looks like eight, and nothing else tells. So the run is kept as it was
    when the registers were last seen to be right.
    """

    def __init__(self, sensor):
        self._sensor = sensor
        self._sure = array("i", bytes(4 * navigator.SAVED))
        self._tick = 0

    def restart(self, state):
        """The sensor has just been set up."""
        navigator.save(state, self._sure)
        self._tick = state[_TICK]

    def keeps(self, state):
        """Now and then: False where the registers have changed since the last time.

        `state` has gone back to then, with a gap, and is to go on from there.
        """
        try:
            sound = self._sensor.check()
        except OSError:
            return True  # the sampler meets a dead bus as well, and knows what to do
        if sound:
            self.restart(state)
        else:
            navigator.load(state, self._sure, state[_TICK] - self._tick)
        return sound


class Watchdog:
    """Restarts the board once nobody has fed it for 8.4 s.

    The first meal after the boot window arms it: 8 s in which a person can get in through the
    REPL, 2 s after a restart by watchdog, as what has hung may hang again. Nothing stops it then.
    """

    def __init__(self, wanted):
        bitten = machine.reset_cause() == machine.WDT_RESET
        self._wanted = wanted
        self._window = _BITTEN_WINDOW_MS if bitten else _BOOT_WINDOW_MS
        self._since = ticks_ms()
        self._dog = None

    def feed(self):
        """The loop has made progress."""
        if self._dog:
            self._dog.feed()
        elif self._wanted and ticks_diff(ticks_ms(), self._since) >= self._window:
            self.arm()

    def arm(self):
        """From now on, if it is wanted at all."""
        if self._wanted and not self._dog:
            self._dog = machine.WDT(timeout=_TIMEOUT_MS)
