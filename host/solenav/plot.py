"""One picture of a walk: where it went, how the filter fared, and five seconds of it from close up.

Colours are Okabe and Ito's, which the colour-blind can tell apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import mpu9150, parameters
from solenav.capture.contents import Capture
from solenav.errors import SolenavError
from solenav.evaluate import Comparison, Evaluation, compare, last_run, measure, rmse
from solenav.recording import FloatArray, Truth
from solenav_core import messages

SIZE_IN = (14.0, 10.0)
DPI = 110
ZOOM_S = 5.0

BLUE, RED, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#AA4499"
INK, GREY, STANCE = "#222222", "#666666", "#E4E4E4"
AXIS_COLOURS = (BLUE, RED, GREEN)

_STYLE = {
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": "#999999",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.solid_joinstyle": "round",
}

# More points than this in one line cost time and can't be seen.
_LINE_POINTS = 4000
_PATH_POINTS = 40000
# Truth that comes seldom than this is drawn as points: nobody knows the way between them.
_SPARSE_S = 0.25
# A stance narrower than this share of the panel is less than a pixel or two.
_THINNEST = 1 / 400


@dataclass(frozen=True)
class _Walk:
    """What is drawn, per pose: seconds, m, m/s, m/s²; `rate` in °/s at the samples' own times."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    stance: NDArray[np.bool_]
    steps: NDArray[np.intp]  # the rows in which a step was counted
    acc_norm: FloatArray
    threshold: FloatArray
    n_eff: FloatArray
    resampled: int
    lockouts: NDArray[np.intp]  # the rows in which zero velocity was accepted (H1)
    rate_time: FloatArray
    rate: FloatArray
    limits: dict[str, float]  # C1 and C2, where the parameters are known
    figures: Evaluation
    truth: Truth | None
    comparison: Comparison | None


def plot(capture: Capture, out: Path, *, title: str | None = None) -> None:
    """Draw a capture with poses into a PNG of `SIZE_IN` inches at `DPI`.

    Truth, where there is some, is laid onto the estimate as `solenav.evaluate` does.
    Raises SolenavError without poses or matplotlib, and where `out` can't be written.
    """
    try:
        matplotlib = import_module("matplotlib")
        figures = import_module("matplotlib.figure")
    except ImportError:
        raise SolenavError("plotting needs matplotlib", "pip install 'solenav[plot]'") from None
    walk = _gather(capture)
    with matplotlib.rc_context(_STYLE):
        figure = figures.Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
        _draw(figure, walk, title or str(capture.sidecar.get("name") or capture.path.stem))
        try:
            figure.savefig(out, format="png")
        except OSError as error:
            raise SolenavError(
                f"can't write {out}: {error.strerror}", "choose another file with -o", 1
            ) from None


def _gather(capture: Capture) -> _Walk:
    """Everything in SI units (and °/s)."""
    run, _restarts = last_run(capture)
    truth = run.truth
    figures = measure(run, truth)
    known = truth if truth is not None and len(truth.time_s) else None
    rows = run.poses.rows
    params = parameters.named(run.params[0][1]) if run.params else {}
    stance = (rows["flags"] & messages.IN_STANCE) > 0
    locked = stance & (rows["threshold"] >= params.get("M_B", 2**16))
    rate_time, rate = _rate(run)
    return _Walk(
        time=run.time_of_tick(run.poses.tick),
        position=run.positions(),
        velocity=rows["velocity"] / 2**24,
        stance=stance,
        steps=np.flatnonzero(np.diff(rows["steps"])) + 1,
        acc_norm=rows["acc_norm"] / 2**7,
        threshold=rows["threshold"] / 2**14,
        n_eff=rows["n_eff"] / 2**8,
        resampled=int(rows["resampled"][-1]),
        lockouts=np.flatnonzero(locked),
        rate_time=rate_time,
        rate=rate,
        limits={
            "acc_min": params["ACC_MIN"] / 2**7,
            "acc_max": params["ACC_MAX"] / 2**7,
            "rate_max": params["RATE_MAX"] / 2**2 / mpu9150.GYRO_LSB_PER_DPS,
        }
        if params
        else {},
        figures=figures,
        truth=known,
        comparison=compare(run, known) if known is not None else None,
    )


def _rate(run: Capture) -> tuple[FloatArray, FloatArray]:
    """Times (s) and magnitudes (°/s) of the samples' angular rate, less the static start's bias."""
    if not len(run.samples):
        return np.empty(0), np.empty(0)
    bias = run.aligns.rows["bias"][-1] / 2**20 if len(run.aligns) else np.zeros(3)
    counts = run.samples.rows["gyro"] - bias
    return (
        run.time_of_tick(run.samples.tick),
        np.linalg.norm(counts, axis=1) / mpu9150.GYRO_LSB_PER_DPS,
    )


def _draw(figure: Any, walk: _Walk, title: str) -> None:
    """All panels: on the left the place and the close-up, on the right the whole walk over time."""
    figure.text(0.05, 0.966, title, fontsize=15, fontweight="bold", color=INK)
    figure.text(0.05, 0.942, _caption(walk), fontsize=10.5, color=GREY)
    left, right = figure.add_gridspec(
        1, 2, left=0.05, right=0.95, bottom=0.055, top=0.905, wspace=0.13
    )
    place, close = left.subgridspec(2, 1, height_ratios=(1.0, 0.85), hspace=0.17)
    whole = right.subgridspec(3, 1, hspace=0.22).subplots(sharex=True)
    details = close.subgridspec(3, 1, height_ratios=(1.35, 1, 1), hspace=0.12).subplots(sharex=True)

    _trajectory(figure.add_subplot(place), walk)
    _height(whole[0], walk)
    _velocity(whole[1], walk)
    _filter(whole[2], walk)
    window = _window(walk)
    for axes in whole:
        axes.axvspan(*window, color="#F0E442", alpha=0.35, linewidth=0)
        axes.set_xlim(walk.time[0], walk.time[-1])
    whole[0].set_title("Height")
    whole[1].set_title("Velocity")
    _close_up(details, walk, window)
    for axes in (whole[-1], details[-1]):
        axes.set_xlabel("time from the first sample, s")
    figure.align_ylabels([*whole, *details])


def _caption(walk: _Walk) -> str:
    """The walk's figures in a line."""
    figures = walk.figures
    parts = [
        f"{figures.distance_m:.1f} m in {figures.steps} steps, {figures.duration_s:.0f} s",
    ]
    closure = figures.closure
    if closure.meaningful:
        share = f" ({closure.horizontal_share:.2%})" if closure.horizontal_share else ""
        parts.append(
            f"loop closes to {closure.horizontal_m:.2f} m{share}, height {closure.vertical_m:+.2f} m"
        )
    if walk.comparison is not None:
        comparison = walk.comparison
        how = {"none": "as it is", "yaw": "turned and shifted to fit"}[comparison.alignment.mode]
        error = rmse(comparison.error)
        height = "" if error.up is None else f", height {error.up:.2f} m"
        parts.append(
            f"RMSE {error.horizontal:.2f} m{height}, final error "
            f"{np.hypot(*comparison.error[-1, :2]):.2f} m "
            f"({comparison.alignment.points} points of truth, {how})"
        )
    return "   ·   ".join(parts)


def _trajectory(axes: Any, walk: _Walk) -> None:
    every = max(1, len(walk.position) // _PATH_POINTS)
    path = walk.position[::every]
    axes.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=1.1, label="estimate", zorder=3)
    steps = walk.position[walk.steps]
    axes.plot(
        *steps[:, :2].T, "o", color=BLUE, markersize=3.2, markeredgewidth=0, label="steps", zorder=4
    )
    shown = [path[:, :2]]
    if walk.truth is not None and walk.comparison is not None:
        truth = walk.comparison.alignment.moved(walk.truth.position_enu)
        _truth_line(axes, walk.truth.time_s, truth[:, 0], truth[:, 1])
        shown.append(truth[np.isfinite(truth[:, 0]), :2])
    for row, marker, label in ((0, "^", "start"), (-1, "s", "end")):
        axes.plot(
            *walk.position[row, :2],
            marker,
            color="white",
            markeredgecolor=INK,
            markeredgewidth=1.4,
            markersize=8,
            linestyle="none",
            label=label,
            zorder=6,
        )
    _fit(axes, np.vstack(shown))
    axes.set_title("Trajectory")
    axes.set_xlabel("East, m")
    axes.set_ylabel("North, m")
    axes.legend(ncols=5, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)


def _truth_line(axes: Any, time: FloatArray, x: FloatArray, y: FloatArray) -> None:
    """The truth as a line, or as points where it comes seldom."""
    sparse = len(time) < 2 or float(np.median(np.diff(time))) > _SPARSE_S
    if sparse:
        style: dict[str, Any] = {"marker": "x", "markersize": 5.5, "linestyle": "none"}
        every = 1
    else:
        style = {"linewidth": 1.1, "linestyle": (0, (4, 2))}
        every = max(1, len(time) // _PATH_POINTS)
    axes.plot(x[::every], y[::every], color=RED, label="truth", zorder=5, **style)


def _fit(axes: Any, points: FloatArray) -> None:
    """Limits around points (n, 2), at least a metre, with equal scales that fill the panel."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre, half = (low + high) / 2, np.maximum((high - low) * 0.54, 0.5)
    axes.set_xlim(centre[0] - half[0], centre[0] + half[0])
    axes.set_ylim(centre[1] - half[1], centre[1] + half[1])
    axes.set_aspect("equal", adjustable="datalim")


def _height(axes: Any, walk: _Walk) -> None:
    axes.plot(*_envelope(walk.time, walk.position[:, 2]), color=BLUE, linewidth=1.0, label="estimate")
    if walk.truth is not None and walk.comparison is not None:
        up = walk.comparison.alignment.moved(walk.truth.position_enu)[:, 2]
        if np.isfinite(up).any():
            _truth_line(axes, walk.truth.time_s, walk.truth.time_s, up)
    axes.set_ylabel("Up, m")


def _velocity(axes: Any, walk: _Walk) -> None:
    for axis, (name, colour) in enumerate(zip("ENU", AXIS_COLOURS, strict=True)):
        line = _envelope(walk.time, walk.velocity[:, axis])
        axes.plot(*line, color=colour, linewidth=0.8, alpha=0.85, label=name)
    _shade(axes, walk)
    axes.set_ylabel("velocity, m/s")


def _filter(axes: Any, walk: _Walk) -> None:
    """M and N_eff where they have a meaning: in stance."""
    stood = np.where(walk.stance, 1.0, np.nan)
    other = axes.twinx()
    axes.plot(*_envelope(walk.time, walk.n_eff * stood), color=BLUE, linewidth=0.8)
    other.plot(*_envelope(walk.time, walk.threshold * stood), color=RED, linewidth=0.9)
    marks = np.full(len(walk.lockouts), 0.97)
    axes.plot(
        walk.time[walk.lockouts], marks, "v", color=INK, transform=axes.get_xaxis_transform()
    )
    axes.set_title(
        f"Particles in stance: {walk.resampled} resamplings, {len(walk.lockouts)} lock-outs (▼)"
    )
    axes.set_ylim(0, 110)
    other.set_ylim(0, 0.55)
    _own_axis(axes, other, ("effective sample size N_eff", BLUE), ("threshold M", RED))


def _own_axis(axes: Any, other: Any, left: tuple[str, str], right: tuple[str, str]) -> None:
    """Twin axes, each labelled in the colour of its line."""
    other.grid(False)
    other.spines["right"].set_visible(True)
    for side, (label, colour) in ((axes, left), (other, right)):
        side.set_ylabel(label, color=colour)
        side.tick_params(axis="y", colors=colour)


def _window(walk: _Walk) -> tuple[float, float]:
    """`ZOOM_S` seconds around the step in mid-walk, or around the middle."""
    start, end = float(walk.time[0]), float(walk.time[-1])
    middle = float(walk.time[walk.steps[len(walk.steps) // 2]]) if len(walk.steps) else (start + end) / 2
    begin = max(start, min(middle - ZOOM_S / 2, end - ZOOM_S))
    return begin, max(min(begin + ZOOM_S, end), begin + 0.1)


def _close_up(panels: Any, walk: _Walk, window: tuple[float, float]) -> None:
    """Velocity and the detector's signals, sample by sample."""
    speed, force, rate = panels
    poses = _within(walk.time, window)
    samples = _within(walk.rate_time, window)
    time = walk.time[poses]
    for axis, (name, colour) in enumerate(zip("ENU", AXIS_COLOURS, strict=True)):
        speed.plot(time, walk.velocity[poses, axis], color=colour, linewidth=1.2, label=name)
    speed.set_ylabel("velocity, m/s")
    speed.set_title(f"{window[1] - window[0]:.0f} seconds from close up (stance shaded)")
    speed.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)

    force.plot(time, walk.acc_norm[poses], color=INK, linewidth=1.0)
    force.set_ylabel("|a|, m/s²")
    rate.plot(walk.rate_time[samples], walk.rate[samples], color=INK, linewidth=1.0)
    rate.set_ylabel("|ω|, °/s")
    rate.set_yscale("log")
    if not len(walk.rate_time):
        rate.text(0.5, 0.5, "no samples in this capture", transform=rate.transAxes, ha="center")
    for axes, name in ((force, "acc_min"), (force, "acc_max"), (rate, "rate_max")):
        if name in walk.limits:
            axes.axhline(walk.limits[name], color=PURPLE, linewidth=1.0, linestyle=(0, (4, 2)))
    for axes in panels:
        axes.set_xlim(*window)
        _shade(axes, walk)


def _within(time: FloatArray, window: tuple[float, float]) -> slice:
    first, last = np.searchsorted(time, window)
    return slice(max(0, int(first) - 1), int(last) + 1)


def _shade(axes: Any, walk: _Walk) -> None:
    """Shade the stances that are wide enough to be seen in the panel."""
    change = np.flatnonzero(np.diff(walk.stance.astype(int), prepend=0, append=0))
    start, stop = walk.time[change[::2]], walk.time[np.minimum(change[1::2], len(walk.time) - 1)]
    left, right = axes.get_xlim()
    shown = (stop - start > (right - left) * _THINNEST) & (stop > left) & (start < right)
    axes.broken_barh(
        np.column_stack([start, stop - start])[shown].tolist(),
        (0, 1),
        transform=axes.get_xaxis_transform(),
        facecolor=STANCE,
        linewidth=0,
        zorder=0,
    )


def _envelope(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A line that looks the same with fewer points: least and largest value of each stretch."""
    size = len(time) // (_LINE_POINTS // 2)
    if size < 2:
        return time, values
    count = len(time) // size
    blocks = values[: count * size].reshape(count, size)
    some = np.isfinite(blocks).any(axis=1)
    pairs = np.full((count, 2), np.nan)
    pairs[some, 0] = np.nanmin(blocks[some], axis=1)
    pairs[some, 1] = np.nanmax(blocks[some], axis=1)
    return np.repeat(time[: count * size : size], 2), pairs.ravel()
