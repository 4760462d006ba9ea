"""`ekf`: the error-state Kalman filter with zero-velocity updates, 9 or 15 states.

The field's standard: Foxlin 2005, "Pedestrian tracking with shoe-mounted inertial sensors", IEEE
Computer Graphics and Applications 25(6); Skog, Nilsson, Händel 2010, "Evaluation of zero-velocity
detectors for foot-mounted inertial navigation systems", IPIN. States: errors of position, velocity
and attitude (ENU); with 15 the accelerometer's and the gyro's biases (body) as well. Joseph's form
keeps the covariance symmetric.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from solenav.filters import motion
from solenav.filters import still as stillness
from solenav.filters.walk import Aids, Inputs, Track, Walk
from solenav.recording import FloatArray


@dataclass(frozen=True)
class Tuning:
    """What an EKF needs to be told, SI units; the defaults are those of 9 states.

    `accel_noise` m/s/√s and `gyro_noise` rad/√s are the process noise, `zupt` m/s the noise of the
    zero velocity per stance sample at 200 Hz; then deviations at the start and how the biases
    wander. `gate` is the largest m² (three degrees of freedom) that a gated filter accepts.
    """

    accel_noise: float = 0.2
    gyro_noise: float = 1.66e-3
    zupt: float = 0.562
    start_velocity: float = 0.01
    start_tilt: float = 8.73e-3
    start_heading: float = 1.75e-3
    accel_bias: float = 0.05
    gyro_bias: float = 8.73e-4
    accel_bias_walk: float = 1e-4
    gyro_bias_walk: float = 1.75e-5
    gate: float = 10.0


# Chosen by tools/studies/rivals.py. A zero velocity as soft as that, over the samples of a
# stance, is what serves best: the foot rolls on, and what one sample gets wrong the next repeats.
TUNING = {
    9: Tuning(),
    15: Tuning(gyro_noise=5.24e-3, zupt=0.75, start_tilt=2.76e-2, gyro_bias=2.76e-4, gate=2.15),
}


class _Noise(NamedTuple):
    q_v: float
    q_t: float
    q_ba: float
    q_bg: float
    r: float
    gate: float


def run(walk: Walk, aids: Aids, *, states: int, tuning: Tuning | None = None) -> Track:
    """The walk by an EKF of 9 or 15 `states`."""
    t = tuning or TUNING[states]
    n = len(walk.counts)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    deviations = np.concatenate(
        [
            np.zeros(3),
            np.full(3, t.start_velocity),
            [t.start_tilt, t.start_tilt, t.start_heading],
            np.full(3, t.accel_bias),
            np.full(3, t.gyro_bias),
        ]
    )[:states]
    noise = _Noise(
        t.accel_noise**2 * walk.dt,
        t.gyro_noise**2 * walk.dt,
        t.accel_bias_walk**2 * walk.dt,
        t.gyro_bias_walk**2 * walk.dt,
        # Samples of one stance repeat each other: a higher rate says no more.
        t.zupt**2 * walk.rate_hz / 200.0,
        t.gate if aids.gate else math.inf,
    )
    _navigate(
        walk.inputs(),
        noise,
        stillness.of_walk(walk, aids.still),
        np.diag(deviations**2),
        position,
        velocity,
    )
    return Track(position, velocity)


@njit(cache=True)
def _matrix(q: FloatArray) -> FloatArray:
    out = np.empty((3, 3))
    for i in range(3):
        axis = np.zeros(3)
        axis[i] = 1.0
        out[:, i] = motion.rotate(q, axis)
    return out


@njit(cache=True)
def _navigate(
    given: Inputs,
    noise: _Noise,
    still: stillness.Still,
    cov: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    accel, gyro, stance, first, attitude, gyro_bias, gravity, dt = given
    states = len(cov)
    q, b_g, b_a = attitude.copy(), gyro_bias.copy(), np.zeros(3)
    v, p = np.zeros(3), np.zeros(3)
    eye = np.eye(states)
    transition = np.eye(states)
    for i in range(3):
        transition[i, 3 + i] = dt
    r = noise.r * np.eye(3)
    still_ticks = 0
    for n in range(first, len(accel)):
        rate = gyro[n] - b_g
        force = motion.integrate(accel[n] - b_a, rate, gravity, dt, q, v, p)
        transition[3:6, 6:9] = -dt * motion.skew(force)
        if states == 15:
            body = _matrix(q)
            transition[3:6, 9:12] = -dt * body
            transition[6:9, 12:15] = -dt * body
        cov = transition @ cov @ transition.T
        for i in range(3):
            cov[3 + i, 3 + i] += noise.q_v
            cov[6 + i, 6 + i] += noise.q_t
            if states == 15:
                cov[9 + i, 9 + i] += noise.q_ba
                cov[12 + i, 12 + i] += noise.q_bg
        still_ticks = stillness.count(rate, still, still_ticks)
        if stance[n]:
            stillness.learn(rate, still, still_ticks, b_g)
            inverse = np.linalg.inv(np.ascontiguousarray(cov[3:6, 3:6]) + r)
            if v @ (inverse @ v) <= noise.gate:
                gain = np.ascontiguousarray(cov[:, 3:6]) @ inverse
                # The velocity is the observation of its own error.
                error = gain @ v
                p -= error[0:3]
                v -= error[3:6]
                motion.turn(q, -error[6:9])
                if states == 15:
                    b_a -= error[9:12]
                    b_g -= error[12:15]
                left = eye.copy()
                left[:, 3:6] -= gain
                cov = left @ cov @ left.T + gain @ r @ gain.T
        position[n], velocity[n] = p, v
