"""From walks over known way points to a kriged map of the floor's magnetic field.

A survey walk is dead reckoned, and its steps are laid onto the lines between its way points by
time and length walked; the phone's yaw is turned to fit those lines, so that the field is known
in the floor's axes. One point per step goes into the map. Ordinary kriging (PyKrige) with an
exponential variogram, component by component, gives the field and its variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solenav.errors import SolenavError
from solenav.magmap.grid import MagneticMap
from solenav.pdr import reckoning, steps
from solenav.pdr.attitude import level
from solenav.pdr.length import GENERIC
from solenav.recording import FloatArray, Recording

COMPONENTS = ("x", "y", "up")
NEIGHBOURS = 24
MOST_POINTS = 6000
# A leg's direction is that of the feet only where it is long and steadily walked.
LEG_M = 2.5
SEPARATION_M = 0.05


@dataclass(frozen=True)
class Survey:
    """Points (n, 2) m in the floor's axes and the field (n, 3) µT along x, y and up there."""

    name: str
    points: FloatArray
    field: FloatArray


@dataclass(frozen=True)
class Variogram:
    """Of one component: `lags` m, `semivariance` µT² seen; the model: sill, range, nugget."""

    component: str
    lags: FloatArray
    semivariance: FloatArray
    sill: float
    range_m: float
    nugget: float

    def at(self, lags: FloatArray) -> FloatArray:
        """The exponential model's semivariance, PyKrige's convention: range/3 is the scale."""
        return (self.sill - self.nugget) * (1 - np.exp(-lags / (self.range_m / 3))) + self.nugget


def survey(trace: Recording) -> Survey:
    """One point per step of a walk with way points.

    SolenavError without a magnetometer, with holes in it, with fewer than two way points, or
    without a step between them.
    """
    seen = level(trace)
    field = reckoning.need_field(trace.name, seen)
    truth = trace.truth
    if truth is None or len(truth.time_s) < 2:
        raise SolenavError(
            f"{trace.name} has no way points", "a survey needs to know where it went"
        )
    found = steps.detect(seen.time_s, seen.vertical)
    found = reckoning.between(found, truth.time_s[0], truth.time_s[-1])
    if not len(found):
        raise SolenavError(f"{trace.name}: no steps between its way points", "walk them")
    middle = (found.begin_s + found.time_s) / 2
    points = along_way_points(truth.time_s, truth.position_enu[:, :2], middle, GENERIC.of(found))
    yaw = reckoning.over_steps(found, seen.time_s, seen.yaw)
    turned = yaw + _offset(truth.time_s, truth.position_enu[:, :2], middle, yaw)
    mean = reckoning.over_steps(found, seen.time_s, field)
    c, s = np.cos(turned), np.sin(turned)
    along = np.column_stack(
        [c * mean[:, 0] - s * mean[:, 1], s * mean[:, 0] + c * mean[:, 1], mean[:, 2]]
    )
    return Survey(trace.name, points, along)


def along_way_points(
    passed_s: FloatArray, points: FloatArray, time_s: FloatArray, lengths: FloatArray
) -> FloatArray:
    """Where steps in the middle of which it was `time_s` (n,) were, (n, 2), on straight legs.

    Within a leg as far as the `lengths` (n,) walked by then are of the leg's.
    """
    leg = np.clip(np.searchsorted(passed_s, time_s, side="right") - 1, 0, len(points) - 2)
    share = np.empty(len(time_s))
    for one in np.unique(leg):
        of = leg == one
        walked = np.cumsum(lengths[of])
        share[of] = (walked - lengths[of] / 2) / walked[-1]
    return points[leg] + share[:, np.newaxis] * (points[leg + 1] - points[leg])


def _offset(
    passed_s: FloatArray, points: FloatArray, time_s: FloatArray, yaw: FloatArray
) -> FloatArray:
    """What to add to the yaw (n,) of steps: a line over time through the legs' directions."""
    leg = np.clip(np.searchsorted(passed_s, time_s, side="right") - 1, 0, len(points) - 2)
    moved = np.diff(points, axis=0)
    course = np.arctan2(moved[:, 1], moved[:, 0])[leg]
    length = np.hypot(moved[:, 0], moved[:, 1])[leg]
    off = course - yaw
    used = length >= LEG_M if (length >= LEG_M).any() else np.ones(len(leg), bool)
    # Beside the mean direction, so that nothing wraps; then a line, trimmed once.
    mean = np.angle(np.exp(1j * off[used]).sum())
    rest = np.angle(np.exp(1j * (off - mean)))
    middle = np.median(rest[used])
    used &= np.abs(rest - middle) < np.radians(40)
    if used.sum() < 8 or np.ptp(time_s[used]) < 20.0:
        return np.full(len(yaw), mean + middle)
    slope, level_ = np.polyfit(time_s[used], rest[used], 1)
    return np.asarray(mean + level_ + slope * time_s)


def build(
    surveys: Sequence[Survey],
    *,
    site: str,
    floor: str,
    spacing: float = 0.5,
    reach: float = 2.0,
) -> tuple[MagneticMap, list[Variogram]]:
    """The kriged map, `spacing` m from cell to cell, up to `reach` m from what was walked.

    SolenavError for too few points or points all in one place, and where PyKrige is missing.
    """
    ok = steps.need("pykrige.ok")
    if spacing <= 0 or reach <= 0:
        raise SolenavError("spacing and reach must be positive", "give metres, 0.5 and 2 are usual")
    points = np.vstack([s.points for s in surveys]) if surveys else np.empty((0, 2))
    field = np.vstack([s.field for s in surveys]) if surveys else np.empty((0, 3))
    points, field = _apart(points, field)
    if len(points) < 12 or len(points) > MOST_POINTS:
        raise SolenavError(
            f"{len(points)} places surveyed: 12 are the least, {MOST_POINTS} the most",
            "survey more of the floor" if len(points) < 12 else "build it from fewer walks",
        )
    low = np.floor((points.min(axis=0) - reach) / spacing) * spacing
    size = np.ceil((points.max(axis=0) + reach - low) / spacing).astype(int) + 1
    x, y = (low[k] + spacing * np.arange(size[k]) for k in (0, 1))
    cells = np.column_stack([g.ravel() for g in np.meshgrid(x, y)])
    tree = steps.need("scipy.spatial").cKDTree(points)
    near = tree.query(cells)[0] <= reach
    grid = np.full((3, len(cells)), np.nan)
    deviation = np.full((3, len(cells)), np.nan)
    variograms = []
    for k, component in enumerate(COMPONENTS):
        try:
            kriging = ok.OrdinaryKriging(
                points[:, 0],
                points[:, 1],
                field[:, k],
                variogram_model="exponential",
                nlags=20,
                weight=True,
            )
            value, variance = kriging.execute(
                "points",
                cells[near, 0],
                cells[near, 1],
                backend="loop",
                n_closest_points=min(NEIGHBOURS, len(points) - 1),
            )
        except (ValueError, np.linalg.LinAlgError) as error:
            raise SolenavError(
                f"the field along {component} can't be kriged: {error}", "survey more of the floor"
            ) from None
        grid[k, near] = np.asarray(value)
        deviation[k, near] = np.sqrt(np.maximum(np.asarray(variance), 0.0))
        variograms.append(_variogram(component, kriging))
    shape = (3, len(y), len(x))
    made = MagneticMap(
        site,
        floor,
        x,
        y,
        grid.reshape(shape),
        deviation.reshape(shape),
        tuple(s.name for s in surveys),
        {
            "points": len(points),
            "variograms": [
                {
                    "component": v.component,
                    "sill": v.sill,
                    "range_m": v.range_m,
                    "nugget": v.nugget,
                    "lags_m": v.lags.tolist(),
                    "semivariance": v.semivariance.tolist(),
                }
                for v in variograms
            ],
        },
    )
    return made, variograms


def variograms_of(made: MagneticMap) -> list[Variogram]:
    """What the map was kriged by; nothing where it was not kriged. SolenavError where damaged."""
    try:
        found = [
            Variogram(
                str(one["component"]),
                np.array(one["lags_m"], np.float64),
                np.array(one["semivariance"], np.float64),
                float(one["sill"]),
                float(one["range_m"]),
                float(one["nugget"]),
            )
            for one in made.notes.get("variograms", [])
        ]
        if any(v.lags.ndim != 1 or v.lags.shape != v.semivariance.shape for v in found):
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise SolenavError(
            "the map's variograms are damaged", "build it again: `solenav magmap build`"
        ) from None
    return found


def _variogram(component: str, kriging: Any) -> Variogram:
    psill, range_m, nugget = (float(v) for v in kriging.variogram_model_parameters)
    return Variogram(
        component,
        np.asarray(kriging.lags),
        np.asarray(kriging.semivariance),
        psill + nugget,
        range_m,
        nugget,
    )


def _apart(points: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points within centimetres become one, their field the mean: kriging would be singular."""
    if not len(points):
        return points, field
    cell = np.round(points / SEPARATION_M).astype(np.int64)
    _, which, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    merged = np.zeros((len(count), 5))
    np.add.at(merged, which, np.column_stack([points, field]))
    merged /= count[:, np.newaxis]
    return merged[:, :2], merged[:, 2:]
