"""Step accounting: which stances are steps, how far and how much they turned.

A step is a stance of at least STEP_STANCE ticks after a swing of at least STEP_SWING: shorter
ones are flicker of the detector. It counts as soon as the foot has stood that long; its
displacement and turn are settled when the foot leaves the ground, after the filter's last word.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import azimuth, clamp, isqrt
from solenav_core.strapdown import to_nav

_HALF = const(0x1FFFFFFF)  # a unit vector in Q29: turning one takes twice its length
_FAR = const(33554432)  # 128 m in Q18, longest step that the distance counts

_S_TICK = const(0)
_S_POS = const(401)
_S_P_PP = const(417)
_S_SWING_TICKS = const(429)
_S_POS_LAST = const(843)
_S_POS_STEP = const(849)
_S_HEADING_STEP = const(852)
_S_HEADING_LAST = const(853)
_S_TICK_STEP = const(854)
_S_STANCE_TICKS = const(855)
_S_STEPPING = const(856)
_S_STEPS = const(857)
_S_DISTANCE = const(858)
_S_STEP_MOVE = const(859)
_S_STEP_TURN = const(862)
_S_STEP_TICKS = const(863)
_S_STEP_VAR = const(864)
_P_STEP_SWING = const(107)
_P_STEP_STANCE = const(108)
_W_NAV = const(0)


@micropython.viper
def heading(s: ptr32, w: ptr32, t: ptr32) -> int:
    """Azimuth of the body's front axis, clockwise from North, 2**16 a turn."""
    int(to_nav(s, w, 0, _HALF, 0))
    return int(azimuth(w[_W_NAV] >> 2, w[_W_NAV + 1] >> 2, t))


@micropython.viper
def stood(s: ptr32, p: ptr32, w: ptr32, t: ptr32) -> int:
    """One stance tick: remember where the foot stands; count the step once it has stood."""
    i = 0
    while i < 3:
        s[_S_POS_LAST + i] = s[_S_POS + i]
        s[_S_STEP_VAR + i] = s[_S_P_PP + i]
        i = i + 1
    ticks = s[_S_STANCE_TICKS]
    if ticks < 0x3FFFFFFF:
        ticks = ticks + 1
    s[_S_STANCE_TICKS] = ticks
    if ticks != p[_P_STEP_STANCE]:
        return 0
    # The foot is flat by now: its heading means something.
    s[_S_HEADING_LAST] = int(heading(s, w, t))
    if s[_S_STEPPING]:
        s[_S_STEPPING] = 2
        if s[_S_STEPS] < 0x3FFFFFFF:
            s[_S_STEPS] = s[_S_STEPS] + 1
        # Q10 m, halved until both squares fit one word.
        east = int(clamp(s[_S_POS] - s[_S_POS_STEP], _FAR)) >> 8
        north = int(clamp(s[_S_POS + 1] - s[_S_POS_STEP + 1], _FAR)) >> 8
        shift = 0
        while east > 16383 or east < -16383 or north > 16383 or north < -16383:
            east = east >> 1
            north = north >> 1
            shift = shift + 1
        length = int(isqrt(east * east + north * north)) << shift
        if s[_S_DISTANCE] < 0x3FFFFFFF:
            s[_S_DISTANCE] = s[_S_DISTANCE] + length
    return 0


@micropython.viper
def swung(s: ptr32, p: ptr32) -> int:
    """One swing tick. 1 on the tick that ends a counted step, with its figures settled."""
    if s[_S_SWING_TICKS] != p[_P_STEP_SWING]:
        return 0
    s[_S_STANCE_TICKS] = 0
    counted = int(s[_S_STEPPING] == 2)
    if counted or s[_S_STEPPING] == 0:
        i = 0
        while i < 3:
            s[_S_STEP_MOVE + i] = int(clamp(s[_S_POS_LAST + i] - s[_S_POS_STEP + i], 0x3FFFFFFF))
            s[_S_POS_STEP + i] = s[_S_POS_LAST + i]
            since = s[_S_P_PP + i] - s[_S_STEP_VAR + i]
            if since < 0:
                since = 0
            s[_S_P_PP + i] = since
            i = i + 1
        turned = s[_S_HEADING_LAST] - s[_S_HEADING_STEP]
        s[_S_STEP_TURN] = ((turned + 32768) & 65535) - 32768
        s[_S_HEADING_STEP] = s[_S_HEADING_LAST]
        s[_S_STEP_TICKS] = s[_S_TICK] - s[_S_TICK_STEP]
        s[_S_TICK_STEP] = s[_S_TICK]
    s[_S_STEPPING] = 1
    return counted
