"""From raw counts to specific force, rate and field in body axes: matrices, biases, mounting.

Each sensor has a matrix (scale and misalignment) and a bias in the parameters; magnetometer: soft
and hard iron. The mounting says which sensor axis is the body's right, front and up: 1 x, 2 y,
3 z, negative where it points the other way. Without one in the parameters the static start takes
the axis nearest to the vertical for Up; the front axis then stays the sensor's y, or where y is
upright z, so that a sensor tipped up or down keeps its heading.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp

_FIELD_MAX = const(26000)  # 488 µT in Q4 counts: three squares fit one word

_S_MOUNT = const(33)
_S_BIAS = const(407)
_P_ACC_XX = const(1)
_P_ACC_BX = const(10)
_P_GYRO_XX = const(13)
_P_GYRO_BX = const(22)
_P_MAG_XX = const(25)
_P_MAG_BX = const(34)
_P_MOUNT_R = const(37)
_W_FORCE = const(3)
_W_RATE = const(6)
_W_FIELD = const(9)
_I_ACC = const(0)
_I_GYRO = const(3)
_I_MAG = const(6)


@micropython.viper
def mounted(s: ptr32, w: ptr32, at: int) -> int:
    """The vector at w[at] from sensor axes to body axes, once the mounting is known."""
    if s[_S_MOUNT] == 0:
        return 0
    x = w[at]
    y = w[at + 1]
    z = w[at + 2]
    i = 0
    while i < 3:
        axis = s[_S_MOUNT + i]
        value = x
        if axis == 2 or axis == -2:
            value = y
        elif axis == 3 or axis == -3:
            value = z
        if axis < 0:
            value = 0 - value
        w[at + i] = value
        i = i + 1
    return 1


@micropython.viper
def orient(s: ptr32, p: ptr32, w: ptr32) -> int:
    """Settle the mounting: the parameters', or that of a force in work FORCE, sensor axes."""
    if p[_P_MOUNT_R] != 0:
        i = 0
        while i < 3:
            s[_S_MOUNT + i] = p[_P_MOUNT_R + i]
            i = i + 1
        return 0
    x = w[_W_FORCE]
    y = w[_W_FORCE + 1]
    z = w[_W_FORCE + 2]
    right = 1
    front = 2
    up = 3
    most = z
    if z < 0:
        right = -1
        up = -3
        most = 0 - z
    # Three quarters: a sensor that leans half-way stays as it is, whatever the noise.
    far = y
    if y < 0:
        far = 0 - y
    if far - (far >> 2) > most:
        most = far
        right = 1
        front = -3
        up = 2
        if y < 0:
            front = 3
            up = -2
    far = x
    if x < 0:
        far = 0 - x
    if far - (far >> 2) > most:
        right = -3
        front = 2
        up = 1
        if x < 0:
            right = 3
            up = -1
    s[_S_MOUNT] = right
    s[_S_MOUNT + 1] = front
    s[_S_MOUNT + 2] = up
    return 0


@micropython.viper
def condition(s: ptr32, p: ptr32, w: ptr32, m: ptr32) -> int:
    """Specific force (Q20 m/s²) and rate less its bias (Q8 counts) of a sample, into work."""
    x = m[_I_ACC]
    y = m[_I_ACC + 1]
    z = m[_I_ACC + 2]
    at = 0
    i = 0
    while i < 3:
        total = x * p[_P_ACC_XX + at] + y * p[_P_ACC_XX + at + 1] + z * p[_P_ACC_XX + at + 2]
        w[_W_FORCE + i] = ((total + 2) >> 2) - p[_P_ACC_BX + i]
        at = at + 3
        i = i + 1
    x = m[_I_GYRO]
    y = m[_I_GYRO + 1]
    z = m[_I_GYRO + 2]
    at = 0
    i = 0
    while i < 3:
        total = x * p[_P_GYRO_XX + at] + y * p[_P_GYRO_XX + at + 1] + z * p[_P_GYRO_XX + at + 2]
        w[_W_RATE + i] = ((total + 32) >> 6) - ((p[_P_GYRO_BX + i] + 2048) >> 12)
        at = at + 3
        i = i + 1
    int(mounted(s, w, _W_FORCE))
    int(mounted(s, w, _W_RATE))
    i = 0
    while i < 3:
        w[_W_RATE + i] = w[_W_RATE + i] - ((s[_S_BIAS + i] + 2048) >> 12)
        i = i + 1
    return 0


@micropython.viper
def magnetic(s: ptr32, p: ptr32, w: ptr32, x: int, y: int, z: int) -> int:
    """Magnetic field (Q4 counts) of a reading in sixteenths of a count, into work FIELD."""
    at = 0
    i = 0
    while i < 3:
        total = (x >> 4) * p[_P_MAG_XX + at]
        total = total + (y >> 4) * p[_P_MAG_XX + at + 1] + (z >> 4) * p[_P_MAG_XX + at + 2]
        rest = (x & 15) * p[_P_MAG_XX + at] + (y & 15) * p[_P_MAG_XX + at + 1]
        rest = rest + (z & 15) * p[_P_MAG_XX + at + 2]
        field = (total + (rest >> 4) + 128) >> 8
        w[_W_FIELD + i] = int(clamp(field - p[_P_MAG_BX + i], _FIELD_MAX))
        at = at + 3
        i = i + 1
    return int(mounted(s, w, _W_FIELD))
