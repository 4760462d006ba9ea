"""Static start: gravity, gyro bias and attitude from the first stretch of stillness.

A sample is still while no axis leaves its limit around the first still sample. The stretch ends
after ALIGN_TICKS, or with the first motion once it has lasted ALIGN_MIN: people walk off early.
Motion before that starts the stretch anew. No magnetometer is needed: the body's front axis
gets the heading of parameters YAW_W and YAW_Z.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import div, isqrt, mulshift
from solenav_core.strapdown import compose, to_nav, turn

_ONE = const(0x3FFFFFFF)
_TEN = const(10485760)  # 10 m/s² in Q20
_G_MIN = const(7864320)  # 7.5 m/s²: below or above, this is no sensor at rest on Earth
_G_MAX = const(12582912)  # 12 m/s²
_ROUNDS = const(8)

_S_AL_COUNT = const(3)
_S_AL_RESTARTS = const(4)
_S_AL_PEAK_ACC = const(5)
_S_AL_PEAK_RATE = const(6)
_S_AL_REF = const(7)
_S_AL_SUM = const(13)
_S_ATT = const(55)
_S_BIAS = const(68)
_S_GRAVITY = const(71)
_S_P_VV = const(72)
_S_P_TT = const(85)
_P_ACC_SCALE = const(1)
_P_YAW_W = const(4)
_P_YAW_Z = const(5)
_P_ALIGN_TICKS = const(6)
_P_ALIGN_MIN = const(7)
_P_ALIGN_ACC = const(8)
_P_ALIGN_RATE = const(9)
_P_BIAS_MAX = const(10)
_P_P_VV_0 = const(25)
_P_P_TT_0 = const(26)
_W_NAV = const(0)


@micropython.viper
def gather(s: ptr32, p: ptr32, m: ptr32) -> int:
    """Take one sample into the stretch of stillness.

    0: not enough yet. 1: long enough, this sample included. 2: long enough, this one moves.
    """
    peak_acc = s[_S_AL_PEAK_ACC]
    peak_rate = s[_S_AL_PEAK_RATE]
    count = s[_S_AL_COUNT]
    if count > 0:
        i = 0
        while i < 6:
            off = m[i] - s[_S_AL_REF + i]
            if off < 0:
                off = 0 - off
            if i < 3:
                if off > peak_acc:
                    peak_acc = off
            elif off > peak_rate:
                peak_rate = off
            i = i + 1
        if peak_acc > p[_P_ALIGN_ACC] or peak_rate > p[_P_ALIGN_RATE]:
            if count >= p[_P_ALIGN_MIN]:
                return 2
            count = 0
            s[_S_AL_RESTARTS] = s[_S_AL_RESTARTS] + 1
    if count == 0:
        peak_acc = 0
        peak_rate = 0
        i = 0
        while i < 6:
            s[_S_AL_REF + i] = m[i]
            s[_S_AL_SUM + i] = 0
            i = i + 1
    i = 0
    while i < 6:
        s[_S_AL_SUM + i] = s[_S_AL_SUM + i] + m[i]
        i = i + 1
    s[_S_AL_PEAK_ACC] = peak_acc
    s[_S_AL_PEAK_RATE] = peak_rate
    s[_S_AL_COUNT] = count + 1
    return int(count + 1 >= p[_P_ALIGN_TICKS])


@micropython.viper
def level(s: ptr32, w: ptr32, ax: int, ay: int, az: int) -> int:
    """Attitude in which the mean force (Q20 m/s², body) points up; leaves it in work NAV.

    Each round turns the force towards Up by the sine of what is left, so the error falls with
    its cube; a force that points down is turned over first, about the front axis.
    """
    s[_S_ATT] = _ONE
    s[_S_ATT + 1] = 0
    s[_S_ATT + 2] = 0
    s[_S_ATT + 3] = 0
    if az < 0:
        s[_S_ATT] = 0
        s[_S_ATT + 2] = _ONE
    i = 0
    while i < _ROUNDS:
        int(to_nav(s, w, ax, ay, az))
        hx = int(div(w[_W_NAV + 1], _TEN, 29))
        hy = 0 - int(div(w[_W_NAV], _TEN, 29))
        int(turn(s, hx, hy, 0, 1))
        i = i + 1
    return int(to_nav(s, w, ax, ay, az))


@micropython.viper
def head(s: ptr32, p: ptr32, w: ptr32) -> int:
    """Turn about Up until the front axis has the initial heading.

    A front axis within 6° of the vertical has no heading; it is left as levelling put it.
    """
    i = 0
    while i < _ROUNDS:
        int(to_nav(s, w, 0, _ONE, 0))
        east = w[_W_NAV] >> 16
        north = w[_W_NAV + 1] >> 16
        across = int(isqrt(east * east + north * north))
        if across > 1638:
            if north < 0:
                int(compose(s, 0, 0, 0, _ONE, 1))
                east = 0 - east
            int(turn(s, 0, 0, int(div(east, across, 29)), 1))
        i = i + 1
    return int(compose(s, p[_P_YAW_W], 0, 0, p[_P_YAW_Z], 1))


@micropython.viper
def finish(s: ptr32, p: ptr32, w: ptr32) -> int:
    """Biases, gravity, attitude and first variances from the stretch. 0 if it makes no sense."""
    count = s[_S_AL_COUNT]
    i = 0
    while i < 3:
        total = s[_S_AL_SUM + 3 + i]
        if total < 0:
            total = 0 - total
        if total >= p[_P_BIAS_MAX] * count:
            return 0
        i = i + 1
    scale = p[_P_ACC_SCALE]
    ax = int(mulshift(int(div(s[_S_AL_SUM], count, 15)), scale, 17))
    ay = int(mulshift(int(div(s[_S_AL_SUM + 1], count, 15)), scale, 17))
    az = int(mulshift(int(div(s[_S_AL_SUM + 2], count, 15)), scale, 17))
    if ax > _G_MAX or ay > _G_MAX or az > _G_MAX:
        return 0
    if ax < 0 - _G_MAX or ay < 0 - _G_MAX or az < 0 - _G_MAX:
        return 0
    int(level(s, w, ax, ay, az))
    gravity = w[_W_NAV + 2]
    if gravity < _G_MIN or gravity > _G_MAX:
        return 0
    int(head(s, p, w))
    s[_S_GRAVITY] = gravity
    i = 0
    while i < 3:
        s[_S_BIAS + i] = int(div(s[_S_AL_SUM + 3 + i], count, 20))
        s[_S_P_VV + i] = p[_P_P_VV_0]
        i = i + 1
    s[_S_P_TT] = p[_P_P_TT_0]
    s[_S_P_TT + 1] = p[_P_P_TT_0]
    return 1
