"""The navigator: owns the state, runs the tick.

`tick` is the one entry point: a raw sample goes in, the state changes, nothing is allocated.
Everything that the navigator knows is in the state, so its bytes are the snapshot and their
CRC-32 is the digest.
"""

from array import array
from binascii import crc32

from solenav_core.align import align
from solenav_core.calibration import condition
from solenav_core.compat import const, micropython, ptr32
from solenav_core.covariance import grow
from solenav_core.detector import collect, detect, push
from solenav_core.features import observe_motion, summarise
from solenav_core.forest import classify
from solenav_core.heading import steer
from solenav_core.layout import (
    SAMPLE_FIELDS,
    STATE_FIELDS,
    TABLE_FIELDS,
    WORK_FIELDS,
    offsets,
    size,
)
from solenav_core.particles import stir, update
from solenav_core.qmath import clamp
from solenav_core.steps import stood, swung
from solenav_core.strapdown import propagate, recentre
from solenav_core.words import blank, pick

# What `tick` returns: bits.
ALIGNED = 1  # a static start was taken on this tick; a better one may follow
STANCE = 2
STEP = 4  # a step's figures are settled
RESAMPLED = 8
LOCKED_OUT = 16  # H1: zero velocity accepted after the filter had been locked out
BROKEN = 32  # more samples were lost before this one than can be bridged
STEERED = 64  # the magnetometer corrected the heading
CLASSIFIED = 128  # the forest has had its say on a window, whose features are in the state

_TOP = const(0x3FFFFFFF)
_IDLE = const(255)  # features: STAGE of a window that is dealt with
_MAG_NEW = const(8)  # messages.MAG_NEW

_S_TICK = const(0)
_S_MODE = const(1)
_S_LAST = const(3)
_S_GAPS = const(9)
_S_AL_DONE = const(12)
_S_STANCE = const(36)
_S_STILL_TICKS = const(38)
_S_BIAS = const(407)
_S_STRIDE = const(207)
_S_PAUSE = const(208)
_S_STAGE = const(212)
_S_SWING_TICKS = const(429)
_S_OBSERVED = const(432)
_S_SINCE_CONSISTENT = const(434)
_S_POS_LAST = const(843)
_S_POS_REF = const(846)
_P_BIAS_MAX = const(48)
_P_DETECTOR = const(54)
_P_MOTION_STRIDE = const(64)
_P_STILL_TICKS = const(73)
_P_STILL_GAIN = const(74)
_P_FREEZE_TICKS = const(81)
_P_STEP_SWING = const(107)
_P_UNREST_MAX = const(70)
_P_UNREST_SURE = const(71)
_P_BRIDGE_TICKS = const(96)
_P_MAG_GAIN = const(100)
_W_FORCE = const(3)
_W_RATE = const(6)
_I_FLAGS = const(9)
_W_UNREST = const(12)


def new_state():
    """A navigator before its first sample: `array('i')` of the layout's size."""
    return array("i", bytes(4 * size(STATE_FIELDS)))


def new_work():
    """The tick's work area; its contents never outlive a tick."""
    return array("i", bytes(4 * size(WORK_FIELDS)))


def new_sample():
    """A sample for `tick`: ax ay az gx gy gz mx my mz flags."""
    return array("i", bytes(4 * size(SAMPLE_FIELDS)))


def new_tables(forest=None):
    """The tables of a tick: constants, and the forest (words as in forest.py) that is shipped or
    another, which `forest.objection` has let pass."""
    # Not above: so a board can let go of what both are made of.
    from solenav_core.tables.forest import FOREST
    from solenav_core.tables.lookup import TABLES

    tables = array("i", TABLES)
    tables.extend(array("i", FOREST) if forest is None else forest)
    return tables


_FOREST_AT = offsets(TABLE_FIELDS)["FOREST"]


def with_forest(tables, forest):
    """`tables` with other words for the forest: these tables where they fit, else new ones."""
    if len(tables) == _FOREST_AT + len(forest):
        for i, word in enumerate(forest):
            tables[_FOREST_AT + i] = word
        return tables
    made = tables[:_FOREST_AT]
    made.extend(forest)
    return made


def forest_hash(tables):
    """CRC-32 of the forest in the tables: HELLO's `forest`."""
    return crc32(memoryview(tables)[_FOREST_AT:])


def reset(state):
    """Back to before the first sample."""
    blank(state, len(state))


_AT = offsets(STATE_FIELDS)
_WORDS = {name: words for name, words, _stage, _format in STATE_FIELDS}
# What outlives a restart of the board, and so is worth saving.
_KEPT = ("TICK", "MOUNT", "ATT", "POS", "CELL", "BIAS", "GRAVITY", "RNG", "STEPS", "DISTANCE")
_KEPT += ("HEADING_LAST", "RESUMED", "MAG_NORM", "MAG_UP", "MAG_AZ")
_PLACES = array("i", [_AT[name] + i for name in _KEPT for i in range(_WORDS[name])])
SAVED = len(_PLACES)
_FRESH = ("MODE", "AL_COUNT", "AL_DONE", "AL_BEST", "RING_HEAD", "RING_FILL", "STILL_TICKS")
_FRESH += ("STANCE", "OBSERVED", "GLRT_FILL", "STRIDE", "PAUSE", "MOTION")


def resume(state):
    """Go on with the same position, heading and biases after a hole that can't be bridged.

    The next stance levels the foot; until then nothing moves. Without a static start so far
    there is nothing to keep, and the search for one starts anew. The tick goes on by one more
    than the samples do, so that whoever counts them sees the hole.
    """
    state[_AT["TICK"]] += 1
    for name in _FRESH:
        state[_AT[name]] = 0
    if state[_AT["GRAVITY"]] and state[_AT["RESUMED"]] < _TOP:
        state[_AT["RESUMED"]] += 1


def save(state, words):
    """What `load` needs into `words`, `array('i')` of SAVED. False before the first start."""
    pick(state, _PLACES, words, SAVED)
    return state[_AT["GRAVITY"]] != 0


def load(state, words, ticks):
    """Resume from what `save` wrote, at most `ticks` ago; `state` is overwritten."""
    reset(state)
    for at, place in enumerate(_PLACES):
        state[place] = words[at]
    state[_AT["TICK"]] += ticks
    for i in range(3):
        for name in ("POS_LAST", "POS_REF", "POS_STEP"):
            state[_AT[name] + i] = state[_AT["POS"] + i]
    resume(state)


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
def bridge(s: ptr32, p: ptr32, w: ptr32, m: ptr32, lost: int) -> int:
    """Move over samples that were lost before this one, on the mean of it and the last one.

    The event BROKEN where they are too many for the pose to be trusted from then on; four times
    as many can't be told at all, and are passed over.
    """
    broken = 0
    if lost > p[_P_BRIDGE_TICKS]:
        broken = 32
        if s[_S_GAPS] < _TOP:
            s[_S_GAPS] = s[_S_GAPS] + 1
        if lost > p[_P_BRIDGE_TICKS] << 2:
            return broken
    i = 0
    while i < 6:
        w[_W_FORCE + i] = (w[_W_FORCE + i] + s[_S_LAST + i]) >> 1
        i = i + 1
    while lost > 0:
        int(propagate(s, p, w))
        if s[_S_SWING_TICKS] <= p[_P_FREEZE_TICKS]:
            int(grow(s, p, w))
        lost = lost - 1
    int(condition(s, p, w, m))
    return broken


@micropython.viper
def tick(s: ptr32, p: ptr32, w: ptr32, t: ptr32, m: ptr32) -> int:
    """One sample `m` into the state `s`; returns the event bits above.

    `p` parameters, `w` work area, `t` tables. Order: docs/algorithm.md.
    """
    if (s[_S_TICK] >> 24) < 127:  # 123 days at 200 Hz; then it stops, short of the word
        s[_S_TICK] = s[_S_TICK] + 1
    int(condition(s, p, w, m))
    int(push(s, p, w))
    if p[_P_DETECTOR]:
        int(collect(s, p, w))
    events = 0
    if s[_S_AL_DONE] == 0:
        start = int(align(s, p, w, t, m))
        if start:
            events = 1
        if start == 1 or s[_S_MODE] == 0:
            return events
        if start:
            # The start has changed what this sample means, and has used the work area.
            int(condition(s, p, w, m))
    int(stir(s))
    lost = (m[_I_FLAGS] >> 8) & 127
    if lost > 0:
        events = events | int(bridge(s, p, w, m, lost))
    int(propagate(s, p, w))
    if s[_S_SWING_TICKS] <= p[_P_FREEZE_TICKS]:
        int(grow(s, p, w))
    i = 0
    while i < 6:
        s[_S_LAST + i] = w[_W_FORCE + i]
        i = i + 1
    if s[_S_SINCE_CONSISTENT] < _TOP:
        s[_S_SINCE_CONSISTENT] = s[_S_SINCE_CONSISTENT] + 1
    if p[_P_MOTION_STRIDE] or s[_S_STRIDE]:
        pause = s[_S_PAUSE] - 1
        s[_S_PAUSE] = pause
        if pause < 1:
            int(observe_motion(s, p, w))
        # Between two samples there is time for what the last window still needs.
        stage = s[_S_STAGE]
        if stage < _IDLE and (pause > 0 or p[_P_MOTION_STRIDE] < 2):
            s[_S_STAGE] = stage + 1
            if stage < 2:
                int(summarise(0, 0, s, stage))
            else:
                events = events | int(classify(0, 0, s, t, p, (stage - 2) << 3)) << 7
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
    if m[_I_FLAGS] & _MAG_NEW:
        if p[_P_MAG_GAIN] and w[_W_UNREST] <= p[_P_UNREST_SURE]:
            events = events | int(steer(s, p, w, t, m)) << 6
    if w[_W_UNREST] > p[_P_UNREST_MAX]:
        s[_S_OBSERVED] = 0
    else:
        fresh = 1 - s[_S_OBSERVED]
        s[_S_OBSERVED] = 1
        events = events | int(update(s, p, w, t, fresh)) << 3
    int(stood(s, p, w, t))
    int(recentre(s))
    return events | 2
