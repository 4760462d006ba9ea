"""Pictures of magnetic maps and of walks on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from solenav.magmap.grid import MagneticMap
from solenav.magmap.positioning import Located
from solenav.magmap.surveying import Variogram, variograms_of
from solenav.plotting import BLUE, GREEN, GREY, INK, PURPLE, RED, sheet
from solenav.recording import FloatArray, Truth

COLOURS = {"firefly": RED, "plain": BLUE, "centroid": GREEN, "dead reckoning": PURPLE}


def draw_map(made: MagneticMap, out: Path) -> None:
    """Strength of the field, its three components' uncertainty, and variograms where kriged."""
    variograms = variograms_of(made)
    panels = 3 if variograms else 2
    with sheet(out, (5.6 * panels, 5.6), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        axes = figure.subplots(1, panels)
        strength = np.linalg.norm(made.field, axis=0)
        unsure = np.linalg.norm(made.deviation, axis=0)
        for panel, values, title, colours in (
            (axes[0], strength, "field strength, µT", "viridis"),
            (axes[1], unsure, "its deviation (all components), µT", "magma"),
        ):
            picture = _cells(panel, made, values, colours)
            figure.colorbar(picture, ax=panel, shrink=0.8)
            panel.set_title(title)
        if variograms:
            _variograms(axes[2], variograms)


def draw_tracks(
    made: MagneticMap,
    found: Mapping[str, Located | FloatArray],
    out: Path,
    *,
    truth: Truth | None = None,
    walls: Sequence[FloatArray] = (),
    plan: tuple[Any, tuple[float, float]] | None = None,
    title: str = "",
) -> None:
    """Walks over the map, the floor's polygons `walls`, or its `plan` (image, width and height)."""
    with sheet(out, (8.0, 7.0), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        draw_walks(axes, made, found, truth=truth, walls=walls, plan=plan)
        axes.set_title(title)
        axes.legend(loc="best")


def draw_walks(
    axes: Any,
    made: MagneticMap,
    found: Mapping[str, Located | FloatArray],
    *,
    truth: Truth | None = None,
    walls: Sequence[FloatArray] = (),
    plan: tuple[Any, tuple[float, float]] | None = None,
) -> None:
    """The same into one panel."""
    if plan is not None:
        image, (width, height) = plan
        axes.imshow(image, extent=(0, width, 0, height), alpha=0.6)
    else:
        _cells(axes, made, np.linalg.norm(made.field, axis=0), "Greys", alpha=0.55)
    for polygon in walls:
        closed = np.vstack([polygon, polygon[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=GREY, linewidth=1.2)
    for name, one in found.items():
        way = one.track.position if isinstance(one, Located) else one
        axes.plot(way[:, 0], way[:, 1], color=COLOURS.get(name, BLUE), linewidth=1.3, label=name)
    if truth is not None:
        points = truth.position_enu
        axes.plot(points[:, 0], points[:, 1], "x--", color=INK, linewidth=0.8, label="way points")
        low, high = points[:, :2].min(axis=0) - 6, points[:, :2].max(axis=0) + 6
        if not walls:
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.grid(False)
    axes.set_aspect("equal")
    # The map's edge is no edge for walks that begin on it.
    axes.use_sticky_edges = False
    axes.autoscale_view()
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")


def draw_errors(errors: Mapping[str, Mapping[str, FloatArray]], out: Path) -> None:
    """Cumulative distribution of errors: a panel a data set, a line a filter."""
    with sheet(out, (5.5 * len(errors), 4.5), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        panels = np.atleast_1d(figure.subplots(1, len(errors)))
        for panel, (name, of) in zip(panels, errors.items(), strict=True):
            for filter, values in of.items():
                ordered = np.sort(values)
                share = np.arange(1, len(ordered) + 1) / len(ordered)
                panel.plot(ordered, 100 * share, color=COLOURS.get(filter, BLUE), label=filter)
            panel.axhline(75, color=GREY, linewidth=0.7, linestyle=":")
            panel.set_xlim(0, 8)
            panel.set_ylim(0, 100)
            panel.set_title(name)
            panel.set_xlabel("error at a way point, m")
            panel.legend(loc="lower right")
        panels[0].set_ylabel("share of way points, %")


def _cells(
    axes: Any, made: MagneticMap, values: FloatArray, colours: str, alpha: float = 1.0
) -> Any:
    half = made.spacing / 2
    extent = (made.x[0] - half, made.x[-1] + half, made.y[0] - half, made.y[-1] + half)
    axes.grid(False)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    return axes.imshow(
        values, origin="lower", extent=extent, cmap=colours, alpha=alpha, interpolation="nearest"
    )


def _variograms(axes: Any, variograms: Sequence[Variogram]) -> None:
    for one, colour in zip(variograms, cycle((BLUE, RED, GREEN)), strict=False):
        axes.plot(one.lags, one.semivariance, ".", color=colour)
        lags = np.linspace(0, float(one.lags.max()), 200)
        axes.plot(lags, one.at(lags), color=colour, label=one.component)
    axes.set_title("variograms: seen and model, µT²")
    axes.set_xlabel("distance, m")
    axes.set_ylim(bottom=0)
    axes.legend()
