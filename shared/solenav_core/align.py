"""Static start: gravity, gyro bias and attitude from the first stretch of stillness.

A sample is still while no axis leaves its limit around the first still sample; motion ends the
stretch and starts another. ALIGN_TICKS of stillness are a full static start. People fidget and
walk off early, so a stretch of at least ALIGN_MIN serves as well until a longer one comes, and
navigation begins with it; with the first real swing the search is over. No magnetometer is
needed: the body's front axis gets the heading of parameters YAW_W and YAW_Z.

Where navigation goes on after a hole in the samples or a restart (`navigator.resume`), position,
heading and biases are kept, and RESUME_TICKS of a stance level the foot anew.
"""

from solenav_core.calibration import magnetic, mounted, orient
from solenav_core.compat import const, micropython, ptr32
from solenav_core.heading import refer
from solenav_core.qmath import div, isqrt, mulshift
from solenav_core.strapdown import compose, to_nav, turn

_ONE = const(0x3FFFFFFF)
_TEN = const(10485760)  # 10 m/s² in Q20
_G_MIN = const(7864320)  # 7.5 m/s²: below or above, this is no sensor at rest on Earth
_G_MAX = const(12582912)  # 12 m/s²
_ROUNDS = const(8)
_HALF = const(0x1FFFFFFF)  # a unit vector in Q29: turning one takes twice its length
_MAG_NEW = const(8)  # messages.MAG_NEW
_FLAT = const(0x3330000)  # 0.1 in Q29: the front axis 6° from the vertical

_S_AL_COUNT = const(11)
_S_AL_BEST = const(13)
_S_AL_DONE = const(12)
_S_AL_RESTARTS = const(14)
_S_AL_PEAK_ACC = const(15)
_S_AL_PEAK_RATE = const(16)
_S_AL_REF = const(17)
_S_AL_SUM = const(23)
_S_ATT = const(394)
_S_TICK = const(0)
_S_MODE = const(1)
_S_STANCE = const(36)
_S_RNG = const(430)
_S_TICK_STEP = const(854)
_S_STEP_VAR = const(864)
_S_BIAS = const(407)
_S_GRAVITY = const(410)
_S_P_VV = const(411)
_S_P_TT = const(424)
_S_RESUMED = const(10)
_S_GAPS = const(9)
_S_AL_MAG = const(29)
_S_AL_MAG_COUNT = const(32)
_S_VEL = const(398)
_S_POS = const(401)
_S_POS_LAST = const(843)
_S_POS_REF = const(846)
_S_POS_STEP = const(849)
_S_HEADING_STEP = const(852)
_S_HEADING_LAST = const(853)
_S_STANCE_TICKS = const(855)
_S_STEPPING = const(856)
_S_MAG_REFUSED = const(871)
_P_YAW_W = const(42)
_P_YAW_Z = const(43)
_P_ALIGN_TICKS = const(44)
_P_ALIGN_MIN = const(45)
_P_ALIGN_ACC = const(46)
_P_ALIGN_RATE = const(47)
_P_BIAS_MAX = const(48)
_P_SEED = const(109)
_P_P_VV_0 = const(82)
_P_P_TT_0 = const(83)
_P_RESUME_TICKS = const(97)
_P_RESUME_ACC = const(98)
_P_RESUME_RATE = const(99)
_P_P_VV_H1 = const(95)
_P_ACC_XX = const(1)
_P_ACC_BX = const(10)
_P_GYRO_XX = const(13)
_P_GYRO_BX = const(22)
_W_NAV = const(0)
_W_FORCE = const(3)
_W_RATE = const(6)
_I_MAG = const(6)
_I_FLAGS = const(9)


@micropython.viper
def gather(s: ptr32, p: ptr32, m: ptr32) -> int:
    """Take one sample into the stretch of stillness.

    0: nothing new. 1: a full static start, this sample included. 2: this sample moves, and the
    stretch that it ends (still in the sums) is better than what is in use.
    """
    peak_acc = s[_S_AL_PEAK_ACC]
    peak_rate = s[_S_AL_PEAK_RATE]
    count = s[_S_AL_COUNT]
    least = p[_P_ALIGN_MIN]
    full = p[_P_ALIGN_TICKS]
    most_acc = p[_P_ALIGN_ACC]
    most_rate = p[_P_ALIGN_RATE]
    if s[_S_RESUMED]:
        full = p[_P_RESUME_TICKS]
        least = full
        most_acc = p[_P_RESUME_ACC]
        most_rate = p[_P_RESUME_RATE]
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
        if peak_acc > most_acc or peak_rate > most_rate:
            if s[_S_AL_RESTARTS] < 0x3FFFFFFF:
                s[_S_AL_RESTARTS] = s[_S_AL_RESTARTS] + 1
            if count >= least and count > s[_S_AL_BEST]:
                return 2
            count = 0
    if count == 0:
        peak_acc = 0
        peak_rate = 0
        i = 0
        while i < 6:
            s[_S_AL_REF + i] = m[i]
            s[_S_AL_SUM + i] = 0
            i = i + 1
        i = 0
        while i < 4:
            s[_S_AL_MAG + i] = 0
            i = i + 1
    if m[_I_FLAGS] & _MAG_NEW:
        i = 0
        while i < 3:
            s[_S_AL_MAG + i] = s[_S_AL_MAG + i] + m[_I_MAG + i]
            i = i + 1
        s[_S_AL_MAG_COUNT] = s[_S_AL_MAG_COUNT] + 1
    i = 0
    while i < 6:
        s[_S_AL_SUM + i] = s[_S_AL_SUM + i] + m[i]
        i = i + 1
    s[_S_AL_PEAK_ACC] = peak_acc
    s[_S_AL_PEAK_RATE] = peak_rate
    s[_S_AL_COUNT] = count + 1
    return int(count + 1 >= full)


@micropython.viper
def level(s: ptr32, w: ptr32, ax: int, ay: int, az: int) -> int:
    """Turn the attitude until the mean force (Q20 m/s², body) points up; leaves it in work NAV.

    Each round turns the force towards Up by the sine of what is left, so the error falls with
    its cube; a force that points down is turned over first, about the front axis. The turns are
    the shortest, so that an attitude which was nearly right keeps its heading.
    """
    int(to_nav(s, w, ax, ay, az))
    if w[_W_NAV + 2] < 0:
        int(compose(s, 0, 0, _ONE, 0, 0))
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

    A front axis within 6° of the vertical has no heading; it is left as levelling put it. Any
    other points north of East or West, since levelling turns by at most a right angle.
    """
    i = 0
    while i < _ROUNDS:
        int(to_nav(s, w, 0, _HALF, 0))
        east = w[_W_NAV]
        north = w[_W_NAV + 1]
        if north > _FLAT and 0 - (north >> 4) < east < north >> 4:
            # Nearly there: the tangent is the angle, and keeps every bit.
            int(turn(s, 0, 0, int(div(east, north, 29)), 1))
        else:
            east = east >> 15
            north = north >> 15
            across = int(isqrt(east * east + north * north))
            if across > _FLAT >> 15:
                int(turn(s, 0, 0, int(div(east, across, 29)), 1))
        i = i + 1
    return int(compose(s, p[_P_YAW_W], 0, 0, p[_P_YAW_Z], 1))


@micropython.viper
def sensible(s: ptr32, p: ptr32, w: ptr32) -> int:
    """1 if the stretch may be a sensor at rest on Earth.

    Its mean force (Q20 m/s²) goes into work FORCE, its mean rate (Q20 counts) into work RATE,
    both in sensor axes.
    """
    count = s[_S_AL_COUNT]
    i = 0
    while i < 3:
        rate = s[_S_AL_SUM + 3 + i]
        if rate < 0:
            rate = 0 - rate
        if rate >= p[_P_BIAS_MAX] * count:
            return 0
        w[_W_NAV + i] = int(div(s[_S_AL_SUM + 3 + i], count, 20))
        i = i + 1
    at = 0
    i = 0
    while i < 3:
        rate = 0 - p[_P_GYRO_BX + i]
        j = 0
        while j < 3:
            rate = rate + int(mulshift(w[_W_NAV + j], p[_P_GYRO_XX + at] << 4, 18))
            at = at + 1
            j = j + 1
        w[_W_RATE + i] = rate
        i = i + 1
    i = 0
    while i < 3:
        w[_W_NAV + i] = int(div(s[_S_AL_SUM + i], count, 15))
        i = i + 1
    total = 0
    at = 0
    i = 0
    while i < 3:
        force = 0 - p[_P_ACC_BX + i]
        j = 0
        while j < 3:
            force = force + int(mulshift(w[_W_NAV + j], p[_P_ACC_XX + at], 17))
            at = at + 1
            j = j + 1
        w[_W_FORCE + i] = force
        if force > _G_MAX or force < 0 - _G_MAX:
            return 0
        force = force >> 13
        total = total + force * force
        i = i + 1
    norm = int(isqrt(total)) << 13
    return int(_G_MIN < norm < _G_MAX)


@micropython.viper
def finish(s: ptr32, p: ptr32, w: ptr32, t: ptr32) -> int:
    """Start navigating from the stretch: biases, gravity, attitude, first variances.

    1, or 0 where the stretch makes no sense; then nothing has changed.
    """
    if int(sensible(s, p, w)) == 0:
        return 0
    i = _S_ATT
    while i < _S_MAG_REFUSED + 1:
        s[i] = 0
        i = i + 1
    s[_S_STANCE] = 0
    s[_S_GAPS] = 0
    s[_S_RNG] = (p[_P_SEED] >> 16) & 65535
    s[_S_RNG + 1] = p[_P_SEED] & 65535
    s[_S_TICK_STEP] = s[_S_TICK]
    int(orient(s, p, w))
    int(mounted(s, w, _W_FORCE))
    int(mounted(s, w, _W_RATE))
    s[_S_ATT] = _ONE
    int(level(s, w, w[_W_FORCE], w[_W_FORCE + 1], w[_W_FORCE + 2]))
    s[_S_GRAVITY] = w[_W_NAV + 2]
    int(head(s, p, w))
    i = 0
    while i < 3:
        s[_S_BIAS + i] = w[_W_RATE + i]
        s[_S_P_VV + i] = p[_P_P_VV_0]
        i = i + 1
    s[_S_P_TT] = p[_P_P_TT_0]
    s[_S_P_TT + 1] = p[_P_P_TT_0]
    s[_S_AL_BEST] = s[_S_AL_COUNT]
    count = s[_S_AL_MAG_COUNT]
    if count > 0:
        x = int(div(s[_S_AL_MAG], count, 4))
        y = int(div(s[_S_AL_MAG + 1], count, 4))
        int(magnetic(s, p, w, x, y, int(div(s[_S_AL_MAG + 2], count, 4))))
        int(refer(s, p, w, t))
    s[_S_MODE] = 1
    return 1


@micropython.viper
def settle(s: ptr32, p: ptr32, w: ptr32) -> int:
    """Go on navigating from the stretch, of a stance: the foot is levelled, nothing else moves.

    1, or 0 where the stretch is of no foot that stands; then nothing has changed.
    """
    if int(sensible(s, p, w)) == 0:
        return 0
    int(mounted(s, w, _W_FORCE))
    int(mounted(s, w, _W_RATE))
    i = 0
    while i < 3:
        rate = (w[_W_RATE + i] >> 12) - (s[_S_BIAS + i] >> 12)
        if rate > p[_P_RESUME_RATE] << 8 or rate < 0 - (p[_P_RESUME_RATE] << 8):
            return 0
        i = i + 1
    i = _S_P_VV
    while i < _S_POS_LAST:
        if i < _S_RNG or i > _S_RNG + 1:
            s[i] = 0
        i = i + 1
    int(level(s, w, w[_W_FORCE], w[_W_FORCE + 1], w[_W_FORCE + 2]))
    i = 0
    while i < 3:
        s[_S_VEL + i] = 0
        s[_S_P_VV + i] = p[_P_P_VV_H1]
        s[_S_POS_LAST + i] = s[_S_POS + i]
        s[_S_POS_REF + i] = s[_S_POS + i]
        s[_S_POS_STEP + i] = s[_S_POS + i]
        s[_S_STEP_VAR + i] = 0
        i = i + 1
    s[_S_P_TT] = p[_P_P_TT_0]
    s[_S_P_TT + 1] = p[_P_P_TT_0]
    s[_S_HEADING_STEP] = s[_S_HEADING_LAST]
    s[_S_TICK_STEP] = s[_S_TICK]
    s[_S_STANCE_TICKS] = 0
    s[_S_STEPPING] = 0
    s[_S_STANCE] = 0
    s[_S_AL_BEST] = s[_S_AL_COUNT]
    s[_S_MODE] = 1
    return 1


@micropython.viper
def align(s: ptr32, p: ptr32, w: ptr32, t: ptr32, m: ptr32) -> int:
    """One sample of the search. 0, or 1 (this sample used up) or 2 (not) for a new start."""
    found = int(gather(s, p, m))
    if found == 0:
        return 0
    made = 0
    if s[_S_RESUMED]:
        made = int(settle(s, p, w))
    else:
        made = int(finish(s, p, w, t))
    if made:
        if found == 1 or s[_S_RESUMED]:
            s[_S_AL_DONE] = 1
    s[_S_AL_COUNT] = 0
    return found * made
