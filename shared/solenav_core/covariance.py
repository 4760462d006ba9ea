"""Variances of velocity, position and tilt: one scalar set per axis (docs/algorithm.md, step 2).

East and North velocity errors grow with the tilt about the other axis (gamma = g dt); Up has no
such coupling. The tilt of set E is the one about North, of set N the one about minus East, so
that both couple with the same sign.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp, mulsat, mulshift

_LIMIT = const(0x3FFFFFFF)  # 16 (m/s)², 64 m²/s and m², 4 rad m/s and rad m, 1 rad²

_S_P_VV = const(74)
_S_P_PV = const(77)
_S_P_PP = const(80)
_S_P_VT = const(83)
_S_P_PT = const(85)
_S_P_TT = const(87)
_S_DP_VV = const(89)
_P_DT = const(3)
_P_GAMMA = const(19)
_P_GAMMA2 = const(20)
_P_Q_VV_H = const(21)
_P_Q_VV_U = const(22)
_P_Q_TT = const(23)


@micropython.viper
def grow(s: ptr32, p: ptr32) -> int:
    """One sample period without observation. Every value is limited, none wraps."""
    dt = p[_P_DT]
    gamma = p[_P_GAMMA]
    i = 0
    while i < 3:
        p_vv = s[_S_P_VV + i]
        p_pv = s[_S_P_PV + i]
        d_pv = int(mulshift(dt, p_vv, 32))
        d_pp = int(mulshift(dt, d_pv, 30)) + int(mulshift(dt, p_pv, 29))
        if i < 2:
            p_vt = s[_S_P_VT + i]
            p_tt = s[_S_P_TT + i]
            p_pt = int(clamp(s[_S_P_PT + i] + int(mulshift(dt, p_vt, 30)), _LIMIT))
            d_pv = d_pv + int(mulshift(gamma, p_pt, 34))
            d_vv = int(mulshift(gamma, p_vt, 31)) + int(mulshift(p[_P_GAMMA2], p_tt, 34))
            d_vv = d_vv + p[_P_Q_VV_H]
            s[_S_P_PT + i] = p_pt
            s[_S_P_VT + i] = int(clamp(p_vt + int(mulshift(gamma, p_tt, 32)), _LIMIT))
            s[_S_P_TT + i] = int(clamp(p_tt + p[_P_Q_TT], _LIMIT))
        else:
            d_vv = p[_P_Q_VV_U]
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
    seen = int(mulshift(s[_S_P_PV + i], taken, 30))
    s[_S_P_PP + i] = int(clamp(s[_S_P_PP + i] - int(mulsat(k_p, seen, 20)), _LIMIT))
    if s[_S_P_PP + i] < 0:
        s[_S_P_PP + i] = 0
    s[_S_P_PV + i] = int(mulshift(s[_S_P_PV + i], rho, 30))
    s[_S_P_VV + i] = int(mulshift(s[_S_P_VV + i], rho, 30))
    if i < 2:
        seen = int(mulshift(s[_S_P_VT + i], taken, 30))
        p_tt = s[_S_P_TT + i] - int(mulsat(k_t, seen, 22))
        if p_tt < 0:
            p_tt = 0
        s[_S_P_TT + i] = int(clamp(p_tt, _LIMIT))
        s[_S_P_PT + i] = int(clamp(s[_S_P_PT + i] - int(mulsat(k_p, seen, 20)), _LIMIT))
        s[_S_P_VT + i] = int(mulshift(s[_S_P_VT + i], rho, 30))
    return 0
