"""What the live view knows of a board: the last of each message, and how fresh it is."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from solenav.link import Damage, Frame, missing, unpack
from solenav.link.units import POSE_FLAGS, complaints, mode_text
from solenav.mpu9150 import celsius
from solenav_core import layout, messages

STALE_S = 1.0
RECENT = 6400
"""Poses that are kept as they came."""
WAY = 4096
"""Points of the whole way that are kept; when they are more, every other one goes."""
_LOGS = 50
_STAND_STILL = (messages.ALIGNING, messages.RESUMING)


class Point(NamedTuple):
    """One pose: s since the start, m ENU, m/s, whether in stance, N_eff, M, complaints."""

    time_s: float
    east: float
    north: float
    up: float
    speed: float
    stance: bool
    n_eff: float
    threshold: float
    doubtful: bool


@dataclass
class Live:
    """State of a live view, fed with frames; `now` is any clock in seconds."""

    hello: dict[str, Any] = field(default_factory=dict)
    pose: dict[str, Any] = field(default_factory=dict)
    status: dict[str, Any] = field(default_factory=dict)
    align: dict[str, Any] = field(default_factory=dict)
    tick: int = 0
    logs: deque[str] = field(default_factory=lambda: deque(maxlen=_LOGS))
    recent: deque[Point] = field(default_factory=lambda: deque(maxlen=RECENT))
    way: list[Point] = field(default_factory=list)
    ways: int = 0  # how often `way` was thinned or begun anew: what was copied of it is void then
    starts: int = 0  # boots and fresh starts that were seen
    variance: float = 0.0  # m², East and North, of the steps seen
    frames: int = 0
    damaged: int = 0
    lost: int = 0  # frames that the sequence numbers miss
    heard: float = -math.inf
    _seq: int = -1
    _every: int = 1  # of the poses goes into the way
    _poses: int = 0

    def take(self, item: Frame | Damage | None, now: float) -> None:
        """Take what the reader gave."""
        if item is None:
            return
        self.heard = now
        if isinstance(item, Damage):
            self.damaged += 1
            return
        self.frames += 1
        self.lost += missing(self._seq, item)
        self._seq = item.seq
        if item.tick < self.tick and item.kind == messages.POSE:
            self._begin()
        self.tick = item.tick
        if item.kind == messages.HELLO:
            self.hello = unpack(item)
        elif item.kind == messages.POSE:
            self.pose = unpack(item)
            self._remember()
        elif item.kind == messages.STEP:
            east, north, _up = unpack(item)["variance"]
            self.variance += (east + north) / 2**24
        elif item.kind == messages.STATUS:
            self.status = unpack(item)
        elif item.kind == messages.ALIGN:
            self.align = unpack(item)
        elif item.kind == messages.LOG:
            fields = unpack(item)
            level = messages.LEVELS[min(fields["level"], 2)]
            self.logs.append(f"{level}: {fields['text'].decode('utf-8', 'replace')}")

    def _begin(self) -> None:
        """The board started afresh: another walk."""
        self.recent.clear()
        self.way.clear()
        self.ways += 1
        self.starts += 1
        self.variance = 0.0
        self._every, self._poses = 1, 0

    def _remember(self) -> None:
        point = self._point()
        self.recent.append(point)
        if self._poses % self._every == 0:
            self.way.append(point)
            if len(self.way) >= WAY:
                del self.way[1::2]
                self._every *= 2
                self.ways += 1
        self._poses += 1

    def _point(self) -> Point:
        pose = self.pose
        rate = self.hello.get("rate", 200_000) / 1000
        return Point(
            self.tick / max(rate, 1e-3),
            *position_m(pose),
            speed_mps(pose),
            bool(pose["flags"] & messages.IN_STANCE),
            pose["n_eff"] / 256,
            pose["threshold"] / 2**14,
            bool(complaints(pose["flags"])),
        )

    @property
    def mode(self) -> str:
        """What the board does, in words."""
        if not self.status:
            return "?"
        mode = self.status["mode"]
        return mode_text(mode) + (": stand still" if mode in _STAND_STILL else "")

    @property
    def warnings(self) -> list[str]:
        """Why the last pose can't be trusted, in words."""
        return complaints(self.pose.get("flags", 0))

    def stale(self, now: float) -> bool:
        return now - self.heard > STALE_S

    def values(self) -> dict[str, str]:
        """The lines of the view: what to its value with unit."""
        out = {"mode": self.mode}
        if self.pose:
            out |= _pose_values(self.pose)
            out["spread"] = f"{math.sqrt(self.variance):.2f} m (1 sigma of the steps, level)"
        if self.warnings:
            out["warning"] = "; ".join(self.warnings)
        if self.status:
            s = self.status
            drops = s["dropped_samples"], s["dropped_poses"], s["dropped_others"]
            out["drops"] = (
                f"{sum(drops)} on the board's UART, {s['overruns']} samples overrun, "
                f"{self.lost} frames on the way, {self.damaged} damaged"
            )
            out["sensor"] = (
                f"{s['samples']} samples, {s['bus_errors']} bus errors, {s['clipped']} clipped, "
                f"{s['gaps']} gaps ({s['lost']} lost), {s['spikes']} spikes, "
                f"{s['recoveries']} recoveries, "
                f"period {s['period'] / 256:.1f} µs, {celsius(s['temperature']):.1f} °C"
            )
        if self.logs:
            out["log"] = self.logs[-1]
        return out

    def line(self) -> str:
        """One line for a log or a pipe."""
        return "; ".join(f"{key} {value}" for key, value in self.values().items())

    def as_dict(self) -> dict[str, Any]:
        """The same for programs, in SI units; None where it isn't known yet."""
        pose = self.pose
        flags = pose.get("flags", 0)
        return {
            "tick": self.tick,
            "mode": self.mode,
            "position": list(position_m(pose)) if pose else None,
            "speed": speed_mps(pose) if pose else None,
            "heading": heading_deg(pose["attitude"]) if pose else None,
            "steps": pose["steps"] if pose else None,
            "distance": pose["distance"] / 2**10 if pose else None,
            "flags": [name for flag, name in POSE_FLAGS.items() if flags & flag],
            "warnings": self.warnings,
            "n_eff": pose["n_eff"] / 256 if pose else None,
            "threshold": pose["threshold"] / 2**14 if pose else None,
            "spread": math.sqrt(self.variance),
            "temperature": celsius(self.status["temperature"]) if self.status else None,
            "lost_frames": self.lost,
            "damaged_frames": self.damaged,
            "log": list(self.logs),
        }


def position_m(pose: dict[str, Any]) -> tuple[float, float, float]:
    """East, North, Up (m) of a POSE."""
    east, north, up = (
        c * layout.CELL_M + p / 2**18 for c, p in zip(pose["cell"], pose["position"], strict=True)
    )
    return east, north, up


def speed_mps(pose: dict[str, Any]) -> float:
    """Of a POSE, in m/s."""
    return math.hypot(*(v / 2**24 for v in pose["velocity"]))


def heading_deg(attitude: tuple[int, ...]) -> float:
    """Azimuth of the body's front axis from a Q30 quaternion, 0 to 360, clockwise from North."""
    w, x, y, z = attitude
    return math.degrees(math.atan2(2 * (x * y - w * z), w * w - x * x + y * y - z * z)) % 360


def _pose_values(pose: dict[str, Any]) -> dict[str, str]:
    e, n, u = position_m(pose)
    speed = speed_mps(pose)
    return {
        "position": f"E {e:9.2f}   N {n:9.2f}   U {u:7.2f} m",
        "speed": f"{speed:5.2f} m/s",
        "heading": f"{heading_deg(pose['attitude']):5.1f}°",
        "steps": f"{pose['steps']}, distance {pose['distance'] / 1024:.1f} m",
        "phase": "stance" if pose["flags"] & messages.IN_STANCE else "swing",
        "filter": f"N_eff {pose['n_eff'] / 256:5.1f}, M {pose['threshold'] / 16384:.3f}, "
        f"{pose['resampled']} resampled",
    }
