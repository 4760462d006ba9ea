"""How far a filter's track is from the truth: the paper's figures, closure, and evo's.

Guo, Xu, Ji 2020 give RMSE of velocity and position in stance per axis (tables 2 and 3) and the
final error (tables 4 and 5). One horizontal figure, `Score.error_m`, ranks filters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solenav.evaluation import Comparison, Errors, ape, errors, lay, rmse, rpe
from solenav.filters.walk import BoolArray, Track, Walk
from solenav.recording import FloatArray

STRETCH_M = 5.0
"""A relative pose error is taken over so much of the way."""
LOST_SHARE = 0.05
"""A filter whose error is a larger share of the distance has lost the walk."""


@dataclass(frozen=True)
class Score:
    """A track's errors in m and m/s, along the estimate's axes; None where nothing is known.

    `error_m` is the one horizontal figure, of `kind` "truth" (RMSE after `solenav.evaluation`'s
    alignment) or "closure" (of a closed loop), infinite for a track that isn't finite;
    `error_share` is its share of `distance_m`, the walk's, the same for every filter. Errors in
    stance are over the samples that the clean detector calls stance; velocity is compared with the
    truth's where that knows it, else with zero. `ape_m` and `rpe_m` are evo's RMSE in the plane,
    the latter over stretches of `STRETCH_M`.
    """

    distance_m: float
    kind: str | None
    error_m: float | None
    error_share: float | None
    closure_m: tuple[float, float]
    closure_share: float | None
    stance_velocity_rmse_mps: Errors | None = None
    stance_position_rmse_m: Errors | None = None
    final_m: Errors | None = None
    ape_m: float | None = None
    rpe_m: float | None = None

    @property
    def lost(self) -> bool:
        """Whether the error is above `LOST_SHARE` of the distance."""
        return self.error_share is not None and self.error_share > LOST_SHARE


def check(walk: Walk) -> None:
    """SolenavError where the walk's truth has no time in common with it, whatever the track."""
    nowhere = np.zeros((len(walk.counts), 3))
    score(walk, Track(nowhere, nowhere), with_evo=False)


def score(walk: Walk, track: Track, *, with_evo: bool = True) -> Score:
    """The track's errors. `with_evo` False leaves out the APE and RPE, which take the longest.

    SolenavError where the truth has no time in common with the walk, and where evo is missing.
    """
    first = walk.start.row + 1
    time_s = walk.time_s[first:]
    position, velocity = track.position[first:], track.velocity[first:]
    truth = walk.truth
    comparison = None
    if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
        return _nowhere(walk)
    if truth is not None and len(truth.time_s):
        comparison = lay(time_s, position, velocity, truth, name=walk.name)
    east, north, up = (position[-1] - position[0]).tolist()
    closure = math.hypot(east, north)
    kind, error_m = _figure(walk, comparison, closure)
    return Score(
        distance_m=walk.distance_m,
        kind=kind,
        error_m=error_m,
        error_share=_share(error_m, walk.distance_m),
        closure_m=(closure, up),
        closure_share=_share(closure, walk.distance_m),
        stance_velocity_rmse_mps=_velocity_in_stance(walk, comparison, velocity),
        stance_position_rmse_m=_in_stance(walk, comparison, comparison.error)
        if comparison
        else None,
        final_m=errors(comparison.error[-1]) if comparison else None,
        ape_m=_rmse(ape(comparison)) if comparison and with_evo else None,
        rpe_m=_rmse(rpe(comparison, STRETCH_M)) if comparison and with_evo else None,
    )


def _nowhere(walk: Walk) -> Score:
    """The score of a track that isn't finite."""
    kind, error_m = _figure(walk, None, math.inf)
    if walk.truth is not None and len(walk.truth.time_s):
        kind, error_m = "truth", math.inf
    share = None if error_m is None else math.inf
    return Score(walk.distance_m, kind, error_m, share, (math.inf, math.inf), math.inf)


def _figure(
    walk: Walk, comparison: Comparison | None, closure: float
) -> tuple[str | None, float | None]:
    """The horizontal figure and what kind it is."""
    if comparison is not None:
        return "truth", rmse(comparison.error).horizontal
    if walk.truth is not None and walk.truth.closed_loop:
        return "closure", closure
    return None, None


def _share(error_m: float | None, distance_m: float) -> float | None:
    return error_m / distance_m if error_m is not None and distance_m else None


def _stance_at(walk: Walk, time_s: FloatArray) -> BoolArray:
    """The clean detector's decision at the samples nearest to times (m,), a bool each."""
    rows = np.rint(time_s * walk.rate_hz).astype(np.intp)
    return walk.clean[np.clip(rows, 0, len(walk.clean) - 1)]


def _in_stance(walk: Walk, comparison: Comparison, error: FloatArray) -> Errors | None:
    stance = _stance_at(walk, comparison.time_s)
    return rmse(error[stance]) if stance.any() else None


def _velocity_in_stance(
    walk: Walk, comparison: Comparison | None, velocity: FloatArray
) -> Errors | None:
    known = walk.truth.velocity_enu if walk.truth is not None else None
    if comparison is not None and known is not None:
        reference = comparison.alignment.turned(known[comparison.rows])
        return _in_stance(walk, comparison, comparison.velocity - reference)
    stance = walk.clean[walk.start.row + 1 :]
    return rmse(velocity[stance]) if stance.any() else None


def _rmse(statistics: dict[str, float] | None) -> float | None:
    return None if statistics is None else statistics["rmse"]
