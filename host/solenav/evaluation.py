"""How good a walk's estimate is: what it measured, how it closes, how far it is from the truth.

Positions are metres in the estimate's own frame (East, North, Up from the static start), times
seconds from the first sample. Guo, Xu, Ji 2020 give their results as RMSE in stance (tables 2
and 3) and as final error (table 5): both are here. The absolute pose error comes from evo.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.capture.contents import Capture, Table
from solenav.capture.order import POSITION_M, VELOCITY_MPS, counted, leaping
from solenav.errors import SolenavError
from solenav.pdr.track import StepTrack
from solenav.recording import FloatArray, Truth

ALIGNMENTS = ("auto", "none", "origin", "yaw")

_NEED_TRUTH = (
    "simulate or import a recording that has one, or put a table with the columns time_s, "
    "east_m, north_m, up_m beside it (NAME.truth.csv)"
)
# A pose or two may be lost on the way; across more, a straight line is no estimate any more.
_GAP_PERIODS = 3.5
# A relative pose error takes a point so often.
_THIN_S = 0.1

_STATISTICS = ("rmse", "mean", "median", "std", "min", "max")


@dataclass(frozen=True)
class Errors:
    """One kind of error per axis, in the plane and in space; None where the truth has no height."""

    east: float
    north: float
    up: float | None
    horizontal: float
    total: float | None


@dataclass(frozen=True)
class Closure:
    """From the first pose to the last, in m; `horizontal_share` is of the distance walked.

    It is an error only where the walk is known to end where it began: then `meaningful`.
    """

    horizontal_m: float
    vertical_m: float
    total_m: float
    horizontal_share: float | None
    meaningful: bool


@dataclass(frozen=True)
class Alignment:
    """How the truth was laid onto the estimate: turned about Up (rad), then shifted (m, ENU).

    `mode` is "none", "origin" (first common point) or "yaw" (best fit of turn and shift);
    `points` of the truth were compared, and in mode "yaw" fitted.
    """

    mode: str
    yaw_rad: float
    shift_m: tuple[float, float, float]
    points: int

    def turned(self, vectors: FloatArray) -> FloatArray:
        """Vectors (n, 3) of the truth's frame in the estimate's."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        east, north, up = vectors.T
        return np.column_stack([c * east - s * north, s * east + c * north, up])

    def moved(self, positions: FloatArray) -> FloatArray:
        """Positions (n, 3) of the truth's frame in the estimate's."""
        return self.turned(positions) + np.array(self.shift_m)


@dataclass(frozen=True)
class Comparison:
    """Estimate and truth side by side, at those of the truth's times that have poses around them.

    `time_s` (n,); `estimate` and `reference` (n, 3) in m, in the estimate's frame; an unknown
    height is NaN. `velocity` (n, 3) is the estimate's, in m/s. `rows` (n,) are the truth's rows
    that they come from.
    """

    alignment: Alignment
    time_s: FloatArray
    estimate: FloatArray
    velocity: FloatArray
    reference: FloatArray
    rows: NDArray[np.intp]

    @property
    def error(self) -> FloatArray:
        """Estimate less truth, (n, 3) in m."""
        return self.estimate - self.reference


@dataclass(frozen=True)
class TruthErrors:
    """Errors against the truth, along the estimate's axes, in m and m/s.

    `ape_m` holds evo's statistics (rmse, mean, median, std, min, max) of the absolute pose error,
    `horizontal` and, where heights are known, `total`. `final_m` is the last point's error, signed.
    What concerns stance is None where the truth doesn't know stance (or velocity).
    """

    frame: str
    alignment: Alignment
    position_rmse_m: Errors
    ape_m: dict[str, dict[str, float] | None]
    final_m: Errors
    final_share: float | None
    stance_points: int
    stance_position_rmse_m: Errors | None
    stance_velocity_rmse_mps: Errors | None


@dataclass(frozen=True)
class Evaluation:
    """What is known of a walk. `distance_m` is the sum of the step lengths.

    `duration_s` runs from the first pose to the last. After `restarts` of the board the figures
    are those of the last run. `left_out` poses leap away from all others (`last_run`). `truth` is
    None where there is none.
    """

    steps: int
    distance_m: float
    duration_s: float
    poses: int
    closure: Closure
    restarts: int = 0
    left_out: int = 0
    truth: TruthErrors | None = None

    def as_dict(self) -> dict[str, Any]:
        """Everything as dictionaries, numbers and None, for JSON."""
        return asdict(self)


def evaluate(capture: Capture, *, align: str = "auto", require_truth: bool = False) -> Evaluation:
    """Steps, distance and closure of a capture with poses, and its errors where the truth is known.

    `align` says how the truth is laid onto the estimate before they are compared: "none",
    "origin", "yaw", or "auto", which is none for a truth in real East and North, else yaw.

    Raises SolenavError without poses, for an unknown `align`, where truth and poses have no time
    in common, where evo is missing, and with `require_truth` where no position is known.
    """
    if align not in ALIGNMENTS:
        raise SolenavError(f"unknown alignment {align!r}", f"choose one of {', '.join(ALIGNMENTS)}")
    truth = capture.truth
    run, restarts = last_run(capture)
    left_out = sum(run.damaged.values()) - sum(capture.damaged.values())
    walk = replace(measure(run, truth), restarts=restarts, left_out=left_out)
    if truth is None or not len(truth.time_s):
        if require_truth:
            raise SolenavError(f"{capture.path} has no truth to compare with", _NEED_TRUTH)
        return walk
    comparison = compare(run, truth, align)
    return replace(walk, truth=_against_truth(truth, comparison, walk.distance_m))


def measure(run: Capture, truth: Truth | None) -> Evaluation:
    """What the estimate of one run says by itself. SolenavError without poses."""
    run.need_poses()
    rows = run.poses.rows
    time_s = run.time_of_tick(run.poses.tick)
    distance = float(rows["distance"][-1]) / 2**10
    return Evaluation(
        # The differences wrap as the counter does, so that their sum doesn't; signed, so that
        # one damaged count cancels out.
        steps=int(rows["steps"][0])
        + int(np.diff(rows["steps"]).view(np.int16).sum(dtype=np.int64)),
        distance_m=distance,
        duration_s=float(time_s[-1] - time_s[0]),
        poses=len(rows),
        closure=_closure(run.positions(), distance, truth),
    )


def _closure(position: FloatArray, distance_m: float, truth: Truth | None) -> Closure:
    """What lies between the first and the last of positions (n, 3)."""
    east, north, up = (position[-1] - position[0]).tolist()
    horizontal = math.hypot(east, north)
    return Closure(
        horizontal_m=horizontal,
        vertical_m=up,
        total_m=math.hypot(horizontal, up),
        horizontal_share=horizontal / distance_m if distance_m else None,
        meaningful=truth is not None and truth.closed_loop,
    )


def evaluate_steps(
    walk: StepTrack, truth: Truth | None, *, align: str = "auto", require_truth: bool = False
) -> Evaluation:
    """The same of steps, a foot's or a waist's: places between steps are on straight lines.

    `poses` counts the steps' ends. Errors, `align` and `require_truth` as in `evaluate`.
    """
    if align not in ALIGNMENTS:
        raise SolenavError(f"unknown alignment {align!r}", f"choose one of {', '.join(ALIGNMENTS)}")
    time_s, position = walk.position_s, walk.position
    found = Evaluation(
        steps=len(walk),
        distance_m=walk.distance_m,
        duration_s=float(time_s[-1] - time_s[0]),
        poses=len(time_s),
        closure=_closure(position, walk.distance_m, truth),
    )
    if truth is None or not len(truth.time_s):
        if require_truth:
            raise SolenavError(f"{walk.name} has no truth to compare with", _NEED_TRUTH)
        return found
    comparison = lay(time_s, position, np.zeros_like(position), truth, align, name=walk.name)
    return replace(
        found,
        truth=replace(
            _against_truth(truth, comparison, walk.distance_m), stance_velocity_rmse_mps=None
        ),
    )


def compare(run: Capture, truth: Truth, align: str = "auto") -> Comparison:
    """The estimate of one run at the truth's times, and the truth laid onto it. Needs no evo.

    Raises SolenavError without poses and where nothing is left.
    """
    run.need_poses()
    return lay(
        run.time_of_tick(run.poses.tick),
        run.positions(),
        run.poses.rows["velocity"] / 2**24,
        truth,
        align,
        name=str(run.path),
    )


def lay(
    time_s: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    truth: Truth,
    align: str = "auto",
    *,
    name: str,
) -> Comparison:
    """An estimate, (n,) s, (n, 3) m and m/s, at the truth's times, and the truth laid onto it.

    The estimate is interpolated, so that a survey point per stride will do, and clocks of
    different rates cost nothing; truth without poses around it is left out. `align` is as in
    `evaluate`.

    Raises SolenavError, which calls the estimate `name`, where nothing is left.
    """
    usable = np.isfinite(truth.position_enu[:, :2]).all(axis=1) & _near(truth.time_s, time_s)
    rows = np.flatnonzero(usable)
    if not len(rows):
        raise SolenavError(
            f"{name}: no point of the truth falls into the time of the poses",
            "times in the truth's table count from the first sample, in seconds: check them",
        )
    points = truth.position_enu[rows]
    wanted = truth.time_s[rows]
    estimate = _at(wanted, time_s, position)
    if align == "auto":
        align = "none" if truth.frame == "enu" else "yaw"
    alignment = _ALIGN[align](points, estimate)
    return Comparison(
        alignment, wanted, estimate, _at(wanted, time_s, velocity), alignment.moved(points), rows
    )


def last_run(capture: Capture) -> tuple[Capture, int]:
    """What a capture holds from the board's last start on, and how often it started again.

    Ticks count from each start, so only within one do they tell the time. Poses whose position or
    velocity leaps away from those on both sides and back are left out and counted in `damaged`:
    they were damaged in a way that their CRC doesn't see.
    """
    starts = [
        table.order[1:][np.diff(table.tick) < 0] for table in (capture.samples, capture.poses)
    ]
    restarts = max(len(orders) for orders in starts)
    if not restarts:
        return _without_leaps(capture), 0
    # Samples come before the poses: where both are there, theirs is the earlier.
    start = int(min(orders[-1] for orders in starts if len(orders) == restarts))
    later = replace(
        capture,
        samples=_since(capture.samples, start),
        poses=_since(capture.poses, start),
        steps=_since(capture.steps, start),
        aligns=_since(capture.aligns, start),
        statuses=_since(capture.statuses, start),
    )
    return _without_leaps(later), restarts


def _since(table: Table, order: int) -> Table:
    return table.where(table.order >= order)


def _without_leaps(capture: Capture) -> Capture:
    poses = capture.poses
    found = {
        "position out of reach": leaping(capture.positions(), poses.tick, POSITION_M),
        "velocity out of reach": leaping(poses.rows["velocity"] / 2**24, poses.tick, VELOCITY_MPS),
    }
    bad = np.logical_or.reduce(list(found.values()))
    if not bad.any():
        return capture
    return replace(capture, poses=poses.where(~bad), damaged=capture.damaged + counted(found))


def _near(wanted_s: FloatArray, time_s: FloatArray) -> NDArray[np.bool_]:
    """Whether poses at `time_s` (ascending) surround each wanted time closely enough."""
    if len(time_s) < 2:
        return np.abs(wanted_s - time_s[0]) < 1e-3
    steps = np.diff(time_s)
    period = float(np.median(steps))
    after = np.clip(np.searchsorted(time_s, wanted_s), 1, len(time_s) - 1)
    between = (wanted_s > time_s[0]) & (wanted_s < time_s[-1])
    between &= steps[after - 1] <= _GAP_PERIODS * period
    # At the edges of gaps and the ends a rounded clock may put a truth just outside.
    off = np.minimum(np.abs(wanted_s - time_s[after - 1]), np.abs(wanted_s - time_s[after]))
    near: NDArray[np.bool_] = between | (off < period / 2)
    return near


def _at(wanted_s: FloatArray, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """`values` (m, 3) at `time_s`, interpolated at the wanted times, (n, 3)."""
    return np.column_stack([np.interp(wanted_s, time_s, column) for column in values.T])


def _no_alignment(points: FloatArray, estimate: FloatArray) -> Alignment:
    return Alignment("none", 0.0, (0.0, 0.0, 0.0), len(points))


def _origin_alignment(points: FloatArray, estimate: FloatArray) -> Alignment:
    """The first point onto the estimate of its time."""
    east, north, up = np.nan_to_num(estimate[0] - points[0]).tolist()
    return Alignment("origin", 0.0, (east, north, up), len(points))


def _yaw_alignment(points: FloatArray, estimate: FloatArray) -> Alignment:
    """Least squares turn about Up and shift; gravity fixes the other two turns.

    In the plane Umeyama's solution (1991, eq. 40 to 42, scale 1) is the angle of the summed
    cross and dot products.
    """
    centre, target = points[:, :2].mean(axis=0), estimate[:, :2].mean(axis=0)
    (x, y), (u, v) = (points[:, :2] - centre).T, (estimate[:, :2] - target).T
    yaw = math.atan2(float(np.sum(x * v - y * u)), float(np.sum(x * u + y * v)))
    rise = (estimate[:, 2] - points[:, 2])[np.isfinite(points[:, 2])]
    turned = Alignment("yaw", yaw, (0.0, 0.0, 0.0), len(points)).turned(np.array([[*centre, 0.0]]))
    east, north = (target - turned[0, :2]).tolist()
    return Alignment(
        "yaw", yaw, (east, north, float(rise.mean()) if len(rise) else 0.0), len(points)
    )


_ALIGN = {"none": _no_alignment, "origin": _origin_alignment, "yaw": _yaw_alignment}


def _against_truth(truth: Truth, comparison: Comparison, distance_m: float) -> TruthErrors:
    """Every figure that a comparison gives."""
    rows = comparison.rows
    error = comparison.error
    final = errors(error[-1])
    stance = np.zeros(len(rows), bool) if truth.stance is None else truth.stance[rows]
    velocity_error = None
    if truth.velocity_enu is not None and stance.any():
        reference = comparison.alignment.turned(truth.velocity_enu[rows])
        velocity_error = rmse((comparison.velocity - reference)[stance])
    return TruthErrors(
        frame=truth.frame,
        alignment=comparison.alignment,
        position_rmse_m=rmse(error),
        ape_m={"horizontal": ape(comparison, 2), "total": ape(comparison, 3)},
        final_m=final,
        final_share=final.horizontal / distance_m if distance_m else None,
        stance_points=int(stance.sum()),
        stance_position_rmse_m=rmse(error[stance]) if stance.any() else None,
        stance_velocity_rmse_mps=velocity_error,
    )


def rmse(error: FloatArray) -> Errors:
    """Root mean square of errors (n, 3); each axis over the rows where it is known (not NaN)."""
    mean = np.zeros(3)
    for axis, column in enumerate(error.T):
        known = column[np.isfinite(column)]
        mean[axis] = np.mean(known**2) if len(known) else np.nan
    return errors(np.sqrt(mean))


def errors(axes: FloatArray) -> Errors:
    east, north, up = axes.tolist()
    horizontal = math.hypot(east, north)
    if math.isnan(up):
        return Errors(east, north, None, horizontal, None)
    return Errors(east, north, up, horizontal, math.hypot(horizontal, up))


def ape(comparison: Comparison, dimensions: int = 2) -> dict[str, float] | None:
    """evo's statistics of the absolute pose error, estimate to truth, in m, or None.

    Over the plane (2 `dimensions`) or space (3), where those coordinates are known.
    """
    known = _known(comparison, dimensions)
    if not known.any():
        return None
    metrics = _evo("metrics")
    found = metrics.APE(metrics.PoseRelation.translation_part)
    return _statistics(found, comparison, known, dimensions)


def rpe(comparison: Comparison, stretch_m: float, dimensions: int = 2) -> dict[str, float] | None:
    """evo's statistics of the relative pose error over stretches of `stretch_m` of truth, in m.

    The displacement over a stretch, estimate less truth, both in the estimate's frame; so a
    wrong heading counts. None where the truth is shorter than a stretch.
    """
    known = _known(comparison, dimensions)
    # evo builds a matrix a pose, in Python.
    known = _thinned(comparison.time_s, known)
    if known.sum() < 2:
        return None
    metrics = _evo("metrics")
    found = metrics.RPE(
        metrics.PoseRelation.translation_part,
        stretch_m,
        metrics.Unit.meters,
        # The same stretches for every estimate.
        pairs_from_reference=True,
    )
    try:
        return _statistics(found, comparison, known, dimensions)
    except _evo("filters").FilterException:
        return None


def _known(comparison: Comparison, dimensions: int) -> NDArray[np.bool_]:
    """Whether each point of the truth knows its first coordinates, (n,)."""
    return np.asarray(np.isfinite(comparison.reference[:, :dimensions]).all(axis=1))


def _thinned(time_s: FloatArray, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The known points at least `_THIN_S` apart."""
    kept = np.zeros(len(time_s), bool)
    where = np.flatnonzero(known)
    beats = np.floor(time_s[where] / _THIN_S)
    kept[where[np.diff(beats, prepend=-1.0) > 0]] = True
    return kept


def _statistics(
    metric: Any, comparison: Comparison, known: NDArray[np.bool_], dimensions: int
) -> dict[str, float]:
    """What an evo metric says of the known points of a comparison."""
    trajectory = _evo("trajectory")

    def path(points: FloatArray) -> Any:
        shown = np.zeros((int(known.sum()), 3))
        shown[:, :dimensions] = points[known, :dimensions]
        # The truth has no attitude, and the translation part doesn't ask for one.
        level = np.tile([1.0, 0.0, 0.0, 0.0], (len(shown), 1))
        return trajectory.PoseTrajectory3D(shown, level, comparison.time_s[known])

    metric.process_data((path(comparison.reference), path(comparison.estimate)))
    statistics = metric.get_all_statistics()
    return {name: float(statistics[name]) for name in _STATISTICS}


def _evo(module: str) -> Any:
    try:
        return import_module(f"evo.core.{module}")
    except ImportError:
        raise SolenavError(
            "comparing with the truth needs evo", "pip install 'solenav[evaluate]'"
        ) from None
