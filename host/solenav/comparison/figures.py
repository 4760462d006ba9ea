"""Pictures of a comparison, as in the paper: tracks, errors over time, and boxes over many runs.

The style is that of `solenav.plotting`. Up to `LINES` filters share a picture of lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.comparison.faults import stances
from solenav.comparison.metrics import LOST_SHARE, score
from solenav.comparison.runs import Run
from solenav.evaluation import Comparison, lay
from solenav.filters import named
from solenav.filters.walk import Track, Walk
from solenav.plotting import (
    BLUE,
    DASHED,
    GREEN,
    GREY,
    INK,
    PURPLE,
    RED,
    at_least,
    envelope,
    fit,
    sheet,
)
from solenav.recording import FloatArray

LINES = 6
DPI = 100

ORANGE, SKY = "#E69F00", "#56B4E9"
# The further down, the nearer to the reader: what matters most is drawn last.
_COLOURS = {
    "ins": "#BBBBBB",
    "apf-literal": "#999999",
    "reset": ORANGE,
    "pf": GREEN,
    "ekf15": "#8C510A",
    "ekf": RED,
    "apf-float": SKY,
    "kf-twin": PURPLE,
    "apf": BLUE,
}
# Which filters a picture of lines shows where there are more than it holds.
_FIRST = ("apf", "ekf", "pf", "kf-twin", "reset", "ekf15", "apf-literal")
_AXES = ("E", "N", "U")
# An error so many times the middle one's leaves the picture.
_FAR = 8.0
_WIDTH_IN = 6.2
_PATH_POINTS = 20000
# A truth that comes more seldom is drawn as points.
_SPARSE_S = 0.25


def draw(walk: Walk, filters: Sequence[str], folder: Path, stem: str | None = None) -> list[Path]:
    """Tracks, velocity error and, where the truth is known, position error of one walk.

    The PNGs in `folder` begin with `stem`, by default the walk's name. SolenavError without
    matplotlib or where they can't be written.
    """
    tracks = {name: named(name)(walk) for name in chosen(filters)}
    stem = stem or walk.name.replace("/", "_")
    out = [folder / f"{stem}-tracks.png", folder / f"{stem}-velocity.png"]
    draw_tracks(walk, tracks, out[0])
    draw_velocity_error(walk, tracks, out[1])
    if walk.truth is not None and len(walk.truth.time_s):
        out.append(folder / f"{stem}-position.png")
        draw_position_error(walk, tracks, out[2])
    return out


@contextmanager
def _sheet(out: Path, size_in: tuple[float, float]) -> Iterator[Any]:
    """A figure of `solenav.plotting` in few colours: lines need no more, and take less."""
    with sheet(out, size_in, DPI) as figure:
        yield figure
    # matplotlib can't be without it.
    image = import_module("PIL.Image")
    with image.open(out) as picture:
        # This method keeps the rare ones.
        few = picture.convert("RGB").quantize(
            method=image.Quantize.MAXCOVERAGE, dither=image.Dither.NONE
        )
    few.save(out, optimize=True)


def chosen(filters: Sequence[str]) -> list[str]:
    """At most `LINES` of the filters, the least important first."""
    names = list(dict.fromkeys(filters))
    if len(names) > LINES:
        plain = [name for name in _FIRST if name in names]
        names = [*plain, *(name for name in names if name not in plain)][:LINES]
    order = list(_COLOURS)
    return sorted(names, key=lambda name: (order.index(_base(name)), name))


def _base(name: str) -> str:
    return name.partition("+")[0]


def _line(name: str) -> dict[str, Any]:
    """A filter's colour; with aids, dashes."""
    aids = name.count("+")
    dashes = ("-", (0, (5, 1.5)), (0, (2, 1)))[min(aids, 2)]
    width = 1.6 if _base(name) == "apf" else 1.2
    return {"color": _COLOURS[_base(name)], "linestyle": dashes, "linewidth": width}


def _legend(figure: Any, axes: Any, title: str, caption: str, columns: int = 4) -> None:
    """Title, caption and one legend for the whole picture, above it."""
    height = figure.get_size_inches()[1]
    figure.text(
        0.02,
        1 - 0.28 / height,
        title,
        fontsize=12.5,
        fontweight="bold",
        color=INK,
        parse_math=False,
    )
    figure.text(0.02, 1 - 0.49 / height, caption, fontsize=9.5, color=GREY)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles[::-1],
        labels[::-1],
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.52 / height),
        ncols=columns,
        fontsize=9,
        columnspacing=1.4,
        handlelength=2.4,
    )


def draw_tracks(walk: Walk, tracks: Mapping[str, Track], out: Path) -> None:
    """The ways in the plane, and the truth. A track that is lost may leave the picture."""
    first = walk.start.row + 1
    ways = {name: track.position[first:, :2] for name, track in tracks.items()}
    # The truth is laid onto each estimate; drawn is how it lies on the last, which matters most.
    last, track = list(tracks.items())[-1]
    laid = _laid(walk, track)
    kept = [ways[name] for name, track in tracks.items() if _bounded(walk, track)]
    if laid is not None:
        kept.append(laid.reference[:, :2])
    shown = np.vstack(kept or [np.zeros((1, 2))])
    height = _WIDTH_IN * float(np.clip(_slope(shown), 0.3, 0.9))
    with _sheet(out, (_WIDTH_IN + 0.9, height + 1.6)) as figure:
        wide, high = figure.get_size_inches()
        axes = figure.add_axes((0.7 / wide, 0.5 / high, _WIDTH_IN / wide, height / high))
        for name, way in ways.items():
            every = max(1, len(way) // _PATH_POINTS)
            axes.plot(*way[::every].T, label=name, zorder=3, **_line(name))
            axes.plot(*way[-1], "s", color=_COLOURS[_base(name)], markersize=6, zorder=5)
        if laid is not None:
            style: dict[str, Any] = {"linestyle": DASHED, "linewidth": 1.3}
            if _sparse(laid.time_s):
                style = {"linestyle": "none", "marker": "x", "markersize": 6}
            axes.plot(*laid.reference[:, :2].T, color=INK, label="truth", zorder=4, **style)
        axes.plot(0, 0, "o", markersize=11, markerfacecolor="none", markeredgecolor=INK, zorder=6)
        fit(axes, shown)
        axes.set_xlabel("East, m")
        axes.set_ylabel("North, m")
        _legend(figure, axes, walk.name, "○ start, ■ end" + _turned(laid, last))


def _bounded(walk: Walk, track: Track) -> bool:
    """Whether a track can share a picture with the others."""
    found = score(walk, track, with_evo=False)
    return found.closure_m[0] < math.inf and not found.lost


def _slope(points: FloatArray) -> float:
    """Height over width of points (n, 2)."""
    east, north = np.ptp(points, axis=0)
    return float(north / max(east, 1e-3))


def _turned(laid: Comparison | None, name: str) -> str:
    fitted = laid is not None and laid.alignment.mode == "yaw"
    return f"; truth laid onto {name} by turn and shift" if fitted else ""


def draw_velocity_error(walk: Walk, tracks: Mapping[str, Track], out: Path) -> None:
    """RMS of the velocity's error in each stance of the clean detector, per axis.

    Velocity is compared with the truth's, or with zero where that doesn't know.
    """
    first = walk.start.row + 1
    whole = stances(walk.with_stance(walk.clean))
    time = np.array([(begin + end) / 2 * walk.dt for begin, end in whole])
    known = walk.truth.velocity_enu if walk.truth is not None else None

    def error(track: Track) -> FloatArray:
        laid = _laid(walk, track)
        if laid is None or known is None:
            rows, off = np.arange(first, len(walk.counts)), track.velocity[first:]
        else:
            rows = np.rint(laid.time_s * walk.rate_hz).astype(np.intp)
            off = laid.velocity - laid.alignment.turned(known[laid.rows])
        sums = np.vstack([np.zeros(3), np.cumsum(off**2, axis=0)])
        edges = np.searchsorted(rows, whole).reshape(-1, 2)
        count = np.maximum(edges[:, 1] - edges[:, 0], 1)[:, None]
        mean = (sums[edges[:, 1]] - sums[edges[:, 0]]) / count
        # Exactly none has no place on a logarithmic scale.
        return np.sqrt(np.where(mean > 0, mean, np.nan))

    _over_time(
        walk,
        {name: (time, error(track)) for name, track in tracks.items()},
        "velocity error",
        f"RMS of {'estimate less truth' if known is not None else 'the velocity'} in each stance",
        "m/s",
        out,
    )


def draw_position_error(walk: Walk, tracks: Mapping[str, Track], out: Path) -> None:
    """Position less the truth's. ValueError for a walk without truth."""
    errors = {}
    fitted = ""
    for name, track in tracks.items():
        laid = _laid(walk, track)
        if laid is None:
            raise ValueError("no truth")
        errors[name] = (laid.time_s, laid.error)
        if laid.alignment.mode == "yaw":
            fitted = ", each fitted by turn and shift"
    _over_time(walk, errors, "position error", f"estimate less truth{fitted}", "m", out)


def _over_time(
    walk: Walk,
    errors: Mapping[str, tuple[FloatArray, FloatArray]],
    what: str,
    caption: str,
    unit: str,
    out: Path,
) -> None:
    """Errors (n, 3) at times (n,) by filter, a panel an axis; all above zero on a log scale."""
    everything = np.vstack([off for _time, off in errors.values()])
    shown = [axis for axis in range(3) if np.isfinite(everything[:, axis]).any()]
    positive = not (everything < 0).any()
    with _sheet(out, (9.0, 1.6 + 1.6 * len(shown))) as figure:
        high = figure.get_size_inches()[1]
        panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        figure.subplots_adjust(
            left=0.085, right=0.98, top=1 - 1.02 / high, bottom=0.48 / high, hspace=0.14
        )
        for axes, axis in zip(panels, shown, strict=True):
            spans = []
            for name, (time, off) in errors.items():
                dots = {"marker": ".", "markersize": 4} if _sparse(time) else {}
                axes.plot(*envelope(time, off[:, axis]), label=name, **_line(name), **dots)
                finite = off[np.isfinite(off[:, axis]), axis]
                spans.append((float(finite.min(initial=0.0)), float(finite.max(initial=0.0))))
            if positive:
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter("{x:g}")
            else:
                _limits(axes, spans)
                axes.axhline(0, color=INK, linewidth=0.7, zorder=2)
            axes.set_ylabel(f"{_AXES[axis]}, {unit}")
        panels[-1].set_xlabel("time from the first sample, s")
        panels[-1].set_xlim(walk.time_s[walk.start.row], walk.time_s[-1])
        figure.align_ylabels(panels)
        _legend(figure, panels[0], f"{walk.name}: {what}", caption)


def _limits(axes: Any, spans: list[tuple[float, float]]) -> None:
    """Wide enough for zero and all lines, but for those that are far off the middle one."""
    sizes = [max(-low, high) for low, high in spans]
    kept = [span for span, size in zip(spans, sizes, strict=True) if size <= _FAR * median(sizes)]
    low, high = min(span[0] for span in kept), max(span[1] for span in kept)
    room = 0.08 * (high - low)
    axes.set_ylim(low - room, high + room)
    at_least(axes, 0.02)


def draw_boxes(runs: Sequence[Run], out: Path, title: str = "Horizontal error") -> None:
    """A box a filter: quartiles of the error as a share of the distance, whiskers to 5 and 95 %.

    ValueError where no run's error is known.
    """
    shares: dict[str, list[float]] = {}
    for run in runs:
        share = run.score.error_share
        if share is not None:
            # What ran away has no place on an axis, but a place beyond all others.
            shares.setdefault(run.filter, []).append(100 * min(share, 1e3))
    if not shares:
        raise ValueError("no error is known")
    names = list(shares)
    with _sheet(out, (7.6, 1.5 + 0.33 * len(names))) as figure:
        height = figure.get_size_inches()[1]
        axes = figure.add_axes((0.2, 0.55 / height, 0.77, 1 - 1.2 / height))
        boxes = axes.boxplot(
            [shares[name] for name in names],
            orientation="horizontal",
            whis=(5, 95),
            widths=0.62,
            patch_artist=True,
            medianprops={"color": INK, "linewidth": 1.6},
            whiskerprops={"color": GREY},
            capprops={"color": GREY},
            flierprops={"marker": ".", "markersize": 4, "markeredgecolor": GREY},
        )
        for patch, name in zip(boxes["boxes"], names, strict=True):
            patch.set(facecolor=_COLOURS[_base(name)], alpha=0.75, edgecolor=INK, linewidth=0.8)
        axes.set_yticks(range(1, len(names) + 1), names, color=INK)
        axes.invert_yaxis()
        axes.axvline(100 * LOST_SHARE, color=INK, linestyle=DASHED, linewidth=1.0)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.grid(axis="y", visible=False)
        axes.set_xlabel(f"error, % of the distance (dashed: lost, {LOST_SHARE:.0%})")
        count = (
            f"{min(map(len, shares.values()))} runs a filter; box: quartiles, whiskers: 5 to 95 %"
        )
        figure.text(0.02, 1 - 0.28 / height, title, fontsize=12.5, fontweight="bold", color=INK)
        figure.text(0.02, 1 - 0.49 / height, count, fontsize=9.5, color=GREY)


def draw_curves(
    panels: Mapping[str, Mapping[str, Sequence[tuple[float, float]]]], out: Path, title: str
) -> None:
    """Error against share of faults, both in %: a panel a kind of fault, a line a filter."""
    names = sorted(
        dict.fromkeys(name for lines in panels.values() for name in lines),
        key=lambda name: (list(_COLOURS).index(_base(name)), name),
    )
    with _sheet(out, (3.4 * len(panels) + 0.6, 4.8)) as figure:
        high = figure.get_size_inches()[1]
        found = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        figure.subplots_adjust(
            left=0.065, right=0.985, top=1 - 1.1 / high, bottom=0.5 / high, wspace=0.06
        )
        for axes, (kind, lines) in zip(found, panels.items(), strict=True):
            for name in names:
                x, y = zip(*lines[name], strict=True)
                axes.plot(x, y, marker=".", markersize=6, label=name, **_line(name))
            axes.axhline(100 * LOST_SHARE, color=INK, linestyle=DASHED, linewidth=0.9, zorder=1)
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.set_xlabel(f"{kind}, %")
            axes.set_xticks(x)
        found[0].set_ylabel("median error, % of the distance")
        _legend(figure, found[0], title, f"dashed line: lost, {LOST_SHARE:.0%}", columns=6)


def _laid(walk: Walk, track: Track) -> Comparison | None:
    if walk.truth is None or not len(walk.truth.time_s):
        return None
    first = walk.start.row + 1
    return lay(
        walk.time_s[first:],
        track.position[first:],
        track.velocity[first:],
        walk.truth,
        name=walk.name,
    )


def _sparse(time_s: FloatArray | NDArray[Any]) -> bool:
    return len(time_s) < 2 or float(np.median(np.diff(time_s))) > _SPARSE_S
