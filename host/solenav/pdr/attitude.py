"""A phone's attitude while it is carried: level from gravity, turns from the gyro.

The gyro turns a quaternion, and the accelerometer pulls its vertical back with a time constant of
some seconds, so that steps don't tip it (Mahony, Hamel, Pflimlin 2008, "Nonlinear complementary
filters on the special orthogonal group", eq. 32, proportional part). Yaw is free: it starts at zero
and drifts as the gyro does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solenav.datasets import checks
from solenav.recording import FloatArray, Recording

LEVEL_S = 5.0
START_S = 0.5


@dataclass(frozen=True)
class Levelled:
    """What a phone measured, seen from where it points.

    `yaw` (n,) rad, counterclockwise, of the phone's y axis (the screen's upper edge), unwrapped,
    0 at the start; `vertical` (n,) m/s² up, free of gravity; `field` (n, 3) µT forward, left and
    up of the phone's y axis in the plane, or None.
    """

    time_s: FloatArray
    yaw: FloatArray
    vertical: FloatArray
    field: FloatArray | None


def level(recording: Recording) -> Levelled:
    """The samples of a carried phone in level axes that turn with it.

    SolenavError, with the time, for samples that are not finite, times that don't increase, and
    gaps of more than 0.1 s: turns in them would be missing.
    """
    n = len(recording.time_s)
    checks.check_samples(
        recording.time_s,
        recording.accel,
        recording.gyro,
        lambda i: f"{recording.name}, {recording.time_s[min(i, n - 1)] if n else 0.0:.2f} s",
    )
    rows = np.empty((n, 3, 3))
    start = recording.time_s < START_S
    up = recording.accel[start].mean(axis=0)
    q = _upright(up / np.linalg.norm(up))
    steps = np.diff(recording.time_s, prepend=recording.time_s[0])
    for i in range(n):
        rate = recording.gyro[i].tolist()
        force = recording.accel[i].tolist()
        q = _turned(q, rate, force, float(steps[i]))
        rows[i] = _matrix(q)
    forward = np.arctan2(rows[:, 1, 1], rows[:, 0, 1])
    vertical = np.einsum("ij,ij->i", rows[:, 2], recording.accel)
    field = None
    if recording.mag is not None:
        east, north, rise = np.einsum("ijk,ik->ji", rows, recording.mag)
        c, s = np.cos(forward), np.sin(forward)
        field = np.column_stack([c * east + s * north, c * north - s * east, rise])
    yaw = np.unwrap(forward)
    gravity = np.median(np.linalg.norm(recording.accel, axis=1))
    return Levelled(recording.time_s, yaw - yaw[0], vertical - gravity, field)


Quaternion = tuple[float, float, float, float]


def _upright(up: FloatArray) -> Quaternion:
    """The shortest turn that brings a body's `up` (unit) to z."""
    x, y, z = up.tolist()
    if z < -0.999999:
        return (0.0, 1.0, 0.0, 0.0)
    w = math.sqrt((1.0 + z) / 2.0)
    return (w, y / (2.0 * w), -x / (2.0 * w), 0.0)


def _turned(q: Quaternion, rate: list[float], force: list[float], dt: float) -> Quaternion:
    w, x, y, z = q
    size = math.sqrt(sum(f * f for f in force)) or 1.0
    ax, ay, az = (f / size for f in force)
    # Up in body axes, as the quaternion has it: the third row of its matrix.
    ux, uy, uz = 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z
    gain = dt / LEVEL_S
    px = rate[0] * dt + gain * (ay * uz - az * uy)
    py = rate[1] * dt + gain * (az * ux - ax * uz)
    pz = rate[2] * dt + gain * (ax * uy - ay * ux)
    angle = math.sqrt(px * px + py * py + pz * pz)
    c = math.cos(angle / 2)
    s = math.sin(angle / 2) / angle if angle > 0 else 0.5
    a, b, d = px * s, py * s, pz * s
    w, x, y, z = (
        w * c - x * a - y * b - z * d,
        w * a + x * c + y * d - z * b,
        w * b - x * d + y * c + z * a,
        w * d + x * b - y * a + z * c,
    )
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return (w / norm, x / norm, y / norm, z / norm)


def _matrix(q: Quaternion) -> tuple[tuple[float, ...], ...]:
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
