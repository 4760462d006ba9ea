"""Adaptive particle filter over the error of the INS velocity, run in stance.

100 particles, each a hypothesis of the 3-D velocity error; the INS velocity itself observes it,
since the foot stands. Guo, Xu, Ji 2020, section 2 and table 1, read as docs/algorithm.md says:
adaptive observation noise, adaptive threshold M with retain or revert, H1 and H2 with secondary
resampling, feedback into velocity, position and tilt.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.covariance import shrink
from solenav_core.qmath import clamp, div, isqrt, mulshift
from solenav_core.strapdown import turn

_N = const(100)
_STRIDE = const(37)  # prime to 100: every particle gets another row of the table
_LIMIT = const(0x3FFFFFFF)
_X_MAX = const(1048575)  # 16 m/s in Q16: 100 weights of 1 times this fit after the split by 2**10
_E_MAX = const(4095)  # largest deviation on the spread's scale
_KP_MAX = const(33554432)  # 32 s in Q20
_KT_MAX = const(67108864)  # 4 rad s/m in Q24
_PHI_MAX = const(8388608)  # 0.5 rad in Q24
_ERR_MAX = const(134217728)  # 8 m/s in Q24: beyond this the velocity says nothing about tilt
_COUNT_MAX = const(1023)
_RISE_MAX = const(4194303)  # K_E * t: over 100 particles far past any M_b
_MOVE_MAX = const(268435456)  # 1024 m in Q18

_S_VEL = const(61)
_S_POS = const(64)
_S_P_VV = const(74)
_S_P_PV = const(77)
_S_P_VT = const(83)
_S_P_TT = const(87)
_S_DP_VV = const(89)
_S_RNG = const(93)
_S_INCONSISTENT = const(95)
_S_SINCE_CONSISTENT = const(96)
_S_M2 = const(97)
_S_THRESHOLD = const(98)
_S_N_EFF = const(99)
_S_RESAMPLED = const(100)
_S_LOCKOUTS = const(101)
_S_LOG_W = const(102)
_S_X = const(202)
_S_POS_REF = const(505)
_P_R = const(27)
_P_LIKELIHOOD = const(28)
_P_M2_MAX = const(29)
_P_LOG_FLOOR = const(30)
_P_M_A = const(31)
_P_M_B = const(32)
_P_K_E = const(33)
_P_K = const(34)
_P_HEAVY_MIN = const(35)
_P_LOCKOUT_TICKS = const(36)
_P_LOCKOUT_MIN = const(37)
_P_P_VV_H1 = const(38)
_P_P_TT_0 = const(26)
_W_ERR = const(6)
_W_VAR = const(9)
_W_SCALE = const(12)
_W_ROOT = const(15)
_W_GAIN = const(21)
_W_GAIN_SHIFT = const(22)
_W_SUM_W = const(23)
_W_SUM_W2 = const(24)
_W_HEAVY = const(25)
_W_PROPOSAL = const(26)
_W_WEIGHT = const(326)
_T_EXP2 = const(0)
_T_GAUSS = const(273)


@micropython.viper
def draw_row(s: ptr32) -> int:
    """One step of xorshift32 (Marsaglia 2003) on 16-bit halves; a row of the table, 0..99."""
    hi = s[_S_RNG]
    lo = s[_S_RNG + 1]
    a = hi ^ (((hi << 13) | (lo >> 3)) & 65535)
    b = lo ^ ((lo << 13) & 65535)
    b = b ^ (a >> 1)
    hi = a ^ (((a << 5) | (b >> 11)) & 65535)
    lo = b ^ ((b << 5) & 65535)
    s[_S_RNG] = hi
    s[_S_RNG + 1] = lo
    return (lo * _N) >> 16


@micropython.viper
def roots(s: ptr32, w: ptr32, source: int) -> int:
    """Square roots of three variances (Q26, state words from `source`), with their shifts.

    root * table >> shift is in Q16; small variances keep three more bits of root.
    """
    i = 0
    while i < 3:
        variance = s[source + i]
        if variance < 0:
            variance = 0
        if variance < 0x2000000:
            w[_W_ROOT + 2 * i] = int(isqrt(variance << 6))
            w[_W_ROOT + 2 * i + 1] = 12
        else:
            w[_W_ROOT + 2 * i] = int(isqrt(variance))
            w[_W_ROOT + 2 * i + 1] = 9
        i = i + 1
    return 0


@micropython.viper
def draw(s: ptr32, w: ptr32, t: ptr32) -> int:
    """All particles anew from N(0, P_VV), weights 1."""
    row = int(draw_row(s))
    int(roots(s, w, _S_P_VV))
    i = 0
    while i < _N:
        at = 3 * i
        g = _T_GAUSS + 3 * row
        a = 0
        while a < 3:
            shift = w[_W_ROOT + 2 * a + 1]
            half = 1 << (shift - 1)
            s[_S_X + at + a] = (w[_W_ROOT + 2 * a] * t[g + a] + half) >> shift
            a = a + 1
        s[_S_LOG_W + i] = 0
        row = row + 1
        if row >= _N:
            row = 0
        i = i + 1
    return 0


@micropython.viper
def propose(s: ptr32, w: ptr32, t: ptr32, fresh: int) -> int:
    """x' = x + process noise, into work PROPOSAL; particles just drawn have theirs already."""
    row = 0
    if fresh == 0:
        row = int(draw_row(s))
        int(roots(s, w, _S_DP_VV))
    i = 0
    while i < _N:
        at = 3 * i
        g = _T_GAUSS + 3 * row
        a = 0
        while a < 3:
            x = s[_S_X + at + a]
            if fresh == 0:
                shift = w[_W_ROOT + 2 * a + 1]
                half = 1 << (shift - 1)
                x = x + ((w[_W_ROOT + 2 * a] * t[g + a] + half) >> shift)
                if x > _X_MAX:
                    x = _X_MAX
                elif x < 0 - _X_MAX:
                    x = 0 - _X_MAX
            w[_W_PROPOSAL + at + a] = x
            a = a + 1
        row = row + _STRIDE
        if row >= _N:
            row = row - _N
        i = i + 1
    return 0


@micropython.viper
def observe(s: ptr32, p: ptr32, w: ptr32) -> int:
    """m² of the INS velocity against zero, and the likelihood's gain for the noise it implies.

    m² > 2 widens the observation noise by (m²/2)², that is, divides the gain by m²/2.
    """
    m2 = 0
    i = 0
    while i < 3:
        v = s[_S_VEL + i] >> 12
        if v > 32767:
            v = 32767
        elif v < -32767:
            v = -32767
        m2 = m2 + int(div(v * v, (s[_S_P_VV + i] >> 2) + p[_P_R], 10))
        i = i + 1
    s[_S_M2] = m2
    gain = p[_P_LIKELIHOOD]
    shift = 0
    if m2 > p[_P_M2_MAX]:
        half = m2 >> 1
        while half >= 2048:
            half = half >> 1
            shift = shift + 1
        gain = (gain << 10) // half
    if gain < 1:
        gain = 1
    w[_W_GAIN] = gain
    w[_W_GAIN_SHIFT] = shift
    return 0


@micropython.viper
def weigh(s: ptr32, p: ptr32, w: ptr32, t: ptr32) -> int:
    """log2 weights of the proposals, largest 0, and their weights; sums for N_eff and H2."""
    gain = w[_W_GAIN]
    shift = w[_W_GAIN_SHIFT]
    limit = 0x3FFFFFFF // gain
    best = -0x3FFFFFFF
    i = 0
    while i < _N:
        at = _W_PROPOSAL + 3 * i
        total = 0
        a = 0
        while a < 3:
            e = ((s[_S_VEL + a] >> 8) - w[at + a]) >> shift
            if e > limit:
                e = limit
            elif e < 0 - limit:
                e = 0 - limit
            e = (e * gain) >> 16
            total = total + e * e
            a = a + 1
        log_w = s[_S_LOG_W + i] - (total >> 6)
        s[_S_LOG_W + i] = log_w
        if log_w > best:
            best = log_w
        i = i + 1
    least = p[_P_LOG_FLOOR]
    heavy = p[_P_K]
    sum_w = 0
    sum_w2 = 0
    count = 0
    i = 0
    while i < _N:
        log_w = s[_S_LOG_W + i] - best
        if log_w < least:
            log_w = least
        s[_S_LOG_W + i] = log_w
        down = 0 - log_w
        whole = down >> 16
        weight = 0
        if whole < 15:
            at = _T_EXP2 + ((down >> 8) & 255)
            weight = t[at] - (((t[at] - t[at + 1]) * (down & 255)) >> 8)
            weight = (weight + (1 << whole)) >> (whole + 1)
        w[_W_WEIGHT + i] = weight
        sum_w = sum_w + weight
        sum_w2 = sum_w2 + ((weight * weight) >> 8)
        if weight > heavy:
            count = count + 1
        i = i + 1
    w[_W_SUM_W] = sum_w
    w[_W_SUM_W2] = sum_w2
    w[_W_HEAVY] = count
    root = sum_w >> 6
    s[_S_N_EFF] = int(div(root * root, sum_w2, 12))
    return 0


@micropython.viper
def estimate(s: ptr32, w: ptr32) -> int:
    """Weighted mean (ERR, Q24 m/s) and variance (VAR, on the scale of SCALE) of the proposals."""
    sum_w = w[_W_SUM_W]
    a = 0
    while a < 3:
        high = 0
        low = 0
        i = 0
        while i < _N:
            x = w[_W_PROPOSAL + 3 * i + a]
            weight = w[_W_WEIGHT + i]
            high = high + weight * (x >> 10)
            low = low + weight * (x & 1023)
            i = i + 1
        high = high + (low >> 10)
        low = low & 1023
        mean = high // sum_w
        mean = (mean << 10) + (((high - mean * sum_w) << 10) + low) // sum_w
        w[_W_ERR + a] = mean << 8
        # A scale on which the prior's sigma is 2**9 to 2**10 keeps every square small.
        scale = 0
        sigma2 = s[_S_P_VV + a]
        while sigma2 >= 16384:
            sigma2 = sigma2 >> 2
            scale = scale + 1
        total = 0
        i = 0
        while i < _N:
            e = (w[_W_PROPOSAL + 3 * i + a] - mean) >> scale
            if e > _E_MAX:
                e = _E_MAX
            elif e < 0 - _E_MAX:
                e = 0 - _E_MAX
            total = total + ((w[_W_WEIGHT + i] * e + 8192) >> 14) * e
            i = i + 1
        w[_W_VAR + a] = int(div(total, sum_w, 14))
        w[_W_SCALE + a] = scale
        a = a + 1
    return 0


@micropython.viper
def adapt(s: ptr32, p: ptr32) -> int:
    """The adaptive threshold M = M_a + K_e t / N_eff, at most M_b. 1 if it reached M_b (H1)."""
    t = s[_S_INCONSISTENT]
    if s[_S_M2] > p[_P_M2_MAX]:
        if t < _COUNT_MAX:
            t = t + 1
    else:
        t = 0
        s[_S_SINCE_CONSISTENT] = 0
    s[_S_INCONSISTENT] = t
    threshold = p[_P_M_B]
    if s[_S_SINCE_CONSISTENT] <= p[_P_LOCKOUT_TICKS] or t < p[_P_LOCKOUT_MIN]:
        rise = int(clamp(p[_P_K_E] * t, _RISE_MAX))
        threshold = p[_P_M_A] + (rise << 8) // (s[_S_N_EFF] | 1)
        if threshold > p[_P_M_B]:
            threshold = p[_P_M_B]
    s[_S_THRESHOLD] = threshold
    return int(threshold >= p[_P_M_B])


@micropython.viper
def retain(s: ptr32, w: ptr32) -> int:
    """Keep x' where its weight passes M, else go back to x; then take the estimate out."""
    threshold = s[_S_THRESHOLD]
    ex = w[_W_ERR] >> 8
    ey = w[_W_ERR + 1] >> 8
    ez = w[_W_ERR + 2] >> 8
    i = 0
    while i < _N:
        at = _S_X + 3 * i
        if w[_W_WEIGHT + i] > threshold:
            new = _W_PROPOSAL + 3 * i
            s[at] = w[new]
            s[at + 1] = w[new + 1]
            s[at + 2] = w[new + 2]
        s[at] = int(clamp(s[at] - ex, _X_MAX))
        s[at + 1] = int(clamp(s[at + 1] - ey, _X_MAX))
        s[at + 2] = int(clamp(s[at + 2] - ez, _X_MAX))
        i = i + 1
    return 0


@micropython.viper
def remaining(s: ptr32, p: ptr32, w: ptr32, i: int, locked: int) -> int:
    """rho = min(1, s² / P_VV) of axis i, Q30."""
    p_vv = s[_S_P_VV + i]
    if locked:
        if p_vv <= p[_P_P_VV_H1]:
            return _LIMIT
        return int(div(p[_P_P_VV_H1], p_vv, 30))
    scale = w[_W_SCALE + i]
    if scale >= 3:
        p_vv = p_vv >> (2 * scale - 6)
    else:
        p_vv = p_vv << (6 - 2 * scale)
    if w[_W_VAR + i] >= p_vv:
        return _LIMIT
    return int(div(w[_W_VAR + i], p_vv, 30))


@micropython.viper
def ratio(cov: int, var: int, room: int, limit: int) -> int:
    """cov / var * 2**22, limited: `limit` once |cov| >> room reaches var."""
    if cov == 0 or var <= 0:
        return 0
    size = cov
    if size < 0:
        size = 0 - size
    if (size >> room) >= var:
        if cov < 0:
            return 0 - limit
        return limit
    return int(clamp(int(div(cov, var, 22)), limit))


@micropython.viper
def feed_back(s: ptr32, p: ptr32, w: ptr32, locked: int) -> int:
    """The estimated error out of velocity, position and tilt, and out of their variances."""
    phi_e = 0
    phi_n = 0
    i = 0
    while i < 3:
        error = w[_W_ERR + i]
        rho = int(remaining(s, p, w, i, locked))
        k_p = int(ratio(s[_S_P_PV + i], s[_S_P_VV + i], 3, _KP_MAX))
        k_t = 0
        s[_S_VEL + i] = s[_S_VEL + i] - error
        move = int(clamp(int(mulshift(k_p, error, 26)), _MOVE_MAX))
        s[_S_POS + i] = s[_S_POS + i] - move
        if i < 2:
            k_t = int(ratio(s[_S_P_VT + i], s[_S_P_VV + i], 4, _KT_MAX))
            tilt = int(mulshift(k_t, int(clamp(error, _ERR_MAX)), 24))
            if i == 0:
                phi_n = 0 - int(clamp(tilt, _PHI_MAX))
            else:
                phi_e = int(clamp(tilt, _PHI_MAX))
        int(shrink(s, i, rho, k_p, k_t))
        i = i + 1
    east = int(clamp(s[_S_POS] - s[_S_POS_REF], _MOVE_MAX))
    north = int(clamp(s[_S_POS + 1] - s[_S_POS_REF + 1], _MOVE_MAX))
    lift = int(mulshift(phi_e, north, 24)) - int(mulshift(phi_n, east, 24))
    s[_S_POS + 2] = s[_S_POS + 2] + lift
    return int(turn(s, phi_e << 5, phi_n << 5, 0, 1))


@micropython.viper
def update(s: ptr32, p: ptr32, w: ptr32, t: ptr32, fresh: int) -> int:
    """One stance tick; `fresh` on the first of a stance. 0, 1 (H2) or 3 (H1): drawn anew."""
    if fresh:
        int(draw(s, w, t))
    int(propose(s, w, t, fresh))
    int(observe(s, p, w))
    int(weigh(s, p, w, t))
    int(estimate(s, w))
    locked = int(adapt(s, p))
    if locked:
        i = 0
        while i < 3:
            w[_W_ERR + i] = s[_S_VEL + i]
            i = i + 1
    int(retain(s, w))
    int(feed_back(s, p, w, locked))
    if locked:
        s[_S_INCONSISTENT] = 0
        s[_S_SINCE_CONSISTENT] = 0
        s[_S_LOCKOUTS] = s[_S_LOCKOUTS] + 1
        i = 0
        while i < 3:
            s[_S_P_VV + i] = p[_P_P_VV_H1]
            if i < 2 and s[_S_P_TT + i] < p[_P_P_TT_0]:
                s[_S_P_TT + i] = p[_P_P_TT_0]
            i = i + 1
    if locked or w[_W_HEAVY] < p[_P_HEAVY_MIN]:
        s[_S_RESAMPLED] = s[_S_RESAMPLED] + 1
        int(draw(s, w, t))
        return 1 + 2 * locked
    return 0
