"""A threshold of the GLRT detector for each motion, from recordings.

Zhang, Xiu, Yang, Yang 2018 (J. BUAA 44(3)): within a gait cycle the detector's statistic T has its
lowest minimum where the foot stands, and a second lowest one in swing. A threshold between the two
takes the first for stance and not the second; so that interval is swept for each motion, and what
gives the best position stays. Which motion it is, the core says itself.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from solenav import spreading, tuning
from solenav.engines.traced import Trace
from solenav.errors import SolenavError
from solenav.filters.walk import BoolArray, Walk
from solenav.modes.labels import MODES
from solenav.parameters import Settings
from solenav.recording import FloatArray

FIELDS = dict(
    zip(MODES, ("glrt_still", "glrt_walk", "glrt_run", "glrt_up", "glrt_down"), strict=True)
)
"""Of `Settings`, each mode's threshold."""
LARGEST = 2.0**20
"""T is limited to this: with it as a threshold only what is limited is no stance."""
_ADAPTIVE = 2
_SWEEP = 9
_SEEDS = (1, 2)
_ENOUGH_S = 2.0
_FEWEST = 5
# Minima that are less than this factor below what is between them are one.
_PROMINENCE = 4.0
_CYCLE_S = (0.5, 2.2)


@dataclass(frozen=True)
class Threshold:
    """One mode's threshold, T without unit.

    `lowest` and `second` are medians over `strides` of the two lowest minima of T in a gait cycle;
    between them `swept` values were tried on the `recordings` that have this motion for 2 s and
    more. `errors_m` (swept) are their geometric mean errors. `value` is the best, or the start
    where nothing could be swept; `why` says then why.
    """

    mode: str
    start: float
    value: float
    strides: int
    lowest: float | None
    second: float | None
    recordings: tuple[str, ...]
    swept: tuple[float, ...] = ()
    errors_m: tuple[float, ...] = ()
    why: str = ""


@dataclass(frozen=True)
class Judged:
    """A recording's horizontal error in m with the start's detector, one GLRT threshold, and each
    mode's; geometric means over seeds of the particles."""

    name: str
    distance_m: float
    start_m: float
    fixed_m: float
    adaptive_m: float


@dataclass(frozen=True)
class Report:
    """A threshold for each mode, and what they do: `settings` choose the adaptive detector.

    `gain_over_start` and `gain_over_fixed` are ratios of geometric mean errors, over the start's
    detector and over the GLRT with the start's one threshold; above 1 is better.
    """

    settings: Settings
    rate_hz: float
    thresholds: tuple[Threshold, ...]
    recordings: tuple[Judged, ...]
    gain_over_start: float
    gain_over_fixed: float

    def config(self) -> dict[str, Any]:
        """The fragment of the firmware's `config.json`: see `tuning.config`."""
        return tuning.config(self.settings, self.rate_hz)

    def as_dict(self) -> dict[str, Any]:
        """Everything as dictionaries, lists, numbers and None, for JSON."""
        found = asdict(self)
        found["thresholds"] = list(found["thresholds"])
        found["recordings"] = list(found["recordings"])
        return {**found, "config": self.config()}


def tune(
    walks: Sequence[Walk],
    start: Settings | None = None,
    *,
    jobs: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Report:
    """Thresholds by mode that do best on `walks` (`tuning.from_capture`), one mode after another.

    Every other parameter stays at `start`. A mode that no walk has keeps its threshold.
    `progress` gets the modes done. SolenavError for no walks, and where numba or scipy is missing.
    """
    if not walks:
        raise SolenavError("no recordings to tune on", "give at least one")
    start = start or Settings()
    chosen = replace(start, detector=_ADAPTIVE)
    watched = {walk.name: tuning.run(walk, _wide(start)) for walk in walks}
    found = []
    # What there is most of comes first: the others are judged with it in place.
    for done, mode in enumerate(sorted(MODES, key=lambda m: -_seconds(walks, watched, m)), 1):
        one = _sweep(mode, walks, watched, chosen, jobs or os.cpu_count() or 1)
        chosen = _with(chosen, mode, one.value)
        found.append(one)
        progress(done)
    fixed = replace(start, detector=1)
    logs = [tuning.log_of(_errors(walks, s, _SEEDS)) for s in (start, fixed, chosen)]
    before, one_for_all, after = (float(log.mean()) for log in logs)
    judged = tuple(
        Judged(
            walk.name,
            walk.distance_m,
            *(float(np.exp(log[:, i].mean())) for log in logs),
        )
        for i, walk in enumerate(walks)
    )
    return Report(
        settings=chosen,
        rate_hz=tuning.rate_of(walks),
        thresholds=tuple(sorted(found, key=lambda one: MODES.index(one.mode))),
        recordings=judged,
        gain_over_start=math.exp(before - after),
        gain_over_fixed=math.exp(one_for_all - after),
    )


def minima(run: Trace, chosen: BoolArray, rate_hz: float) -> FloatArray:
    """The lowest and second lowest minimum of T of each gait cycle, (k, 2).

    `run` on the GLRT detector. A cycle reaches from one stance's minimum to the next; the second
    lowest is the least in between, `LARGEST` where T is above that all through the swing. In
    stretches of `chosen` (n,) of 2 s and more; the cycle's
    length there is where T resembles itself most, from 0.5 to 2.2 s.
    """
    try:
        from scipy.signal import find_peaks
    except ImportError:
        raise SolenavError("tuning needs scipy", "pip install 'solenav[import]'") from None
    logs = np.log(np.clip(run.glrt, 1.0, LARGEST))
    found = []
    for begin, end in _stretches(chosen, round(_ENOUGH_S * rate_hz)):
        part = -logs[begin:end]
        prominence = math.log(_PROMINENCE)
        lows, _ = find_peaks(part, prominence=prominence)
        apart = 0.7 * _period(part, rate_hz)
        stances, _ = find_peaks(part, prominence=prominence, distance=apart)
        for one, other in pairwise(stances.tolist()):
            between = lows[(lows > one) & (lows < other)]
            second = -part[between].max() if len(between) else math.log(LARGEST)
            found.append(np.exp([-part[one], second]))
    return np.array(found).reshape(-1, 2)


def _stretches(chosen: BoolArray, shortest: int) -> list[tuple[int, int]]:
    """Rows (begin, end) of the stretches of `chosen` with `shortest` and more."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen, [0]]).astype(np.int8)))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(begin, end) for begin, end in pairs if end - begin >= shortest]


def _period(signal: FloatArray, rate_hz: float) -> int:
    """The lag, in samples, at which a signal of 2 s or more resembles itself most."""
    centred = signal - signal.mean()
    first, last = (round(s * rate_hz) for s in _CYCLE_S)
    last = min(last, len(signal) // 2)
    likeness = [
        float(centred[lag:] @ centred[:-lag]) / (len(centred) - lag)
        for lag in range(first, last + 1)
    ]
    return first + int(np.argmax(likeness))


def _wide(start: Settings) -> Settings:
    """The GLRT as a witness: wide open, so that no walk is lost."""
    return replace(start, detector=1, glrt_max=LARGEST)


def _with(settings: Settings, mode: str, value: float) -> Settings:
    changed: dict[str, Any] = {FIELDS[mode]: value}
    return replace(settings, **changed)


def _moves(run: Trace, mode: str) -> BoolArray:
    """(n,) where the core holds that motion."""
    found: BoolArray = run.motion == 1 + MODES.index(mode)
    return found


def _seconds(walks: Sequence[Walk], watched: Mapping[str, Trace], mode: str) -> float:
    return sum(float(_moves(watched[walk.name], mode).sum()) * walk.dt for walk in walks)


def _sweep(
    mode: str,
    walks: Sequence[Walk],
    watched: Mapping[str, Trace],
    settings: Settings,
    jobs: int,
) -> Threshold:
    """The best threshold of a mode, the others' staying as they are."""
    start = float(getattr(settings, FIELDS[mode]))
    mine = [w for w in walks if _seconds([w], watched, mode) >= _ENOUGH_S]
    names = tuple(walk.name for walk in mine)
    lows = np.concatenate(
        [np.empty((0, 2))]
        + [minima(watched[w.name], _moves(watched[w.name], mode), w.rate_hz) for w in mine]
    )
    why = ""
    if mode == "still":
        why = "standing has no gait cycle"
    elif not mine:
        why = "no recording has it"
    elif len(lows) < _FEWEST:
        why = f"{len(lows)} gait cycles are too few"
    if why:
        return Threshold(mode, start, start, len(lows), None, None, names, why=why)
    lowest, second = np.median(lows, axis=0).tolist()
    swept = np.geomspace(lowest, second, _SWEEP)
    tried = [_with(settings, mode, value) for value in swept.tolist()]
    errors = _spread(mine, tried, jobs)
    return Threshold(
        mode,
        start,
        float(swept[int(errors.argmin())]),
        len(lows),
        lowest,
        second,
        names,
        tuple(swept.tolist()),
        tuple(np.exp(errors).tolist()),
    )


def _spread(walks: Sequence[Walk], tried: Sequence[Settings], jobs: int) -> FloatArray:
    """Mean logarithms (k,) of the errors of k settings."""
    work = [(walks, settings, _SEEDS) for settings in tried]
    if jobs == 1:
        found = dict(enumerate(_errors(*one) for one in work))
    else:
        found = spreading.in_processes(_errors, work, jobs, lambda done: None)
    return np.array([tuning.log_of(found[i]).mean() for i in range(len(work))])


def _errors(walks: Sequence[Walk], settings: Settings, seeds: Sequence[int]) -> FloatArray:
    """Errors in m (seeds, walks)."""
    return np.array(
        [
            [tuning.error_m(w, tuning.run(w, replace(settings, seed=seed))) for w in walks]
            for seed in seeds
        ]
    )
