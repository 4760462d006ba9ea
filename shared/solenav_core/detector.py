"""Zero-velocity detectors. C1 force magnitude, C2 angular rate, C3 variance of the magnitude.

Guo, Xu, Ji 2020: C_zero = C1 & C2 & C3. Instead of them, if the parameter DETECTOR says so, the
generalised likelihood ratio test of Skog, Haendel, Nilsson, Rantakokko 2010 (IEEE Trans. Biomed.
Eng. 57(11), equation 13, "SHOE"), with one threshold or, as in Zhang, Xiu, Yang, Yang 2018, one
for each motion. Beside the decision a sample has its unrest, which says what the decision is
worth. The rate is the one less its bias, so that a large zero-rate offset doesn't hide a stance.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp, div, isqrt, mulsat, mulshift

_T_MAX = const(0x2000000)  # 131072 in Q8
_NORM_MAX = const(8191)  # 64 m/s² in Q7: 31 squared deviations still fit one word
_AXIS_MAX = const(4095)  # 64 m/s² in Q6, 8190 counts: 31 times three squares still fit one word
_GLRT_MAX = const(0x2000000)  # 2**20 in Q5

_S_ACC_NORM = const(37)
_S_STILL_TICKS = const(38)
_S_RING_HEAD = const(39)
_S_RING_FILL = const(40)
_S_RING = const(41)
_S_STILLEST = const(72)
_S_GLRT = const(73)
_S_GLRT_HEAD = const(74)
_S_GLRT_FILL = const(75)
_S_GLRT_SUM = const(76)
_S_GLRT_SQUARES = const(79)
_S_GLRT_TURN = const(82)
_S_GLRT_RING = const(83)
_S_MOTION = const(393)
_S_GRAVITY = const(410)
_P_ACC_MIN = const(49)
_P_ACC_MAX = const(50)
_P_RATE_MAX = const(51)
_P_VAR_MAX = const(52)
_P_WINDOW = const(53)
_P_DETECTOR = const(54)
_P_GLRT_WINDOW = const(55)
_P_GLRT_ACC = const(56)
_P_GLRT_RATE = const(57)
_P_GLRT_MAX = const(58)
_P_UNREST_RATE = const(67)
_P_UNREST_ACC = const(68)
_P_UNREST_GROWTH = const(69)
_P_STILL_RATE = const(72)
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
def collect(s: ptr32, p: ptr32, w: ptr32) -> int:
    """The sample's force and rate (of work FORCE, RATE) into the GLRT's window and its sums."""
    size = p[_P_GLRT_WINDOW]
    head = s[_S_GLRT_HEAD]
    fill = s[_S_GLRT_FILL]
    if fill == 0 or fill > size or head >= size:
        # A fresh window, or one that has become shorter.
        head = 0
        fill = 0
        i = 0
        while i < 7:
            s[_S_GLRT_SUM + i] = 0
            i = i + 1
    at = _S_GLRT_RING + (head << 2)
    full = int(fill >= size)
    total = 0
    i = 0
    while i < 3:
        value = int(clamp((w[_W_FORCE + i] + 8192) >> 14, _AXIS_MAX))
        square = value * value
        if full:
            old = s[at + i]
            s[_S_GLRT_SUM + i] = s[_S_GLRT_SUM + i] + value - old
            s[_S_GLRT_SQUARES + i] = s[_S_GLRT_SQUARES + i] + square - old * old
        else:
            s[_S_GLRT_SUM + i] = s[_S_GLRT_SUM + i] + value
            s[_S_GLRT_SQUARES + i] = s[_S_GLRT_SQUARES + i] + square
        s[at + i] = value
        rate = int(clamp((w[_W_RATE + i] + 256) >> 9, _AXIS_MAX))
        total = total + rate * rate
        i = i + 1
    if full:
        s[_S_GLRT_TURN] = s[_S_GLRT_TURN] + total - s[at + 3]
    else:
        s[_S_GLRT_TURN] = s[_S_GLRT_TURN] + total
        fill = fill + 1
    s[at + 3] = total
    head = head + 1
    if head >= size:
        head = 0
    s[_S_GLRT_HEAD] = head
    s[_S_GLRT_FILL] = fill
    return 0


@micropython.viper
def likelihood_ratio(s: ptr32, p: ptr32) -> int:
    """T of the window, Q5, into state GLRT; 1 if it is below the threshold that holds.

    With W samples a, w and their mean force m,
    T = 1/W sum(|a - g m/|m||² / sigma_a² + |w|² / sigma_w²). The first sum is taken apart as
    sum(|a - m|²) + W (|m| - g)², both from running sums, so that a tick costs the same for every
    window and nothing is lost to cancellation.
    """
    n = s[_S_GLRT_FILL]
    if n < p[_P_GLRT_WINDOW] or n < 1:
        s[_S_GLRT] = _GLRT_MAX
        return 0
    total = 0
    length = 0
    i = 0
    while i < 3:
        sum = s[_S_GLRT_SUM + i]
        mean = ((sum << 3) // n + 1) >> 1  # Q8
        length = length + mean * mean
        mean = (mean + 2) >> 2
        # sum(a²) - 2 mean sum(a) + n mean²: of a mean that is rounded as well.
        total = total + s[_S_GLRT_SQUARES + i] - mean * (2 * sum - n * mean)
        i = i + 1
    off = int(isqrt(length)) - ((s[_S_GRAVITY] + 2048) >> 12)
    total = total + n * ((off * off + 8) >> 4)
    ratio = int(mulsat(total, p[_P_GLRT_ACC], 17))
    ratio = ratio + int(mulsat(s[_S_GLRT_TURN], p[_P_GLRT_RATE], 17))
    if ratio > _GLRT_MAX:
        ratio = _GLRT_MAX
    s[_S_GLRT] = ratio
    limit = p[_P_GLRT_MAX]
    if p[_P_DETECTOR] > 1:
        limit = p[_P_GLRT_MAX + s[_S_MOTION]]
    return int(ratio < limit)


@micropython.viper
def detect(s: ptr32, p: ptr32, w: ptr32) -> int:
    """Whether this sample is stance; its unrest, and the ticks of angular stillness, as well."""
    int(unrest(s, p, w))
    if int(slower(w, p[_P_STILL_RATE])):
        # Saturates: a foot may rest for days.
        if s[_S_STILL_TICKS] < 0x3FFFFFFF:
            s[_S_STILL_TICKS] = s[_S_STILL_TICKS] + 1
    else:
        s[_S_STILL_TICKS] = 0
    if p[_P_DETECTOR]:
        return int(likelihood_ratio(s, p))
    norm = s[_S_ACC_NORM]
    stance = 0
    if p[_P_ACC_MIN] < norm < p[_P_ACC_MAX]:
        if int(slower(w, p[_P_RATE_MAX])):
            if s[_S_RING_FILL] >= p[_P_WINDOW]:
                stance = int(int(spread(s)) < p[_P_VAR_MAX])
    return stance
