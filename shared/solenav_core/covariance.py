"""Variances of velocity, position and tilt: one scalar set per axis (docs/algorithm.md, step 2).

East and North velocity errors grow with the tilt about the other axis (gamma = g dt); Up has no
such coupling, but what the samples miss where the force changes fast. The tilt of set E is the one
about North, of set N the one about minus East, so that both couple with the same sign. Products are
written out in halves, as in `strapdown`.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp, mulsat, mulshift

_LIMIT = const(0x3FFFFFFF)  # 16 (m/s)², 64 m²/s and m², 4 rad m/s and rad m, 1 rad²

_S_LAST = const(3)
_S_P_VV = const(411)
_S_P_PV = const(414)
_S_P_PP = const(417)
_S_P_VT = const(420)
_S_P_PT = const(422)
_S_P_TT = const(424)
_S_DP_VV = const(426)
_S_SWING_TICKS = const(429)
_S_STANCE_TICKS = const(855)
_P_DT = const(41)
_P_ALIGN_TICKS = const(44)
_P_GAMMA = const(75)
_P_GAMMA2 = const(76)
_P_Q_VV_H = const(77)
_P_Q_VV_U = const(78)
_P_STRIKE = const(79)
_P_Q_TT = const(80)
_W_FORCE = const(3)


@micropython.viper
def grow(s: ptr32, p: ptr32, w: ptr32) -> int:
    """One sample period without observation, from state LAST to work FORCE.

    Every value is limited, none wraps.
    """
    dt = p[_P_DT]
    dtl = dt & 32767
    dt = dt >> 15
    gamma = p[_P_GAMMA]
    gammal = gamma & 32767
    gamma = gamma >> 15
    i = 0
    while i < 3:
        p_vv = s[_S_P_VV + i]
        low = p_vv & 32767
        high = p_vv >> 15
        mid = dt * low + dtl * high + ((dtl * low) >> 15)
        d_pv = (dt * high + (mid >> 15) + 2) >> 2
        p_pv = s[_S_P_PV + i]
        low = p_pv & 32767
        high = p_pv >> 15
        mid = dt * low + dtl * high + ((dtl * low) >> 15) + 8192
        d_pp = ((dt * high) << 1) + (mid >> 14)
        low = d_pv & 32767
        high = d_pv >> 15
        mid = dt * low + dtl * high + ((dtl * low) >> 15) + 16384
        d_pp = d_pp + dt * high + (mid >> 15)
        if i < 2:
            p_vt = s[_S_P_VT + i]
            low = p_vt & 32767
            high = p_vt >> 15
            mid = dt * low + dtl * high + ((dtl * low) >> 15) + 16384
            p_pt = int(clamp(s[_S_P_PT + i] + dt * high + (mid >> 15), _LIMIT))
            s[_S_P_PT + i] = p_pt
            mid = gamma * low + gammal * high + ((gammal * low) >> 15)
            d_vv = (gamma * high + (mid >> 15) + 1) >> 1
            low = p_pt & 32767
            high = p_pt >> 15
            mid = gamma * low + gammal * high + ((gammal * low) >> 15)
            d_pv = d_pv + ((gamma * high + (mid >> 15) + 8) >> 4)
            p_tt = s[_S_P_TT + i]
            low = p_tt & 32767
            high = p_tt >> 15
            mid = gamma * low + gammal * high + ((gammal * low) >> 15)
            s[_S_P_VT + i] = int(clamp(p_vt + ((gamma * high + (mid >> 15) + 2) >> 2), _LIMIT))
            d_vv = d_vv + int(mulshift(p[_P_GAMMA2], p_tt, 34)) + p[_P_Q_VV_H]
            s[_S_P_TT + i] = int(clamp(p_tt + p[_P_Q_TT], _LIMIT))
        else:
            d_vv = p[_P_Q_VV_U]
            if s[_S_SWING_TICKS] == 0 and s[_S_STANCE_TICKS] > p[_P_ALIGN_TICKS] << 1:
                # In a long stance the accelerometer's bias is what drives the velocity.
                d_vv = p[_P_Q_VV_H]
            # What the samples miss where the force changes fast.
            low = (w[_W_FORCE] - s[_S_LAST]) >> 16
            high = (w[_W_FORCE + 1] - s[_S_LAST + 1]) >> 16
            mid = (w[_W_FORCE + 2] - s[_S_LAST + 2]) >> 16
            mid = low * low + high * high + mid * mid
            d_vv = int(clamp(d_vv + int(mulsat(mid, p[_P_STRIKE], 22)), _LIMIT))
        s[_S_P_PP + i] = int(clamp(s[_S_P_PP + i] + d_pp, _LIMIT))
        s[_S_P_PV + i] = int(clamp(p_pv + d_pv, _LIMIT))
        p_new = int(clamp(p_vv + d_vv, _LIMIT))
        if p_new < 0:
            p_new = 0
        s[_S_P_VV + i] = p_new
        s[_S_DP_VV + i] = p_new - p_vv
        i = i + 1
    return 0


@micropython.viper
def shrink(s: ptr32, i: int, rho: int, k_p: int, k_t: int) -> int:
    """Axis i after an observation that leaves rho (Q30) of the velocity's variance.

    k_p Q20 s and k_t Q24 rad s/m are the gains that the feedback used.
    """
    taken = _LIMIT - rho
    takenl = taken & 32767
    taken = taken >> 15
    rhol = rho & 32767
    rho = rho >> 15
    low = s[_S_P_PV + i]
    high = low >> 15
    low = low & 32767
    mid = high * takenl + low * taken + ((low * takenl) >> 15) + 16384
    seen = high * taken + (mid >> 15)
    mid = high * rhol + low * rho + ((low * rhol) >> 15) + 16384
    s[_S_P_PV + i] = high * rho + (mid >> 15)
    p_pp = int(clamp(s[_S_P_PP + i] - int(mulsat(k_p, seen, 20)), _LIMIT))
    if p_pp < 0:
        p_pp = 0
    s[_S_P_PP + i] = p_pp
    low = s[_S_P_VV + i]
    high = low >> 15
    low = low & 32767
    mid = high * rhol + low * rho + ((low * rhol) >> 15) + 16384
    s[_S_P_VV + i] = high * rho + (mid >> 15)
    if i < 2:
        low = s[_S_P_VT + i]
        high = low >> 15
        low = low & 32767
        mid = high * takenl + low * taken + ((low * takenl) >> 15) + 16384
        seen = high * taken + (mid >> 15)
        mid = high * rhol + low * rho + ((low * rhol) >> 15) + 16384
        s[_S_P_VT + i] = high * rho + (mid >> 15)
        p_tt = s[_S_P_TT + i] - int(mulsat(k_t, seen, 22))
        if p_tt < 0:
            p_tt = 0
        s[_S_P_TT + i] = int(clamp(p_tt, _LIMIT))
        s[_S_P_PT + i] = int(clamp(s[_S_P_PT + i] - int(mulsat(k_p, seen, 20)), _LIMIT))
    return 0
