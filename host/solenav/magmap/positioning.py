"""Where a phone walks on a magnetic map: three particle filters over the same steps and field.

Each particle is a place, a turn that lays the phone's yaw into the map's axes, and a factor on the
step length. A step moves it; the mean field over the step, turned by the particle's own heading,
is compared with the map's at its place, component by component. What differs is how particles are
weighed and renewed (docs/magmap.md gives the sources):

- `plain`: weight by the field alone; below 2N/3 effective particles systematic resampling.
- `firefly`: weight is a sum, of the field and of the distance to the dead reckoned place; instead
  of copying, light particles fly towards brighter ones; too narrow a cloud is thrown open.
- `centroid`: weight as `plain`; only particles nearest to and farthest from the cloud's centre are
  resampled; where the field contradicts all particles for some steps, it starts anew.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator

from solenav.errors import SolenavError
from solenav.magmap.grid import MagneticMap
from solenav.pdr import reckoning, steps
from solenav.pdr.attitude import level
from solenav.pdr.length import GENERIC, LengthModel
from solenav.pdr.steps import Steps
from solenav.pdr.track import StepTrack
from solenav.recording import FloatArray, Recording

X, Y, TURN, SCALE = range(4)
START_M = 1.0
"""A start may be so far off the map, as its edge is drawn by cells."""


@dataclass(frozen=True)
class Tuning:
    """What the filters go by. m, rad, µT; see docs/magmap.md for what each one does.

    `field_ut` is the deviation of a step's field from a sure map (phone, height, people);
    `clip` caps what one component can say, in squared deviations, and `off_map` is what a place
    off the map says. Then the spread at the start and per step. From `rho_start` on come the
    firefly filter's, from `near` on the centroid filter's. `brightest`: all fly to the one
    heaviest particle. `by_cloud`: near and far are shares of the cloud's radius, not of the step.
    """

    particles: int = 500
    field_ut: float = 10.0
    clip: float = 9.0
    off_map: float = 40.0
    temper: float = 0.5
    start_m: float = 0.5
    start_turn: float = math.radians(20)
    start_scale: float = 0.12
    step_m: float = 0.25
    step_turn: float = math.radians(3.0)
    step_scale: float = 0.01
    resample: float = 2 / 3
    rho_start: float = 0.9
    rho_end: float = 0.0
    turns: float = 0.5
    pdr_m: float = 2.0
    calm_ut: float = 100.0
    attraction: float = 1.0
    brightest: bool = False
    jitter_m: float = 1.5
    jitter_turn: float = math.radians(8.0)
    narrow_m2: float = 0.01
    near: float = 0.2
    far: float = 0.8
    by_cloud: bool = False
    lost: float = 9.0
    lost_steps: int = 5
    anew_m: float = 2.0


TUNING = Tuning()


@dataclass(frozen=True)
class Located:
    """A walk on the map.

    `track` are the steps, from place to place of the filter's mean, with the cloud's covariance
    differences left out: `spread` (n + 1,) m is the cloud's deviation at each place instead.
    `renewed` counts resamplings, `anew` fresh starts; `seconds_per_step` is the filter's
    own time on the processor.
    """

    filter: str
    track: StepTrack
    spread: FloatArray
    renewed: int
    anew: int
    seconds_per_step: float

    def at(self, time_s: FloatArray) -> FloatArray:
        """Places (n, 2) at any times, between steps by interpolation."""
        where = self.track.position
        return np.column_stack(
            [np.interp(time_s, self.track.position_s, where[:, k]) for k in (0, 1)]
        )


@dataclass(frozen=True)
class _Step:
    """One step as a filter gets it: length m, its yaw and turn rad, field (3,) and change µT."""

    length: float
    yaw: float
    turned: float
    field: FloatArray
    disturbed: float


@dataclass
class _Cloud:
    """Particles (n, 4), weights (n,), the mean (2,), and what a filter remembers."""

    particles: FloatArray
    weights: FloatArray
    place: FloatArray
    turns: float = 0.0
    lost: int = 0
    renewed: int = 0
    anew: int = 0


_Weigh = Callable[[_Cloud, _Step, FloatArray, FloatArray, Tuning], FloatArray]
_Renew = Callable[[_Cloud, _Step, Generator, Tuning], None]


@dataclass(frozen=True)
class Paces:
    """A walk as the filters get it: what doesn't depend on the map, the start, or luck.

    `yaw` (n,) rad and `field` (n, 3) µT are means over each of the `found` steps, in axes level
    and turning with the phone; `first_yaw` and `first_field` (3,) those of the first second.
    `reckoned` is the walk without a map. `notes` are the trace's.
    """

    found: Steps
    lengths: FloatArray
    yaw: FloatArray
    field: FloatArray
    first_yaw: float
    first_field: FloatArray
    reckoned: StepTrack
    notes: Mapping[str, Any]


def paces(trace: Recording, *, model: LengthModel = GENERIC, begin_s: float = 0.0) -> Paces:
    """The steps of `trace` from `begin_s` on, with the field over each.

    SolenavError for a trace without magnetometer, with holes in it, or without steps.
    """
    seen = level(trace)
    field = reckoning.need_field(trace.name, seen)
    found = steps.detect(seen.time_s, seen.vertical)
    found = reckoning.between(found, begin_s, math.inf)
    if not len(found):
        raise SolenavError(
            f"{trace.name}: no steps found", "is it a walk with a phone in the hand?"
        )
    lengths = model.of(found)
    soon = (seen.time_s >= begin_s) & (seen.time_s <= begin_s + 1.0)
    return Paces(
        found,
        lengths,
        reckoning.over_steps(found, seen.time_s, seen.yaw),
        reckoning.over_steps(found, seen.time_s, field),
        float(seen.yaw[soon].mean()),
        field[soon].mean(axis=0),
        replace(
            reckoning.track_of(trace.name, found, seen.time_s, seen.yaw, lengths), start_s=begin_s
        ),
        trace.notes,
    )


def locate(
    walk: Recording | Paces,
    floor: MagneticMap,
    start: tuple[float, float],
    *,
    filter: str = "firefly",
    start_heading: float | None = None,
    seed: int = 1,
    tuning: Tuning = TUNING,
    begin_s: float = 0.0,
) -> Located:
    """The walk from `start` (m, the map's axes) at `begin_s` on; `Paces` begin where they do.

    `start_heading` is where the phone points then, rad counterclockwise from the map's x; None
    takes it from the field, which the map must know at the start.

    SolenavError for an unknown filter; a map of another floor; a start off the map; and whatever
    `paces` refuses.
    """
    if filter not in FILTERS:
        raise SolenavError(f"there is no filter {filter!r}", f"choose from {', '.join(FILTERS)}")
    check_floor(walk.reckoned.name if isinstance(walk, Paces) else walk.name, walk.notes, floor)
    known = _field_at(floor, start)
    if known is None:
        raise SolenavError(
            f"the start ({start[0]:g}, {start[1]:g}) is off the map {floor.floor}",
            f"it has places in x {floor.x[0]:g} to {floor.x[-1]:g}, y {floor.y[0]:g} to "
            f"{floor.y[-1]:g} m: see `solenav magmap show`",
        )
    if isinstance(walk, Recording):
        walk = paces(walk, begin_s=begin_s)
    yaw, mean, first = walk.yaw, walk.field, walk.first_field
    unsure = tuning.start_turn
    if start_heading is not None:
        turn = start_heading - walk.first_yaw
    else:
        turn = math.atan2(known[1], known[0]) - math.atan2(first[1], first[0]) - walk.first_yaw
        # A weak horizontal field says little of its direction.
        weakest = min(math.hypot(known[0], known[1]), math.hypot(first[0], first[1]))
        unsure = max(unsure, math.atan2(1.5 * tuning.field_ut, weakest))
    changes = np.diff(yaw, prepend=walk.first_yaw)
    disturbed = np.linalg.norm(np.diff(mean, axis=0, prepend=mean[:1]), axis=1)
    rng = np.random.default_rng(seed)
    cloud = _begin(np.array(start, np.float64), turn, unsure, rng, tuning)
    places, spread = [cloud.place], [tuning.start_m]
    clock = time.thread_time()
    for length, yaw_, turned, felt, change in zip(
        walk.lengths.tolist(), yaw.tolist(), changes.tolist(), mean, disturbed.tolist(), strict=True
    ):
        step = _Step(length, yaw_, turned, felt, change)
        _advance(cloud, step, floor, rng, tuning, *FILTERS[filter])
        places.append(cloud.place)
        off = cloud.particles[:, :2] - cloud.place
        spread.append(math.sqrt(float(cloud.weights @ (off * off).sum(axis=1))))
    seconds = (time.thread_time() - clock) / len(yaw)
    where = np.array(places)
    moved = np.column_stack([np.diff(where, axis=0), np.zeros(len(yaw))])
    covariance = np.zeros((len(yaw), 3, 3))
    covariance[:, 0, 0] = covariance[:, 1, 1] = np.square(spread[1:]) / 2
    track = replace(
        walk.reckoned,
        displacement=moved,
        heading=np.arctan2(moved[:, 1], moved[:, 0]),
        covariance=covariance,
        start=np.array([*start, 0.0]),
    )
    return Located(filter, track, np.array(spread), cloud.renewed, cloud.anew, seconds)


def _field_at(floor: MagneticMap, start: tuple[float, float]) -> FloatArray | None:
    """The field (3,) of the known cell next to the start, None where none is within START_M."""
    rows, columns = np.nonzero(floor.covered)
    away = np.hypot(floor.x[columns] - start[0], floor.y[rows] - start[1])
    next_to = int(np.argmin(np.nan_to_num(away, nan=np.inf)))
    if not away[next_to] <= START_M:
        return None
    return np.asarray(floor.field[:, rows[next_to], columns[next_to]])


def check_floor(name: str, notes: Mapping[str, Any], floor: MagneticMap) -> None:
    """SolenavError where a trace's notes and the map say that they are of different floors."""
    of = notes.get("floor")
    if of and floor.floor and of != floor.floor:
        raise SolenavError(
            f"{name} was walked on floor {of}, the map is of floor {floor.floor}",
            "give the map of that floor",
        )
    site = notes.get("site")
    if site and floor.site and site != floor.site:
        raise SolenavError(
            f"{name} was walked at {site}, the map is of {floor.site}",
            "give the map of that site",
        )


def _begin(start: FloatArray, turn: float, unsure: float, rng: Generator, t: Tuning) -> _Cloud:
    n = t.particles
    particles = np.empty((n, 4))
    particles[:, :2] = start + rng.normal(0.0, t.start_m, (n, 2))
    particles[:, TURN] = turn + rng.normal(0.0, unsure, n)
    particles[:, SCALE] = 1.0 + rng.normal(0.0, t.start_scale, n)
    return _Cloud(particles, np.full(n, 1.0 / n), start)


def _advance(
    cloud: _Cloud,
    step: _Step,
    floor: MagneticMap,
    rng: Generator,
    t: Tuning,
    weigh: _Weigh,
    renew: _Renew,
) -> None:
    """One step of any filter, in place."""
    p = cloud.particles
    before = cloud.place
    noise = rng.standard_normal((4, len(p)))
    p[:, TURN] += t.step_turn * noise[0]
    p[:, SCALE] += t.step_scale * noise[1]
    heading = step.yaw + p[:, TURN]
    length = step.length * p[:, SCALE]
    c, s = np.cos(heading), np.sin(heading)
    moved = np.column_stack([length * c, length * s])
    p[:, :2] += moved + t.step_m * noise[2:].T
    predicted = before + cloud.weights @ moved
    value, variance = floor.at(p[:, :2])
    fx, fy, up = step.field
    off = np.column_stack([c * fx - s * fy, s * fx + c * fy, np.full(len(p), up)]) - value
    against = np.minimum(off * off / (t.field_ut**2 + variance), t.clip).sum(axis=1)
    against = np.where(np.isnan(against), t.off_map, against)
    weights = cloud.weights * weigh(cloud, step, against, predicted, t)
    total = weights.sum()
    cloud.weights = weights / total if total > 0 else np.full(len(p), 1.0 / len(p))
    cloud.place = cloud.weights @ p[:, :2]
    cloud.turns += abs(step.turned) / (math.pi / 2)
    cloud.lost = cloud.lost + 1 if float(cloud.weights @ against) > t.lost else 0
    renew(cloud, step, rng, t)


def _few(cloud: _Cloud, t: Tuning) -> bool:
    return 1.0 / float(cloud.weights @ cloud.weights) < t.resample * len(cloud.weights)


# --- plain ---------------------------------------------------------------------------------------


def _by_field(
    cloud: _Cloud, step: _Step, against: FloatArray, predicted: FloatArray, t: Tuning
) -> FloatArray:
    return np.asarray(np.exp(-0.5 * t.temper * (against - against.min())))


def _systematic(weights: FloatArray, count: int, rng: Generator) -> FloatArray:
    """Rows drawn `count` times by weight (sum 1), evenly spread."""
    at = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), at), len(weights) - 1)


def _resample(cloud: _Cloud, step: _Step, rng: Generator, t: Tuning) -> None:
    if not _few(cloud, t):
        return
    n = len(cloud.weights)
    cloud.particles = cloud.particles[_systematic(cloud.weights, n, rng)]
    cloud.weights = np.full(n, 1.0 / n)
    cloud.renewed += 1


# --- firefly -------------------------------------------------------------------------------------


def _by_both(
    cloud: _Cloud, step: _Step, against: FloatArray, predicted: FloatArray, t: Tuning
) -> FloatArray:
    """A sum of both weights, each normalised first.

    The share of dead reckoning falls from `rho_start` to `rho_end` as turns come in; the field has
    what is left, and less where it changed much within a step.
    """
    field = _by_field(cloud, step, against, predicted, t)
    off = cloud.particles[:, :2] - predicted
    near = np.exp(-0.5 * (off * off).sum(axis=1) / t.pdr_m**2)
    rho_p = max(t.rho_end, t.rho_start * (1.0 - cloud.turns / t.turns))
    rho_m = (1.0 - rho_p) * math.exp(-step.disturbed / t.calm_ut)
    return np.asarray(rho_p * near / (near.sum() or 1.0) + rho_m * field / field.sum())


def brighter(weights: FloatArray, rng: Generator, t: Tuning) -> FloatArray:
    """Whom each particle sees: rows (n,).

    Particles heavier than the mean, drawn by how much: a resampling of the residuals. Were it the
    heaviest alone, nearly all would meet in one place, and what the others knew would be lost.
    """
    n = len(weights)
    if t.brightest:
        return np.full(n, np.argmax(weights))
    above = np.maximum(weights - 1.0 / n, 0.0)
    return rng.permutation(_systematic(above / above.sum(), n, rng))


def _fly(cloud: _Cloud, step: _Step, rng: Generator, t: Tuning) -> None:
    p, n = cloud.particles, len(cloud.weights)
    if _few(cloud, t):
        to = brighter(cloud.weights, rng, t)
        attraction = t.attraction * np.exp(-n * cloud.weights)
        # None flies to a dimmer one.
        attraction[cloud.weights[to] <= cloud.weights] = 0.0
        p += attraction[:, np.newaxis] * (p[to] - p)
        p[:, :3] += (rng.random((n, 3)) - 0.5) * (t.jitter_m, t.jitter_m, t.jitter_turn)
        cloud.weights = np.full(n, 1.0 / n)
        cloud.renewed += 1
    off = p[:, :2] - cloud.place
    if float((off * off).sum(axis=1).mean()) < t.narrow_m2:
        p[:, :2] = cloud.place + 4.0 * step.length * (rng.random((n, 2)) - 0.5)
        cloud.anew += 1


# --- centroid ------------------------------------------------------------------------------------


def _partial(cloud: _Cloud, step: _Step, rng: Generator, t: Tuning) -> None:
    p, n = cloud.particles, len(cloud.weights)
    if cloud.lost >= t.lost_steps:
        p[:, :2] = cloud.place + rng.normal(0.0, t.anew_m, (n, 2))
        p[:, TURN] += rng.normal(0.0, t.start_turn, n)
        cloud.weights = np.full(n, 1.0 / n)
        cloud.lost = 0
        cloud.anew += 1
        return
    if not _few(cloud, t):
        return
    off = p[:, :2] - centre(p[:, :2])
    away = np.sqrt((off * off).sum(axis=1))
    unit = away.max() if t.by_cloud else step.length
    inner, outer = away < t.near * unit, away > t.far * unit
    both = np.flatnonzero(inner | outer)
    if not len(both):
        return
    weights = cloud.weights[both]
    # Pairwise: a random order pairs each with another; the odd one out keeps its own.
    order = rng.permutation(len(both))
    pairs = order[: len(order) // 2 * 2].reshape(-1, 2)
    weights[pairs] = weights[pairs].mean(axis=1, keepdims=True)
    drawn = _systematic(weights / weights.sum(), len(both), rng)
    p[both] = p[both[drawn]]
    cloud.weights[both] = 1.0 / n
    cloud.weights /= cloud.weights.sum()
    cloud.renewed += 1


def centre(points: FloatArray, rounds: int = 8) -> FloatArray:
    """The point (2,) with the least sum of distances to `points` (n, 2): Weiszfeld 1937."""
    here = np.median(points, axis=0)
    for _ in range(rounds):
        off = points - here
        near = 1.0 / np.maximum(np.sqrt((off * off).sum(axis=1)), 1e-6)
        here = near @ points / near.sum()
    return np.asarray(here)


FILTERS: dict[str, tuple[_Weigh, _Renew]] = {
    "firefly": (_by_both, _fly),
    "plain": (_by_field, _resample),
    "centroid": (_by_field, _partial),
}
