"""The navigator: owns the state, runs the tick.

`tick` is the one entry point: a raw sample goes in, the state changes, nothing is allocated.
Everything that the navigator knows is in the state, so its bytes are the snapshot and their
CRC-32 is the digest.
"""

from array import array
from binascii import crc32

from solenav_core.align import align
from solenav_core.compat import const, micropython, ptr32
from solenav_core.covariance import grow
from solenav_core.detector import detect, push
from solenav_core.layout import SAMPLE_FIELDS, STATE_FIELDS, WORK_FIELDS, size
from solenav_core.particles import stir, update
from solenav_core.qmath import clamp
from solenav_core.steps import stood, swung
from solenav_core.strapdown import correct_rate, propagate, recentre

# What `tick` returns: bits.
ALIGNED = 1  # a static start was taken on this tick; a better one may follow
STANCE = 2
STEP = 4  # a step's figures are settled
RESAMPLED = 8
LOCKED_OUT = 16  # H1: zero velocity accepted after the filter had been locked out

_TOP = const(0x3FFFFFFF)

_S_TICK = const(0)
_S_MODE = const(1)
_S_AL_DONE = const(4)
_S_STANCE = const(21)
_S_STILL_TICKS = const(23)
_S_BIAS = const(71)
_S_SWING_TICKS = const(93)
_S_OBSERVED = const(96)
_S_SINCE_CONSISTENT = const(98)
_S_POS_LAST = const(507)
_S_POS_REF = const(510)
_P_BIAS_MAX = const(10)
_P_STILL_TICKS = const(22)
_P_STILL_GAIN = const(23)
_P_FREEZE_TICKS = const(29)
_P_STEP_SWING = const(44)
_P_UNREST_MAX = const(19)
_W_RATE = const(3)
_W_UNREST = const(6)


def new_state():
    """A navigator before its first sample: `array('i')` of the layout's size."""
    return array("i", bytes(4 * size(STATE_FIELDS)))


def new_work():
    """The tick's work area; its contents never outlive a tick."""
    return array("i", bytes(4 * size(WORK_FIELDS)))


def new_sample():
    """A sample for `tick`: ax ay az gx gy gz mx my mz flags."""
    return array("i", bytes(4 * size(SAMPLE_FIELDS)))


def reset(state):
    """Back to before the first sample."""
    for i in range(len(state)):
        state[i] = 0


def digest(state):
    """CRC-32 of the state's bytes (little-endian words)."""
    return crc32(state)


@micropython.viper
def rest(s: ptr32, p: ptr32, w: ptr32) -> int:
    """Zero angular rate: a long enough still takes the rate into the bias (step 5)."""
    if s[_S_STILL_TICKS] <= p[_P_STILL_TICKS]:
        return 0
    i = 0
    while i < 3:
        # RATE is Q8, the bias Q20, the gain Q22: 8 + 22 - 10 = 20.
        taken = (w[_W_RATE + i] * p[_P_STILL_GAIN] + 512) >> 10
        s[_S_BIAS + i] = int(clamp(s[_S_BIAS + i] + taken, p[_P_BIAS_MAX] << 20))
        i = i + 1
    return 1


@micropython.viper
def tick(s: ptr32, p: ptr32, w: ptr32, t: ptr32, m: ptr32) -> int:
    """One sample `m` into the state `s`; returns the event bits above.

    `p` parameters, `w` work area, `t` tables. Order: docs/algorithm.md.
    """
    if (s[_S_TICK] >> 24) < 127:  # 123 days at 200 Hz; then it stops, short of the word
        s[_S_TICK] = s[_S_TICK] + 1
    int(push(s, p, m))
    events = 0
    if s[_S_AL_DONE] == 0:
        start = int(align(s, p, w, m))
        if start:
            events = 1
        if start == 1 or s[_S_MODE] == 0:
            return events
    int(stir(s))
    int(correct_rate(s, w, m))
    int(propagate(s, p, w, m))
    if s[_S_SWING_TICKS] <= p[_P_FREEZE_TICKS]:
        int(grow(s, p))
    if s[_S_SINCE_CONSISTENT] < _TOP:
        s[_S_SINCE_CONSISTENT] = s[_S_SINCE_CONSISTENT] + 1
    if int(detect(s, p, w)) == 0:
        if s[_S_SWING_TICKS] < _TOP:
            s[_S_SWING_TICKS] = s[_S_SWING_TICKS] + 1
        if s[_S_SWING_TICKS] >= p[_P_STEP_SWING]:
            s[_S_AL_DONE] = 1
        s[_S_STANCE] = 0
        s[_S_OBSERVED] = 0
        int(recentre(s))
        return events | int(swung(s, p)) << 2
    fresh = 1 - s[_S_STANCE]
    s[_S_STANCE] = 1
    s[_S_SWING_TICKS] = 0
    if fresh:
        i = 0
        while i < 3:
            s[_S_POS_REF + i] = s[_S_POS_LAST + i]
            i = i + 1
    int(rest(s, p, w))
    if w[_W_UNREST] > p[_P_UNREST_MAX]:
        s[_S_OBSERVED] = 0
    else:
        fresh = 1 - s[_S_OBSERVED]
        s[_S_OBSERVED] = 1
        events = events | int(update(s, p, w, t, fresh)) << 3
    int(stood(s, p, w, t))
    int(recentre(s))
    return events | 2
