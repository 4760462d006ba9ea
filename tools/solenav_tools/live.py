"""What the live view knows of a board: the last of each message, and how fresh it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from rich.markup import escape
from rich.panel import Panel
from rich.table import Table

from solenav.link import Damage, Frame, unpack
from solenav_core import layout, messages

_MODES = ("idle", "aligning: stand still", "navigating", "sensor fault")
STALE_S = 1.0


@dataclass
class Live:
    """State of a live view, fed with frames; `now` is any clock in seconds."""

    hello: dict[str, Any] = field(default_factory=dict)
    pose: dict[str, Any] = field(default_factory=dict)
    status: dict[str, Any] = field(default_factory=dict)
    align: dict[str, Any] = field(default_factory=dict)
    tick: int = 0
    last_log: str = ""
    frames: int = 0
    damaged: int = 0
    lost: int = 0  # frames that the sequence numbers miss
    heard: float = -math.inf
    _seq: int = -1

    def take(self, item: Frame | Damage | None, now: float) -> None:
        """Take what the reader gave."""
        if item is None:
            return
        self.heard = now
        if isinstance(item, Damage):
            self.damaged += 1
            return
        self.frames += 1
        if self._seq >= 0 and item.kind != messages.HELLO:
            self.lost += (item.seq - self._seq - 1) % 256
        self._seq = item.seq
        self.tick = item.tick
        if item.kind == messages.HELLO:
            self.hello = unpack(item)
        elif item.kind == messages.POSE:
            self.pose = unpack(item)
        elif item.kind == messages.STATUS:
            self.status = unpack(item)
        elif item.kind == messages.ALIGN:
            self.align = unpack(item)
        elif item.kind == messages.LOG:
            fields = unpack(item)
            level = messages.LEVELS[min(fields["level"], 2)]
            self.last_log = f"{level}: {fields['text'].decode('utf-8', 'replace')}"

    def foreign(self) -> bool:
        """True where the firmware speaks another schema."""
        return bool(self.hello) and self.hello["schema"] != messages.SCHEMA

    def stale(self, now: float) -> bool:
        return now - self.heard > STALE_S

    def values(self) -> dict[str, str]:
        """The lines of the view: what to its value with unit."""
        out = {"mode": _MODES[min(self.status.get("mode", 0), 3)] if self.status else "?"}
        if self.pose:
            out |= _pose_values(self.pose)
        if self.status:
            s = self.status
            drops = s["dropped_samples"], s["dropped_poses"], s["dropped_others"]
            out["drops"] = (
                f"{sum(drops)} on the board's UART, {s['overruns']} samples overrun, "
                f"{self.lost} frames on the way, {self.damaged} damaged"
            )
            out["sensor"] = (
                f"{s['samples']} samples, {s['bus_errors']} bus errors, {s['clipped']} clipped, "
                f"period {s['period'] / 256:.1f} µs"
            )
        if self.last_log:
            out["log"] = self.last_log
        return out

    def line(self) -> str:
        """One line for a log or a pipe."""
        return "; ".join(f"{key} {value}" for key, value in self.values().items())

    def render(self, name: str, now: float) -> Panel:
        """The view for a terminal."""
        table = Table.grid(padding=(0, 2))
        table.add_column(justify="right", style="bold")
        table.add_column()
        for key, value in self.values().items():
            table.add_row(key, escape(value))
        stale = self.stale(now)
        age = f" [red]no data for {now - self.heard:.0f} s[/]" if stale and self.frames else ""
        if not self.frames:
            age = " [yellow]waiting for the board[/]"
        return Panel(
            table, title=f"{name} tick {self.tick}{age}", border_style="red" if stale else "green"
        )


def heading_deg(attitude: tuple[int, ...]) -> float:
    """Azimuth of the body's front axis from a Q30 quaternion, 0 to 360, clockwise from North."""
    w, x, y, z = attitude
    return math.degrees(math.atan2(2 * (x * y - w * z), w * w - x * x + y * y - z * z)) % 360


def _pose_values(pose: dict[str, Any]) -> dict[str, str]:
    e, n, u = (
        c * layout.CELL_M + p / 2**18 for c, p in zip(pose["cell"], pose["position"], strict=True)
    )
    speed = math.hypot(*(v / 2**24 for v in pose["velocity"]))
    stance = "stance" if pose["flags"] & messages.IN_STANCE else "swing"
    trust = ""
    if pose["flags"] & messages.FROZEN:
        trust = ", no stance for long: drifting"
    if pose["flags"] & messages.SATURATED:
        trust = ", velocity has been at its limit: do not trust"
    return {
        "position": f"E {e:9.2f}   N {n:9.2f}   U {u:7.2f} m",
        "speed": f"{speed:5.2f} m/s",
        "heading": f"{heading_deg(pose['attitude']):5.1f}°",
        "steps": f"{pose['steps']}, distance {pose['distance'] / 1024:.1f} m",
        "phase": stance + trust,
        "filter": f"N_eff {pose['n_eff'] / 256:5.1f}, M {pose['threshold'] / 16384:.3f}, "
        f"{pose['resampled']} resampled",
    }
