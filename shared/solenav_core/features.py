"""What the last second and a quarter looked like: the features that tell motions apart.

Ten signals, whole numbers limited to +-1023, in body axes (right x, front y, up z):

- on ticks of even number within a block, group 0: force less gravity along Up, x, y, z (1/8 m/s²),
  its magnitude less gravity, the velocity upwards (1/64 m/s);
- on ticks of odd number, group 1: rate less bias, x, y, z (32 counts, 1.95 °/s), its magnitude,
  the horizontal speed (1/64 m/s).

A block is MOTION_BLOCK samples of each group; two blocks that follow on each other are a window,
so that each block ends one. A group has `GROUP` words, each of its five signals five of them,
``5 * signal + kind``:

| kind | in a block | in the features |
|---|---|---|
| 0 | sum | mean, Q2 |
| 1 | sum of squares | standard deviation, Q2 |
| 2 | sum of cubes, in units of 512 | skewness, Q8, at most +-8; 0 with a deviation below 8 |
| 3 | largest | largest of the window |
| 4 | least | least of the window |

then three of the pairs xy, yz, xz: sum of products, correlation (Q8; 0 where either deviation is
below 8). `CLASSES` motions by these 56 features: after Zhang, Xiu, Yang, Yang 2018 (J. BUAA 44(3)),
who take mean, deviation, extremes, skewness and correlations of force and rate; the two velocities
are ours, since they are what a climb is.

Three blocks lie in state SUMS: the open one, the last and the one before, which is turned into the
features in place, a signal or the correlations of a group on each tick, so that no tick pays for a
whole window. From `DESCRIBED` on the forest is asked; after it, event CLASSIFIED, the features stay
in the slot that `slot` names until that slot opens anew, with the end of the block.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp, isqrt, mulshift

GROUP = 28
DESCRIBED = 12  # stages of a window before the forest's first

_LIMIT = const(1023)  # three of them multiplied fit one word, 512 times 1023² as well
_GROUP = const(28)
_FEATURES = const(56)
_CLASSES = const(5)
_PAIRS = const(25)  # of a group's words, the first correlation
_QUIET = const(128)  # Q4: skewness and correlations of less are noise of the last bit
_SKEW_MAX = const(2047)
_IDLE = const(255)  # STAGE of a window that is dealt with

_S_ACC_NORM = const(37)
_S_BLOCK_SIZE = const(207)
_S_BLOCK_TICKS = const(208)
_S_BLOCK_SLOT = const(209)
_S_BLOCKS = const(210)
_S_STAGE = const(211)
_S_SUMS = const(212)
_S_VOTE = const(385)
_S_RIVAL_WINDOWS = const(391)
_S_MOTION = const(392)
_S_VEL = const(397)
_S_GRAVITY = const(409)
_P_MOTION_BLOCK = const(64)
_W_FORCE = const(3)
_W_RATE = const(6)
_W_SIGNAL = const(13)


def slot(open_slot):
    """The slot in SUMS of the window's features while `open_slot` (BLOCK_SLOT) is open."""
    return (open_slot + 1) % 3


@micropython.viper
def sense(s: ptr32, w: ptr32, odd: int) -> int:
    """The five signals of group 0 or (`odd`) 1 into work SIGNAL."""
    total = 0
    i = 0
    if odd:
        while i < 3:
            value = int(clamp((w[_W_RATE + i] + 4096) >> 13, _LIMIT))
            w[_W_SIGNAL + i] = value
            total = total + value * value
            i = i + 1
        w[_W_SIGNAL + 3] = int(clamp(int(isqrt(total)), _LIMIT))
        value = (s[_S_VEL] + 131072) >> 18
        total = (s[_S_VEL + 1] + 131072) >> 18
        w[_W_SIGNAL + 4] = int(clamp(int(isqrt(value * value + total * total)), _LIMIT))
        return 0
    gravity = (s[_S_GRAVITY] + 65536) >> 17
    while i < 3:
        value = (w[_W_FORCE + i] + 65536) >> 17
        if i == 2:
            value = value - gravity
        w[_W_SIGNAL + i] = int(clamp(value, _LIMIT))
        i = i + 1
    w[_W_SIGNAL + 3] = int(clamp(((s[_S_ACC_NORM] + 8) >> 4) - gravity, _LIMIT))
    w[_W_SIGNAL + 4] = int(clamp((s[_S_VEL + 2] + 131072) >> 18, _LIMIT))
    return 0


@micropython.viper
def accumulate(at: int, i: int, s: ptr32, w: ptr32, first: int) -> int:
    """Work SIGNAL into the group's sums at s[at]; `first`: nothing is in them. `i` is 0."""
    while i < 5:
        y = w[_W_SIGNAL + i]
        square = y * y
        cube = (square * y + 256) >> 9
        if first:
            s[at] = y
            s[at + 1] = square
            s[at + 2] = cube
            s[at + 3] = y
            s[at + 4] = y
        else:
            s[at] = s[at] + y
            s[at + 1] = s[at + 1] + square
            s[at + 2] = s[at + 2] + cube
            if y > s[at + 3]:
                s[at + 3] = y
            if y < s[at + 4]:
                s[at + 4] = y
        at = at + 5
        i = i + 1
    x = w[_W_SIGNAL]
    y = w[_W_SIGNAL + 1]
    z = w[_W_SIGNAL + 2]
    if first:
        s[at] = x * y
        s[at + 1] = y * z
        s[at + 2] = x * z
    else:
        s[at] = s[at] + x * y
        s[at + 1] = s[at + 1] + y * z
        s[at + 2] = s[at + 2] + x * z
    return 0


@micropython.viper
def describe(a: int, b: int, s: ptr32, n: int) -> int:
    """The sums at s[a] and s[b] of one signal into mean Q10, deviation Q4, skewness, extremes.

    At s[a]; `n` samples are in both. `relate` brings mean and deviation to their formats.
    """
    if n < 1:
        return 0
    mean = (((s[a] + s[b]) << 11) // n + 1) >> 1
    square = int(mulshift(mean << 5, mean, 17))  # Q8
    total = s[a + 1] + s[b + 1]
    variance = total // n
    variance = (variance << 8) + ((total - variance * n) << 8) // n - square
    if variance < 0:
        variance = 0  # by the rounding of the mean
    deviation = int(isqrt(variance))
    skew = 0
    if deviation >= _QUIET:
        # E(y³) = skew + 3 mean variance + mean³, all in sixteens.
        total = s[a + 2] + s[b + 2]
        skew = total // n
        skew = (skew << 5) + ((total - skew * n) << 5) // n
        skew = skew - 3 * int(mulshift(mean, variance, 22)) - int(mulshift(mean, square, 22))
        cube = int(mulshift(deviation << 1, variance, 17))
        if cube < 65536:
            skew = (int(clamp(skew, 0x200000)) << 8) // cube  # > 0: 32, of the least deviation
        else:
            skew = skew // (cube >> 8)  # > 0: 256 at least
        skew = int(clamp(skew, _SKEW_MAX))
    s[a] = mean
    s[a + 1] = deviation
    s[a + 2] = skew
    if s[b + 3] > s[a + 3]:
        s[a + 3] = s[b + 3]
    if s[b + 4] < s[a + 4]:
        s[a + 4] = s[b + 4]
    return 1


@micropython.viper
def relate(a: int, b: int, s: ptr32, n: int) -> int:
    """Correlations of the group whose signals `describe` has dealt with; then means, deviations."""
    if n < 1:
        return 0
    i = 0
    while i < 3:
        # xy, yz, xz
        one = a + 5 * (i & 1)
        other = a + 10
        if i == 0:
            other = a + 5
        one_deviation = s[one + 1]
        other_deviation = s[other + 1]
        total = s[a + _PAIRS + i] + s[b + _PAIRS + i]
        shared = 0
        if one_deviation >= _QUIET and other_deviation >= _QUIET:
            shared = total // n
            shared = (shared << 8) + ((total - shared * n) << 8) // n
            shared = shared - int(mulshift(s[one] << 5, s[other], 17))
            most = one_deviation * other_deviation
            shared = int(clamp(shared, most))
            if most < 0x100000:
                shared = (shared << 8) // most  # > 0: 2**14, of the least deviations
            else:
                shared = int(clamp(shared // (most >> 8), 256))  # > 0: 4096 at least
        s[a + _PAIRS + i] = shared
        i = i + 1
    i = 0
    while i < 5:
        s[a] = (s[a] + 128) >> 8
        s[a + 1] = (s[a + 1] + 2) >> 2
        a = a + 5
        i = i + 1
    return 1


@micropython.viper
def observe_motion(s: ptr32, p: ptr32, w: ptr32) -> int:
    """This sample into the sums; the next stage of the last window, which is returned.

    0 where there is nothing more to do, else one more than STAGE was.
    """
    size = p[_P_MOTION_BLOCK]
    if s[_S_BLOCK_SIZE] != size:
        s[_S_BLOCK_SIZE] = size
        s[_S_BLOCK_TICKS] = 0
        s[_S_BLOCKS] = 0
        s[_S_STAGE] = _IDLE
        s[_S_RIVAL_WINDOWS] = 0
        s[_S_MOTION] = 0
        i = 0
        while i < _CLASSES:
            s[_S_VOTE + i] = 0
            i = i + 1
    if size < 1:
        return 0
    ticks = s[_S_BLOCK_TICKS]
    slot = s[_S_BLOCK_SLOT]
    odd = ticks & 1
    int(sense(s, w, odd))
    int(accumulate(_S_SUMS + _FEATURES * slot + _GROUP * odd, 0, s, w, int(ticks < 2)))
    ticks = ticks + 1
    stage = s[_S_STAGE]
    if ticks >= 2 * size:
        ticks = 0
        slot = slot + 1
        if slot > 2:
            slot = 0
        s[_S_BLOCK_SLOT] = slot
        if s[_S_BLOCKS] < 2:
            s[_S_BLOCKS] = s[_S_BLOCKS] + 1
        if s[_S_BLOCKS] > 1:
            stage = 0
            s[_S_STAGE] = 0
    s[_S_BLOCK_TICKS] = ticks
    if ticks == 0 or stage >= _IDLE:
        return 0
    s[_S_STAGE] = stage + 1
    if stage < 12:
        # The oldest block is the slot after the open one, the last the one before it.
        a = slot + 1
        if a > 2:
            a = 0
        b = a + 1
        if b > 2:
            b = 0
        a = _S_SUMS + _FEATURES * a
        b = _S_SUMS + _FEATURES * b
        part = stage
        if part > 5:
            a = a + _GROUP
            b = b + _GROUP
            part = part - 6
        if part < 5:
            int(describe(a + 5 * part, b + 5 * part, s, 2 * size))
        else:
            int(relate(a, b, s, 2 * size))
    return stage + 1
