"""Zero-velocity detector: C1 force magnitude, C2 angular rate, C3 variance of the magnitude.

Guo, Xu, Ji 2020: C_zero = C1 & C2 & C3. Beside the decision a sample has its unrest, which says
what the decision is worth. The rate is the one less its bias, so that a large zero-rate offset
doesn't hide a stance.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import div, isqrt, mulshift

_T_MAX = const(0x2000000)  # 131072 in Q8
_NORM_MAX = const(8191)  # 64 m/s² in Q7: 31 squared deviations still fit one word

_S_ACC_NORM = const(37)
_S_STILL_TICKS = const(38)
_S_RING_HEAD = const(39)
_S_RING_FILL = const(40)
_S_RING = const(41)
_S_STILLEST = const(72)
_S_GRAVITY = const(89)
_P_ACC_MIN = const(49)
_P_ACC_MAX = const(50)
_P_RATE_MAX = const(51)
_P_VAR_MAX = const(52)
_P_WINDOW = const(53)
_P_UNREST_RATE = const(54)
_P_UNREST_ACC = const(55)
_P_UNREST_GROWTH = const(56)
_P_STILL_RATE = const(59)
_W_FORCE = const(3)
_W_RATE = const(6)
_W_UNREST = const(12)


@micropython.viper
def push(s: ptr32, p: ptr32, w: ptr32) -> int:
    """|a| of the sample (Q7 m/s², of work FORCE) into the window."""
    x = (w[_W_FORCE] + 4096) >> 13
    y = (w[_W_FORCE + 1] + 4096) >> 13
    z = (w[_W_FORCE + 2] + 4096) >> 13
    norm = int(isqrt(x * x + y * y + z * z))
    s[_S_ACC_NORM] = norm
    if norm > _NORM_MAX:
        norm = _NORM_MAX
    head = s[_S_RING_HEAD]
    s[_S_RING + head] = norm
    head = head + 1
    if head >= p[_P_WINDOW]:
        head = 0
    s[_S_RING_HEAD] = head
    if s[_S_RING_FILL] < p[_P_WINDOW]:
        s[_S_RING_FILL] = s[_S_RING_FILL] + 1
    return 0


@micropython.viper
def spread(s: ptr32) -> int:
    """Sum of the squared deviations of |a| from its mean over the window, Q14 (m/s²)²."""
    n = s[_S_RING_FILL]
    if n < 1:
        return 0
    mean = 0
    i = 0
    while i < n:
        mean = mean + s[_S_RING + i]
        i = i + 1
    mean = (mean + (n >> 1)) // n
    total = 0
    i = 0
    while i < n:
        off = s[_S_RING + i] - mean
        total = total + off * off
        i = i + 1
    return total


@micropython.viper
def slower(w: ptr32, limit: int) -> int:
    """1 if |rate| (work RATE, Q8 counts) is below `limit` (Q2 counts, up to 26000)."""
    total = 0
    i = 0
    while i < 3:
        rate = w[_W_RATE + i] >> 6
        if rate > limit or rate < 0 - limit:
            return 0
        total = total + rate * rate
        i = i + 1
    return int(total < limit * limit)


@micropython.viper
def unrest(s: ptr32, p: ptr32, w: ptr32) -> int:
    """How far this sample is from the stillest of late: u = T / T_least, Q8, into work UNREST.

    T = (|rate| / sigma_rate)² + ((|a| - g) / sigma_a)² is the statistic of the SHOE detector
    (Skog, Haendel, Nilsson, Rantakokko 2010) over one sample. The least T grows slowly, and is
    at least 1: so a runner, whose foot is never quite still, has stances as well.
    """
    total = 0
    i = 0
    while i < 3:
        rate = w[_W_RATE + i] >> 9
        total = total + rate * rate
        i = i + 1
    off = s[_S_ACC_NORM] - (s[_S_GRAVITY] >> 13)
    total = int(mulshift(total, p[_P_UNREST_RATE], 24))
    total = total + int(mulshift(off * off, p[_P_UNREST_ACC], 24))
    if total > _T_MAX:
        total = _T_MAX
    least = s[_S_STILLEST]
    least = least + int(mulshift(least, p[_P_UNREST_GROWTH], 30))
    if least > total << 4:
        least = total << 4
    if least < 4096:
        least = 4096
    s[_S_STILLEST] = least
    w[_W_UNREST] = int(div(total, least >> 4, 8))
    return 0


@micropython.viper
def detect(s: ptr32, p: ptr32, w: ptr32) -> int:
    """C1 & C2 & C3 on this sample; its unrest, and the ticks of angular stillness, as well."""
    int(unrest(s, p, w))
    if int(slower(w, p[_P_STILL_RATE])):
        # Saturates: a foot may rest for days.
        if s[_S_STILL_TICKS] < 0x3FFFFFFF:
            s[_S_STILL_TICKS] = s[_S_STILL_TICKS] + 1
    else:
        s[_S_STILL_TICKS] = 0
    norm = s[_S_ACC_NORM]
    stance = 0
    if p[_P_ACC_MIN] < norm < p[_P_ACC_MAX]:
        if int(slower(w, p[_P_RATE_MAX])):
            if s[_S_RING_FILL] >= p[_P_WINDOW]:
                stance = int(int(spread(s)) < p[_P_VAR_MAX])
    return stance
