"""Recordings of a sensor that is turned by hand: rests in many attitudes, and a tumble."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from solenav.calibration import Calibration
from solenav.recording import Recording
from solenav.sim.field import Earth
from solenav.sim.gait import Motion, multiply
from solenav.sim.imu import from_rotation_vector, ideal_samples, rotate, rotation_vector

FloatArray = NDArray[np.float64]
RATE = 200.0
UP = {
    "+z": (0.0, 0.0, 0.0),
    "-z": (180.0, 0.0, 0.0),
    "+y": (90.0, 0.0, 0.0),
    "-y": (-90.0, 0.0, 0.0),
    "+x": (0.0, -90.0, 0.0),
    "-x": (0.0, 90.0, 0.0),
}
"""Rotation vectors in degrees about the sensor's x, y, z that bring a face up."""
SIX = tuple(UP)
BETWEEN = (
    *((turn, 0.0, 0.0) for turn in (45.0, -45.0, 135.0, -135.0)),
    *((0.0, turn, 0.0) for turn in (45.0, -45.0, 135.0, -135.0)),
    *((90.0, 45.0, 0.0), (90.0, -45.0, 0.0), (-90.0, 45.0, 0.0), (50.0, 20.0, 30.0)),
)
"""Rotation vectors in degrees of attitudes half-way between faces."""


def attitude(pose: str | Sequence[float], lean: Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """The quaternion (4,) that brings a face up or turns by degrees, leaning by some more."""
    turn = np.radians(UP[pose] if isinstance(pose, str) else pose)
    own = from_rotation_vector(turn[None])
    return np.asarray(multiply(own, from_rotation_vector(np.radians(lean)[None]))[0])


def held(attitudes: Sequence[FloatArray], rest_s: float = 2.5, turn_s: float = 1.2) -> FloatArray:
    """Attitudes (n, 4) over time: each held for `rest_s`, turned to the next within `turn_s`."""
    parts = []
    rest, turn = round(rest_s * RATE), round(turn_s * RATE)
    u = (1 - np.cos(np.pi * np.arange(turn) / turn)) / 2
    for k, q in enumerate(attitudes):
        parts.append(np.repeat(q[None], rest, axis=0))
        if k + 1 < len(attitudes):
            way = rotation_vector(multiply(q[None] * [1, -1, -1, -1], attitudes[k + 1][None]))
            parts.append(
                multiply(np.repeat(q[None], turn, axis=0), from_rotation_vector(u[:, None] * way))
            )
    return np.vstack(parts)


def tumbled(seconds: float = 60.0, seed: int = 1) -> FloatArray:
    """Attitudes (n, 4) of a sensor turned slowly about axes that wander, 1 rad/s."""
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE)
    t = np.arange(n) / RATE
    phase = rng.uniform(0, 2 * np.pi, 3)
    rate = np.stack([np.sin(0.37 * t + phase[0]), np.sin(0.53 * t + phase[1]), np.cos(0.29 * t)], 1)
    q = np.empty((n, 4))
    q[0] = [1, 0, 0, 0]
    steps = from_rotation_vector(1.2 * rate / RATE)
    for k in range(1, n):
        q[k] = multiply(q[k - 1][None], steps[k][None])[0]
    return q


def recording(
    attitudes: FloatArray,
    errors: Calibration | None = None,
    seed: int = 1,
    noise: tuple[float, float, float] = (0.03, 0.001, 0.4),
    shake: float = 0.0,
) -> Recording:
    """What a sensor of the `attitudes` (n, 4) measures, if `errors` would put it right.

    `noise` of accelerometer (m/s²), gyro (rad/s), magnetometer (µT, every second sample);
    `shake` m/s² of a hand that trembles.
    """
    rng = np.random.default_rng(seed)
    n = len(attitudes) - 1
    none = np.zeros((n + 1, 3))
    accel, gyro = ideal_samples(Motion(none, none, attitudes, np.ones(n + 1, bool)), RATE)
    t = np.arange(n) / RATE
    accel = accel + shake * np.stack([np.sin(31 * t), np.sin(37 * t), np.sin(43 * t)], 1)
    mag = rotate(attitudes[1:] * [1, -1, -1, -1], np.repeat(Earth().enu[None], n, axis=0))
    values = {"accelerometer": accel, "gyro": gyro, "magnetometer": mag}
    if errors is not None:
        values = {
            name: (true + errors.bias(name)) @ np.linalg.inv(errors.matrix(name)).T
            for name, true in values.items()
        }
    for sigma, name in zip(noise, values, strict=True):
        values[name] = values[name] + sigma * rng.standard_normal((n, 3))
    values["magnetometer"][::2] = np.nan
    return Recording(
        "hand", t, values["accelerometer"], values["gyro"], RATE, mag=values["magnetometer"]
    )
