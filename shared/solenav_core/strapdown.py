"""Strapdown integration: attitude, velocity and position from one sample.

Navigation frame ENU, body frame right-front-up, attitude quaternion body to ENU. Method:
third- and fourth-order series of the rotation vector, specific force turned to the middle of
the interval, trapezoidal position (docs/algorithm.md, step 1).

Where no factor passes 2**30 by more than a rounding, products are written out in halves of 15
bits, the low ones with an l at the end of their name, `mid` for what low halves take part in:
those of `mulshift` to the last bit, at half its cost.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp, mulshift

_ONE = const(0x3FFFFFFF)  # 1 in Q30 less its last bit: 2**30 itself is no small int
_VEL_MAX = const(419430400)  # a quarter of 100 m/s in Q24: literals stay below 2**30
_CELL = const(0x20000000)  # half a cell, 2048 m in Q18
_FAR = const(0x3FFFFFFF)  # farthest that an anchor may lie from the cell's middle, Q18 m

_S_SATURATED = const(2)
_S_ATT = const(394)
_S_VEL = const(398)
_S_POS = const(401)
_S_CELL = const(404)
_S_GRAVITY = const(410)
_S_POS_LAST = const(843)
_S_POS_STEP = const(849)
_P_HALF_ANGLE = const(40)
_P_DT = const(41)
_W_NAV = const(0)
_W_FORCE = const(3)
_W_RATE = const(6)


@micropython.viper
def compose(s: ptr32, bw: int, bx: int, by: int, bz: int, left: int) -> int:
    """Attitude times b (left = 0) or b times attitude (left = 1), renormalised. b in Q30.

    As both factors are units no sum of two products of halves passes 2**31 (Cauchy-Schwarz).
    One Newton step of the inverse root, (3 - |q|²) / 2, keeps the length; it needs |q| near 1.
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
    s[_S_ATT] = w
    wl = w & 32767
    w = w >> 15
    mid = ((w * wl) << 1) + ((wl * wl) >> 15) + 16384
    norm2 = w * w + (mid >> 15)
    s[_S_ATT + 1] = x
    xl = x & 32767
    x = x >> 15
    mid = ((x * xl) << 1) + ((xl * xl) >> 15) + 16384
    norm2 = norm2 + x * x + (mid >> 15)
    s[_S_ATT + 2] = y
    yl = y & 32767
    y = y >> 15
    mid = ((y * yl) << 1) + ((yl * yl) >> 15) + 16384
    norm2 = norm2 + y * y + (mid >> 15)
    s[_S_ATT + 3] = z
    zl = z & 32767
    z = z >> 15
    mid = ((z * zl) << 1) + ((zl * zl) >> 15) + 16384
    norm2 = norm2 + z * z + (mid >> 15)
    half = (_ONE - norm2) >> 1
    halfl = half & 32767
    half = half >> 15
    mid = w * halfl + wl * half + ((wl * halfl) >> 15) + 16384
    s[_S_ATT] = s[_S_ATT] + w * half + (mid >> 15)
    mid = x * halfl + xl * half + ((xl * halfl) >> 15) + 16384
    s[_S_ATT + 1] = s[_S_ATT + 1] + x * half + (mid >> 15)
    mid = y * halfl + yl * half + ((yl * halfl) >> 15) + 16384
    s[_S_ATT + 2] = s[_S_ATT + 2] + y * half + (mid >> 15)
    mid = z * halfl + zl * half + ((zl * halfl) >> 15) + 16384
    s[_S_ATT + 3] = s[_S_ATT + 3] + z * half + (mid >> 15)
    return 0


@micropython.viper
def turn(s: ptr32, hx: int, hy: int, hz: int, left: int) -> int:
    """Turn the attitude by the rotation vector 2 h (Q30 rad), |h| up to about 1/2.

    left = 0: h is in body axes; left = 1: in ENU.
    """
    hxl = hx & 32767
    hx = hx >> 15
    mid = ((hx * hxl) << 1) + ((hxl * hxl) >> 15) + 16384
    h2 = hx * hx + (mid >> 15)
    hyl = hy & 32767
    hy = hy >> 15
    mid = ((hy * hyl) << 1) + ((hyl * hyl) >> 15) + 16384
    h2 = h2 + hy * hy + (mid >> 15)
    hzl = hz & 32767
    hz = hz >> 15
    mid = ((hz * hzl) << 1) + ((hzl * hzl) >> 15) + 16384
    h2 = h2 + hz * hz + (mid >> 15)
    cosine = _ONE - (h2 >> 1)
    sinc = _ONE - h2 // 6
    if h2 >= 131072:
        # Of a smaller h the fourth power comes to nothing.
        h4 = int(mulshift(h2, h2, 30))
        cosine = cosine + h4 // 24
        sinc = sinc + h4 // 120
    sincl = sinc & 32767
    sinc = sinc >> 15
    mid = hx * sincl + hxl * sinc + ((hxl * sincl) >> 15) + 16384
    x = hx * sinc + (mid >> 15)
    mid = hy * sincl + hyl * sinc + ((hyl * sincl) >> 15) + 16384
    y = hy * sinc + (mid >> 15)
    mid = hz * sincl + hzl * sinc + ((hzl * sincl) >> 15) + 16384
    z = hz * sinc + (mid >> 15)
    return int(compose(s, cosine, x, y, z, left))


@micropython.viper
def to_nav(s: ptr32, w: ptr32, x: int, y: int, z: int) -> int:
    """Turn a body vector into ENU, into work NAV: v + 2 qw (q x v) + 2 q x (q x v).

    Twice the vector's length must stay within 2**30, give or take a rounding.
    """
    qw = s[_S_ATT]
    qwl = qw & 32767
    qw = qw >> 15
    qx = s[_S_ATT + 1]
    qxl = qx & 32767
    qx = qx >> 15
    qy = s[_S_ATT + 2]
    qyl = qy & 32767
    qy = qy >> 15
    qz = s[_S_ATT + 3]
    qzl = qz & 32767
    qz = qz >> 15
    w[_W_NAV] = x
    w[_W_NAV + 1] = y
    w[_W_NAV + 2] = z
    xl = x & 32767
    x = x >> 15
    yl = y & 32767
    y = y >> 15
    zl = z & 32767
    z = z >> 15
    mid = qy * zl + qyl * z + ((qyl * zl) >> 15) + 16384
    tx = qy * z + (mid >> 15)
    mid = qz * yl + qzl * y + ((qzl * yl) >> 15) + 16384
    tx = tx - qz * y - (mid >> 15)
    mid = qz * xl + qzl * x + ((qzl * xl) >> 15) + 16384
    ty = qz * x + (mid >> 15)
    mid = qx * zl + qxl * z + ((qxl * zl) >> 15) + 16384
    ty = ty - qx * z - (mid >> 15)
    mid = qx * yl + qxl * y + ((qxl * yl) >> 15) + 16384
    tz = qx * y + (mid >> 15)
    mid = qy * xl + qyl * x + ((qyl * xl) >> 15) + 16384
    tz = tz - qy * x - (mid >> 15)
    tx = tx << 1
    txl = tx & 32767
    tx = tx >> 15
    ty = ty << 1
    tyl = ty & 32767
    ty = ty >> 15
    tz = tz << 1
    tzl = tz & 32767
    tz = tz >> 15
    mid = qw * txl + qwl * tx + ((qwl * txl) >> 15) + 16384
    x = w[_W_NAV] + qw * tx + (mid >> 15)
    mid = qy * tzl + qyl * tz + ((qyl * tzl) >> 15) + 16384
    x = x + qy * tz + (mid >> 15)
    mid = qz * tyl + qzl * ty + ((qzl * tyl) >> 15) + 16384
    x = x - qz * ty - (mid >> 15)
    w[_W_NAV] = x
    mid = qw * tyl + qwl * ty + ((qwl * tyl) >> 15) + 16384
    y = w[_W_NAV + 1] + qw * ty + (mid >> 15)
    mid = qz * txl + qzl * tx + ((qzl * txl) >> 15) + 16384
    y = y + qz * tx + (mid >> 15)
    mid = qx * tzl + qxl * tz + ((qxl * tzl) >> 15) + 16384
    y = y - qx * tz - (mid >> 15)
    w[_W_NAV + 1] = y
    mid = qw * tzl + qwl * tz + ((qwl * tzl) >> 15) + 16384
    z = w[_W_NAV + 2] + qw * tz + (mid >> 15)
    mid = qx * tyl + qxl * ty + ((qxl * tyl) >> 15) + 16384
    z = z + qx * ty + (mid >> 15)
    mid = qy * txl + qyl * tx + ((qyl * txl) >> 15) + 16384
    z = z - qy * tx - (mid >> 15)
    w[_W_NAV + 2] = z
    return 0


@micropython.viper
def propagate(s: ptr32, p: ptr32, w: ptr32) -> int:
    """Attitude, velocity and position over one sample period, from work FORCE and RATE."""
    ax = w[_W_FORCE]
    ay = w[_W_FORCE + 1]
    az = w[_W_FORCE + 2]
    scale = p[_P_HALF_ANGLE]
    scalel = scale & 32767
    scale = scale >> 15
    rate = w[_W_RATE]
    ratel = rate & 32767
    rate = rate >> 15
    mid = rate * scalel + ratel * scale + ((ratel * scalel) >> 15) + 16
    hx = ((rate * scale) << 10) + (mid >> 5)
    rate = w[_W_RATE + 1]
    ratel = rate & 32767
    rate = rate >> 15
    mid = rate * scalel + ratel * scale + ((ratel * scalel) >> 15) + 16
    hy = ((rate * scale) << 10) + (mid >> 5)
    rate = w[_W_RATE + 2]
    ratel = rate & 32767
    rate = rate >> 15
    mid = rate * scalel + ratel * scale + ((ratel * scalel) >> 15) + 16
    hz = ((rate * scale) << 10) + (mid >> 5)
    # h x a turns the force from the interval's start to its middle.
    hxl = hx & 32767
    hxh = hx >> 15
    hyl = hy & 32767
    hyh = hy >> 15
    hzl = hz & 32767
    hzh = hz >> 15
    axl = ax & 32767
    axh = ax >> 15
    ayl = ay & 32767
    ayh = ay >> 15
    azl = az & 32767
    azh = az >> 15
    mid = hyh * azl + hyl * azh + ((hyl * azl) >> 15) + 16384
    fx = ax + hyh * azh + (mid >> 15)
    mid = hzh * ayl + hzl * ayh + ((hzl * ayl) >> 15) + 16384
    fx = fx - hzh * ayh - (mid >> 15)
    mid = hzh * axl + hzl * axh + ((hzl * axl) >> 15) + 16384
    fy = ay + hzh * axh + (mid >> 15)
    mid = hxh * azl + hxl * azh + ((hxl * azl) >> 15) + 16384
    fy = fy - hxh * azh - (mid >> 15)
    mid = hxh * ayl + hxl * ayh + ((hxl * ayl) >> 15) + 16384
    fz = az + hxh * ayh + (mid >> 15)
    mid = hyh * axl + hyl * axh + ((hyl * axl) >> 15) + 16384
    fz = fz - hyh * axh - (mid >> 15)
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
