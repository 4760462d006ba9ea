"""From a carried phone's samples to steps with direction, length and covariance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from solenav.errors import SolenavError
from solenav.pdr import length, steps
from solenav.pdr.attitude import Levelled, level
from solenav.pdr.length import GENERIC, LengthModel
from solenav.pdr.steps import TUNING, Steps, StepTuning
from solenav.pdr.track import StepTrack
from solenav.recording import FloatArray, Recording, Truth

MAG_S = 20.0
"""How slowly the magnetometer pulls the gyro's heading."""
# A phone is never held exactly ahead, nor walks one exactly straight.
HEADING_RAD = math.radians(5.0)
HEADINGS = ("gyro", "magnetometer")


def reckon(
    recording: Recording,
    *,
    heading: str = "gyro",
    start: tuple[float, float] = (0.0, 0.0),
    start_heading: float | None = None,
    model: LengthModel = GENERIC,
    tuning: StepTuning = TUNING,
) -> StepTrack:
    """The walk of a phone held ahead, from `start` (m), as steps.

    `heading` "gyro" starts at `start_heading` (rad counterclockwise from East, 0 where None) and
    drifts; "magnetometer" pulls it to the magnetic field, so that North is magnetic North, and
    then `start_heading` must be None. SolenavError for an unknown one, without a magnetometer
    where it's needed, and where no step is found.
    """
    seen = level(recording)
    found = steps.detect(seen.time_s, seen.vertical, tuning)
    if not len(found):
        raise SolenavError(
            f"{recording.name}: no steps found", "is it a walk with the phone in the hand?"
        )
    yaw = heading_of(recording.name, seen, heading, start_heading)
    return track_of(recording.name, found, seen.time_s, yaw, model.of(found), start)


def track_of(
    name: str,
    found: Steps,
    time_s: FloatArray,
    yaw: FloatArray,
    lengths: FloatArray,
    start: tuple[float, float] = (0.0, 0.0),
) -> StepTrack:
    """Steps laid end to end: `yaw` (m,) rad at `time_s` (m,), `lengths` (n,) m."""
    course = over_steps(found, time_s, yaw)
    c, s = np.cos(course), np.sin(course)
    moved = np.column_stack([lengths * c, lengths * s, np.zeros(len(found))])
    along, across = (length.SPREAD * lengths) ** 2, (HEADING_RAD * lengths) ** 2
    covariance = np.zeros((len(found), 3, 3))
    covariance[:, 0, 0] = c * c * along + s * s * across
    covariance[:, 1, 1] = s * s * along + c * c * across
    covariance[:, 0, 1] = covariance[:, 1, 0] = c * s * (along - across)
    return StepTrack(
        name,
        found.time_s,
        moved,
        course,
        covariance,
        np.array([*start, 0.0]),
        float(found.begin_s[0]),
    )


def heading_of(name: str, seen: Levelled, heading: str, start: float | None) -> FloatArray:
    """Yaw (n,) rad, counterclockwise from East. See `reckon`."""
    if heading not in HEADINGS:
        raise SolenavError(f"unknown heading {heading!r}", f"choose {' or '.join(HEADINGS)}")
    if heading == "gyro":
        return seen.yaw + (start or 0.0)
    if start is not None:
        raise SolenavError(
            "a start heading and the magnetometer's contradict each other", "give one of them"
        )
    field = need_field(name, seen)
    # North lies that far to the left of the phone's y axis.
    north = np.arctan2(field[:, 1], field[:, 0])
    absolute = math.pi / 2 - north
    off = absolute - seen.yaw
    # Averaged as unit vectors: angles wrap.
    c, s = _slow(seen.time_s, np.cos(off)), _slow(seen.time_s, np.sin(off))
    return seen.yaw + np.unwrap(np.arctan2(s, c))


def need_field(name: str, seen: Levelled) -> FloatArray:
    """The field (n, 3). SolenavError without a magnetometer or with holes in it."""
    if seen.field is None:
        raise SolenavError(f"{name} has no magnetometer", "record one, or use the gyro's heading")
    if not np.isfinite(seen.field).all():
        hole = float(seen.time_s[np.argmin(np.isfinite(seen.field).all(axis=1))])
        raise SolenavError(
            f"{name}: the magnetometer has a hole at {hole:.2f} s",
            "cut the trace there and read the parts one by one",
        )
    return seen.field


def adapted(
    recording: Recording, truth: Truth, *, tuning: StepTuning = TUNING
) -> tuple[LengthModel, FloatArray]:
    """A user's own model from the way points passed, and how it came about.

    The rows (n, 3) are, for each leg between way points: its length in m, what the generic model
    said, and what the model adapted on the legs before it said; so none is judged on itself.
    """
    seen = level(recording)
    found = steps.detect(seen.time_s, seen.vertical, tuning)
    own, rows = GENERIC, []
    points = truth.position_enu[:, :2]
    for a, b, here, there in zip(truth.time_s, truth.time_s[1:], points, points[1:], strict=False):
        leg = between(found, a, b)
        metres = float(np.hypot(*(there - here)))
        if len(leg):
            rows.append([metres, GENERIC.of(leg).sum(), own.of(leg).sum()])
            own = own.adapted(leg, metres)
    return own, np.array(rows).reshape(-1, 3)


def between(found: Steps, begin_s: float, end_s: float) -> Steps:
    """The steps whose middle falls into a time."""
    middle = (found.begin_s + found.time_s) / 2
    kept = (middle >= begin_s) & (middle < end_s)
    return replace(
        found,
        time_s=found.time_s[kept],
        begin_s=found.begin_s[kept],
        frequency_hz=found.frequency_hz[kept],
        variance=found.variance[kept],
    )


def over_steps(found: Steps, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """The mean of `values` (m,) or (m, k) at `time_s` over each step."""
    first = np.searchsorted(time_s, found.begin_s)
    last = np.maximum(np.searchsorted(time_s, found.time_s), first + 1)
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    count = (last - first).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((total[last] - total[first]) / count)


def _slow(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Exponential mean with MAG_S, of the past only; begins with the first second's mean."""
    out = np.empty(len(values))
    kept = float(values[time_s < 1.0].mean())
    for i, (dt, value) in enumerate(
        zip(np.diff(time_s, prepend=time_s[0]).tolist(), values.tolist(), strict=True)
    ):
        kept += dt / (MAG_S + dt) * (value - kept)
        out[i] = kept
    return out
