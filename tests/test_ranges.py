"""No word of the core overflows: the torture set, and a search for what the set doesn't hold."""

from __future__ import annotations

import math
import shutil
from array import array
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from solenav import parameters
from solenav.engines import checked, ranges, source
from solenav.sim import torture
from solenav_core import layout, navigator, params

Words = dict[str, tuple[int, ...]]

WORK = layout.offsets(layout.WORK_FIELDS)
RATES = (50.0, 100.0, 200.0, 400.0, 600.0)
PARAMS = {rate: parameters.to_integers(parameters.Settings(), rate) for rate in RATES}
WORD = 2**31 - 1
FACTOR = 2**31 - 2**16 - 1
ONE = torture.ONE

kernels = checked.load()


# The torture set


@pytest.fixture(scope="module")
def recorder() -> ranges.Recorder:
    """What the torture set reaches."""
    out = ranges.Recorder()
    for case in torture.short():
        out.run(case.name, case.counts, PARAMS[200.0], case.prepare)
    for mounted in (False, True):
        for case in torture.fields():
            out.run(case.name, case.counts, torture.steering(PARAMS[200.0], mounted), case.prepare)
    for longest in (False, True):
        for case in torture.stances():
            chosen = torture.detecting(PARAMS[200.0], longest)
            out.run(case.name, case.counts, chosen, case.prepare)
    return out


def test_the_torture_set_stays_within_the_word(recorder: ranges.Recorder) -> None:
    worst = [reached for found in recorder.reached().values() for reached in found]
    assert all(reached.margin >= 0 for reached in worst)
    assert any(reached.margin < 0.1 for reached in worst)  # it is a torture set


def test_the_torture_set_comes_to_every_operation(recorder: ranges.Recorder) -> None:
    missed = {
        (reached.site.kernel, reached.site.text)
        for found in recorder.reached().values()
        for reached in found
        if reached.magnitude is None
    }
    assert missed == set()


@pytest.mark.parametrize("rate", [50.0, 600.0])
def test_the_torture_set_stays_within_the_word_at_other_rates(rate: float) -> None:
    for case in torture.short():
        state = navigator.new_state()
        if case.prepare is not None:
            case.prepare(state)
        work, sample = navigator.new_work(), navigator.new_sample()
        for row in case.counts.tolist():
            sample[:] = array("i", row)
            kernels["tick"](state, PARAMS[rate], work, navigator.new_tables(), sample)


def test_the_torture_set_is_the_same_on_every_machine() -> None:
    cases = torture.short()
    assert len({case.name for case in cases}) == len(cases)
    for case, again in zip(cases, torture.short(), strict=True):
        assert case.name == again.name and np.array_equal(case.counts, again.counts)
    assert torture.noise(1, 4, 1).tolist() == [[-4, -1, -2, 1, -3, -3]]


# The recorder


@pytest.mark.parametrize(
    ("magnitude", "margin"),
    [(None, 31), (0, 31), (1, 31), (2**30, 1), (2**31 - 1, 0), (2**31, 0), (1518500250, 0.4)],
)
def test_margin_is_rounded_down(magnitude: int | None, margin: float) -> None:
    assert ranges.Reached(ranges.Site("k", 1, "a + b"), magnitude).margin == margin


def test_each_operation_has_its_largest_magnitude_and_the_run_that_did_it() -> None:
    recorder = ranges.Recorder()
    recorder.kernels["clamp"](0, 5)
    recorder.credit("small")
    recorder.kernels["clamp"](0, 7)
    recorder.credit("large")
    recorder.kernels["clamp"](0, 6)
    recorder.credit("late")
    negations = recorder.reached()["qmath.clamp"]
    # x < 0 - limit; the one in the body was not come to.
    assert [(r.site.text, r.magnitude, r.run) for r in negations] == [
        ("0 - limit", 7, "large"),
        ("0 - limit", None, ""),
    ]
    assert negations[0].site.line < negations[1].site.line


def test_arithmetic_of_indexes_is_left_out() -> None:
    texts = [r.site.text for found in ranges.Recorder().reached().values() for r in found]
    assert "_S_VEL + i" not in texts
    assert "old + int(mulshift(w[_W_NAV + i], dt, 26))" in texts


@pytest.fixture
def core(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the core that the engines read instead."""
    copy = tmp_path / "core"
    shutil.copytree(source.core_path(), copy)
    monkeypatch.setattr(source, "core_path", lambda: copy)
    return copy


def test_a_planted_overflow_is_caught_and_named(core: Path) -> None:
    path = core / "detector.py"
    text = path.read_text(encoding="utf-8")
    planted = text.replace("x * x + y * y + z * z", "(x * x + y * y + z * z) << 1")
    assert planted != text
    path.write_text(planted, encoding="utf-8")
    line = planted.split("<< 1")[0].count("\n") + 1
    recorder = ranges.Recorder()
    counts = np.full((1, 6), 32767, np.int16)
    with pytest.raises(checked.RangeError, match=f"detector.push line {line}: .*overflow of <<"):
        recorder.run("full scale", counts, PARAMS[200.0])


def test_an_overflow_in_an_augmented_assignment_is_caught(core: Path) -> None:
    path = core / "detector.py"
    text = path.read_text(encoding="utf-8")
    planted = text.replace("    norm = int(isqrt(", "    x *= x * 4\n    norm = int(isqrt(")
    assert planted != text
    path.write_text(planted, encoding="utf-8")
    counts = np.full((1, 6), 32767, np.int16)
    with pytest.raises(checked.RangeError, match=r"detector.push .*overflow of \*"):
        ranges.Recorder().run("full scale", counts, PARAMS[200.0])


# The search: single kernels over the ranges that they are written for


def integers(low: int, high: int) -> SearchStrategy[int]:
    """Integers that are often at an end of their range, or next to it."""
    ends = [v for v in (low, low + 1, -1, 0, 1, high - 1, high) if low <= v <= high]
    return st.one_of(st.sampled_from(ends), st.integers(low, high))


factors = integers(-FACTOR, FACTOR)
words = integers(-WORD, WORD)
CALIBRATION = [n for n in params.NAMES if n.startswith(("ACC_X", "ACC_Y", "ACC_Z", "ACC_B"))]
CALIBRATION += [n for n in params.NAMES if n.startswith(("GYRO_", "MAG_X", "MAG_Y", "MAG_Z"))]
CALIBRATION += ["MAG_BX", "MAG_BY", "MAG_BZ"]
ends = st.lists(st.integers(0, 1), min_size=1, max_size=36)
samples = st.tuples(*[integers(-32768, 32767)] * 6)
rates = st.sampled_from(RATES)
axes = st.integers(0, 2)


def unit(parts: tuple[int, ...]) -> tuple[int, ...]:
    """An attitude of length 1, as `compose` leaves it: no component past ONE."""
    length = math.isqrt(sum(part * part for part in parts)) + 1
    return tuple(part * ONE // length for part in parts)


# Sizes apart, so that rotations next to half a turn come up as well.
components = st.one_of(st.integers(-1000, 1000), st.integers(-ONE, ONE), st.just(ONE))
attitudes = st.tuples(*[components] * 4).filter(any).map(unit)


def field(name: str) -> SearchStrategy[tuple[int, ...]]:
    """All words of a field, within the limits; of long ones the values repeat."""
    low, high = torture.LIMITS[name]
    count = torture.WORDS[name]
    some = st.lists(integers(low, high), min_size=min(count, 7), max_size=min(count, 7))
    return some.map(lambda values: tuple(values[i % len(values)] for i in range(count)))


fields = st.fixed_dictionaries(
    {name: field(name) for name in torture.LIMITS}
    | {"ATT": attitudes, "X": st.lists(st.integers(0, 2**24), min_size=1, max_size=5).map(tuple)}
)


class Bench:
    """Arrays for the kernels, the state as `given` says."""

    def __init__(self, given: Words, rate: float) -> None:
        self.s = navigator.new_state()
        if "X" in given:
            given |= torture.cloud(given["P_VV"], given["X"])
        torture.navigate(self.s, **given)
        self.w = navigator.new_work()
        self.m = navigator.new_sample()
        self.p = PARAMS[rate]
        self.t = navigator.new_tables()

    def work(self, name: str, *values: int) -> None:
        for i, value in enumerate(values):
            self.w[WORK[name] + i] = value

    def calibrate(self, ends: Sequence[int]) -> None:
        """Matrices and biases at their limits: 0 the least, else the largest, in turn."""
        self.p = array("i", self.p)
        for i, name in enumerate(CALIBRATION):
            self.p[params.NAMES.index(name)] = parameters.LIMITS[name][ends[i % len(ends)] > 0]

    def sample(self, counts: tuple[int, ...]) -> None:
        for i, value in enumerate(counts):
            self.m[i] = value


def fits(value: int) -> bool:
    return abs(value) < 2**31 - 1


@given(factors, factors, integers(17, 46))
def test_mulshift(a: int, b: int, n: int) -> None:
    assume(fits(a * b >> n))
    kernels["mulshift"](a, b, n)


@given(factors, factors, integers(17, 38))
def test_mulsat(a: int, b: int, n: int) -> None:
    assume(fits(a * b >> (n + 8)))
    kernels["mulsat"](a, b, n)


@given(words, integers(1, WORD), integers(0, 30))
def test_div(num: int, den: int, n: int) -> None:
    assume(fits((abs(num) << n) // den + 1))
    kernels["div"](num, den, n)


@given(integers(0, WORD))
def test_isqrt(x: int) -> None:
    kernels["isqrt"](x)


@given(words, integers(0, WORD))
def test_clamp(x: int, limit: int) -> None:
    kernels["clamp"](x, limit)


@given(integers(1 - 2**29, 2**29 - 1), integers(1 - 2**29, 2**29 - 1))
def test_azimuth(east: int, north: int) -> None:
    kernels["azimuth"](east, north, navigator.new_tables())


@given(attitudes, attitudes, st.integers(0, 1))
def test_compose(attitude: tuple[int, ...], other: tuple[int, ...], left: int) -> None:
    bench = Bench({"ATT": attitude}, 200.0)
    kernels["compose"](bench.s, *other, left)


@given(attitudes, st.tuples(*[integers(-(2**29), 2**29)] * 3), st.integers(0, 1))
def test_turn(attitude: tuple[int, ...], half: tuple[int, ...], left: int) -> None:
    assume(sum(h * h for h in half) <= 2**58)
    bench = Bench({"ATT": attitude}, 200.0)
    kernels["turn"](bench.s, *half, left)


@given(attitudes)
def test_heading(attitude: tuple[int, ...]) -> None:
    bench = Bench({"ATT": attitude}, 200.0)
    kernels["heading"](bench.s, bench.w, bench.t)


@given(attitudes)
def test_head(attitude: tuple[int, ...]) -> None:
    bench = Bench({"ATT": attitude}, 200.0)
    kernels["head"](bench.s, bench.p, bench.w)


@given(fields, samples, rates)
def test_propagate(given: Words, counts: tuple[int, ...], rate: float) -> None:
    bench = Bench(given, rate)
    bench.sample(counts)
    kernels["condition"](bench.s, bench.p, bench.w, bench.m)
    kernels["propagate"](bench.s, bench.p, bench.w)


@given(fields, samples, integers(0, 2**24), integers(0, 2**22), integers(0, 2**29))
def test_unrest(
    given: Words, counts: tuple[int, ...], of_rate: int, of_accel: int, growth: int
) -> None:
    """At any parameters within their limits."""
    bench = Bench(given, 200.0)
    bench.p = array("i", bench.p)
    for name, value in (("RATE", of_rate), ("ACC", of_accel), ("GROWTH", growth)):
        bench.p[params.NAMES.index(f"UNREST_{name}")] = value
    bench.calibrate((1, 1, 1))
    bench.sample(counts)
    kernels["condition"](bench.s, bench.p, bench.w, bench.m)
    kernels["push"](bench.s, bench.p, bench.w)
    kernels["unrest"](bench.s, bench.p, bench.w)
    low, high = torture.LIMITS["STILLEST"]
    assert low <= bench.s[layout.offsets(layout.STATE_FIELDS)["STILLEST"]] <= high


@given(fields, st.lists(samples, min_size=1, max_size=8), integers(1, 31), ends)
def test_likelihood_ratio(
    given: Words, rows: list[tuple[int, ...]], window: int, at: list[int]
) -> None:
    """Any samples through any calibration, any window, noise as small as the limits let it be."""
    bench = Bench(given, 200.0)
    bench.calibrate(at)
    bench.p = torture.detecting(bench.p, longest=True)
    bench.p[params.NAMES.index("GLRT_WINDOW")] = window
    for counts in rows * 5:
        bench.sample(counts)
        kernels["condition"](bench.s, bench.p, bench.w, bench.m)
        kernels["collect"](bench.s, bench.p, bench.w)
        kernels["likelihood_ratio"](bench.s, bench.p)
    found = bench.s[layout.offsets(layout.STATE_FIELDS)["GLRT"]]
    assert 0 <= found <= torture.LIMITS["GLRT"][1]


signals = st.lists(integers(-1023, 1023), min_size=1, max_size=64).map(
    lambda some: [some[i % len(some)] for i in range(64)]
)


@given(signals, signals)
def test_features_of_any_window(one: list[int], other: list[int]) -> None:
    """Sums of any 64 values of two signals: every feature within what a forest's node can ask."""
    bench = Bench({}, 200.0)
    at = layout.offsets(layout.STATE_FIELDS)["SUMS"]
    for place, y in ((0, one), (5, other)):
        cubes = sum((v**3 + 32) >> 6 for v in y)
        words = [sum(y), sum(v * v for v in y), cubes, max(y), min(y)]
        bench.s[at + place : at + place + 5] = array("i", words)
        kernels["describe"](at + place, at + 60, bench.s)
        mean, deviation, skewness = bench.s[at + place : at + place + 3]
        assert abs(mean) <= 64 * 1023 and 0 <= deviation <= 1023 << 4 and abs(skewness) <= 2047
    products = sum(a * b for a, b in zip(one, other, strict=True))
    assert abs(kernels["relate"](at, at + 5, products, bench.s)) <= 256


@given(fields, samples, rates, ends)
def test_calibrated_samples(
    given: Words, counts: tuple[int, ...], rate: float, at: list[int]
) -> None:
    """Any sample through any calibration within its limits, up to the pose."""
    bench = Bench(given, rate)
    bench.calibrate(at)
    bench.sample(counts)
    kernels["condition"](bench.s, bench.p, bench.w, bench.m)
    kernels["push"](bench.s, bench.p, bench.w)
    kernels["propagate"](bench.s, bench.p, bench.w)
    kernels["detect"](bench.s, bench.p, bench.w)


@given(
    fields,
    st.tuples(*[integers(-32768, 32767)] * 3),
    ends,
    st.lists(integers(0, 1), min_size=5, max_size=5),
)
def test_steer(given: Words, field: tuple[int, ...], at: list[int], limits: list[int]) -> None:
    """Any reading, any reference that a start can take, any parameters within their limits."""
    bench = Bench(given, 200.0)
    bench.calibrate(at)
    names = ("MAG_GAIN", "MAG_BIAS_GAIN", "MAG_NORM_TOL", "MAG_DIP_TOL", "MAG_ERR_MAX")
    for name, end in zip(names, limits, strict=True):
        bench.p[params.NAMES.index(name)] = parameters.LIMITS[name][end]
    bench.sample((0,) * 6 + field)
    kernels["steer"](bench.s, bench.p, bench.w, bench.t, bench.m)


@given(attitudes, st.tuples(*[integers(-(2**19), 2**19)] * 3), ends, st.integers(-32768, 32767))
def test_refer(
    attitude: tuple[int, ...], field: tuple[int, ...], at: list[int], north: int
) -> None:
    bench = Bench({"ATT": attitude}, 200.0)
    bench.calibrate(at)
    bench.p[params.NAMES.index("MAG_ALIGN")] = 1
    bench.p[params.NAMES.index("DECLINATION")] = north
    kernels["magnetic"](bench.s, bench.p, bench.w, *field)
    kernels["refer"](bench.s, bench.p, bench.w, bench.t)


@given(fields, samples, rates)
def test_grow(given: Words, counts: tuple[int, ...], rate: float) -> None:
    bench = Bench(given, rate)
    bench.sample(counts)
    kernels["condition"](bench.s, bench.p, bench.w, bench.m)
    for _ in range(3):
        kernels["grow"](bench.s, bench.p, bench.w)


@given(fields, axes, integers(0, ONE), integers(-(2**25), 2**25), integers(-(2**26), 2**26))
def test_shrink(given: Words, i: int, rho: int, k_p: int, k_t: int) -> None:
    kernels["shrink"](Bench(given, 200.0).s, i, rho, k_p, k_t)


@given(
    fields,
    rates,
    st.tuples(*[integers(-(2**28), 2**28)] * 3),
    st.tuples(*[integers(0, 4095**2)] * 3),
    integers(1024, 2**26),
    st.integers(0, 1),
)
def test_feed_back(
    given: Words,
    rate: float,
    error: tuple[int, ...],
    variance: tuple[int, ...],
    noise: int,
    locked: int,
) -> None:
    bench = Bench(given, rate)
    bench.work("NOISE", noise)
    bench.work("ERR", *(given["VEL"] if locked else error))
    bench.work("VAR", *variance)
    kernels["scales"](bench.s, bench.w)
    kernels["feed_back"](bench.s, bench.p, bench.w, locked)


@settings(max_examples=50)
@given(fields, rates, integers(0, parameters.LIMITS["UNREST_MAX"][1]), st.integers(0, 1))
def test_update(given: Words, rate: float, unrest: int, fresh: int) -> None:
    # The best particle's weight is 1 from the last tick.
    given["LOG_W"] = (0, *given["LOG_W"][1:])
    bench = Bench(given, rate)
    bench.work("UNREST", unrest)
    kernels["update"](bench.s, bench.p, bench.w, bench.t, fresh)


@settings(max_examples=50)
@given(fields, rates, st.lists(samples, max_size=3), st.lists(samples, max_size=2))
def test_tick(
    given: Words, rate: float, first: list[tuple[int, ...]], then: list[tuple[int, ...]]
) -> None:
    """Any state, any samples, a sample of rest between them."""
    given["RING"] = (1255,) * layout.WINDOW_MAX
    bench = Bench(given, rate)
    for counts in (*first, (150, -90, 2040, 12, -7, 3), *then):
        bench.sample(counts)
        kernels["tick"](bench.s, bench.p, bench.w, bench.t, bench.m)


@given(fields, rates)
def test_steps(given: Words, rate: float) -> None:
    bench = Bench(given, rate)
    names = list(parameters.named(bench.p))
    # Both kernels act on one value of their counter only.
    stand, leave = (bench.p[names.index(name)] for name in ("STEP_STANCE", "STEP_SWING"))
    torture.put(bench.s, STANCE_TICKS=stand - 1, SWING_TICKS=leave)
    torture.put(bench.s, TICK_STEP=given["TICK"][0] // 2)
    kernels["stood"](bench.s, bench.p, bench.w, bench.t)
    kernels["swung"](bench.s, bench.p)
    kernels["recentre"](bench.s)


@given(st.integers(0, 2**24), st.lists(samples, min_size=1, max_size=3))
def test_align(seed: int, others: list[tuple[int, ...]]) -> None:
    """A stretch around any sample, long enough for a start, ended by another sample."""
    source_ = torture.numbers(seed)
    rest = [value % 60000 - 30000 for value in islice(source_, 6)]
    bench = Bench({}, 50.0)
    torture.put(bench.s, MODE=0, AL_DONE=0)
    for counts in (*[tuple(rest)] * 12, *others):
        bench.sample(counts)
        kernels["align"](bench.s, bench.p, bench.w, bench.t, bench.m)
