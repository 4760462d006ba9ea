"""What every filter is given and what it gives: samples and stance in, trajectory out."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solenav import importing, mpu9150, parameters
from solenav.capture.contents import Capture
from solenav.engines.traced import Start, trace
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording, Truth

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Aids:
    """What may help a filter along.

    `still` learns the gyro bias while the foot rests; `gate` refuses a zero velocity that the
    filter thinks impossible.
    """

    still: bool = False
    gate: bool = False


class Inputs(NamedTuple):
    """A walk as numba takes it; `first` is the row that navigation begins with. See `Walk`."""

    accel: FloatArray
    gyro: FloatArray
    stance: BoolArray
    first: int
    attitude: FloatArray
    gyro_bias: FloatArray
    gravity: float
    dt: float


@dataclass(frozen=True)
class Walk:
    """A recording as filters see it: every filter gets the same samples, start and stances.

    `counts` (n, 6) are the sensor's, `params` the core's parameters; `accel` (n, 3) specific
    force in m/s² and `gyro` (n, 3) rate in rad/s are those counts calibrated, in body axes.
    `stance` (n,) are the decisions to go by, from the core's detector unless spoilt. `start` is
    the core's static start: navigation begins with the row after `start.row`, at rest in the
    origin. `clean` (n,) are the detector's own decisions, which errors in stance are taken over.
    `distance_m` is the sum of the core's step lengths on them: the walk's, whatever a filter says.
    """

    name: str
    rate_hz: float
    counts: NDArray[np.int16]
    params: array[int]
    accel: FloatArray
    gyro: FloatArray
    start: Start
    stance: BoolArray
    clean: BoolArray
    distance_m: float
    truth: Truth | None = None

    @property
    def dt(self) -> float:
        """Sample period in s."""
        return 1.0 / self.rate_hz

    @property
    def time_s(self) -> FloatArray:
        """(n,) seconds from the first sample, as ticks count it."""
        return np.arange(len(self.counts), dtype=np.float64) * self.dt

    def inputs(self) -> Inputs:
        """What a filter's kernel runs on."""
        return Inputs(
            self.accel,
            self.gyro,
            self.stance,
            self.start.row + 1,
            self.start.attitude,
            self.start.gyro_bias,
            self.start.gravity,
            self.dt,
        )

    def with_stance(self, stance: BoolArray) -> Walk:
        """The same walk on other stance decisions."""
        return replace(self, stance=stance)


@dataclass(frozen=True)
class Track:
    """A filter's trajectory, a row a sample: `position` m, `velocity` m/s (n, 3) ENU.

    Rows up to the static start are zero. Each row is the state when its sample was dealt with.
    """

    position: FloatArray
    velocity: FloatArray


def walk_of(
    counts: NDArray[np.int16], params: array[int], *, name: str, truth: Truth | None = None
) -> Walk:
    """A walk from counts (n, 6) and the core's parameters.

    SolenavError where the core found no static start.
    """
    own = trace(counts, params)
    if own.start.row < 0:
        raise SolenavError(
            f"{name}: no static start in the recording", "let the foot stand still at the start"
        )
    accel, gyro = parameters.body_samples(counts, params, own.start.mount)
    rate_hz = params[0] / 1000.0
    stance, distance_m = own.stance, float(own.distance[-1])
    return Walk(
        name, rate_hz, counts, params, accel, gyro, own.start, stance, stance, distance_m, truth
    )


def of_recording(recording: Recording, *, name: str | None = None) -> Walk:
    """The walk of a recording as MPU-9150 counts, on the default parameters.

    SolenavError where the core found no static start.
    """
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    params = importing.parameters_of(recording)
    return walk_of(counts, params, name=name or recording.name, truth=recording.truth)


def load(capture: Capture) -> Walk:
    """The walk of a capture's samples. SolenavError without samples or a static start."""
    capture.need_samples()
    params = capture.params[0][1]
    return walk_of(capture.sample_counts, params, name=capture.path.stem, truth=capture.truth)
