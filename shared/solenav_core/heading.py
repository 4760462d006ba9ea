"""Magnetic heading in stance: the field's direction holds yaw and the yaw part of the gyro bias.

What the static start measured is the reference: strength, vertical part and azimuth of the field
in ENU (with MAG_ALIGN the azimuth is the declination, and the heading comes from the field). A
reading in stance whose strength or vertical part differs from it by more than its share is of
steel, not of the Earth (Afzal, Renaudin, Lachapelle 2010), and is left out. The others turn the
attitude about Up by a small share of the error, and take a share of it out of the gyro bias.
"""

from solenav_core.calibration import magnetic
from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import azimuth, clamp, isqrt, mulshift
from solenav_core.strapdown import to_nav, turn

_ROUNDS = const(8)
_HALF_TURN = const(51472)  # Q30 rad of half the angle, for one in 2**16 of a turn
_TURN_MAX = const(0x18000000)  # 3/8 rad
_WEAK = const(534)  # 10 µT in Q4 counts
_STRONG = const(8000)  # 150 µT

_S_ATT = const(394)
_S_BIAS = const(407)
_S_MAG_AZ = const(869)
_S_MAG_NORM = const(867)
_S_MAG_UP = const(868)
_S_MAG_USED = const(870)
_S_MAG_REFUSED = const(871)
_P_BIAS_MAX = const(48)
_P_MAG_GAIN = const(100)
_P_MAG_BIAS_GAIN = const(101)
_P_MAG_NORM_TOL = const(102)
_P_MAG_DIP_TOL = const(103)
_P_MAG_ERR_MAX = const(104)
_P_MAG_ALIGN = const(105)
_P_DECLINATION = const(106)
_W_NAV = const(0)
_W_FIELD = const(9)
_I_MAG = const(6)


@micropython.viper
def strength(w: ptr32) -> int:
    """Length of work FIELD, Q4 counts."""
    x = w[_W_FIELD]
    y = w[_W_FIELD + 1]
    z = w[_W_FIELD + 2]
    return int(isqrt(x * x + y * y + z * z))


@micropython.viper
def direction(s: ptr32, w: ptr32, t: ptr32) -> int:
    """Azimuth of work FIELD in ENU, 2**16 a turn; the field in ENU, Q16 counts, into NAV."""
    int(to_nav(s, w, w[_W_FIELD] << 12, w[_W_FIELD + 1] << 12, w[_W_FIELD + 2] << 12))
    return int(azimuth(w[_W_NAV], w[_W_NAV + 1], t))


@micropython.viper
def error(angle: int, reference: int) -> int:
    """`angle` less `reference`, -32768..32767."""
    return ((angle - reference + 32768) & 65535) - 32768


@micropython.viper
def refer(s: ptr32, p: ptr32, w: ptr32, t: ptr32) -> int:
    """Take work FIELD, the static start's, for reference; 0 where it is no field of the Earth.

    With MAG_ALIGN the attitude is turned until the field points to the declination.
    """
    norm = int(strength(w))
    s[_S_MAG_NORM] = 0
    if norm < _WEAK or norm > _STRONG:
        return 0
    found = int(direction(s, w, t))
    if p[_P_MAG_ALIGN]:
        i = 0
        while i < _ROUNDS:
            half = int(error(found, p[_P_DECLINATION])) * _HALF_TURN
            int(turn(s, 0, 0, int(clamp(half, _TURN_MAX)), 1))
            found = int(direction(s, w, t))
            i = i + 1
        found = p[_P_DECLINATION]
    s[_S_MAG_NORM] = norm
    s[_S_MAG_UP] = w[_W_NAV + 2] >> 12
    s[_S_MAG_AZ] = found
    return 1


@micropython.viper
def apart(a: int, b: int, share: int) -> int:
    """1 if a differs from b by more than `share`, both below 2**16."""
    off = a - b
    if off < 0:
        off = 0 - off
    return int(off > share)


@micropython.viper
def steer(s: ptr32, p: ptr32, w: ptr32, t: ptr32, m: ptr32) -> int:
    """One magnetometer reading in stance. 1 where it was used."""
    norm = s[_S_MAG_NORM]
    if norm == 0:
        return 0
    int(magnetic(s, p, w, m[_I_MAG] << 4, m[_I_MAG + 1] << 4, m[_I_MAG + 2] << 4))
    off = int(error(int(direction(s, w, t)), s[_S_MAG_AZ]))
    off = int(clamp(off, p[_P_MAG_ERR_MAX]))
    bad = int(apart(int(strength(w)), norm, (norm * p[_P_MAG_NORM_TOL]) >> 8))
    if bad or int(apart(w[_W_NAV + 2] >> 12, s[_S_MAG_UP], (norm * p[_P_MAG_DIP_TOL]) >> 8)):
        if s[_S_MAG_REFUSED] < 0x3FFFFFFF:
            s[_S_MAG_REFUSED] = s[_S_MAG_REFUSED] + 1
        return 0
    if s[_S_MAG_USED] < 0x3FFFFFFF:
        s[_S_MAG_USED] = s[_S_MAG_USED] + 1
    # Up in body axes, Q14: the third row of the rotation matrix.
    qw = s[_S_ATT] >> 15
    qx = s[_S_ATT + 1] >> 15
    qy = s[_S_ATT + 2] >> 15
    qz = s[_S_ATT + 3] >> 15
    taken = (off * p[_P_MAG_BIAS_GAIN]) >> 4
    limit = p[_P_BIAS_MAX] << 20
    up = (qx * qz - qw * qy) >> 15
    s[_S_BIAS] = int(clamp(s[_S_BIAS] - int(mulshift(taken, up << 4, 18)), limit))
    up = (qy * qz + qw * qx) >> 15
    s[_S_BIAS + 1] = int(clamp(s[_S_BIAS + 1] - int(mulshift(taken, up << 4, 18)), limit))
    up = 16384 - ((qx * qx + qy * qy) >> 15)
    s[_S_BIAS + 2] = int(clamp(s[_S_BIAS + 2] - int(mulshift(taken, up << 4, 18)), limit))
    int(turn(s, 0, 0, off * p[_P_MAG_GAIN], 1))
    return 1
