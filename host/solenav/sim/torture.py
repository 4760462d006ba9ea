"""Inputs meant to hurt: samples and states at the ends of what the core has to bear.

All from integer arithmetic, so that they are the same on every machine. A `Case` is run from a
fresh state that its `prepare` may change; most start in the middle of navigation, with the
words in question at their limits.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from solenav_core import layout, messages, navigator
from solenav_core.params import NAMES

Counts = NDArray[np.int16]
Integers = NDArray[np.int64]

AT = layout.offsets(layout.STATE_FIELDS)
WORDS = {name: words for name, words, _stage, _format in layout.STATE_FIELDS}

ONE = 2**30 - 1
_LOW, _HIGH = -32768, 32767
_FLAT = (150, -90, 2040, 12, -7, 3)  # a foot at rest, tilted a little, with a gyro bias
_LEVEL = (ONE, 0, 0, 0)
_HALF = 2**29
# Level, turned over about each axis, turned by a third, and the cube's diagonal upright.
_ATTITUDES = (
    _LEVEL,
    (0, ONE, 0, 0),
    (0, 0, ONE, 0),
    (0, 0, 0, -ONE),
    (_HALF, _HALF, -_HALF, _HALF),
    (953558000, 349029000, -349029000, 0),
)

# Least and largest value of each state word between two ticks, at the default parameters. Not
# here: ATT, which is a unit quaternion; REACH and X, see `cloud`; what a static start alone reads.
LIMITS = {
    "TICK": (0, 127 << 24),
    "SATURATED": (0, ONE),
    "LAST": (-220_000_000, 220_000_000),
    "GAPS": (0, ONE),
    "RESUMED": (0, ONE),
    "STANCE": (0, 1),
    "STILL_TICKS": (0, ONE),
    "RING": (0, 8191),
    "STILLEST": (4096, 2**29),
    "GLRT": (0, 2**25),
    "STRIDE": (0, 32767),
    "PAUSE": (-1, 32767),
    "BLOCK_FILL": (0, 63),
    "BLOCK_SLOT": (0, 2),
    "BLOCKS": (0, 2),
    "STAGE": (0, 255),
    "SCORE": (0, 64 * 63),
    "VOTE": (0, 2 * 64 * 63),
    "RIVAL": (0, 5),
    "RIVAL_WINDOWS": (0, 32767),
    "MOTION": (0, 5),
    "VEL": (-100 << 24, 100 << 24),
    "POS": (-(2**29), 2**29),
    "CELL": (-127, 127),
    "BIAS": (-820 << 20, 820 << 20),
    "GRAVITY": (7864320, 12582912),
    "P_VV": (0, ONE),
    "P_PV": (-ONE, ONE),
    "P_PP": (-ONE, ONE),
    "P_VT": (-ONE, ONE),
    "P_PT": (-ONE, ONE),
    "P_TT": (0, ONE),
    "DP_VV": (-(2**27), 2**27),  # at 50 Hz
    "SWING_TICKS": (0, ONE),
    "RNG": (0, 65535),
    "OBSERVED": (0, 1),
    "INCONSISTENT": (0, 1023),
    "SINCE_CONSISTENT": (0, ONE),
    "LOG_W": (-(2**24), 0),
    "POS_LAST": (-ONE, ONE),
    "POS_REF": (-ONE, ONE),
    "POS_STEP": (-ONE, ONE),
    "HEADING_STEP": (-32768, 32767),
    "HEADING_LAST": (-32768, 32767),
    "STANCE_TICKS": (0, ONE),
    "STEPPING": (0, 2),
    "STEPS": (0, ONE),
    "DISTANCE": (0, ONE),
    "MAG_NORM": (0, 8000),
    "MAG_UP": (-8000, 8000),
    "MAG_AZ": (-32768, 32767),
    "MAG_USED": (0, ONE),
    "MAG_REFUSED": (0, ONE),
}


@dataclass(frozen=True)
class Case:
    """Samples (n, 10) and what to do to the state before the first."""

    name: str
    counts: Counts
    prepare: Callable[[array[int]], None] | None = None


def put(state: array[int], /, **words: int | tuple[int, ...]) -> None:
    """Set fields of the state: one value for all of a field's words, or a value for each."""
    for name, value in words.items():
        values = value if isinstance(value, tuple) else (value,) * WORDS[name]
        for i, word in enumerate(values):
            state[AT[name] + i] = word


def navigate(state: array[int], /, **words: int | tuple[int, ...]) -> None:
    """Make the state that of a level foot after its start, on the ground, then put `words`.

    The detector's window is full of rest, so that the next sample at rest is stance.
    """
    put(state, MODE=1, AL_DONE=1, MOUNT=(1, 2, 3), ATT=_LEVEL, GRAVITY=10283000, RNG=(0, 1))
    put(state, RING_FILL=layout.WINDOW_MAX, RING=1255, P_VV=6711, P_TT=1288490)
    put(state, **words)


def cloud(p_vv: tuple[int, ...], picks: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """REACH and X as the filter leaves them for these variances: nothing beyond 16 sigma.

    REACH is between 3 and 16 sigma by the last of `picks`; particles are at either end of it, at
    0 or between as `picks` have it, in turn.
    """
    reach = []
    for variance in p_vv:
        sigma = math.isqrt(variance)  # Q13
        reach.append(24 * sigma + (104 * sigma + 127) * ((picks[-1] >> 2) % 64) // 63)
    x = []
    for i in range(3 * layout.PARTICLES):
        far, pick = reach[i // layout.PARTICLES], picks[i % len(picks)]
        between = (pick >> 2) % (2 * far + 1) - far
        x.append((-far, far, 0, between)[pick % 4])
    return {"REACH": tuple(reach), "X": tuple(x)}


def numbers(seed: int) -> Iterator[int]:
    """24-bit numbers from a linear congruence (Numerical Recipes)."""
    x = seed
    while True:
        x = (x * 1664525 + 1013904223) % 2**32
        yield x >> 8


def noise(count: int, size: int, seed: int) -> Integers:
    """(count, 6) integers within +-size."""
    source = numbers(seed)
    values = [next(source) % (2 * size + 1) - size for _ in range(count * 6)]
    return np.array(values).reshape(count, 6)


def standing(count: int, seed: int) -> Integers:
    """A foot at rest."""
    return noise(count, 4, seed) + np.array(_FLAT)


def swing(count: int, seed: int) -> Integers:
    """Something like a stride: a push forward, a brake, a turn of the foot and back."""
    half = count // 2
    push = np.array([0, 1500, 300, 6000, 200, 150])
    strides = np.concatenate([np.tile(push, (half, 1)), np.tile(-push, (count - half, 1))])
    return strides + standing(count, seed) + noise(count, 60, seed + 1)


def _samples(*parts: Integers) -> Counts:
    """With all words of a sample; no reading of the magnetometer, nothing lost."""
    counts = np.vstack(parts)
    return np.hstack([counts, np.zeros((len(counts), 4), np.int64)]).astype(np.int16)


def walks() -> list[Case]:
    """Everyday input: a walk, a restless start with wild motion after it, a flight."""
    walk = [standing(240, 1)]
    for i in range(12):
        walk += [swing(100, 10 + i), standing(90, 40 + i)]
    restless = [standing(80, 2), noise(20, 3000, 3), standing(210, 4), noise(400, _HIGH, 5)]
    flight = np.tile([_HIGH, _LOW, _HIGH, _LOW, _HIGH, 3], (900, 1))
    return [
        Case("walk", _samples(*walk)),
        Case("restless", _samples(*restless, standing(300, 7))),
        Case("flight", _samples(standing(220, 6), flight)),
    ]


def minutes(rate_hz: int) -> list[Case]:
    """A minute of stance and one of swing: what saturates only with time."""
    count = 60 * rate_hz
    turning = standing(count, 9) + np.array([0, 0, 0, 3000, 0, 0])
    return [
        Case("minute of stance", _samples(standing(count, 8)), navigate),
        Case("minute of swing", _samples(turning), navigate),
    ]


def starts() -> list[Case]:
    """Static starts in every mounting, at the ends of what is taken for gravity and bias."""
    means = [(2048, 0, 0), (-2048, 0, 0), (0, 2048, 0), (0, -2048, 0), (0, 0, 2048), (0, 0, -2048)]
    means += [(1183, -1183, 1183), (0, 900, -1280), (0, 0, 2500), (1, 2047, 3)]
    cases = []
    for i, mean in enumerate(means):
        rates = tuple(815 * ((i >> axis & 1) * 2 - 1) for axis in range(3))
        rest = noise(210, 3, 20 + i) + np.array([*mean, *rates])
        name = "start " + " ".join(map(str, mean))
        cases.append(Case(name, _samples(rest, noise(3, 3000, i), rest[:30])))
    return cases


def full_scale() -> list[Case]:
    """Every axis at either end of its scale in several attitudes, moving at the limits."""
    signs = list(product((_LOW, _HIGH), repeat=6))
    corners = np.array([signs[(i * 37) % 64] for i in range(64)])
    cases = [
        Case(
            f"full scale {i}",
            _samples(corners),
            partial(navigate, ATT=attitude, VEL=(100 << 24) * (1 - 2 * (i & 1)), P_VV=ONE),
        )
        for i, attitude in enumerate(_ATTITUDES)
    ]
    cases += [
        Case(
            f"attitude {'+' if sign > 0 else '-'}{i}",
            _samples(standing(26, 21)),
            partial(navigate, ATT=tuple(sign * word for word in attitude)),
        )
        for i, attitude in enumerate(_ATTITUDES)
        for sign in (1, -1)
    ]
    held = [np.tile(np.array(signs[i]), (40, 1)) for i in (0, 21, 42, 63)]
    cases += [Case(f"full scale held {i}", _samples(part), navigate) for i, part in enumerate(held)]
    return cases


def nothing() -> list[Case]:
    """A dead sensor: all zeros before and after the start."""
    zeros = np.zeros((60, 6), np.int64)
    return [Case("zeros at the start", _samples(zeros)), Case("zeros", _samples(zeros), navigate)]


def far() -> list[Case]:
    """Position at the edge of its cell, anchors as far off as they get, a very long step."""
    cases = []
    for sign in (1, -1):
        edge = sign * (2**29 - 1000)
        words = {"POS": edge, "VEL": sign * (100 << 24), "POS_LAST": -sign * ONE}
        words |= {"POS_REF": -sign * ONE, "POS_STEP": -sign * ONE}
        side = "+" if sign > 0 else "-"
        moving = standing(40, 11) + np.array([0, 0, 0, 3000, 0, 0])
        cases += [
            Case(f"{side} edge, swing", _samples(moving), partial(navigate, **words)),
            Case(
                f"{side} edge, stance",
                _samples(standing(16, 12), moving),
                partial(navigate, **words, STEPPING=1, P_PV=ONE, P_VV=2**22, P_VT=-ONE),
            ),
        ]
    return cases


def late() -> list[Case]:
    """Counters and the tick shortly before they stop."""
    counters = ("STILL_TICKS", "SWING_TICKS", "SINCE_CONSISTENT", "STANCE_TICKS", "DISTANCE")
    words = dict.fromkeys(counters, ONE - 2) | {"TICK": (127 << 24) - 3}
    parts = _samples(standing(8, 13), swing(60, 14), standing(40, 15))
    return [Case("after months", parts, partial(navigate, **words))]


def with_field(parts: Counts, every: int, field: tuple[int, int, int], lost: int = 0) -> Counts:
    """Samples with a reading of the magnetometer on each `every`-th, after `lost` lost samples."""
    out = parts.copy()
    out[:, 6:9] = field
    out[::every, 9] = messages.MAG_NEW | lost << 8
    return out


def steering(params: array[int], mounted: bool = False) -> array[int]:
    """Parameters with which the magnetometer steers; in another mounting if wanted."""
    out = array("i", params)
    changes = {"MAG_GAIN": 900, "MAG_BIAS_GAIN": 4000, "MAG_ALIGN": 1, "DECLINATION": -700}
    if mounted:
        changes |= {"MOUNT_R": 2, "MOUNT_F": -1, "MOUNT_U": 3, "MAG_ALIGN": 0}
    for name, value in changes.items():
        out[NAMES.index(name)] = value
    return out


def detecting(params: array[int], longest: bool = False) -> array[int]:
    """Parameters with which the GLRT tells stance, by the motion; or at the ends of its own."""
    out = array("i", params)
    changes = {"DETECTOR": 2}
    if longest:
        # The largest window, and noise so small that everything is far from rest.
        top = 2**25 - 1
        changes = {"DETECTOR": 1, "GLRT_WINDOW": 31, "GLRT_ACC": top, "GLRT_RATE": top}
    for name, value in changes.items():
        out[NAMES.index(name)] = value
    return out


def stances() -> list[Case]:
    """What a GLRT makes of rest, strides, full scale and nothing.

    To be run with `detecting` parameters.
    """
    full = np.array([_HIGH, _LOW, _HIGH, _LOW, _HIGH, _LOW])
    held = np.tile(full, (40, 1))
    swapped = (held * np.where(np.arange(40) % 2, 1, -1)[:, None]).clip(_LOW, _HIGH)
    zeros = np.zeros((40, 6), np.int64)
    strides = [standing(40, 35), swing(60, 36), standing(40, 37)]
    return [
        Case("GLRT, strides", _samples(*strides), partial(navigate, MOTION=3)),
        Case("GLRT, full scale", _samples(held, swapped, zeros), navigate),
        Case("GLRT, start", _samples(standing(230, 38), swing(30, 39))),
    ]


def _block(shape: Sequence[int]) -> tuple[int, ...]:
    """A block's sums where all signals go as `shape` (32,), every other one the other way round."""
    out: list[int] = []
    for _group in range(2):
        for signal in range(5):
            y = [value * (1 - 2 * (signal & 1)) for value in shape]
            cubes = sum((value**3 + 32) >> 6 for value in y)
            out += [sum(y), sum(value**2 for value in y), cubes, max(y), min(y)]
        product = sum(value**2 for value in shape)
        out += [-product, -product, product]
    return tuple(out)


def windows() -> list[Case]:
    """The end of a window of motion: signals at their ends, hardly moving, rare and far.

    The state is that of 200 Hz: at other rates its blocks are dropped.
    """
    shapes = {
        "held": [1023] * 32,
        "held low": [-1023] * 32,
        "to and fro": [1023, -1023] * 16,
        "half": [1023] * 8 + [-1023] * 24,
        "pulse": [1023] + [0] * 31,
        "little": [9, -11] * 16,
        "none": [0] * 32,
    }
    cases = []
    for name, shape in shapes.items():
        words = {"STRIDE": 2, "PAUSE": 1, "BLOCK_FILL": 62, "BLOCKS": 1, "STAGE": 255}
        sums = _block(shape)
        prepare = partial(navigate, **words, SUMS=sums * 3)
        cases.append(Case(f"window {name}", _samples(standing(60, 40)), prepare))
    return cases


def fields() -> list[Case]:
    """Magnetic fields from none to full scale, in the start and in stance, with holes between.

    To be run with `steering` parameters.
    """
    rest = _samples(standing(230, 22))
    cases = []
    for i, field in enumerate([(0, 0, 0), (60, -30, -140), (-80, 120, 9), (4095, -4096, 4095)]):
        on_the_way = with_field(
            _samples(swing(60, 23), standing(60, 24)), 2, field, (0, 3, 20, 127)[i]
        )
        cases.append(Case(f"field {i}", np.vstack([with_field(rest, 2, field), on_the_way])))
    wild = with_field(_samples(noise(20, _HIGH, 25), standing(20, 26)), 1, (_LOW, _HIGH, _LOW), 20)
    reference = {"MAG_NORM": 8000, "MAG_UP": -8000, "MAG_AZ": _LOW}
    cases.append(Case("field beyond the scale", wild, partial(navigate, **reference)))
    full = partial(navigate, MAG_NORM=2600, MAG_UP=-2200, MAG_USED=ONE, MAG_REFUSED=ONE, GAPS=ONE)
    steel = with_field(_samples(standing(40, 34)), 1, (40, 60, -137))
    steel[20:, 6] += 100
    return [*cases, Case("fields after months", steel, full)]


def holes() -> list[Case]:
    """Navigation that goes on after a hole: still at once, moving first, turned over."""

    def broken(state: array[int]) -> None:
        navigate(state, POS=2**28, VEL=2**24, HEADING_LAST=9000)
        navigator.resume(state)

    over = standing(40, 27) * np.array([1, -1, -1, 1, 1, 1])
    return [
        Case("hole, still", _samples(standing(60, 28), swing(60, 29), standing(40, 30)), broken),
        Case("hole, moving", _samples(swing(60, 31), standing(40, 32)), broken),
        Case("hole, turned over", _samples(over, standing(20, 33)), broken),
    ]


def weights() -> list[Case]:
    """Particles all alike or one against all; M at its least, growing, and at its largest."""
    rest = _samples(standing(12, 16))
    least = LIMITS["LOG_W"][0]
    one = (0, *[least] * (layout.PARTICLES - 1))
    standing_still = partial(navigate, STANCE=1)
    wide = partial(standing_still, P_VV=ONE, **cloud((ONE,) * 3, (0, 1, 63 << 2)))
    fast = {"VEL": 2 << 24, "P_VV": 6711}
    return [
        Case("weights all 1", rest, standing_still),
        Case("weights all 1, apart", rest, wide),
        Case("weights 0 but one", rest, partial(standing_still, LOG_W=one)),
        Case("weights 0 but one, apart", rest, partial(wide, LOG_W=one)),
        Case("M least", rest, partial(standing_still, **fast, INCONSISTENT=0)),
        Case("M growing", rest, partial(wide, VEL=50 << 24, INCONSISTENT=1022)),
        Case(
            "M largest",
            rest,
            partial(standing_still, **fast, INCONSISTENT=1023, SINCE_CONSISTENT=ONE),
        ),
        Case("variance 0", rest, partial(navigate, P_VV=0, P_TT=0, VEL=100 << 24)),
    ]


def corners(count: int) -> list[Case]:
    """States with every word at its least, its largest, 0 or in between; a little of each input."""
    source = numbers(17)

    def word(name: str) -> int:
        low, high = LIMITS[name]
        pick = next(source) >> 8
        between = low + (next(source) << 8) % (high - low + 1)
        return (low, high, max(low, min(high, 0)), between)[pick % 4]

    moving = _samples(standing(3, 18), noise(5, _HIGH, 19), standing(2, 20))
    cases = []
    for i in range(count):
        words = {name: tuple(word(name) for _ in range(WORDS[name])) for name in LIMITS}
        # Rest, so that stance comes at once; the words of the filter are what is tested.
        del words["RING"]
        words["BIAS"] = words["RING_HEAD"] = (0,)
        words["ATT"] = _ATTITUDES[i % len(_ATTITUDES)]
        words |= cloud(words["P_VV"], [next(source) for _ in range(9)])
        cases.append(Case(f"corner {i}", moving, partial(navigate, **words)))
    return cases


def short() -> list[Case]:
    """The whole torture set but for what takes minutes."""
    groups = (
        starts(),
        full_scale(),
        nothing(),
        far(),
        late(),
        holes(),
        weights(),
        windows(),
        corners(40),
    )
    return [case for group in groups for case in group]
