"""Strapdown integration: attitude, velocity and position from one sample.

Navigation frame ENU, body frame right-front-up, attitude quaternion body to ENU. Method:
third- and fourth-order series of the rotation vector, specific force turned to the middle of
the interval, trapezoidal position (docs/algorithm.md, step 1).
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp, mulshift

_ONE = const(0x3FFFFFFF)  # 1 in Q30 less its last bit: 2**30 itself is no small int
_VEL_MAX = const(419430400)  # a quarter of 100 m/s in Q24: literals stay below 2**30
_CELL = const(0x20000000)  # half a cell, 2048 m in Q18
_FAR = const(0x3FFFFFFF)  # farthest that an anchor may lie from the cell's middle, Q18 m

_S_SATURATED = const(2)
_S_ATT = const(57)
_S_VEL = const(61)
_S_POS = const(64)
_S_CELL = const(67)
_S_BIAS = const(70)
_S_GRAVITY = const(73)
_S_POS_LAST = const(505)
_S_POS_STEP = const(511)
_P_ACC_SCALE = const(1)
_P_HALF_ANGLE = const(2)
_P_DT = const(3)
_W_NAV = const(0)
_W_RATE = const(3)
_I_ACC = const(0)
_I_GYRO = const(3)


@micropython.viper
def compose(s: ptr32, bw: int, bx: int, by: int, bz: int, left: int) -> int:
    """Attitude times b (left = 0) or b times attitude (left = 1), renormalised. b in Q30.

    Sums of products of halves, 15 bits each: as both factors are units no sum of two passes
    2**31 (Cauchy-Schwarz). One Newton step of the inverse root, (3 - |q|²) / 2, keeps the
    length; it needs |q| near 1.
    """
    aw = s[_S_ATT]
    ax = s[_S_ATT + 1]
    ay = s[_S_ATT + 2]
    az = s[_S_ATT + 3]
    if left:
        # b times a is the same formula with the factors swapped.
        aw = bw
        ax = bx
        ay = by
        az = bz
        bw = s[_S_ATT]
        bx = s[_S_ATT + 1]
        by = s[_S_ATT + 2]
        bz = s[_S_ATT + 3]
    awl = aw & 32767
    aw = aw >> 15
    axl = ax & 32767
    ax = ax >> 15
    ayl = ay & 32767
    ay = ay >> 15
    azl = az & 32767
    az = az >> 15
    bwl = bw & 32767
    bw = bw >> 15
    bxl = bx & 32767
    bx = bx >> 15
    byl = by & 32767
    by = by >> 15
    bzl = bz & 32767
    bz = bz >> 15
    w = aw * bw - ax * bx
    w = w - ay * by - az * bz + 2
    w = w + ((aw * bwl - ax * bxl) >> 15)
    w = w - ((ay * byl + az * bzl) >> 15)
    w = w + ((awl * bw - axl * bx) >> 15)
    w = w - ((ayl * by + azl * bz) >> 15)
    x = aw * bx + ax * bw
    x = x + ay * bz - az * by + 2
    x = x + ((aw * bxl + ax * bwl) >> 15)
    x = x + ((ay * bzl - az * byl) >> 15)
    x = x + ((awl * bx + axl * bw) >> 15)
    x = x + ((ayl * bz - azl * by) >> 15)
    y = aw * by + ay * bw
    y = y + az * bx - ax * bz + 2
    y = y + ((aw * byl + ay * bwl) >> 15)
    y = y + ((az * bxl - ax * bzl) >> 15)
    y = y + ((awl * by + ayl * bw) >> 15)
    y = y + ((azl * bx - axl * bz) >> 15)
    z = aw * bz + az * bw
    z = z + ax * by - ay * bx + 2
    z = z + ((aw * bzl + az * bwl) >> 15)
    z = z + ((ax * byl - ay * bxl) >> 15)
    z = z + ((awl * bz + azl * bw) >> 15)
    z = z + ((axl * by - ayl * bx) >> 15)
    norm2 = int(mulshift(w, w, 30)) + int(mulshift(x, x, 30))
    norm2 = norm2 + int(mulshift(y, y, 30)) + int(mulshift(z, z, 30))
    half = (_ONE - norm2) >> 1
    s[_S_ATT] = w + int(mulshift(w, half, 30))
    s[_S_ATT + 1] = x + int(mulshift(x, half, 30))
    s[_S_ATT + 2] = y + int(mulshift(y, half, 30))
    s[_S_ATT + 3] = z + int(mulshift(z, half, 30))
    return 0


@micropython.viper
def turn(s: ptr32, hx: int, hy: int, hz: int, left: int) -> int:
    """Turn the attitude by the rotation vector 2 h (Q30 rad), |h| up to about 1/2.

    left = 0: h is in body axes; left = 1: in ENU.
    """
    h2 = int(mulshift(hx, hx, 30)) + int(mulshift(hy, hy, 30)) + int(mulshift(hz, hz, 30))
    h4 = int(mulshift(h2, h2, 30))
    cosine = _ONE - (h2 >> 1) + h4 // 24
    sinc = _ONE - h2 // 6 + h4 // 120
    x = int(mulshift(hx, sinc, 30))
    y = int(mulshift(hy, sinc, 30))
    z = int(mulshift(hz, sinc, 30))
    return int(compose(s, cosine, x, y, z, left))


@micropython.viper
def to_nav(s: ptr32, w: ptr32, x: int, y: int, z: int) -> int:
    """Turn a body vector into ENU, into work NAV: v + 2 qw (q x v) + 2 q x (q x v)."""
    qw = s[_S_ATT]
    qx = s[_S_ATT + 1]
    qy = s[_S_ATT + 2]
    qz = s[_S_ATT + 3]
    tx = (int(mulshift(qy, z, 30)) - int(mulshift(qz, y, 30))) << 1
    ty = (int(mulshift(qz, x, 30)) - int(mulshift(qx, z, 30))) << 1
    tz = (int(mulshift(qx, y, 30)) - int(mulshift(qy, x, 30))) << 1
    ux = int(mulshift(qy, tz, 30)) - int(mulshift(qz, ty, 30))
    uy = int(mulshift(qz, tx, 30)) - int(mulshift(qx, tz, 30))
    uz = int(mulshift(qx, ty, 30)) - int(mulshift(qy, tx, 30))
    w[_W_NAV] = x + int(mulshift(qw, tx, 30)) + ux
    w[_W_NAV + 1] = y + int(mulshift(qw, ty, 30)) + uy
    w[_W_NAV + 2] = z + int(mulshift(qw, tz, 30)) + uz
    return 0


@micropython.viper
def correct_rate(s: ptr32, w: ptr32, m: ptr32) -> int:
    """Raw gyro counts less the bias, Q8, into work RATE."""
    i = 0
    while i < 3:
        w[_W_RATE + i] = (m[_I_GYRO + i] << 8) - ((s[_S_BIAS + i] + 2048) >> 12)
        i = i + 1
    return 0


@micropython.viper
def propagate(s: ptr32, p: ptr32, w: ptr32, m: ptr32) -> int:
    """Attitude, velocity and position over one sample period."""
    scale = p[_P_ACC_SCALE]
    ax = (m[_I_ACC] * scale + 2) >> 2
    ay = (m[_I_ACC + 1] * scale + 2) >> 2
    az = (m[_I_ACC + 2] * scale + 2) >> 2
    scale = p[_P_HALF_ANGLE]
    hx = int(mulshift(w[_W_RATE], scale, 20))
    hy = int(mulshift(w[_W_RATE + 1], scale, 20))
    hz = int(mulshift(w[_W_RATE + 2], scale, 20))
    # h x a turns the force from the interval's start to its middle.
    fx = ax + int(mulshift(hy, az, 30)) - int(mulshift(hz, ay, 30))
    fy = ay + int(mulshift(hz, ax, 30)) - int(mulshift(hx, az, 30))
    fz = az + int(mulshift(hx, ay, 30)) - int(mulshift(hy, ax, 30))
    int(to_nav(s, w, fx, fy, fz))
    int(turn(s, hx, hy, hz, 0))
    w[_W_NAV + 2] = w[_W_NAV + 2] - s[_S_GRAVITY]
    dt = p[_P_DT]
    limit = _VEL_MAX
    limit = limit << 2
    i = 0
    hit = 0
    while i < 3:
        old = s[_S_VEL + i]
        grown = old + int(mulshift(w[_W_NAV + i], dt, 26))
        new = int(clamp(grown, limit))
        if new != grown:
            hit = 1
        s[_S_VEL + i] = new
        s[_S_POS + i] = s[_S_POS + i] + int(mulshift((new >> 1) + (old >> 1), dt, 36))
        i = i + 1
    if hit:
        if s[_S_SATURATED] < 0x3FFFFFFF:
            s[_S_SATURATED] = s[_S_SATURATED] + 1
    return 0


@micropython.viper
def recentre(s: ptr32) -> int:
    """Move to the next cell of 4096 m where the position has left the middle of this one."""
    i = 0
    while i < 3:
        shift = 0
        if s[_S_POS + i] >= _CELL:
            shift = 1
        elif s[_S_POS + i] < 0 - _CELL:
            shift = -1
        if shift != 0:
            s[_S_CELL + i] = s[_S_CELL + i] + shift
            move = shift * _CELL
            s[_S_POS + i] = s[_S_POS + i] - move - move
            for anchor in range(_S_POS_LAST + i, _S_POS_STEP + i + 1, 3):
                near = int(clamp(s[anchor] - move, _FAR))
                s[anchor] = int(clamp(near - move, _FAR))
        i = i + 1
    return 0
