"""A walk as steps with covariance, from a phone or from a foot's STEP messages alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solenav.capture.contents import Capture
from solenav.errors import SolenavError
from solenav.recording import FloatArray

WAIST, FOOT, JOINED = "waist", "foot", "foot and waist"
SOURCES = (WAIST, FOOT, JOINED)


@dataclass(frozen=True)
class StepTrack:
    """Steps of one walk; what STEP says of a foot, for any sensor.

    `time_s` (n,) when each ended; `displacement` (n, 3) m, ENU or the map's axes, since the step
    before; `heading` (n,) rad counterclockwise from East; `covariance` (n, 3, 3) m² of each
    displacement; `start` (3,) m where the first began, at `start_s`. `source` is one of SOURCES.
    """

    name: str
    time_s: FloatArray
    displacement: FloatArray
    heading: FloatArray
    covariance: FloatArray
    start: FloatArray
    start_s: float
    source: str = WAIST

    def __len__(self) -> int:
        return len(self.time_s)

    def after(self, seconds: float) -> StepTrack:
        """The same walk on a clock that began so many seconds earlier."""
        return replace(self, time_s=self.time_s + seconds, start_s=self.start_s + seconds)

    @property
    def position(self) -> FloatArray:
        """(n + 1, 3) m: the start, then the end of each step."""
        return np.vstack([self.start, self.start + np.cumsum(self.displacement, axis=0)])

    @property
    def position_s(self) -> FloatArray:
        """(n + 1,) s: when `position` was."""
        return np.r_[self.start_s, self.time_s]

    @property
    def position_covariance(self) -> FloatArray:
        """(n + 1, 3, 3) m² of the positions, from a start that is sure."""
        return np.concatenate([np.zeros((1, 3, 3)), np.cumsum(self.covariance, axis=0)])

    @property
    def distance_m(self) -> float:
        """The sum of the steps' lengths in the plane."""
        return float(np.hypot(self.displacement[:, 0], self.displacement[:, 1]).sum())


def of_capture(capture: Capture) -> StepTrack:
    """The steps that a foot reported. SolenavError where there are none."""
    if not len(capture.steps):
        raise SolenavError(f"{capture.path} has no steps", "replay it, or record a walk")
    rows = capture.steps.rows
    time_s = capture.time_of_tick(capture.steps.tick)
    moved = rows["displacement"].astype(np.float64) / 2**18
    covariance = np.zeros((len(rows), 3, 3))
    for axis in range(3):
        covariance[:, axis, axis] = rows["variance"][:, axis] / 2**24
    begin_s = float(time_s[0] - rows["ticks"][0] / capture.rate_hz())
    # The core's heading is clockwise from North, 2**16 a turn.
    heading = np.pi / 2 - rows["heading"].astype(np.float64) * (2 * np.pi / 2**16)
    return StepTrack(
        capture.path.stem, time_s, moved, heading, covariance, np.zeros(3), begin_s, FOOT
    )
