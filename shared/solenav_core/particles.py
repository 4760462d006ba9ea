"""Adaptive particle filter over the error of the INS velocity, run in stance.

100 particles, each a hypothesis of the 3-D velocity error; the INS velocity itself observes it,
since the foot stands. Guo, Xu, Ji 2020, section 2 and table 1, read as docs/algorithm.md says:
adaptive observation noise, adaptive threshold M with retain or revert, H1 and H2 with secondary
resampling, feedback into velocity, position and tilt.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.covariance import shrink
from solenav_core.qmath import clamp, div, isqrt, mulsat, mulshift
from solenav_core.strapdown import turn

_N = const(100)
_STRIDE = const(37)  # prime to 100: every particle gets another row of the table
_LIMIT = const(0x3FFFFFFF)
_MOST = const(4540)  # largest particle on its scale: a hundred squares of it fit a word
_FARTHEST = const(51)  # largest component in the table, 3.18, in Q4 rounded up
_ERR_FAR = const(268435456)  # 16 m/s in Q24: taken from a velocity at its limit it still fits
_V_MAX = const(524272)  # 8 m/s in Q16, the velocity that the likelihood takes at most
_KP_MAX = const(33554432)  # 32 s in Q20
_KT_MAX = const(67108864)  # 4 rad s/m in Q24
_PHI_MAX = const(8388608)  # 0.5 rad in Q24
_ERR_MAX = const(134217728)  # 8 m/s in Q24: beyond this the velocity says nothing about tilt
_NOISE_MAX = const(0x4000000)  # 8 (m/s)² in Q23
_HALF_MAX = const(0x400000)  # m²/2 of 4096 in Q10
_COUNT_MAX = const(1023)
_RISE_MAX = const(4194303)  # K_E * t: over 100 particles far past any M_b
_MOVE_MAX = const(268435456)  # 1024 m in Q18

_S_VEL = const(398)
_S_POS = const(401)
_S_P_VV = const(411)
_S_P_PV = const(414)
_S_P_VT = const(420)
_S_P_TT = const(424)
_S_DP_VV = const(426)
_S_RNG = const(430)
_S_INCONSISTENT = const(433)
_S_SINCE_CONSISTENT = const(434)
_S_M2 = const(435)
_S_THRESHOLD = const(436)
_S_N_EFF = const(437)
_S_RESAMPLED = const(438)
_S_LOCKOUTS = const(439)
_S_LOG_W = const(440)
_S_REACH = const(540)
_S_X = const(543)
_S_POS_REF = const(846)
_P_R = const(84)
_P_LIKELIHOOD = const(85)
_P_M2_MAX = const(86)
_P_UNREST_SURE = const(71)
_P_LOG_FLOOR = const(87)
_P_M_A = const(88)
_P_M_B = const(89)
_P_K_E = const(90)
_P_K = const(91)
_P_HEAVY_MIN = const(92)
_P_LOCKOUT_TICKS = const(93)
_P_LOCKOUT_MIN = const(94)
_P_P_VV_H1 = const(95)
_P_P_TT_0 = const(83)
_W_UNREST = const(12)
_W_ERR = const(18)
_W_NOISE = const(30)
_W_VAR = const(21)
_W_SCALE = const(24)
_W_ROOT = const(27)
_W_GAIN = const(31)
_W_GAIN_EXTRA = const(33)
_W_GAIN_SHIFT = const(32)
_W_SUM = const(35)
_W_SUM2 = const(38)
_W_SUM_W = const(34)
_W_HEAVY = const(41)
_W_PROPOSAL = const(42)
_W_WEIGHT = const(342)
_T_EXP2 = const(0)
_T_GAUSS = const(273)


@micropython.viper
def stir(s: ptr32) -> int:
    """One step of xorshift32 (Marsaglia 2003) on 16-bit halves.

    Every tick takes one, whatever it does: so a decision that a rounding tipped over doesn't
    give all later ticks other random numbers.
    """
    hi = s[_S_RNG]
    lo = s[_S_RNG + 1]
    a = hi ^ (((hi << 13) | (lo >> 3)) & 65535)
    b = lo ^ ((lo << 13) & 65535)
    b = b ^ (a >> 1)
    hi = a ^ (((a << 5) | (b >> 11)) & 65535)
    lo = b ^ ((b << 5) & 65535)
    s[_S_RNG] = hi
    s[_S_RNG + 1] = lo
    return 0


@micropython.viper
def row(s: ptr32) -> int:
    """The row of the table, 0..99, that this tick's random number chooses."""
    return (s[_S_RNG + 1] * _N) >> 16


@micropython.viper
def roots(s: ptr32, w: ptr32, source: int) -> int:
    """ROOT: square roots, Q16 m/s, of three variances (Q26, state words from `source`).

    Those of 0.5 (m/s)² or more keep 13 bits of fraction: the others' shift would not fit.
    """
    i = 0
    while i < 3:
        variance = s[source + i]
        if variance < 0:
            variance = 0
        if variance < 0x2000000:
            w[_W_ROOT + i] = int(isqrt(variance << 6))
        else:
            w[_W_ROOT + i] = int(isqrt(variance)) << 3
        i = i + 1
    return 0


@micropython.viper
def widen(s: ptr32, w: ptr32, more: int) -> int:
    """How far a particle may be from 0 after noise of ROOT: alone, or on `more` than before."""
    i = 0
    while i < 3:
        reach = w[_W_ROOT + i] * _FARTHEST >> 4
        if more:
            reach = reach + s[_S_REACH + i]
        s[_S_REACH + i] = reach
        i = i + 1
    return 0


@micropython.viper
def scales(s: ptr32, w: ptr32) -> int:
    """SCALE of each axis: the least on which no particle is beyond _MOST.

    On that scale a hundred squares fit one word.
    """
    i = 0
    while i < 3:
        scale = 0
        reach = s[_S_REACH + i]
        while reach > _MOST:
            reach = reach >> 1
            scale = scale + 1
        w[_W_SCALE + i] = scale
        i = i + 1
    return 0


@micropython.viper
def draw(k: int, q: int, s: ptr32, w: ptr32, t: ptr32, again: int) -> int:
    """All particles anew from N(0, P_VV), weights 1. k and q are room for loop variables.

    `again`, after the tick's proposals, takes the other half of the table first.

    A kernel's first parameters live in registers on a board: they are its hottest locals.
    """
    k = _T_GAUSS + int(row(s))
    if again:
        k = k + 50
        if k >= _T_GAUSS + _N:
            k = k - _N
    int(roots(s, w, _S_P_VV))
    east = w[_W_ROOT]
    north = w[_W_ROOT + 1]
    rise = w[_W_ROOT + 2]
    q = _S_X
    while q < _S_X + _N:
        if k >= _T_GAUSS + _N:
            k = k - _N
        s[q] = (east * t[k] + 1024) >> 11
        s[q + _N] = (north * t[k + _N] + 1024) >> 11
        s[q + 2 * _N] = (rise * t[k + 2 * _N] + 1024) >> 11
        k = k + 1
        q = q + 1
    int(widen(s, w, 0))
    k = _S_LOG_W
    while k < _S_LOG_W + _N:
        s[k] = 0
        k = k + 1
    return 0


@micropython.viper
def propose(k: int, q: int, s: ptr32, w: ptr32, t: ptr32, fresh: int) -> int:
    """x' = x + process noise, into work PROPOSAL; particles just drawn have theirs already."""
    k = _T_GAUSS
    w[_W_ROOT] = 0
    w[_W_ROOT + 1] = 0
    w[_W_ROOT + 2] = 0
    if fresh == 0:
        k = k + int(row(s))
        int(roots(s, w, _S_DP_VV))
        int(widen(s, w, 1))
    east = w[_W_ROOT]
    north = w[_W_ROOT + 1]
    rise = w[_W_ROOT + 2]
    q = _W_PROPOSAL
    at = _S_X
    while q < _W_PROPOSAL + _N:
        if k >= _T_GAUSS + _N:
            k = k - _N
        w[q] = s[at] + ((east * t[k] + 1024) >> 11)
        w[q + _N] = s[at + _N] + ((north * t[k + _N] + 1024) >> 11)
        w[q + 2 * _N] = s[at + 2 * _N] + ((rise * t[k + 2 * _N] + 1024) >> 11)
        k = k + _STRIDE
        q = q + 1
        at = at + 1
    return 0


@micropython.viper
def observe(s: ptr32, p: ptr32, w: ptr32) -> int:
    """m² of the INS velocity against zero; the observation's noise and the likelihood's gain.

    Unrest u makes the noise R (1 + u)²; m² > 2 widens it by (m²/2)² more, that is, divides the
    gain by m²/2. Errors are shifted right until gain times the largest one fits a word.
    """
    unrest = 256 + w[_W_UNREST]
    noise = int(clamp(int(mulsat(p[_P_R], unrest * unrest, 17)), _NOISE_MAX))
    m2 = 0
    span = 0
    i = 0
    while i < 3:
        v = int(clamp(s[_S_VEL + i] >> 12, 32767))
        m2 = m2 + int(div(v * v, (s[_S_P_VV + i] >> 3) + noise, 9))
        if v < 0:
            v = 0 - v
        reach = (v << 4) + s[_S_REACH + i]
        if reach > span:
            span = reach
        i = i + 1
    s[_S_M2] = m2
    gain = (p[_P_LIKELIHOOD] << 8) // unrest  # > 0: 256 and more
    shift = 0
    if m2 > p[_P_M2_MAX]:
        half = m2 >> 1
        if half < 1024:
            half = 1024  # m² widens the noise, it never narrows it
        wider = int(clamp(half, _HALF_MAX)) << 7
        noise = int(clamp(int(mulsat(noise, wider, 17)), _NOISE_MAX))
        noise = int(clamp(int(mulsat(noise, wider, 17)), _NOISE_MAX))
        while half >= 2048:
            half = half >> 1
            shift = shift + 1
        gain = (gain << 10) // half  # > 0: 1024 and more
    if gain < 1:
        gain = 1
    most = 0x3FFFFFFF // gain
    extra = 0
    while span >> (shift + extra) > most:
        extra = extra + 1
    w[_W_NOISE] = noise
    w[_W_GAIN] = gain
    w[_W_GAIN_SHIFT] = shift + extra
    w[_W_GAIN_EXTRA] = extra
    return 0


@micropython.viper
def likelihood(e: int, k: int, total: int, s: ptr32, w: ptr32) -> int:
    """log2 weights less the squared normalised error of each proposal. The largest one."""
    gain = w[_W_GAIN]
    shift = w[_W_GAIN_SHIFT]
    # A factor of two in the error, shifted away, is one of four in its square.
    down = 6
    up = 0
    cap = 0x3FFFFFFF
    extra = w[_W_GAIN_EXTRA]
    if extra <= 3:
        down = 6 - 2 * extra
    else:
        down = 0
        up = 2 * extra - 6
        cap = 0x2000000 >> up
    east = int(clamp(s[_S_VEL] >> 8, _V_MAX))
    north = int(clamp(s[_S_VEL + 1] >> 8, _V_MAX))
    rise = int(clamp(s[_S_VEL + 2] >> 8, _V_MAX))
    best = -0x3FFFFFFF
    j = _S_LOG_W
    k = _W_PROPOSAL
    while k < _W_PROPOSAL + _N:
        e = (((east - w[k]) >> shift) * gain) >> 16
        total = e * e
        e = (((north - w[k + _N]) >> shift) * gain) >> 16
        total = total + e * e
        e = (((rise - w[k + 2 * _N]) >> shift) * gain) >> 16
        total = total + e * e
        if total > cap:
            total = cap
        total = s[j] - ((total >> down) << up)
        s[j] = total
        if total > best:
            best = total
        j = j + 1
        k = k + 1
    return best


@micropython.viper
def weigh(x: int, weight: int, j: int, s: ptr32, p: ptr32, w: ptr32, t: ptr32) -> int:
    """Weights of the proposals, largest 1, and their sums for the mean, N_eff and H2."""
    best = int(likelihood(0, 0, 0, s, w))
    least = p[_P_LOG_FLOOR]
    heavy = p[_P_K]
    sum_w = 0
    sum_w2 = 0
    count = 0
    k = _W_WEIGHT
    j = _S_LOG_W
    while j < _S_LOG_W + _N:
        x = s[j] - best
        if x < least:
            x = least
        s[j] = x
        x = 0 - x
        whole = x >> 16
        weight = 0
        if whole < 15:
            at = _T_EXP2 + ((x >> 8) & 255)
            weight = t[at] - (((t[at] - t[at + 1]) * (x & 255)) >> 8)
            weight = (weight + (1 << whole)) >> (whole + 1)
        w[k] = weight
        sum_w = sum_w + weight
        sum_w2 = sum_w2 + ((weight * weight) >> 8)
        if weight > heavy:
            count = count + 1
        k = k + 1
        j = j + 1
    w[_W_SUM_W] = sum_w
    w[_W_HEAVY] = count
    root = sum_w >> 6
    s[_S_N_EFF] = int(div(root * root, sum_w2, 12))
    return 0


@micropython.viper
def moments(e: int, u: int, w: ptr32) -> int:
    """Weighted sums over the proposals on the scale of SCALE: of values, SUM, and squares, SUM2."""
    east = w[_W_SCALE]
    north = w[_W_SCALE + 1]
    rise = w[_W_SCALE + 2]
    east1 = 0
    east2 = 0
    north1 = 0
    north2 = 0
    rise1 = 0
    rise2 = 0
    k = _W_PROPOSAL
    while k < _W_PROPOSAL + _N:
        weight = w[k + 3 * _N]
        e = w[k] >> east
        u = (weight * e + 8192) >> 14
        east1 = east1 + u
        east2 = east2 + u * e
        e = w[k + _N] >> north
        u = (weight * e + 8192) >> 14
        north1 = north1 + u
        north2 = north2 + u * e
        e = w[k + 2 * _N] >> rise
        u = (weight * e + 8192) >> 14
        rise1 = rise1 + u
        rise2 = rise2 + u * e
        k = k + 1
    w[_W_SUM] = east1
    w[_W_SUM + 1] = north1
    w[_W_SUM + 2] = rise1
    w[_W_SUM2] = east2
    w[_W_SUM2 + 1] = north2
    w[_W_SUM2 + 2] = rise2
    return 0


@micropython.viper
def estimate(w: ptr32) -> int:
    """Weighted mean (ERR, Q24 m/s) and variance (VAR, on the scale of SCALE) of the proposals.

    The variance is the mean square less the square mean.
    """
    int(moments(0, 0, w))
    sum_w = w[_W_SUM_W]
    i = 0
    while i < 3:
        mean = int(div(w[_W_SUM + i], sum_w, 18))
        square = mean >> 2
        var = int(div(w[_W_SUM2 + i], sum_w, 14)) - ((square * square) >> 4)
        if var < 0:
            var = 0
        scale = w[_W_SCALE + i]
        if scale > 0:
            mean = mean + 8  # the shift in `moments` rounds down, by half a unit on average
        w[_W_ERR + i] = int(clamp(mean << (scale + 4), _ERR_FAR))
        w[_W_VAR + i] = var
        i = i + 1
    return 0


@micropython.viper
def adapt(s: ptr32, p: ptr32, w: ptr32) -> int:
    """The adaptive threshold M = M_a + K_e t / N_eff, at most M_b. 1 if it reached M_b (H1).

    Only a sample that is still enough has a say in whether the filter agrees with it.
    """
    t = s[_S_INCONSISTENT]
    sure = int(w[_W_UNREST] <= p[_P_UNREST_SURE])
    if sure:
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
    if threshold < p[_P_M_B]:
        return 0
    return sure


@micropython.viper
def retain(k: int, j: int, s: ptr32, w: ptr32) -> int:
    """Keep x' where its weight passes M, else go back to x; then take the estimate out."""
    threshold = s[_S_THRESHOLD]
    east = w[_W_ERR] >> 8
    north = w[_W_ERR + 1] >> 8
    rise = w[_W_ERR + 2] >> 8
    k = _S_X
    j = _W_WEIGHT
    q = _W_PROPOSAL
    while j < _W_WEIGHT + _N:
        if w[j] > threshold:
            s[k] = w[q] - east
            s[k + _N] = w[q + _N] - north
            s[k + 2 * _N] = w[q + 2 * _N] - rise
        else:
            s[k] = s[k] - east
            s[k + _N] = s[k + _N] - north
            s[k + 2 * _N] = s[k + 2 * _N] - rise
        k = k + 1
        j = j + 1
        q = q + 1
    i = 0
    while i < 3:
        error = w[_W_ERR + i] >> 8
        if error < 0:
            error = 0 - error
        s[_S_REACH + i] = s[_S_REACH + i] + error
        i = i + 1
    return 0


@micropython.viper
def scattered(s: ptr32) -> int:
    """1 if particles may be 16 sigma away on an axis: no longer a picture of P_VV."""
    found = 0
    i = 0
    while i < 3:
        reach = s[_S_REACH + i] >> 7
        if reach * reach > s[_S_P_VV + i]:
            found = 1
        i = i + 1
    return found


@micropython.viper
def remaining(s: ptr32, p: ptr32, w: ptr32, i: int, locked: int) -> int:
    """rho = min(1, s² / P_VV) of axis i, Q30.

    No less than R / (P_VV + R), what one observation leaves of a Gaussian: where few particles
    have weight, their variance says too little.
    """
    p_vv = s[_S_P_VV + i]
    if locked:
        if p_vv <= p[_P_P_VV_H1]:
            return _LIMIT
        return int(div(p[_P_P_VV_H1], p_vv, 30))
    noise = w[_W_NOISE]
    least = int(div(noise, (p_vv >> 3) + noise, 15)) << 15
    scale = w[_W_SCALE + i]
    if scale >= 3:
        p_vv = p_vv >> (2 * scale - 6)
    else:
        p_vv = p_vv << (6 - 2 * scale)
    if w[_W_VAR + i] >= p_vv:
        return _LIMIT
    rho = int(div(w[_W_VAR + i], p_vv, 30))
    if rho < least:
        rho = least
    return int(clamp(rho, _LIMIT))


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
    """One stance tick; `fresh` after one that observed nothing. 0, 1 (H2) or 3 (H1): drawn anew."""
    if fresh:
        int(draw(0, 0, s, w, t, 0))
    int(propose(0, 0, s, w, t, fresh))
    int(scales(s, w))
    int(observe(s, p, w))
    int(weigh(0, 0, 0, s, p, w, t))
    int(estimate(w))
    locked = int(adapt(s, p, w))
    if locked:
        i = 0
        while i < 3:
            w[_W_ERR + i] = s[_S_VEL + i]
            i = i + 1
    int(feed_back(s, p, w, locked))
    if locked:
        s[_S_INCONSISTENT] = 0
        s[_S_SINCE_CONSISTENT] = 0
        if s[_S_LOCKOUTS] < _LIMIT:
            s[_S_LOCKOUTS] = s[_S_LOCKOUTS] + 1
        i = 0
        while i < 3:
            s[_S_P_VV + i] = p[_P_P_VV_H1]
            if i < 2 and s[_S_P_TT + i] < p[_P_P_TT_0]:
                s[_S_P_TT + i] = p[_P_P_TT_0]
            i = i + 1
    anew = int(locked or w[_W_HEAVY] < p[_P_HEAVY_MIN])
    if anew == 0:
        int(retain(0, 0, s, w))
        anew = int(scattered(s))
    if anew:
        if s[_S_RESAMPLED] < _LIMIT:
            s[_S_RESAMPLED] = s[_S_RESAMPLED] + 1
        int(draw(0, 0, s, w, t, 1))
    return anew + 2 * locked
