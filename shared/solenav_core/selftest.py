"""Power-up self-test: every kernel over known vectors, on the machine that will run it.

A compiler that breaks a kernel (an emitter that overwrites an operand, a shift that isn't
arithmetic, a load that isn't signed) would give wrong poses without a word. So the board runs
each kernel over vectors that leave no sign, carry or branch untouched, and compares a CRC-32 of
what came out with the one that plain CPython computed (`tables.selftest`, written by
`tools/tables/selftest.py`). Kernels run in an order in which each needs only those before it, so
the first that fails is the one to blame.
"""

from array import array
from binascii import crc32

from solenav_core import (
    align,
    calibration,
    covariance,
    detector,
    features,
    forest,
    heading,
    navigator,
    particles,
    qmath,
    steps,
    strapdown,
)
from solenav_core.compat import const, micropython, ptr32
from solenav_core.layout import STATE_FIELDS, TABLE_FIELDS, WORK_FIELDS, offsets
from solenav_core.params import NAMES
from solenav_core.tables.defaults import PARAMS

_AT = offsets(STATE_FIELDS)
_RATE = offsets(WORK_FIELDS)["RATE"]
_WORK = offsets(WORK_FIELDS)
_TREES = offsets(TABLE_FIELDS)["FOREST"]
_ROUNDS = 6
_MAG_NEW = 8
_LOW = const(0x4E6D)  # of 1103515245: the low 15 bits, and the rest
_HIGH = const(0x838C)
_TOP = 0x3FFFFFFF  # where counters stop
_COUNTERS = (
    "STILL_TICKS",
    "SWING_TICKS",
    "SINCE_CONSISTENT",
    "STANCE_TICKS",
    "STEPS",
    "DISTANCE",
)
# Five trees that ask for features of every kind and both groups, with leaves of every weight.
# fmt: off
_FOREST = (
    5, 6, 11, 16, 17, 22, 1313281, -1073741761, 1308846, -931638016, -183488383, 2359323, 1310711,
    -1073483776, -920350135, -1065875392, -818653942, 1048588, -1073741823, 1572833, -64,
    -1040187392, 1317150, -1073741761, -16777216,
)
# fmt: on
_FLAT = (0, 0, 2048, 0, 0, 0)
_MOUNTINGS = ((10, -20, -2047), (2047, 5, 9), (-1200, 1300, -990), (6, -2046, 30), (0, 0, 900))


@micropython.viper
def _draw(x: ptr32, bits: int) -> int:
    """Two steps of x = 1103515245 x + 12345 mod 2**31, the low 15 bits of x in x[0].

    The first gives the size of the number, the second its value and sign. In halves: as objects
    the products would be half of the boot's time and fill the heap twice over.
    """
    size = 0
    i = 0
    while i < 2:
        low = x[0] * _LOW + 12345
        high = ((x[0] * _HIGH) & 0xFFFF) + ((x[1] * _LOW) & 0xFFFF)
        x[0] = low & 0x7FFF
        x[1] = (high + (low >> 15)) & 0xFFFF
        if i == 0:
            size = (x[1] << 7 | x[0] >> 8) % bits + 1  # > 0: every test asks for a bit or more
        i += 1
    value = (x[1] << 12 | x[0] >> 3) & ((1 << size) - 1)
    if x[0] & 4:
        return 0 - value
    return value


class _Bench:
    """Arrays to run kernels on, a source of numbers, and the CRC of all results so far."""

    def __init__(self):
        self.s = navigator.new_state()
        self.w = navigator.new_work()
        self.m = navigator.new_sample()
        self.p = PARAMS
        self.t = navigator.new_tables(array("i", _FOREST))
        self.x = array("i", (12345, 0))
        self.crc = 0

    def number(self, bits):
        """A signed number of up to `bits` bits: any size down to one bit, either sign."""
        return _draw(self.x, bits)

    def result(self, value):
        """A kernel's return value into the CRC."""
        self.crc = crc32(array("i", (value,)), self.crc)

    def arrays(self):
        """State and work area into the CRC."""
        self.crc = crc32(self.w, crc32(self.s, self.crc))

    def sample(self, bits):
        """A foot at rest or moving; magnetometer and flags as if nothing had come."""
        for i in range(6):
            self.m[i] = _FLAT[i] + self.number(bits)
        for i in range(6, 10):
            self.m[i] = 0

    def field(self, x, y, z):
        """A new reading of the magnetometer with the sample."""
        self.m[6] = x + self.number(3)
        self.m[7] = y + self.number(3)
        self.m[8] = z + self.number(3)
        self.m[9] = _MAG_NEW


def _mulshift(b):
    for n in (17, 24, 30, 31, 32, 33, 36, 46):
        for _ in range(8):
            x = b.number(30)
            y = b.number(min(30, n - 1))
            b.result(qmath.mulshift(x, y, n))


def _mulsat(b):
    for _ in range(24):
        b.result(qmath.mulsat(b.number(30), b.number(28), 22))


def _div(b):
    for n in (0, 10, 15, 22, 29):
        for _ in range(8):
            den = abs(b.number(30)) + 1
            b.result(qmath.div(b.number(30) % den, den, n))
            b.result(qmath.div(0 - b.number(30) % den, den, n))
    for _ in range(4):
        # Divisors of 31 bits.
        den = _TOP + abs(b.number(29))
        b.result(qmath.div(b.number(30), den, 29))
    b.result(qmath.div(5, 0, 8))


def _isqrt(b):
    for _ in range(24):
        b.result(qmath.isqrt(abs(b.number(30))))


def _clamp(b):
    for _ in range(12):
        b.result(qmath.clamp(b.number(30), abs(b.number(30))))


def _azimuth(b):
    for _ in range(16):
        b.result(qmath.azimuth(b.number(29), b.number(29), b.t))


def _turn(b):
    _stand(b)
    for i in range(_ROUNDS):
        b.result(strapdown.turn(b.s, b.number(28), b.number(28), b.number(28), i & 1))
        b.arrays()


def _to_nav(b):
    for _ in range(_ROUNDS):
        b.result(strapdown.to_nav(b.s, b.w, b.number(28), b.number(28), b.number(28)))
        b.arrays()


def _propagate(b):
    for _ in range(_ROUNDS):
        b.sample(14)
        b.result(calibration.condition(b.s, b.p, b.w, b.m))
        b.result(strapdown.propagate(b.s, b.p, b.w))
        b.arrays()


def _recentre(b):
    for turn in (-1, 1):
        for i in range(3):
            b.s[_AT["POS"] + i] = turn * (0x1FF00000 + 0x100000 * i)
            b.s[_AT["CELL"] + i] = b.number(8)
            for name in ("POS_LAST", "POS_REF", "POS_STEP"):
                b.s[_AT[name] + i] = b.number(29)
        b.result(strapdown.recentre(b.s))
        b.arrays()


def _full_speed(b):
    """Velocity at its limit."""
    for i in range(3):
        b.s[_AT["VEL"] + i] = (1 - 2 * (i & 1)) * 0x63FFFFFF
        b.w[_WORK["FORCE"] + i] = (1 - 2 * (i & 1)) * 150_630_000
    b.s[_AT["ATT"]] = 0x3FFFFFFF
    for i in range(1, 4):
        b.s[_AT["ATT"] + i] = 0
    for count in (0, _TOP):
        b.s[_AT["SATURATED"]] = count
        b.result(strapdown.propagate(b.s, b.p, b.w))
        b.arrays()


def _push(b):
    for _ in range(14):
        b.sample(15)
        calibration.condition(b.s, b.p, b.w, b.m)
        b.result(detector.push(b.s, b.p, b.w))
    b.result(detector.spread(b.s))
    b.arrays()


def _slower(b):
    for limit in (200, 3280, 26000):
        for i in range(48):
            # Around the limit along each axis and on the sphere of it.
            for a in range(3):
                b.w[_RATE + a] = b.number(4)
            b.w[_RATE + i % 3] = (limit << 6) - 96 + b.number(7)
            if i & 4:
                for a in range(3):
                    b.w[_RATE + a] = limit * 37 + b.number(10)
            if i & 8:
                b.w[_RATE + i % 3] = 0 - b.w[_RATE + i % 3]
            b.result(detector.slower(b.w, limit))


def _unrest(b):
    """Quiet after quiet, wild after quiet, and the way back."""
    for bits in (2, 2, 14, 15, 6, 6, 4, 9):
        for least in (0, 4096, 70_000):
            b.sample(bits)
            calibration.condition(b.s, b.p, b.w, b.m)
            detector.push(b.s, b.p, b.w)
            b.s[_AT["STILLEST"]] = least
            b.result(detector.unrest(b.s, b.p, b.w))
            b.arrays()


def _detect(b):
    for bits in (2, 2, 2, 14, 2):
        for _ in range(6):
            b.sample(bits)
            calibration.condition(b.s, b.p, b.w, b.m)
            detector.push(b.s, b.p, b.w)
            b.result(detector.detect(b.s, b.p, b.w))
    b.arrays()


def _collect(b):
    """Windows of one sample, growing, full and cut short; rest, strides, the ends of the scale."""
    for window, bits in ((1, 15), (5, 3), (5, 14), (3, 9), (31, 15)):
        params = _params(b, GLRT_WINDOW=window)
        for _ in range(7):
            b.sample(bits)
            calibration.condition(b.s, b.p, b.w, b.m)
            b.result(detector.collect(b.s, params, b.w))
        b.arrays()


def _likelihood_ratio(b):
    """T from far below to far above its threshold, of one motion after the other."""
    _stand(b)
    b.s[_AT["GLRT_FILL"]] = 0
    for i in range(18):
        params = _params(b, DETECTOR=1 + i % 2, GLRT_WINDOW=4, GLRT_ACC=_TOP >> 5, GLRT_MAX=9 << i)
        params[NAMES.index("GLRT_RATE")] = 3 << i
        params[NAMES.index("GLRT_RUN")] = 9000
        b.s[_AT["MOTION"]] = 3 * (i & 2) >> 1
        b.sample((2, 2, 5, 11, 15, 8)[i // 3])
        calibration.condition(b.s, b.p, b.w, b.m)
        detector.push(b.s, b.p, b.w)
        detector.collect(b.s, params, b.w)
        b.result(detector.likelihood_ratio(b.s, params))
        b.result(detector.detect(b.s, params, b.w))
        b.arrays()


def _sense(b):
    for bits in (14, 9, 15):
        b.sample(bits)
        calibration.condition(b.s, b.p, b.w, b.m)
        detector.push(b.s, b.p, b.w)
        for i in range(3):
            b.s[_AT["VEL"] + i] = b.number(29 - 3 * (bits & 1))
        for group in range(2):
            b.result(features.sense(b.s, b.w, group))
            b.arrays()


def _observe_motion(b):
    """Blocks begun, gone on with and closed; another stride in between, and none."""
    _stand(b)
    for i in range(20):
        if i % 7 == 3:
            b.s[_AT["BLOCK_FILL"]] = 62
        b.sample((14, 12)[i & 1])
        calibration.condition(b.s, b.p, b.w, b.m)
        detector.push(b.s, b.p, b.w)
        b.s[_AT["VOTE"] + 4] = 9
        params = _params(b, MOTION_STRIDE=2 + i // 17 - 3 * (i // 19))
        b.result(features.observe_motion(b.s, params, b.w))
        b.arrays()


def _summarise(b):
    """Windows of signals that go far, hardly move or stand still, and their correlations."""
    for top in (1023, 1023, 200, 30, 9, 0):
        _stand(b)
        for at in range(0, 168, 28):
            value = b.number(10) * top >> 10
            for i in range(0, 25, 5):
                # 31 samples of one value, one of another: sums as a block has them.
                other = 0 - top if i & 1 else b.number(10) * top >> 10
                y = _AT["SUMS"] + at + i
                b.s[y] = 31 * value + other
                b.s[y + 1] = 31 * value * value + other * other
                b.s[y + 2] = 31 * ((value * value * value + 32) >> 6)
                b.s[y + 2] += (other * other * other + 32) >> 6
                b.s[y + 3] = max(value, other)
                b.s[y + 4] = min(value, other)
            for i in range(25, 28):
                b.s[_AT["SUMS"] + at + i] = b.number(6) * value * value >> 1
        for open_slot in range(3):
            b.s[_AT["BLOCK_SLOT"]] = open_slot
            b.result(features.summarise(0, 0, b.s, open_slot & 1))
        b.arrays()


def _classify(b):
    """Features on either side of every split; votes that win, tie, change and hold."""
    _stand(b)
    for i in range(12):
        b.s[_AT["BLOCK_SLOT"]] = i % 3
        for at in range(168):
            b.s[_AT["SUMS"] + at] = b.number((4, 9, 12)[i % 3])
        params = _params(b, MOTION_SHARE=(60, 128, 40)[i // 4], MOTION_HOLD=1 + i // 6)
        for tree in (0, 3):
            b.result(forest.classify(0, 0, b.s, b.t, params, tree))
        b.arrays()
    # No tree at all; in place, as a board has hardly room for other tables now.
    trees = b.t[_TREES]
    b.t[_TREES] = 0
    b.result(forest.classify(0, 0, b.s, b.t, b.p, 0))
    b.t[_TREES] = trees
    b.arrays()


def _grow(b):
    """In swing, in a stance, and in one that is long; slow and fast changes of the force."""
    for i in range(_ROUNDS):
        _covariances(b, ("P_VV", "P_PV", "P_PP", "P_TT"), 30, 0)
        _covariances(b, ("P_VT", "P_PT"), 27, 1)
        b.s[_AT["SWING_TICKS"]] = i & 1
        b.s[_AT["STANCE_TICKS"]] = 150 * i
        for a in range(3):
            b.s[_AT["LAST"] + a] = (5 * a - 3 * i) << 23
            b.w[_WORK["FORCE"] + a] = (7 - 4 * a) << (15 + 2 * i)
        b.result(covariance.grow(b.s, b.p, b.w))
        b.arrays()
    b.s[_AT["SWING_TICKS"]] = b.s[_AT["STANCE_TICKS"]] = 0


def _shrink(b):
    for i in range(_ROUNDS):
        rho = abs(b.number(30))
        b.result(covariance.shrink(b.s, i % 3, rho, b.number(25), b.number(26)))
        b.arrays()


def _level(b):
    """Gravity from every side, over an attitude that was another."""
    for x, y, z in _MOUNTINGS:
        for i in range(4):
            b.s[_AT["ATT"] + i] = b.number(30)
        b.result(align.level(b.s, b.w, x * 5000, y * 5000, z * 5000))
        b.arrays()


def _align(b):
    navigator.reset(b.s)
    params = _params(b, ALIGN_TICKS=12, ALIGN_MIN=4, SEED=0x1234567)
    for turn in range(3):
        for _ in range(7):
            b.sample(3)
            b.m[turn] = b.m[turn] + 900
            b.result(align.align(b.s, params, b.w, b.t, b.m))
        b.sample(12)
        b.result(align.align(b.s, params, b.w, b.t, b.m))
        b.arrays()
    for x, y, z in _MOUNTINGS:
        navigator.reset(b.s)
        b.s[_AT["CELL"]] = 7
        for i in range(3):
            b.s[_AT["STEP_VAR"] + i] = 7
        for _ in range(13):
            b.sample(3)
            b.m[0] = x
            b.m[1] = y
            b.m[2] = z
            b.result(align.align(b.s, params, b.w, b.t, b.m))
        b.arrays()
    for rate in (-900, -800, 800, 900):
        navigator.reset(b.s)
        for _ in range(13):
            b.sample(1)
            b.m[4] = rate
            b.result(align.align(b.s, params, b.w, b.t, b.m))
        b.arrays()


def _condition(b):
    """Every entry of the matrices, every bias, every mounting."""
    params = _params(b)
    for i in range(36):
        at = NAMES.index("ACC_XX") + i
        params[at] = params[at] + b.number((10, 21, 9, 27, 12, 14)[i // 12 * 2 + i % 12 // 9])
    for right, front, up in ((0, 0, 0), (2, 3, 1), (-1, 2, -3), (3, -1, -2), (-2, -3, 1)):
        for i in range(3):
            params[NAMES.index("MOUNT_R") + i] = (right, front, up)[i]
            b.s[_AT["MOUNT"] + i] = 0
        b.result(calibration.orient(b.s, params, b.w))
        b.sample(14)
        b.result(calibration.condition(b.s, params, b.w, b.m))
        b.result(calibration.magnetic(b.s, params, b.w, b.number(16), b.number(16), b.number(16)))
        b.arrays()
    for x, y, z in _MOUNTINGS + ((-8, 100, 101), (100, -134, -99), (-134, 2, 100), (133, 1, -100)):
        b.w[_WORK["FORCE"]] = x * 5000
        b.w[_WORK["FORCE"] + 1] = y * 5000
        b.w[_WORK["FORCE"] + 2] = z * 5000
        b.result(calibration.orient(b.s, b.p, b.w))
        b.arrays()


def _heading(b):
    """References weak, strong and sound; readings of the same field, and of steel."""
    params = _params(b, MAG_GAIN=500, MAG_BIAS_GAIN=3000, MAG_ALIGN=1, DECLINATION=-700)
    for x, y, z in ((9, -12, 9), (60, -30, -140), (-80, 20, -120), (300, -300, 300), (1, 70, -150)):
        _stand(b)
        b.result(calibration.magnetic(b.s, params, b.w, x << 4, y << 4, z << 4))
        params[NAMES.index("MAG_ALIGN")] ^= 1
        b.result(heading.refer(b.s, params, b.w, b.t))
        b.arrays()
        for turn in (0, 20, -60, 3):
            b.field(x + turn, y - turn, z)
            b.result(heading.steer(b.s, params, b.w, b.t, b.m))
        b.s[_AT["MAG_USED"]] = b.s[_AT["MAG_REFUSED"]] = _TOP
        for up in (0, 90):
            b.field(x, y, z + up)
            b.result(heading.steer(b.s, params, b.w, b.t, b.m))
        b.arrays()


def _settle(b):
    """Stances after a hole: turned over, too fast, good; a sample that moves in between."""
    params = _params(b, RESUME_TICKS=4)
    for x, y, z in _MOUNTINGS:
        _stand(b)
        for name in ("POS", "VEL", "HEADING_LAST", "X", "P_VT"):
            b.s[_AT[name]] = b.number(29)
        navigator.resume(b.s)
        for i in range(14):
            b.sample((3, 13)[int(i == 2)])
            b.m[0] = b.m[0] + x
            b.m[1] = b.m[1] + y
            b.m[2] = z
            if 2 < i < 7:
                b.m[4] = b.m[4] + 700
            b.result(align.align(b.s, params, b.w, b.t, b.m))
        b.arrays()


def _head(b):
    """Front axes all round the horizon, and nearly upright."""
    for w, x, z in ((9, 0, 4), (5, 0, -9), (1, 0, 9), (7, 7, 1), (6, 0, 8), (-3, 1, 9)):
        # The levelled attitude need not be a unit: it is renormalised as it is turned.
        b.s[_AT["ATT"]] = w * 95_000_000
        b.s[_AT["ATT"] + 1] = x * 95_000_000
        b.s[_AT["ATT"] + 2] = 0
        b.s[_AT["ATT"] + 3] = z * 95_000_000
        b.result(align.head(b.s, b.p, b.w))
        b.arrays()


def _roots(b):
    for _ in range(8):
        for i in range(3):
            b.s[_AT["P_VV"] + i] = b.number(30)
        b.result(particles.roots(b.s, b.w, _AT["P_VV"]))
        b.arrays()


def _ratio(b):
    for _ in range(24):
        b.result(particles.ratio(b.number(30), abs(b.number(30)), 3, 0x2000000))
        b.result(particles.ratio(b.number(20), abs(b.number(30)), 4, 0x4000000))
        b.result(particles.ratio(b.number(30), abs(b.number(30)), 3, _TOP))


def _feed_back(b):
    for i in range(12):
        _covariances(b, ("P_VV", "P_PP", "P_TT"), 30, 0)
        _covariances(b, ("P_PV",), 30, 1)
        _covariances(b, ("P_VT", "P_PT"), 28, 1)
        for a in range(3):
            b.s[_AT["VEL"] + a] = b.number(29)
            b.s[_AT["POS"] + a] = b.number(29)
            b.s[_AT["POS_REF"] + a] = b.number(29)
            b.w[_WORK["ERR"] + a] = b.number(29)
            b.w[_WORK["VAR"] + a] = abs(b.number(22))
            scale = 0
            while b.s[_AT["P_VV"] + a] >> (2 * scale) >= 16384:
                scale += 1
            b.w[_WORK["SCALE"] + a] = scale
        b.result(particles.feed_back(b.s, b.p, b.w, i & 1))
        b.arrays()


def _observe(b):
    """Velocities and clouds from far too large to quiet, on every scale of the likelihood."""
    for v, p_vv, bits in (
        (0x7FFF000, _TOP, 20),
        (-0x7000000, 0x4000000, 20),
        (-0x7FFF000, _TOP, 13),
        (-0x30000, 0x40000, 12),
        (0x900000, 0x1000, 8),
    ):
        for a in range(3):
            b.s[_AT["VEL"] + a] = (v >> a) * (1 - 2 * (a & 1))
            b.s[_AT["P_VV"] + a] = p_vv
            b.s[_AT["REACH"] + a] = 1 << (bits + a)
            for i in range(0, 100, 9):
                b.w[_WORK["PROPOSAL"] + 100 * a + i] = b.number(bits + a)
        b.w[_WORK["UNREST"]] = abs(b.number(bits - 6))
        b.result(particles.observe(b.s, b.p, b.w))
        b.result(particles.likelihood(0, 0, 0, b.s, b.w))
        b.arrays()


def _adapt(b):
    """The threshold from its least to its largest, then clouds within and beyond 16 sigma."""
    for since, m2 in ((10, 4096), (1000, 4096), (10, 0)):
        for t in (0, 3, 40, 1022, 1023):
            b.s[_AT["SINCE_CONSISTENT"]] = since
            b.s[_AT["M2"]] = m2
            b.s[_AT["INCONSISTENT"]] = t
            b.s[_AT["N_EFF"]] = 25600 >> (t & 3)
            b.w[_WORK["UNREST"]] = 3 * 256 + (since & 2) - 1
            b.result(particles.adapt(b.s, b.p, b.w))
            b.arrays()
    for a in range(3):
        b.s[_AT["P_VV"] + a] = 100
        b.s[_AT["REACH"] + a] = 9 << 7
    b.result(particles.scattered(b.s))
    for a in range(3):
        b.s[_AT["REACH"] + a] = 11 << 7
        b.result(particles.scattered(b.s))
        b.s[_AT["REACH"] + a] = 9 << 7


def _spread(b):
    """Proposals, weights and estimates with particles and velocities of every size."""
    _stand(b)
    for i in range(4):
        for a in range(300):
            b.s[_AT["X"] + a] = b.number(20)
        for a in range(3):
            b.s[_AT["VEL"] + a] = b.number(30)
            b.s[_AT["P_VV"] + a] = abs(b.number(30))
            b.s[_AT["DP_VV"] + a] = b.number(30)
        for a in range(3):
            b.s[_AT["REACH"] + a] = 1 << 20
        b.result(particles.propose(0, 0, b.s, b.w, b.t, 0))
        b.result(particles.scales(b.s, b.w))
        b.w[_WORK["GAIN"]] = 1 << (14 - 4 * i)
        b.w[_WORK["GAIN_SHIFT"]] = 8
        b.w[_WORK["GAIN_EXTRA"]] = 2 * i
        b.result(particles.weigh(0, 0, 0, b.s, b.p, b.w, b.t))
        b.result(particles.estimate(b.w))
        b.result(particles.retain(0, 0, b.s, b.w))
        b.arrays()


def _particles(b):
    """A stance whose velocity starts small, jumps, and ends in lock-outs, the last uncounted."""
    _stand(b)
    for i in range(14):
        if i == 3 or i == 9:
            for a in range(3):
                b.s[_AT["VEL"] + a] = b.number(20 + i)
        if i >= 12:
            b.s[_AT["SINCE_CONSISTENT"]] = 1000
            b.s[_AT["INCONSISTENT"]] = 30
            b.s[_AT["VEL"]] = 0x3000000
            b.s[_AT["P_TT"] + 1] = (5, 0x2000000)[i - 12]
        if i == 13:
            b.s[_AT["LOCKOUTS"]] = b.s[_AT["RESAMPLED"]] = _TOP
        b.result(covariance.grow(b.s, b.p, b.w))
        b.result(particles.update(b.s, b.p, b.w, b.t, int(i == 0)))
        b.arrays()


def _steps(b):
    _stand(b)
    for stride in (300000, -12_000_000, 40_000_000):
        b.s[_AT["POS"]] = b.s[_AT["POS"]] + stride
        b.s[_AT["POS"] + 1] = b.s[_AT["POS"] + 1] - 150000
        for _ in range(10):
            b.result(steps.stood(b.s, b.p, b.w, b.t))
        b.s[_AT["TICK"]] = b.s[_AT["TICK"]] + 150
        b.s[_AT["P_PP"] + 1] = 0
        b.s[_AT["HEADING_STEP"]] = b.number(15)
        for i in range(32):
            b.s[_AT["SWING_TICKS"]] = i
            b.result(steps.swung(b.s, b.p))
        b.arrays()


def _tick(b):
    """A short run of the whole: static start, two steps; then months later, with counters full."""
    navigator.reset(b.s)
    params = _params(
        b,
        ALIGN_TICKS=10,
        ALIGN_MIN=10,
        STILL_TICKS=3,
        STEP_SWING=4,
        STEP_STANCE=3,
        WINDOW=4,
        MAG_GAIN=100,
    )
    for i in range(9):
        for j in range((20, 6, 9, 6, 9, 6, 9, 6, 9)[i]):
            b.sample((2, 14)[i & 1])
            if j & 1:
                b.field(5, 80, -120)
            if j == 3:
                # Holes that can be bridged, and in the end one that can't.
                b.m[9] = b.m[9] | (0, 0, 1, 2, 3, 0, 0, 20, 21)[i] << 8
            b.result(navigator.tick(b.s, params, b.w, b.t, b.m))
        b.arrays()
        if i == 4:
            for name in _COUNTERS:
                b.s[_AT[name]] = _TOP - 1
            b.s[_AT["TICK"]] = (127 << 24) - 1


def _params(b, **changes):
    """The default parameters but for some."""
    params = array("i", b.p)
    for name, value in changes.items():
        params[NAMES.index(name)] = value
    return params


def _covariances(b, names, bits, signed):
    """Numbers of up to `bits` bits into these fields of the state."""
    for name in names:
        for i in range(2 if name in ("P_VT", "P_PT", "P_TT") else 3):
            value = b.number(bits)
            b.s[_AT[name] + i] = value if signed else abs(value)


def _stand(b):
    """A plain navigating state to start from."""
    navigator.reset(b.s)
    b.s[_AT["MODE"]] = 1
    b.s[_AT["ATT"]] = 0x3FFFFFFF
    b.s[_AT["GRAVITY"]] = 10283000
    for i in range(3):
        b.s[_AT["MOUNT"] + i] = i + 1
    b.s[_AT["RNG"] + 1] = 1
    for i in range(3):
        b.s[_AT["P_VV"] + i] = 0x10000 << i
        b.s[_AT["P_PV"] + i] = 0x9000 - 0x6000 * i
        b.s[_AT["BIAS"] + i] = (i - 1) * 0x1234567
    for i in range(2):
        b.s[_AT["P_VT"] + i] = 0x20000
        b.s[_AT["P_TT"] + i] = 0x140000


TESTS = (
    ("mulshift", _mulshift),
    ("mulsat", _mulsat),
    ("div", _div),
    ("isqrt", _isqrt),
    ("clamp", _clamp),
    ("azimuth", _azimuth),
    ("turn", _turn),
    ("to_nav", _to_nav),
    ("condition", _condition),
    ("steer", _heading),
    ("propagate", _propagate),
    ("recentre", _recentre),
    ("full speed", _full_speed),
    ("push", _push),
    ("slower", _slower),
    ("unrest", _unrest),
    ("detect", _detect),
    ("collect", _collect),
    ("likelihood ratio", _likelihood_ratio),
    ("sense", _sense),
    ("observe motion", _observe_motion),
    ("summarise", _summarise),
    ("classify", _classify),
    ("grow", _grow),
    ("shrink", _shrink),
    ("head", _head),
    ("level", _level),
    ("align", _align),
    ("settle", _settle),
    ("roots", _roots),
    ("ratio", _ratio),
    ("feed_back", _feed_back),
    ("observe", _observe),
    ("adapt", _adapt),
    ("weigh", _spread),
    ("update", _particles),
    ("stood", _steps),
    ("tick", _tick),
)


def measure():
    """The CRC-32 after each test, in the order of TESTS: what `tables.selftest` keeps."""
    bench = _Bench()
    out = []
    for _name, test in TESTS:
        test(bench)
        out.append(bench.crc)
    return out


def first_failure(expected):
    """0 where all CRCs are as in `expected`, else the place in TESTS of the first, from 1.

    A kernel that raises has failed as well.
    """
    bench = _Bench()
    for i, (_name, test) in enumerate(TESTS):
        try:
            test(bench)
        except Exception:
            return i + 1
        if bench.crc != expected[i]:
            return i + 1
    return 0
