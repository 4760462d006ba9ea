"""Guiding a person through a calibration: what to do next, what was good, what was not.

A guide looks at the samples that came since row `first` every `every_s` seconds of the board's
time, and says lines for the person until it is `done`. No clock and no port: the same samples
give the same lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from solenav.calibration import magnetometer
from solenav.calibration.still import (
    DIRECTIONS,
    FACES,
    LEAN_MAX_DEG,
    SHORTEST_S,
    Pose,
    face_of,
    poses,
)
from solenav.recording import Recording

HOLD_S = 2.0
REST_S = 10.0
_MOVING_S = 3.0
_TAIL_S = 20.0
_TUMBLE_READINGS = 2000


class Guide(Protocol):
    """What every guide has."""

    every_s: float
    first: int
    done: bool

    def opening(self) -> list[str]:
        """What to do, before the first sample."""

    def look(self, recording: Recording) -> list[str]:
        """Look at the samples from row `first` on."""

    def lacks(self) -> str:
        """What is still missing."""


class Poses:
    """Rests with each of `faces` up; `taken` has the pose of each, in the order they came."""

    every_s = 0.25

    def __init__(self, faces: Sequence[str] = FACES) -> None:
        self.faces = tuple(faces)
        self.taken: dict[str, Pose] = {}
        self.first = 0
        self.done = False

    def opening(self) -> list[str]:
        return [
            f"{len(self.faces)} positions, in any order, {HOLD_S:g} s each; lay it against a box",
            self._next(),
        ]

    def lacks(self) -> str:
        missing = [face for face in self.faces if face not in self.taken]
        return f"missing: {', '.join(missing)} up" if missing else ""

    def look(self, recording: Recording) -> list[str]:
        now = float(recording.time_s[-1])
        for pose in poses(recording):
            # What goes on since the last look has been spoken of.
            if pose.start_s == 0.0 and self.first:
                continue
            said = self._judge(pose, now)
            if said:
                self.first += len(recording.time_s)
                return said if self.done else [*said, self._next()]
        if now > _TAIL_S:
            self.first += len(recording.time_s) // 2
        return []

    def _judge(self, pose: Pose, now: float) -> list[str]:
        """What is to be said of a pose; nothing yet of one that may still become good."""
        seconds = pose.end_s - pose.start_s
        goes_on = now - pose.end_s < 0.1
        face, lean = face_of(np.array(pose.force), self.faces)
        if pose.fault:
            # A short rest that isn't over may become long enough.
            short = pose.fault.startswith("too short")
            ripe = not goes_on if short else seconds >= _MOVING_S or not goes_on
            known = face in self.taken
            return [f"refused: {face} up: {pose.fault}"] if ripe and not known else []
        if seconds < HOLD_S and goes_on:
            return []
        if lean > LEAN_MAX_DEG:
            return [
                f"refused: leans {lean:.0f}° from {face} up, at most {LEAN_MAX_DEG:.0f}° do: "
                "tilt it nearer"
            ]
        if face in self.taken:
            return [f"refused: {face} up is there already"]
        self.taken[face] = pose
        self.done = len(self.taken) == len(self.faces)
        return [f"good: {face} up ({len(self.taken)} of {len(self.faces)})"]

    def _next(self) -> str:
        face = next(face for face in self.faces if face not in self.taken)
        return f"next: turn it so that {face} points up, and hold it still"


class Rest:
    """One rest of REST_S seconds."""

    every_s = 0.5

    def __init__(self) -> None:
        self.first = 0
        self.done = False

    def opening(self) -> list[str]:
        return [f"lay it down on something that doesn't shake, for {REST_S:g} s"]

    def lacks(self) -> str:
        return "" if self.done else f"missing: a rest of {REST_S:g} s"

    def look(self, recording: Recording) -> list[str]:
        now = float(recording.time_s[-1])
        rests = [pose for pose in poses(recording) if not pose.fault]
        if rests and rests[-1].end_s - rests[-1].start_s >= REST_S:
            self.done = True
            return ["good: it rested"]
        if rests and now - rests[-1].end_s > 1.0:
            self.first += len(recording.time_s)
            seconds = rests[-1].end_s - rests[-1].start_s
            return [f"refused: moved after {seconds:.1f} s; lay it down again"]
        if not rests and now > _TAIL_S / 2:
            self.first += len(recording.time_s)
            return [f"refused: moving, it never rests for {SHORTEST_S:g} s; lay it down"]
        return []


class Tumble:
    """A turn through all attitudes; `covered` directions so far."""

    every_s = 2.0

    def __init__(self) -> None:
        self.first = 0
        self.done = False
        self._missed = list(DIRECTIONS)

    def opening(self) -> list[str]:
        return [
            "turn it slowly through every attitude, far from steel, until all directions are there"
        ]

    def lacks(self) -> str:
        if self.done:
            return ""
        return f"missing: the field from {', '.join(self._missed)}"

    def look(self, recording: Recording) -> list[str]:
        field, _force = magnetometer.readings(recording)
        step = max(1, len(field) // _TUMBLE_READINGS)
        before = len(self._missed)
        self._missed = magnetometer.lacking(field[::step])
        if not self._missed:
            self.done = True
            return ["good: enough directions are there"]
        if len(self._missed) == before:
            return []
        there = len(DIRECTIONS) - len(self._missed)
        return [f"{there} of {len(DIRECTIONS)} directions; {self.lacks()}"]
