"""Detector parameters for a user's own recordings, and how far they may be trusted.

The objective is the mean logarithm of the horizontal error over the recordings (RMSE against the
truth, else the closure of a closed loop), no error counted as less than `FLOOR_M`: a share of the
distance would differ by a constant. Errors come from the integer core itself. They jump where a
stance is found or missed, so no gradient is asked for: a Sobol sequence over the logarithms of the
thresholds, then steps along one at a time from the best, and of the best few the one that is best
on several seeds of the particles and with its thresholds moved a little. Whatever then makes no
difference goes back to where it started.
"""

from __future__ import annotations

import math
import os
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from multiprocessing import get_context
from typing import Any

import numpy as np

from solenav import mpu9150, parameters
from solenav.capture.contents import Capture
from solenav.comparison import metrics
from solenav.engines.traced import Trace, trace
from solenav.errors import SolenavError
from solenav.evaluation import last_run
from solenav.filters.walk import Track, Walk, of_recording, walk_of
from solenav.parameters import Settings
from solenav.recording import FloatArray, Recording, Truth
from solenav_core import params as core
from solenav_core.tables.defaults import PARAMS

FLOOR_M = 0.02
"""Errors below this count as this: nobody marks a point on the floor more closely."""
SEEDS = (1, 2, 3, 4, 5)
BOUNDS = {
    "accel_band": (0.3, 6.0),  # m/s², half width around g
    "accel_below": (0.3, 6.0),
    "accel_above": (0.3, 8.0),
    "rate_max_dps": (10.0, 250.0),
    "accel_variance_max": (0.1, 100.0),
    "window_s": (0.01, 0.1),
}
"""Where each dimension is searched. `window_s` ends at what the core's window holds."""

_DETECTOR = ("rate_max_dps", "accel_variance_max", "window_s")
# Another field is searched between its start divided and multiplied by this.
_ELSEWHERE = 10.0
_FLAT = 1.1
_MOVED = 1.1
_NEIGHBOURS = 8
_SHORTLIST = 8
_NOTHING = 1.01
_SWEEP, _SWEEP_SEEDS = 17, 3
# Steps of the refinement, as shares of a dimension's range of logarithms.
_FIRST_STEP, _LAST_STEP = 0.12, 0.01
_SHORTEST_S = 10.0
_SLOWEST_SWING = math.radians(100.0)
_MOST_LOST = 1e-3
_HALF_POINTS = 10
_SHRUNK = 0.9


@dataclass(frozen=True)
class Dimension:
    """What the search found along one dimension.

    Within `low` to `high`, the others staying at their best, the mean error stays within 10 % of
    the best. `inert` says that this holds for the whole of `bounds`: then any value is as good.
    """

    name: str
    start: float
    value: float
    low: float
    high: float
    bounds: tuple[float, float]
    at_bound: bool
    inert: bool


@dataclass(frozen=True)
class Judged:
    """One recording's horizontal errors in m, of `kind` "truth" or "closure".

    `start_m` and `tuned_m` are geometric means over `SEEDS`; `held_out_m` comes from the
    parameters that the other recordings alone would have chosen. Distances are sums of step
    lengths.
    """

    name: str
    kind: str
    distance_m: float
    start_distance_m: float
    start_m: float
    tuned_m: float
    held_out_m: float | None


@dataclass(frozen=True)
class Report:
    """Parameters and the evidence for them; ratios are of geometric mean errors.

    `gain` is start over tuned, `seed_spread` largest over least over the particles' seeds, the
    larger of both settings'; `moved` the least and largest error over tuned where every threshold
    is moved by up to 10 %. `held_out` says what was left out in turn ("recordings", the "halves"
    of one with truth, or None), `held_out_gain` is start over what the rest chose, on what was
    left out. `warnings` say in words what speaks against the result.
    """

    settings: Settings
    rate_hz: float
    dimensions: tuple[Dimension, ...]
    recordings: tuple[Judged, ...]
    gain: float
    seed_spread: float
    moved: tuple[float, float]
    held_out: str | None
    held_out_gain: float | None
    evaluations: int
    warnings: tuple[str, ...]

    @property
    def beyond_seeds(self) -> bool:
        """Whether the gain is more than the particles' seed alone makes."""
        return self.gain > self.seed_spread

    @property
    def verdict(self) -> str:
        """ "better" than the start, on walks like these; "unproven" elsewhere; or "no better".

        Better is a gain beyond the seeds' that recordings show which were left out. One recording
        can't show it.
        """
        carries = self.held_out_gain is None or self.held_out_gain > 1.0
        if not (self.beyond_seeds and carries):
            return "no better"
        return "better" if self.held_out == "recordings" else "unproven"

    def config(self) -> dict[str, Any]:
        """The fragment of the firmware's `config.json`: see `config`."""
        return config(self.settings, self.rate_hz)

    def as_dict(self) -> dict[str, Any]:
        """Everything as dictionaries, lists, numbers and None, for JSON."""
        found = asdict(self)
        found["dimensions"] = list(found["dimensions"])
        found["recordings"] = list(found["recordings"])
        judgement = {"beyond_seeds": self.beyond_seeds, "verdict": self.verdict}
        return {**found, **judgement, "config": self.config()}


def from_capture(capture: Capture, *, closed_loop: bool = False) -> Walk:
    """A capture's samples since its last start, to tune on.

    `closed_loop` says that the walk ends where it began, where the sidecar doesn't.

    SolenavError without samples, with more than one in a thousand lost, and as `from_recording`.
    """
    capture.need_samples()
    run, _restarts = last_run(capture)
    ticks = run.samples.tick
    lost = int(ticks[-1] - ticks[0]) + 1 - len(ticks)
    if lost > _MOST_LOST * len(ticks):
        raise SolenavError(
            f"{capture.path} lost {lost} of {len(ticks) + lost} samples",
            "tune on recordings without gaps: where the foot went in one nobody knows",
        )
    walk = walk_of(
        run.sample_counts,
        run.params[-1][1],
        name=capture.path.stem,
        truth=_truth(capture.truth, closed_loop),
    )
    return _usable(walk)


def from_recording(recording: Recording, *, closed_loop: bool = False) -> Walk:
    """A recording in SI units, to tune on.

    SolenavError without a static start, with less than 10 s after it, where the foot never swings,
    and where neither a truth nor a closed loop can judge it.
    """
    walk = of_recording(recording)
    return _usable(replace(walk, truth=_truth(walk.truth, closed_loop)))


def tune(
    walks: Sequence[Walk],
    start: Settings | None = None,
    *,
    symmetric: bool = True,
    also: Sequence[str] = (),
    budget: int = 400,
    jobs: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Report:
    """Detector parameters that do best on all `walks` together (`from_capture`).

    The search begins at `start` (the defaults), which also gives every other parameter; each
    walk's initial heading stays. `symmetric` keeps the band of C1 symmetric around g, else its
    two sides are free. `also` names further fields of `Settings`, positive numbers, to search
    from a tenth to ten times their start. `budget` is how many parameter sets the search tries;
    `planned` says how many the evidence takes on top. `progress` gets the sets done so far.
    The result doesn't depend on `jobs`, the number of processes (None: a core each).

    SolenavError for no walks, a budget below 16, an unknown field, or where numba or scipy is
    missing.
    """
    start = start or Settings()
    if not walks:
        raise SolenavError("no recordings to tune on", "give at least one")
    if budget < 16:
        raise SolenavError(f"a budget of {budget} parameter sets finds nothing", "give at least 16")
    space = _Space.around(start, walks, symmetric, also)
    halves = _halves(walks[0]) if len(walks) == 1 else []
    with _evaluator([*walks, *halves], jobs or os.cpu_count() or 1, progress) as evaluate:
        search = _Search(space, evaluate, len(walks))
        pool = search.explore(budget)
        best, at_seeds, near = search.pull_back(*search.settle())
        start_at_seeds = evaluate([replace(start, seed=seed) for seed in SEEDS])
        dimensions = search.along(best, at_seeds)
        tuned = space.settings(best)
        distances = [(_distance(walk, start), _distance(walk, tuned)) for walk in walks]
        done = evaluate.done
    left_out = _left_out(pool, len(walks))
    judged = tuple(
        Judged(
            name=walk.name,
            kind="closure" if _by_closure(walk) else "truth",
            distance_m=after,
            start_distance_m=before,
            start_m=_geometric_mean(start_at_seeds[:, i]),
            tuned_m=_geometric_mean(at_seeds[:, i]),
            held_out_m=float(left_out[i]) if len(walks) > 1 else None,
        )
        for i, (walk, (before, after)) in enumerate(zip(walks, distances, strict=True))
    )
    mine = slice(0, len(walks))
    objective, before = _objective(at_seeds[:, mine]), _objective(start_at_seeds[:, mine])
    moved = np.exp(_objective(near[:, mine]) - objective.mean())
    held_out_gain = None
    if len(left_out):
        # Row 0 of the pool is the start.
        at_start = pool[0, -len(left_out) :]
        held_out_gain = math.exp(float(np.mean(log_of(at_start) - log_of(left_out))))
    report = Report(
        settings=tuned,
        rate_hz=rate_of(walks),
        dimensions=dimensions,
        recordings=judged,
        gain=math.exp(float(before.mean() - objective.mean())),
        seed_spread=math.exp(float(max(np.ptp(objective), np.ptp(before)))),
        moved=(float(moved.min()), float(moved.max())),
        held_out=None if not len(left_out) else "recordings" if len(walks) > 1 else "halves",
        held_out_gain=held_out_gain,
        evaluations=done,
        warnings=(),
    )
    return replace(report, warnings=tuple(_warnings(report, walks)))


def planned(budget: int, dimensions: int = 4) -> int:
    """About how many parameter sets `tune` tries in all."""
    closely = (_SHORTLIST + dimensions) * (len(SEEDS) + _NEIGHBOURS)
    return budget + closely + len(SEEDS) + dimensions * _SWEEP * _SWEEP_SEEDS


def config(settings: Settings, rate_hz: float) -> dict[str, Any]:
    """The fragment of the firmware's `config.json` that makes it run on `settings`.

    The detector's parameters, and whatever else isn't the firmware's default at `rate_hz`.
    """
    wanted = parameters.named(parameters.to_integers(settings, rate_hz))
    default = parameters.named(PARAMS)
    detector = ("ACC_MIN", "ACC_MAX", "RATE_MAX", "VAR_MAX", "WINDOW")
    kept = {n: v for n, v in wanted.items() if n in detector or v != default[n]}
    return {"params": kept}


def configured(params: array[int], fragment: Mapping[str, Any]) -> array[int]:
    """The core's parameters with those of a `config.json` laid over them, as the firmware does.

    SolenavError for a parameter that isn't there or is out of range.
    """
    values = parameters.named(params)
    chosen = fragment.get("params", {})
    unknown = sorted(set(chosen) - set(values))
    if unknown:
        raise SolenavError(
            f"there is no parameter {unknown[0]}", "shared/solenav_core/params.py lists them"
        )
    values |= chosen
    return parameters.checked([values[name] for name in core.NAMES])


def _truth(truth: Truth | None, closed_loop: bool) -> Truth | None:
    """The truth, or that of a closed loop where the user says that it is one."""
    if not closed_loop:
        return truth
    if truth is None:
        return Truth(np.empty(0), np.empty((0, 3)), closed_loop=True)
    return replace(truth, closed_loop=True)


def _by_closure(walk: Walk) -> bool:
    return walk.truth is not None and not len(walk.truth.time_s)


def _usable(walk: Walk) -> Walk:
    """The walk. SolenavError where it is too short or nothing can judge it."""
    truth = walk.truth
    if truth is None or not (len(truth.time_s) or truth.closed_loop):
        raise SolenavError(
            f"{walk.name}: neither a truth nor a closed loop, so nothing tells good from bad",
            'if the walk ends where it began, say --closed-loop, or put "truth": '
            '{"closed_loop": true} into the JSON file beside the capture; a truth is a table '
            "NAME.truth.csv with the columns time_s, east_m, north_m, up_m",
        )
    seconds = (len(walk.counts) - walk.start.row - 1) * walk.dt
    if seconds < _SHORTEST_S:
        raise SolenavError(
            f"{walk.name} is too short: {seconds:.1f} s after the static start",
            f"record a walk of at least {_SHORTEST_S:g} s, better a minute",
        )
    if float(np.linalg.norm(walk.gyro, axis=1).max()) < _SLOWEST_SWING:
        raise SolenavError(
            f"{walk.name}: the foot never swings", "record a walk, with the sensor on the foot"
        )
    return walk


def _halves(walk: Walk) -> list[Walk]:
    """The walk judged by either half of its truth, where that has enough points."""
    truth = walk.truth
    assert truth is not None
    after = truth.time_s > walk.time_s[walk.start.row + 1]
    rows = np.flatnonzero(after & np.isfinite(truth.position_enu[:, :2]).all(axis=1))
    if len(rows) < 2 * _HALF_POINTS:
        return []
    return [
        replace(
            walk,
            truth=Truth(truth.time_s[half], truth.position_enu[half], frame=truth.frame),
        )
        for half in np.array_split(rows, 2)
    ]


def params_of(walk: Walk, settings: Settings) -> array[int]:
    """The core's parameters for a walk, at the walk's own initial heading."""
    values = parameters.to_integers(settings, walk.rate_hz)
    for name in ("YAW_W", "YAW_Z"):
        at = core.NAMES.index(name)
        values[at] = walk.params[at]
    return values


def run(walk: Walk, settings: Settings) -> Trace:
    """The core over a walk, at the walk's own initial heading."""
    return trace(walk.counts, params_of(walk, settings))


def error_m(walk: Walk, found: Trace) -> float:
    """The horizontal error of what the core found on a walk, as `metrics.score` has it, in m."""
    own = replace(walk, start=found.start, stance=found.stance, clean=found.stance)
    error = metrics.score(own, Track(found.position, found.velocity), with_evo=False).error_m
    assert error is not None
    return error


def _errors(walks: Sequence[Walk], settings: Settings) -> list[float]:
    """The error on each walk; walks of the same samples, one after another, are run once."""
    errors = []
    before: Walk | None = None
    for walk in walks:
        if before is None or walk.counts is not before.counts:
            found = run(walk, settings)
        errors.append(error_m(walk, found))
        before = walk
    return errors


def _distance(walk: Walk, settings: Settings) -> float:
    """What the core makes of the way, in m."""
    return float(run(walk, settings).distance[-1])


def log_of(errors: FloatArray) -> FloatArray:
    """Logarithms of errors in m, none counted as less than `FLOOR_M`."""
    return np.log(np.maximum(errors, FLOOR_M))


def _objective(errors: FloatArray) -> FloatArray:
    """Mean logarithm of errors (k, recordings), (k,)."""
    return np.asarray(log_of(errors).mean(axis=1))


def _geometric_mean(errors: FloatArray) -> float:
    return float(np.exp(np.log(np.maximum(errors, 1e-6)).mean()))


def rate_of(walks: Sequence[Walk]) -> float:
    """The rate that the firmware is to run at: the recordings', where they agree on one."""
    rates = np.array([walk.rate_hz for walk in walks])
    reference = parameters.REFERENCE_RATE_HZ
    middle = float(np.median(rates))
    if (np.abs(rates / middle - 1) > 0.01).any() or abs(middle / reference - 1) <= 0.01:
        return reference
    return middle


_walks: list[Walk] = []


def _adopt(walks: list[Walk]) -> None:
    """In a process of the pool: the walks that its tasks are about."""
    _walks[:] = walks


def _judge(settings: Settings) -> list[float]:
    return _errors(_walks, settings)


class _Evaluator:
    """Errors (k, walks) of k settings; counts the settings."""

    def __init__(
        self, walks: list[Walk], pool: Executor | None, progress: Callable[[int], None]
    ) -> None:
        self._walks = walks
        self._pool = pool
        self._progress = progress
        self.done = 0

    def __call__(self, settings: Sequence[Settings]) -> FloatArray:
        rows = []
        for row in self._rows(settings):
            rows.append(row)
            self.done += 1
            self._progress(self.done)
        return np.array(rows).reshape(len(settings), len(self._walks))

    def _rows(self, settings: Sequence[Settings]) -> Iterator[list[float]]:
        if self._pool is None:
            return (_errors(self._walks, s) for s in settings)
        return self._pool.map(_judge, settings)


@contextmanager
def _evaluator(
    walks: list[Walk], jobs: int, progress: Callable[[int], None]
) -> Iterator[_Evaluator]:
    if jobs == 1:
        yield _Evaluator(walks, None, progress)
        return
    # Compiled once here, so that the processes find it done.
    run(walks[0], Settings())
    context = get_context("spawn")
    with ProcessPoolExecutor(jobs, context, initializer=_adopt, initargs=(walks,)) as pool:
        try:
            yield _Evaluator(walks, pool, progress)
        except BrokenProcessPool:
            raise SolenavError(
                "a process of the search died", "give it less to do at once: --jobs 1"
            ) from None


@dataclass(frozen=True)
class _Space:
    """Points (d,) are logarithms of the dimensions' values, between `low` and `high`."""

    start: Settings
    names: tuple[str, ...]
    low: FloatArray
    high: FloatArray

    @classmethod
    def around(
        cls, start: Settings, walks: Sequence[Walk], symmetric: bool, also: Sequence[str]
    ) -> _Space:
        numbers = {f.name: getattr(start, f.name) for f in fields(start)}
        for name in also:
            value = numbers.get(name)
            if not isinstance(value, float) or not value > 0:
                raise SolenavError(
                    f"{name!r} is no setting that can be searched",
                    "name a field of solenav.parameters.Settings that is a positive number",
                )
        band = ("accel_band",) if symmetric else ("accel_below", "accel_above")
        taken = {"accel_min", "accel_max", *_DETECTOR}
        names = (*band, *_DETECTOR, *(name for name in also if name not in taken))
        bounds = [
            BOUNDS.get(name) or (numbers[name] / _ELSEWHERE, numbers[name] * _ELSEWHERE)
            for name in names
        ]
        at = names.index("window_s")
        # A hair less, so that rounding stays below the core's longest window.
        longest = parameters.LIMITS["WINDOW"][1] / max(walk.rate_hz for walk in walks)
        bounds[at] = (bounds[at][0], min(bounds[at][1], longest))
        low, high = np.log(np.array(bounds, np.float64)).T
        return cls(start, names, low, high)

    def settings(self, point: FloatArray) -> Settings:
        changed: dict[str, float] = {}
        for name, value in zip(self.names, np.exp(point).tolist(), strict=True):
            if name in ("accel_band", "accel_below"):
                changed["accel_min"] = mpu9150.STANDARD_GRAVITY - value
            if name in ("accel_band", "accel_above"):
                changed["accel_max"] = mpu9150.STANDARD_GRAVITY + value
            if not name.startswith("accel_") or name == "accel_variance_max":
                changed[name] = value
        return replace(self.start, **changed)  # type: ignore[arg-type]

    def value_at_start(self, name: str) -> float:
        """The start's value; of a symmetric band the wider side."""
        s = self.start
        below = mpu9150.STANDARD_GRAVITY - s.accel_min
        above = s.accel_max - mpu9150.STANDARD_GRAVITY
        sides = {"accel_below": below, "accel_above": above, "accel_band": max(below, above)}
        return float(sides[name] if name in sides else getattr(s, name))

    def inside(self, points: FloatArray) -> FloatArray:
        return np.clip(points, self.low, self.high)

    @property
    def start_point(self) -> FloatArray:
        values = [max(self.value_at_start(name), 1e-6) for name in self.names]
        return self.inside(np.log(np.array(values)))


# A point, its errors (seeds, walks), and those of its neighbours (neighbours, walks).
_Closely = tuple[FloatArray, FloatArray, FloatArray]


class _Search:
    """The search's candidates so far: points and errors on seed 1."""

    def __init__(self, space: _Space, evaluate: _Evaluator, walks: int) -> None:
        self._space = space
        self._evaluate = evaluate
        self._count = walks
        self._points = np.empty((0, len(space.names)))
        self._values = np.empty(0)

    def _add(self, points: FloatArray) -> FloatArray:
        errors = self._evaluate([self._space.settings(point) for point in points])
        self._points = np.vstack([self._points, points])
        self._values = np.append(self._values, _objective(errors[:, : self._count]))
        return errors

    def explore(self, budget: int) -> FloatArray:
        """Spend the budget; the errors (k, walks) of what no recording had a say in, start first.

        The start is judged as it is; nearest to it within the bounds is where points begin.
        """
        space = self._space
        start = self._evaluate([space.start])
        spread = 2 ** int(math.log2(max(8, 0.65 * budget)))
        cube = _sobol(len(space.names), spread)
        points = space.low + cube * (space.high - space.low)
        errors = self._add(np.vstack([space.start_point, points]))
        self._refine(budget - 2 - spread)
        return np.vstack([start, errors])

    def _refine(self, left: int) -> None:
        """From the best, steps along each dimension, halved where none helps."""
        space = self._space
        step = _FIRST_STEP
        while step >= _LAST_STEP:
            best = int(self._values.argmin())
            offsets = np.vstack([np.eye(len(space.names)), -np.eye(len(space.names))])
            around = self._points[best] + step * offsets * (space.high - space.low)
            if len(around) > left:
                return
            left -= len(around)
            before = self._values[best]
            self._add(space.inside(around))
            if self._values.min() >= before:
                step /= 2

    def settle(self) -> _Closely:
        """Of the best few the one that is best on all seeds and with thresholds moved."""
        order = np.argsort(self._values, kind="stable")
        few = [self._closely(point) for point in self._points[order[:_SHORTLIST]]]
        return min(few, key=self._mean)

    def pull_back(self, *best: FloatArray) -> _Closely:
        """The same with every dimension back at the start that this costs less than 1 %.

        What doesn't matter isn't changed, and fewer changes are fitted to the recordings.
        """
        space = self._space
        found: _Closely = (best[0], best[1], best[2])
        limit = self._mean(found) + math.log(_NOTHING)
        for i in range(len(space.names)):
            point = found[0].copy()
            point[i] = space.start_point[i]
            back = self._closely(point)
            if self._mean(back) <= limit:
                found = back
        return found

    def _closely(self, point: FloatArray) -> _Closely:
        space = self._space
        chosen = space.settings(point)
        at_seeds = self._evaluate([replace(chosen, seed=seed) for seed in SEEDS])
        cube = 2 * _sobol(len(space.names), _NEIGHBOURS) - 1
        moved = space.inside(point + cube * math.log(_MOVED))
        return point, at_seeds, self._evaluate([space.settings(other) for other in moved])

    def _mean(self, found: _Closely) -> float:
        return float(_objective(np.vstack(found[1:])[:, : self._count]).mean())

    def along(self, best: FloatArray, at_seeds: FloatArray) -> tuple[Dimension, ...]:
        """Each dimension swept with the others at their best, on some of the seeds."""
        space = self._space
        few = SEEDS[:_SWEEP_SEEDS]
        own = at_seeds[: len(few), : self._count]
        limit = float(_objective(own).mean()) + math.log(_FLAT)
        dimensions = []
        for i, name in enumerate(space.names):
            grid = np.linspace(space.low[i], space.high[i], _SWEEP)
            points = np.tile(best, (_SWEEP, 1))
            points[:, i] = grid
            swept = [replace(space.settings(p), seed=seed) for p in points for seed in few]
            errors = _objective(self._evaluate(swept)[:, : self._count])
            flat = errors.reshape(_SWEEP, len(few)).mean(axis=1) <= limit
            below, above = grid < best[i], grid > best[i]
            low = _reach(best[i], grid[below][::-1], flat[below][::-1])
            high = _reach(best[i], grid[above], flat[above])
            bounds = (math.exp(space.low[i]), math.exp(space.high[i]))
            edge = 0.02 * (space.high[i] - space.low[i])
            inert = bool(flat.all())
            at_edge = min(best[i] - space.low[i], space.high[i] - best[i]) < edge
            # Back at the start is no end of a search.
            at_edge = bool(at_edge and best[i] != space.start_point[i])
            value = math.exp(best[i])
            dimensions.append(
                Dimension(
                    name=name,
                    start=space.value_at_start(name),
                    value=value,
                    low=math.exp(low),
                    high=math.exp(high),
                    bounds=bounds,
                    at_bound=at_edge and not inert,
                    inert=inert,
                )
            )
        return tuple(dimensions)


def _reach(best: float, grid: FloatArray, flat: FloatArray) -> float:
    """How far from `best` outwards along `grid` it stays flat."""
    reached = best
    for at, good in zip(grid.tolist(), flat.tolist(), strict=True):
        if not good:
            break
        reached = at
    return reached


def _sobol(dimensions: int, count: int) -> FloatArray:
    """`count` (a power of two) points of a scrambled Sobol sequence, (count, dimensions) in 0 to 1.

    The same each time.
    """
    try:
        from scipy.stats import qmc
    except ImportError:
        raise SolenavError("tuning needs scipy", "pip install 'solenav[import]'") from None
    return np.asarray(qmc.Sobol(dimensions, seed=1).random(count), np.float64)


def _left_out(pool: FloatArray, walks: int) -> FloatArray:
    """Errors of what was left out, by the candidate of `pool` that is best on the rest.

    `pool` (k, walks, or 1 and two halves). Empty where there is nothing to leave out.
    """
    units = pool if walks > 1 else pool[:, 1:]
    if units.shape[1] < 2:
        return np.empty(0)
    logs = log_of(units)
    total = logs.sum(axis=1)
    return np.array([units[int((total - logs[:, i]).argmin()), i] for i in range(units.shape[1])])


def _warnings(report: Report, walks: Sequence[Walk]) -> Iterator[str]:
    """What speaks against the result, or limits it."""
    if len(walks) == 1:
        yield (
            "one recording proves little: these parameters fit this walk, and nothing shows that "
            "they fit another; tune on several, of different days, paces and people"
        )
    if any(_by_closure(walk) for walk in walks):
        yield (
            "closure sees neither a wrong scale nor errors that cancel on the way back: a walk "
            "measured too short closes as well, and so does one that drifts alike on both legs"
        )
    if not report.beyond_seeds:
        yield (
            f"the gain ({report.gain:.2f} times) is within what another seed of the particles "
            f"makes ({report.seed_spread:.2f} times): keep the parameters you have"
        )
    elif report.held_out_gain is not None and report.held_out_gain <= 1.0:
        what = "recording" if report.held_out == "recordings" else "half of the walk"
        yield (
            f"chosen without the {what} that judges them, parameters are no better than those you "
            "have: what was gained is fitted to these walks"
        )
    if report.moved[1] > 1.5:
        yield (
            f"with thresholds moved by 10 % the error becomes up to {report.moved[1]:.1f} times "
            "as large: the result stands on an edge"
        )
    for dimension in report.dimensions:
        if dimension.at_bound:
            yield (
                f"{dimension.name} ended at the bound of its search "
                f"({dimension.value:.3g} of {dimension.bounds[0]:.3g} to "
                f"{dimension.bounds[1]:.3g}): the detector may be the wrong remedy"
            )
    for judged in report.recordings:
        if judged.distance_m < _SHRUNK * judged.start_distance_m:
            yield (
                f"{judged.name}: the distance fell from {judged.start_distance_m:.1f} to "
                f"{judged.distance_m:.1f} m: check that it wasn't bought by calling steps stance"
            )
        if judged.tuned_m > metrics.LOST_SHARE * judged.distance_m:
            yield (f"{judged.name} stays lost: {judged.tuned_m:.2f} m of {judged.distance_m:.1f} m")
    rates = sorted({round(walk.rate_hz) for walk in walks})
    if rates[-1] > 1.01 * rates[0]:
        yield (
            f"the recordings' rates differ ({rates[0]} to {rates[-1]} Hz): the configuration is "
            f"for {report.rate_hz:g} Hz"
        )
