"""The view in a window: tracks, and the last half minute's speed, stance and confidence.

What moves is blitted onto a background that is drawn anew only when an axis has to change.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from solenav.errors import SolenavError
from solenav_tools.monitor.watch import Watch

RECENT_S = 30.0
_FRAME_S = 0.05
_SPEED_MAX = 6.0  # m/s, to begin with
_GROWTH = 1.5


def show(watches: Sequence[Watch], over: Callable[[], bool]) -> None:
    """Draw until `over`, or until the window is closed. SolenavError without a screen."""
    try:
        plt: Any = import_module("matplotlib.pyplot")
    except ImportError:
        raise SolenavError("a window needs matplotlib", "pip install 'solenav[plot]'") from None
    figure = plt.figure(figsize=(11, 7), num="solenav")
    if not figure.canvas.manager or figure.canvas.required_interactive_framework is None:
        raise SolenavError(
            f"no window can be opened (matplotlib's backend is {plt.get_backend()})",
            "install python3-tk or PyQt6 and work on a desktop, or use --web",
        )
    window = Window(watches, figure)
    plt.show(block=False)
    while not over() and plt.fignum_exists(figure.number):
        window.update(time.monotonic())
        figure.canvas.start_event_loop(_FRAME_S)


class Window:
    """The figure's contents. `update` draws what is new."""

    def __init__(self, watches: Sequence[Watch], figure: Any) -> None:
        self.watches = watches
        self.figure = figure
        self.redraws = 0  # of the background
        grid = figure.add_gridspec(3, 2, width_ratios=(3, 2))
        self.track = figure.add_subplot(grid[:, 0])
        self.speed = figure.add_subplot(grid[0, 1])
        self.stance = figure.add_subplot(grid[1, 1], sharex=self.speed)
        self.trust = figure.add_subplot(grid[2, 1], sharex=self.speed)
        self.track.set(xlabel="East, m", ylabel="North, m")
        self.track.set_xlim(-5, 5)
        self.track.set_ylim(-5, 5)
        self.track.set_aspect("equal")
        self.track.grid(alpha=0.3)
        self.speed.set(ylabel="speed, m/s", xlim=(-RECENT_S, 0), ylim=(0, _SPEED_MAX))
        self.stance.set(ylabel="stance", ylim=(-0.5, len(watches) - 0.5))
        self.stance.set_yticks(range(len(watches)), [watch.wearer.name for watch in watches])
        self.trust.set(ylabel="confidence\n(N_eff, %)", xlabel="s ago, s", ylim=(0, 105))
        self.trust.set_xlabel("seconds before now")
        self._lines = []
        for watch in watches:
            style = {"color": watch.wearer.colour, "animated": True}
            (way,) = self.track.plot([], [], label=watch.wearer.name, **style)
            (here,) = self.track.plot([], [], "o", markersize=9, **style)
            (speed,) = self.speed.plot([], [], linewidth=1, **style)
            (stance,) = self.stance.plot([], [], linewidth=6, solid_capstyle="butt", **style)
            (trust,) = self.trust.plot([], [], linewidth=1, **style)
            self._lines.append((way, here, speed, stance, trust))
        self._title = self.track.text(
            0.01, 1.02, "", transform=self.track.transAxes, animated=True, clip_on=False
        )
        # Above the track is a line for each wearer.
        figure.tight_layout(rect=(0, 0, 1, 1 - 0.03 * len(watches)))
        figure.canvas.mpl_connect("draw_event", self._drawn)
        self._background: Any = None
        figure.canvas.draw()

    def _drawn(self, _event: Any) -> None:
        self._background = self.figure.canvas.copy_from_bbox(self.figure.bbox)
        self.redraws += 1

    def update(self, now: float) -> None:
        """Draw what is known at `now` (s)."""
        texts = []
        changed = False
        for i, (watch, lines) in enumerate(zip(self.watches, self._lines, strict=True)):
            with watch.lock:
                live = watch.live
                way = [(point.east, point.north) for point in live.way]
                recent = list(live.recent)
                texts.append(_headline(watch, now))
            if not recent:
                continue
            last = recent[-1]
            way.append((last.east, last.north))
            recent = [point for point in recent if last.time_s - point.time_s <= RECENT_S]
            ago = [point.time_s - last.time_s for point in recent]
            lines[0].set_data(*zip(*way, strict=True))
            lines[1].set_data([last.east], [last.north])
            # What is old looks so.
            lines[1].set_alpha(0.3 if live.stale(now) or last.doubtful else 1.0)
            lines[2].set_data(ago, [point.speed for point in recent])
            lines[3].set_data(ago, [i if point.stance else float("nan") for point in recent])
            lines[4].set_data(
                ago, [point.n_eff if point.stance else float("nan") for point in recent]
            )
            changed = self._fit(way, max(point.speed for point in recent)) or changed
        self._title.set_text("\n".join(texts))
        canvas = self.figure.canvas
        if changed or self._background is None:
            canvas.draw()
        canvas.restore_region(self._background)
        for lines in self._lines:
            for line in lines:
                line.axes.draw_artist(line)
        self.track.draw_artist(self._title)
        canvas.blit(self.figure.bbox)

    def _fit(self, way: list[tuple[float, float]], speed: float) -> bool:
        """Room for all of it, some more than needed; whether an axis changed."""
        changed = False
        (left, right), (bottom, top) = self.track.get_xlim(), self.track.get_ylim()
        easts, norths = [east for east, _north in way], [north for _east, north in way]
        if min(easts) < left or max(easts) > right or min(norths) < bottom or max(norths) > top:
            middle = (min(easts) + max(easts)) / 2, (min(norths) + max(norths)) / 2
            half = _GROWTH / 2 * max(max(easts) - min(easts), max(norths) - min(norths), 10.0)
            self.track.set_xlim(middle[0] - half, middle[0] + half)
            self.track.set_ylim(middle[1] - half, middle[1] + half)
            changed = True
        if speed > self.speed.get_ylim()[1]:
            self.speed.set_ylim(0, speed * _GROWTH)
            changed = True
        return changed


def _headline(watch: Watch, now: float) -> str:
    live = watch.live
    parts = [watch.wearer.name, live.mode]
    if live.pose:
        parts.append(f"{live.pose['distance'] / 1024:.1f} m, {live.pose['steps']} steps")
    if watch.gone:
        parts.append("UNPLUGGED")
    elif live.frames and live.stale(now):
        parts.append(f"NO DATA for {now - live.heard:.0f} s")
    return "   ".join([*parts, *live.warnings, *([watch.trouble] if watch.trouble else [])])
