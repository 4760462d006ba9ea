"""What an IMU on the foot measures: the ideal samples, and a model of the sensor's errors.

Axes are the body's (right-front-up). Quantisation and clipping are the conversion's business
(`solenav.mpu9150.to_counts`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solenav.recording import FloatArray
from solenav.sim.gait import Motion, multiply

GRAVITY = 9.80665
"""m/s², downward."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors of accelerometer, gyro and magnetometer; every axis draws its own, independently.

    `*_bias` (m/s², rad/s) and `*_scale` (relative) are standard deviations of a constant over
    the recording. `*_noise` (m/s²/√Hz, rad/s/√Hz) are one-sided noise densities as in data
    sheets. `*_walk` (m/s²/√s, rad/s/√s) let the bias wander, which stands for its instability.
    `*_coloured` (m/s², rad/s) are standard deviations of noise that repeats itself: white noise
    through two lags of the time constants `lags_s`, which is AR(2) at any rate.

    Of the magnetometer, `hard_iron` (µT) is the standard deviation of a constant in the sensor's
    axes, `soft_iron` that of each element by which the matrix on the field differs from the
    identity (symmetric: iron that the field magnetises has no twist), `mag_noise` (µT) that of
    each reading.
    """

    accel_bias: float = 0.0
    gyro_bias: float = 0.0
    accel_noise: float = 0.0
    gyro_noise: float = 0.0
    accel_walk: float = 0.0
    gyro_walk: float = 0.0
    accel_scale: float = 0.0
    gyro_scale: float = 0.0
    accel_coloured: float = 0.0
    gyro_coloured: float = 0.0
    lags_s: tuple[float, float] = (0.2, 0.02)
    hard_iron: float = 0.0
    soft_iron: float = 0.0
    mag_noise: float = 0.0


IDEAL = SensorErrors()

TABLE1 = SensorErrors(
    accel_bias=0.008,
    gyro_bias=math.radians(0.05),
    accel_noise=400e-6 * GRAVITY,
    gyro_noise=math.radians(0.005),
    hard_iron=1.0,
    soft_iron=0.01,
    mag_noise=0.4,
)
"""Drifts of the paper's Table 1, noise densities of the MPU-9150's data sheet.

The magnetometer's iron is what a calibration leaves.
"""


def ideal_samples(states: Motion, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Mean specific force (n, 3) m/s² and angular rate (n, 3) rad/s between n + 1 states.

    Integrating is exact, not sampling: the rate turns one attitude into the next, and the
    specific force, in the axes of the attitude half-way, makes one velocity into the next. So
    what a strapdown loses on these samples is its own error.
    """
    before, after = states.attitude[:-1], states.attitude[1:]
    turn = rotation_vector(multiply(before * [1, -1, -1, -1], after))
    halfway = multiply(before, from_rotation_vector(turn / 2))
    force = np.diff(states.velocity_enu, axis=0) * rate_hz + [0.0, 0.0, GRAVITY]
    return rotate(halfway * [1, -1, -1, -1], force), turn * rate_hz


def with_errors(
    accel: FloatArray,
    gyro: FloatArray,
    rate_hz: float,
    errors: SensorErrors,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Ideal specific force and angular rate (n, 3) as a sensor with `errors` gives them."""
    e = errors
    return (
        _measured(accel, rate_hz, e.accel_bias, e.accel_scale, e.accel_noise, e.accel_walk, rng),
        _measured(gyro, rate_hz, e.gyro_bias, e.gyro_scale, e.gyro_noise, e.gyro_walk, rng),
    )


def coloured_noise(
    samples: int, rate_hz: float, errors: SensorErrors, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """The coloured part of accelerometer and gyro, (samples, 3) each, from its stationary state."""
    sizes = np.repeat([errors.accel_coloured, errors.gyro_coloured], 3)
    if not sizes.any():
        return np.zeros((samples, 3)), np.zeros((samples, 3))
    one, other = np.exp(-1 / (rate_hz * np.array(errors.lags_s)))
    phi1, phi2 = one + other, -one * other
    # The variance of AR(2) whose new part has 1 (Box, Jenkins 1970, section 3.2).
    variance = (1 - phi2) / ((1 + phi2) * ((1 - phi2) ** 2 - phi1**2))
    settled = int(10 * max(errors.lags_s) * rate_hz) + 2
    noise = rng.standard_normal((settled + samples, 6)) / np.sqrt(variance)
    for n in range(2, len(noise)):
        noise[n] += phi1 * noise[n - 1] + phi2 * noise[n - 2]
    noise = sizes * noise[settled:]
    return noise[:, :3], noise[:, 3:]


def measured_field(
    field_enu: FloatArray, attitude: FloatArray, errors: SensorErrors, rng: np.random.Generator
) -> FloatArray:
    """What a magnetometer of `attitude` (n, 4) measures of a field (n, 3), µT, in its own axes."""
    true = rotate(attitude * [1, -1, -1, -1], field_enu)
    hard = errors.hard_iron * rng.standard_normal(3)
    drawn = rng.standard_normal((3, 3))
    soft = np.eye(3) + errors.soft_iron * (np.tril(drawn) + np.tril(drawn, -1).T)
    return true @ soft + hard + errors.mag_noise * rng.standard_normal(true.shape)


def _measured(
    true: FloatArray,
    rate_hz: float,
    bias: float,
    scale: float,
    noise: float,
    walk: float,
    rng: np.random.Generator,
) -> FloatArray:
    # Every number is drawn even where it counts for nothing, so that switching one error off
    # leaves the others as they were.
    offset = bias * rng.standard_normal(3)
    factor = 1 + scale * rng.standard_normal(3)
    # A one-sided density fills the band up to half the sample rate.
    white = noise * math.sqrt(rate_hz / 2) * rng.standard_normal(true.shape)
    wander = walk / math.sqrt(rate_hz) * np.cumsum(rng.standard_normal(true.shape), axis=0)
    return factor * true + offset + white + wander


def rotation_vector(q: FloatArray) -> FloatArray:
    """Rotation vectors (m, 3) in rad, of at most half a turn, of unit quaternions (m, 4)."""
    q = np.where(q[:, :1] < 0, -q, q)
    sine = np.linalg.norm(q[:, 1:], axis=1)
    half = np.arctan2(sine, q[:, 0])
    safe = np.where(sine > 0, sine, 1.0)
    return (2 * np.where(sine > 0, half / safe, 1.0))[:, None] * q[:, 1:]


def from_rotation_vector(turn: FloatArray) -> FloatArray:
    """Unit quaternions (m, 4) of rotation vectors (m, 3) in rad."""
    half = np.linalg.norm(turn, axis=1, keepdims=True) / 2
    return np.hstack([np.cos(half), turn / 2 * np.sinc(half / np.pi)])


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors `v` (m, 3) turned by unit quaternions `q` (m, 4)."""
    twice = 2 * np.cross(q[:, 1:], v)
    return v + q[:, :1] * twice + np.cross(q[:, 1:], twice)
