"""One picture of a walk: where it went, how the filter fared, and five seconds of it from close up.

Colours are Okabe and Ito's, which the colour-blind can tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import mpu9150, parameters
from solenav.capture.contents import Capture
from solenav.errors import SolenavError, unwritable
from solenav.evaluation import Comparison, Evaluation, compare, last_run, lay, measure, rmse
from solenav.pdr.track import StepTrack
from solenav.recording import FloatArray, Truth
from solenav_core import messages

SIZE_IN = (14.0, 10.0)
DPI = 110
ZOOM_S = 5.0

BLUE, RED, GREEN, PURPLE, YELLOW = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#F0E442"
INK, GREY, SHADE, DARK_PURPLE = "#222222", "#666666", "#E6E6E6", "#9E4B77"
_AXES = (("E", BLUE), ("N", RED), ("U", GREEN))
DASHED = (0, (4, 2))
LEGEND = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}

STYLE = {
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
# Truth that comes at longer intervals is drawn as points: nobody knows the way between them.
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


def plot(capture: Capture, out: Path | str, *, title: str | None = None) -> None:
    """Draw a capture with poses into a PNG of `SIZE_IN` inches at `DPI`.

    Truth, where there is some, is laid onto the estimate as `solenav.evaluation` does.
    Raises SolenavError without poses or matplotlib, and where `out` can't be written.
    """
    walk = _gather(capture)
    with sheet(Path(out), SIZE_IN) as figure:
        _head(
            figure,
            title or str(capture.sidecar.get("name") or capture.path.stem),
            str(capture.sidecar.get("source", "")),
            _caption(walk),
        )
        _draw(figure, walk)


def plot_steps(walk: StepTrack, out: Path, *, truth: Truth | None = None) -> None:
    """Draw steps, a foot's or a waist's, into a PNG: where each ended and how long it was.

    `truth` is laid onto the steps as `solenav.evaluation` does. Raises SolenavError as `plot` does.
    """
    where, lengths = walk.position, np.hypot(walk.displacement[:, 0], walk.displacement[:, 1])
    known = truth.time_s if truth is not None else np.empty(0)
    laid = np.empty((0, 3))
    if truth is not None and len(known):
        at_rest = np.zeros_like(where)
        compared = lay(walk.position_s, where, at_rest, truth, name=walk.name)
        laid = compared.alignment.moved(truth.position_enu)
    with sheet(out, (10.0, 8.0)) as figure:
        figure.set_layout_engine("constrained")
        way, length = figure.subplots(2, 1, height_ratios=(4, 1))
        way.plot(where[:, 0], where[:, 1], ".-", color=BLUE, linewidth=0.9, markersize=4)
        way.plot(*where[0, :2], "o", color=GREY, label="start")
        if len(laid):
            _truth(way, known, laid[:, 0], laid[:, 1])
        way.set_aspect("equal", adjustable="datalim")
        way.set_title(f"{walk.name}: {len(walk)} steps of the {walk.source}")
        way.set_xlabel("x or East, m")
        way.set_ylabel("y or North, m")
        way.legend(ncols=2, **LEGEND)
        length.plot(walk.time_s, lengths, ".", color=BLUE)
        length.set_ylim(bottom=0)
        length.set_ylabel("length, m")
        length.set_xlabel("s")


@contextmanager
def sheet(out: Path, size_in: tuple[float, float], dpi: int = DPI) -> Iterator[Any]:
    """A white matplotlib figure in this module's style, written as a PNG afterwards.

    SolenavError without matplotlib, and where `out` can't be written.
    """
    try:
        matplotlib = import_module("matplotlib")
        figures = import_module("matplotlib.figure")
    except ImportError:
        raise SolenavError("plotting needs matplotlib", "pip install 'solenav[plot]'") from None
    with matplotlib.rc_context(STYLE):
        figure = figures.Figure(figsize=size_in, dpi=dpi, facecolor="white")
        yield figure
        try:
            figure.savefig(out, format="png")
        except OSError as error:
            raise unwritable(out, error, exit_code=1) from None


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
        limits=_limits(params) if params else {},
        figures=figures,
        truth=known,
        comparison=compare(run, known) if known is not None else None,
    )


def _limits(params: dict[str, int]) -> dict[str, float]:
    """The detector's limits in m/s² and °/s."""
    return {
        "acc_min": params["ACC_MIN"] / 2**7,
        "acc_max": params["ACC_MAX"] / 2**7,
        "rate_max": params["RATE_MAX"] / 2**2 / mpu9150.GYRO_LSB_PER_DPS,
    }


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


def _head(figure: Any, title: str, source: str, caption: str) -> None:
    """What the picture shows and where it's from, over all panels."""
    # A file's name may hold what matplotlib takes for a formula.
    plain = {"parse_math": False}
    figure.text(0.055, 0.968, title, fontsize=15, fontweight="bold", color=INK, **plain)
    figure.text(0.95, 0.968, source, fontsize=10.5, color=GREY, ha="right", **plain)
    figure.text(0.055, 0.945, caption, fontsize=10.5, color=GREY)


def _draw(figure: Any, walk: _Walk) -> None:
    """All panels: on the left the place and the close-up, on the right the whole walk over time."""
    left, right = figure.add_gridspec(
        1, 2, left=0.055, right=0.95, bottom=0.05, top=0.905, wspace=0.22
    )
    place, close = left.subgridspec(2, 1, height_ratios=(1.0, 1.08), hspace=0.2)
    whole = right.subgridspec(3, 1, hspace=0.16).subplots(sharex=True)
    details = close.subgridspec(4, 1, height_ratios=(1.3, 1, 1, 1), hspace=0.18).subplots(
        sharex=True
    )
    window = _window(walk)
    _trajectory(figure.add_subplot(place), walk, window)
    _whole(whole, walk)
    for axes in whole:
        axes.axvspan(*window, color=YELLOW, alpha=0.3, linewidth=1, zorder=0.5)
    _close_up(details, walk, window)
    for panels in (whole, details):
        panels[-1].set_xlabel("time from the first sample, s")
        for axes in panels:
            axes.yaxis.set_label_coords(-0.1, 0.5)


def _caption(walk: _Walk) -> str:
    """The walk's figures in a line."""
    figures = walk.figures
    parts = [f"{figures.distance_m:.1f} m in {figures.steps} steps and {figures.duration_s:.0f} s"]
    closure = figures.closure
    if closure.meaningful:
        share = f" ({closure.horizontal_share:.2%})" if closure.horizontal_share else ""
        parts.append(
            f"a loop that ends {closure.horizontal_m:.2f} m from its start{share}, "
            f"in height {closure.vertical_m:+.2f} m"
        )
    if walk.comparison is not None:
        fitted = ", fitted by yaw and shift" if walk.comparison.alignment.mode == "yaw" else ""
        error = rmse(walk.comparison.error)
        final = np.hypot(*walk.comparison.error[-1, :2])
        parts.append(
            f"RMSE {error.horizontal:.2f} m, at the end {final:.2f} m, horizontally "
            f"({walk.comparison.alignment.points} points of truth{fitted})"
        )
    return "   ·   ".join(parts)


def _trajectory(axes: Any, walk: _Walk, window: tuple[float, float]) -> None:
    """The way in the plane, with the foot's stands, the truth, and the close-up's stretch."""
    east, north = walk.position[:, :2].T
    every = max(1, len(east) // _PATH_POINTS)
    close = _within(walk.time, window)
    axes.plot(
        east[close], north[close], color=YELLOW, alpha=0.6, linewidth=7, solid_capstyle="round"
    )
    axes.plot(east[::every], north[::every], color=BLUE, linewidth=1.1, label="estimate", zorder=3)
    axes.plot(
        east[walk.steps], north[walk.steps], ".", color=BLUE, markersize=6, label="steps", zorder=4
    )
    shown = walk.position[::every]
    if walk.truth is not None and walk.comparison is not None:
        truth = walk.comparison.alignment.moved(walk.truth.position_enu)
        _truth(axes, walk.truth.time_s, truth[:, 0], truth[:, 1])
        shown = np.vstack([shown, truth[np.isfinite(truth[:, 0])]])
    # Of two sizes, so that both show where a loop closes.
    for row, marker, size, fill, label in (
        (0, "o", 13, "none", "start"),
        (-1, "s", 7, "white", "end"),
    ):
        axes.plot(
            east[row],
            north[row],
            marker,
            markerfacecolor=fill,
            markeredgecolor=INK,
            markeredgewidth=1.4,
            markersize=size,
            linestyle="none",
            label=label,
            zorder=6,
        )
    fit(axes, shown[:, :2])
    axes.set_title("Trajectory")
    axes.set_xlabel("East, m", labelpad=1)
    axes.set_ylabel("North, m")
    axes.legend(ncols=5, **LEGEND)


def _truth(axes: Any, time: FloatArray, x: FloatArray, y: FloatArray) -> None:
    """The truth as a line, or as points where it comes seldom."""
    sparse = len(time) < 2 or float(np.median(np.diff(time))) > _SPARSE_S
    every = 1 if sparse else max(1, len(time) // _PATH_POINTS)
    style: dict[str, Any] = {"linewidth": 1.1, "linestyle": DASHED}
    if sparse:
        style = {"marker": "x", "markersize": 5.5, "linestyle": "none"}
    axes.plot(x[::every], y[::every], color=RED, label="truth", zorder=5, **style)


def fit(axes: Any, points: FloatArray) -> None:
    """Limits around points (n, 2), at least a metre, with equal scales that fill the panel."""
    low, high = points.min(axis=0), points.max(axis=0)
    panel = axes.get_position().size * axes.figure.get_size_inches()
    scale = max(np.max((high - low) * 1.1 / panel), 1.0 / panel.min())
    left, bottom = (low + high - scale * panel) / 2
    axes.set(xlim=(left, left + scale * panel[0]), ylim=(bottom, bottom + scale * panel[1]))
    axes.set_aspect("equal")


def _whole(panels: Any, walk: _Walk) -> None:
    """Height, velocity and filter over the whole walk."""
    height, velocity, particles = panels
    height.set_xlim(walk.time[0], max(walk.time[-1], walk.time[0] + 0.1))
    up = walk.position[:, 2]
    height.plot(*envelope(walk.time, up), color=BLUE, linewidth=0.8, alpha=0.5, label="in swing")
    stood = np.where(walk.stance, up, np.nan)
    height.plot(*envelope(walk.time, stood), color=BLUE, linewidth=2.2, label="in stance")
    if walk.truth is not None and walk.comparison is not None:
        truth = walk.comparison.alignment.moved(walk.truth.position_enu)[:, 2]
        if np.isfinite(truth).any():
            _truth(height, walk.truth.time_s, walk.truth.time_s, truth)
    height.set_title("Height")
    height.set_ylabel("Up, m")
    at_least(height, 0.1)
    height.locator_params(axis="y", nbins=6)
    height.legend(ncols=3, **LEGEND)

    # Up first: it would hide the others, which matter more.
    for axis, (name, colour) in reversed(list(enumerate(_AXES))):
        line = envelope(walk.time, walk.velocity[:, axis])
        velocity.plot(*line, color=colour, linewidth=0.8, label=name)
    _shade(velocity, walk)
    velocity.set_title("Velocity (stance shaded)")
    velocity.set_ylabel("m/s")
    at_least(velocity, 0.1)
    velocity.legend(
        *[side[::-1] for side in velocity.get_legend_handles_labels()], ncols=3, **LEGEND
    )

    _filter(particles, walk)
    particles.plot(
        walk.time[walk.lockouts],
        np.full(len(walk.lockouts), 0.97),
        "v",
        color=INK,
        transform=particles.get_xaxis_transform(),
    )
    particles.set_title(
        f"Particle filter in stance: {walk.resampled} resamplings, {len(walk.lockouts)} lock-outs"
        + (" (▼)" if len(walk.lockouts) else "")
    )


def at_least(axes: Any, span: float) -> None:
    """Widen the vertical limits to a span that makes noise look like noise."""
    low, high = axes.get_ylim()
    more = max(0.0, span - (high - low)) / 2
    axes.set_ylim(low - more, high + more)


def _filter(axes: Any, walk: _Walk, part: slice = slice(None), alpha: float = 0.5) -> None:
    """N_eff and M of a part of the poses, in stance, where they mean something."""
    time, swing = walk.time[part], ~walk.stance[part]
    other = axes.twinx()
    for side, values, top, colour, label, shown in (
        (axes, walk.n_eff, 110.0, BLUE, "N_eff", alpha),
        (other, walk.threshold, 0.55, RED, "threshold M", 1.0),
    ):
        line = envelope(time, np.where(swing, np.nan, values[part]))
        side.plot(*line, color=colour, alpha=shown, linewidth=1.0)
        side.set_ylim(0, top)
        side.set_ylabel(label, color=colour)
        side.tick_params(axis="y", colors=colour)
    other.grid(False)
    other.spines["right"].set_visible(True)


def _window(walk: _Walk) -> tuple[float, float]:
    """`ZOOM_S` seconds around the step in mid-walk, or around the middle."""
    start, end = float(walk.time[0]), float(walk.time[-1])
    middle = (
        float(walk.time[walk.steps[len(walk.steps) // 2]]) if len(walk.steps) else (start + end) / 2
    )
    begin = max(start, min(middle - ZOOM_S / 2, end - ZOOM_S))
    return begin, max(min(begin + ZOOM_S, end), begin + 0.1)


def _close_up(panels: Any, walk: _Walk, window: tuple[float, float]) -> None:
    """Velocity, the detector's signals and the filter, sample by sample."""
    speed, force, rate, particles = panels
    poses = _within(walk.time, window)
    samples = _within(walk.rate_time, window)
    time = walk.time[poses]
    for axis, (name, colour) in enumerate(_AXES):
        speed.plot(time, walk.velocity[poses, axis], color=colour, linewidth=1.2, label=name)
    speed.set_title(f"{window[1] - window[0]:.0f} s from close up (yellow)")
    speed.set_ylabel("m/s")
    at_least(speed, 0.1)
    speed.legend(ncols=3, **LEGEND)

    force.plot(time, walk.acc_norm[poses], color=INK, linewidth=1.0)
    force.set_ylabel("|a|, m/s²")
    # The impacts may leave the panel: the limits must be readable.
    force.set_ylim(0, np.clip(1.1 * walk.acc_norm[poses].max(), 15, 40))
    rate.set_ylabel("|ω|, °/s")
    shown = walk.rate[samples]
    if len(shown):
        rate.plot(walk.rate_time[samples], shown, color=INK, linewidth=1.0)
        # From the noise of a standing foot up, in whole powers of ten.
        low = np.clip(np.floor(np.log10(np.percentile(shown, 5) + 1e-9)), -1, 1)
        high = max(np.ceil(np.log10(shown.max() + 1e-9)), 2)
        rate.set(yscale="log", ylim=(10**low, 10**high), yticks=10 ** np.arange(low, high + 1))
        rate.minorticks_off()
        rate.yaxis.set_major_formatter("{x:g}")
    else:
        rate.set_yticks(())
        rate.text(0.5, 0.5, "no samples in this capture", transform=rate.transAxes, ha="center")
    for axes, name, text in (
        (force, "acc_min", ""),
        (force, "acc_max", "C1"),
        (rate, "rate_max", "C2"),
    ):
        if name in walk.limits:
            _limit(axes, walk.limits[name], text)
    _filter(particles, walk, poses, 1.0)
    force.set_xlim(*window)
    for axes in panels:
        _shade(axes, walk)


def _limit(axes: Any, value: float, text: str) -> None:
    """A limit of the detector, named at its end."""
    axes.axhline(value, color=PURPLE, linewidth=1.3, linestyle=DASHED)
    axes.text(
        1.01, value, text, color=DARK_PURPLE, va="center", transform=axes.get_yaxis_transform()
    )


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
        facecolor=SHADE,
        linewidth=0,
        zorder=0,
    )


def envelope(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A line (n,) that looks the same with fewer points: least and largest of each stretch."""
    size = len(time) // (_LINE_POINTS // 2)
    if size < 2:
        return time, values
    # NaN is "nothing here": it fills up the last stretch.
    blocks = np.append(values, np.full(-len(values) % size, np.nan)).reshape(-1, size)
    some = np.isfinite(blocks).any(axis=1)
    pairs = np.full((len(blocks), 2), np.nan)
    pairs[some, 0] = np.nanmin(blocks[some], axis=1)
    pairs[some, 1] = np.nanmax(blocks[some], axis=1)
    return np.repeat(time[::size], 2), pairs.ravel()
