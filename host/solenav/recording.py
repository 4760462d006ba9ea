"""An IMU recording in SI units, with what is known of the truth.

This is the common ground of the public data sets and the simulator: both make a `Recording`,
and `solenav.mpu9150.to_counts` turns one into the raw counts that the core reads.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.modes.labels import Label

FloatArray = NDArray[np.float64]


@dataclass
class Truth:
    """Reference trajectory on its own time stamps, in a z-up, right-handed metric frame.

    `position_enu` (m, 3) is in metres; a coordinate that the reference doesn't know is NaN (a
    floor survey has no height). `velocity_enu` (m, 3) is in m/s, `stance` (m,) is True where the
    reference says that the foot stands; both are None where unknown. `frame` is "enu" where
    East and North are real, "local" where the horizontal axes and the origin are arbitrary and
    a comparison must align them (yaw and translation) first. `closed_loop` says that the walk
    ends where it began, which is all that some recordings know; then the arrays may be empty.
    """

    time_s: FloatArray
    position_enu: FloatArray
    velocity_enu: FloatArray | None = None
    stance: NDArray[np.bool_] | None = None
    frame: str = "local"
    closed_loop: bool = False


@dataclass
class Recording:
    """Samples of one foot-mounted IMU, in the sensor's own axes (any mounting, right-handed).

    `time_s` (n,) strictly increasing, in seconds from the first sample; `accel` (n, 3) specific
    force in m/s² (at rest it points up); `gyro` (n, 3) angular rate in rad/s; `rate_hz` the mean
    sample rate that the core's dt is made from; `source` says where it came from (format, file
    name), `notes` whatever a reader of the capture should know (repaired time stamps, ...).
    `mag` (n, 3) magnetic flux density in µT, in the axes of `accel`, a row of NaN where the
    magnetometer gave nothing at that sample; None without a magnetometer. `modes` say how the foot
    moved when, where that is known.
    """

    name: str
    time_s: FloatArray
    accel: FloatArray
    gyro: FloatArray
    rate_hz: float
    truth: Truth | None = None
    source: str = ""
    notes: dict[str, Any] = field(default_factory=dict)
    mag: FloatArray | None = None
    modes: tuple[Label, ...] = ()

    def first(self, seconds: float) -> Recording:
        """The recording's beginning, with the truth of that time; no loop is closed any more."""
        kept = self.time_s < seconds
        truth = self.truth
        if truth is not None:
            known = truth.time_s < seconds
            truth = replace(
                truth,
                time_s=truth.time_s[known],
                position_enu=truth.position_enu[known],
                velocity_enu=None if truth.velocity_enu is None else truth.velocity_enu[known],
                stance=None if truth.stance is None else truth.stance[known],
                closed_loop=truth.closed_loop and bool(kept.all()),
            )
        return replace(
            self,
            time_s=self.time_s[kept],
            accel=self.accel[kept],
            gyro=self.gyro[kept],
            mag=None if self.mag is None else self.mag[kept],
            truth=truth,
            modes=tuple(
                replace(label, end_s=min(label.end_s, seconds))
                for label in self.modes
                if label.start_s < seconds
            ),
        )
