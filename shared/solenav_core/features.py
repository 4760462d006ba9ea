"""What the last second and a quarter looked like: the features that tell motions apart.

Ten signals, whole numbers limited to +-1023, in body axes (right x, front y, up z), taken on every
MOTION_STRIDE-th tick, the two groups in turn (each at 50 Hz by default, at any sample rate):

- group 0: force less gravity along Up, x, y, z (1/8 m/s²), its magnitude less gravity, the velocity
  upwards (1/64 m/s);
- group 1: rate less bias, x, y, z (32 counts, 1.95 °/s), its magnitude, the horizontal speed
  (1/64 m/s).

A block is 32 samples of each group; two blocks that follow on each other are a window, so that
each block ends one. A group has 28 words, each of its five signals five of them, ``5 * signal +
kind``:

| kind | in a block | in the features |
|---|---|---|
| 0 | sum | mean, Q2 |
| 1 | sum of squares | standard deviation, Q2 |
| 2 | sum of cubes, in units of 64 | skewness, Q8, at most +-8; 0 with a deviation below 8 |
| 3 | largest | largest of the window |
| 4 | least | least of the window |

then three of the pairs xy, yz, xz: sum of products; correlation (Q8; 0 where either deviation is
below 8). So 56 features. After Zhang, Xiu, Yang, Yang 2018 (J. BUAA 44(3)), who take mean,
deviation, extremes, skewness and correlations of force and rate; the two velocities are ours,
since they are what a climb is.

Three blocks lie in state SUMS: the open one, the last, and the one before, which turns into the
features in place, a group on each tick, so that no tick pays for a whole window. Then the
forest is asked. After the event CLASSIFIED the features stay in the slot that `slot` names until
that slot opens, with the end of the block.
"""

from solenav_core.compat import const, micropython, ptr32
from solenav_core.qmath import clamp, isqrt

BLOCK = 32  # samples of each group; shifts by 6 below divide by the window's 64

_LIMIT = const(1023)  # a window's 64 cubes, in units of 64, still fit one word
_GROUP = const(28)
_FEATURES = const(56)
_CLASSES = const(5)
_BLOCK_SAMPLES = const(64)  # of both groups
_QUIET = const(128)  # Q4: skewness and correlations of less are noise of the last bit
_SKEW_MAX = const(2047)
_IDLE = const(255)  # STAGE of a window that is dealt with

_S_ACC_NORM = const(37)
_S_STRIDE = const(207)
_S_PAUSE = const(208)
_S_BLOCK_FILL = const(209)
_S_BLOCK_SLOT = const(210)
_S_BLOCKS = const(211)
_S_STAGE = const(212)
_S_SUMS = const(213)
_S_VOTE = const(386)
_S_RIVAL_WINDOWS = const(392)
_S_MOTION = const(393)
_S_VEL = const(398)
_S_GRAVITY = const(410)
_P_MOTION_STRIDE = const(64)
_W_FORCE = const(3)
_W_RATE = const(6)
_W_SIGNAL = const(13)


def slot(open_slot):
    """The slot in SUMS of the window's features while `open_slot` (BLOCK_SLOT) is open."""
    return (open_slot + 1) % 3


@micropython.viper
def sense(s: ptr32, w: ptr32, group: int) -> int:
    """The five signals of group 0 or 1 into work SIGNAL."""
    total = 0
    i = 0
    if group:
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
def observe_motion(s: ptr32, p: ptr32, w: ptr32) -> int:
    """A sample of one group into its sums; a full block ends a window. 1 if it did."""
    at = 0
    y = 0
    i = 0
    stride = p[_P_MOTION_STRIDE]
    s[_S_PAUSE] = stride
    if s[_S_STRIDE] != stride:
        s[_S_STRIDE] = stride
        s[_S_BLOCK_FILL] = 0
        s[_S_BLOCKS] = 0
        s[_S_STAGE] = _IDLE
        s[_S_RIVAL_WINDOWS] = 0
        s[_S_MOTION] = 0
        while i < _CLASSES:
            s[_S_VOTE + i] = 0
            i = i + 1
        i = 0
    if stride < 1:
        return 0
    fill = s[_S_BLOCK_FILL]
    slot = s[_S_BLOCK_SLOT]
    int(sense(s, w, fill & 1))
    at = _S_SUMS + _FEATURES * slot + _GROUP * (fill & 1)
    first = int(fill < 2)
    while i < 5:
        y = w[_W_SIGNAL + i]
        square = y * y
        if first:
            s[at] = y
            s[at + 1] = square
            s[at + 2] = (square * y + 32) >> 6
            s[at + 3] = y
            s[at + 4] = y
        else:
            s[at] = s[at] + y
            s[at + 1] = s[at + 1] + square
            s[at + 2] = s[at + 2] + ((square * y + 32) >> 6)
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
    fill = fill + 1
    if fill < _BLOCK_SAMPLES:
        s[_S_BLOCK_FILL] = fill
        return 0
    s[_S_BLOCK_FILL] = 0
    slot = slot + 1
    if slot > 2:
        slot = 0
    s[_S_BLOCK_SLOT] = slot
    if s[_S_BLOCKS] < 2:
        s[_S_BLOCKS] = s[_S_BLOCKS] + 1
        if s[_S_BLOCKS] < 2:
            return 0
    s[_S_STAGE] = 0
    return 1


@micropython.viper
def describe(a: int, b: int, s: ptr32) -> int:
    """A signal's sums in two blocks, at s[a] and s[b], into s[a]: the sum, deviation Q4, the rest.

    With n = 64, sum S, D = n variance = sum(y²) - S²/n, and n E(y)³ = S (S²/n) / n²:
    sum((y - mean)³) = sum(y³) - (3 D + S²/n) S/n. Products past the word are made of two, of the
    second factor's high and low bits.
    """
    total = s[a] + s[b]
    s[a] = total
    # S²/64 without a product past the word: S = 8 eighth + rest.
    eighth = total >> 3
    square = eighth * eighth + ((eighth * (total & 7)) >> 2)
    spread = s[a + 1] + s[b + 1] - square
    if spread < 0:
        spread = 0
    deviation = int(isqrt(spread << 2))
    s[a + 1] = deviation
    skew = 0
    if deviation >= _QUIET:
        square = 3 * spread + square
        # 28 bits as 14 and 14, by 17; all of it over 2**12.
        skew = ((square & 16383) * total + 2048) >> 12
        skew = s[a + 2] + s[b + 2] - skew - (((square >> 14) * total) << 2)
        # 27 bits as 17 and 10, by 14; all of it over 2**10.
        cube = (spread >> 10) * deviation + (((spread & 1023) * deviation + 512) >> 10)
        if cube < 0x40000:
            skew = (int(clamp(skew, 0x400000)) << 8) // cube  # > 0: 512, of the least deviation
        else:
            skew = skew // (cube >> 8)  # > 0: 1024 at least
        skew = int(clamp(skew, _SKEW_MAX))
    s[a + 2] = skew
    if s[b + 3] > s[a + 3]:
        s[a + 3] = s[b + 3]
    if s[b + 4] < s[a + 4]:
        s[a + 4] = s[b + 4]
    return 0


@micropython.viper
def relate(x: int, y: int, shared: int, s: ptr32) -> int:
    """Correlation, Q8, of the signals at s[x] and s[y], which `describe` has dealt with.

    `shared`: the window's sum of their products.
    """
    most = s[x + 1]
    other = s[y + 1]
    if most < _QUIET or other < _QUIET:
        return 0
    most = (most * other) >> 2
    # The sums' product over 64: 17 bits by 11 and by 6.
    other = s[x]
    shared = shared - (other >> 6) * s[y] - (((other & 63) * s[y] + 32) >> 6)
    shared = int(clamp(shared, most))
    if most < 0x400000:
        return (shared << 8) // most  # > 0: 4096, of the least deviations
    return int(clamp(shared // (most >> 8), 256))  # > 0: 16384 at least


@micropython.viper
def summarise(a: int, b: int, s: ptr32, group: int) -> int:
    """The sums of the last window's group into its features.

    `a` and `b` are 0: locals that come first are the fastest.
    """
    # The oldest block is in the slot after the open one, the last in the one before it.
    a = s[_S_BLOCK_SLOT] + 1
    if a > 2:
        a = 0
    b = a + 1
    if b > 2:
        b = 0
    group = _S_SUMS + _GROUP * group
    a = group + _FEATURES * a
    b = group + _FEATURES * b
    i = 0
    while i < 5:
        int(describe(a, b, s))
        a = a + 5
        b = b + 5
        i = i + 1
    # xy, yz, xz: one place for the code of all.
    x = a - 25
    y = x + 5
    i = 0
    while i < 3:
        s[a] = int(relate(x, y, s[a] + s[b], s))
        x = y - 10 * i
        y = a - i - 15
        a = a + 1
        b = b + 1
        i = i + 1
    a = a - 28
    while i < 8:
        s[a] = (s[a] + 8) >> 4
        s[a + 1] = (s[a + 1] + 2) >> 2
        a = a + 5
        i = i + 1
    return 0
