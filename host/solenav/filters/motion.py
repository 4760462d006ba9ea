"""Float strapdown integration and the quaternions it needs: what every float filter shares.

Quaternions (4,) are scalar first, body to ENU; vectors (3,). Compiled by numba.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from solenav.recording import FloatArray


@njit(cache=True)
def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@njit(cache=True)
def skew(v: FloatArray) -> FloatArray:
    """The matrix (3, 3) that takes a vector to its cross product with `v`."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@njit(cache=True)
def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """The product a ⊗ b."""
    out = np.empty(4)
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return out


@njit(cache=True)
def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Body vector `v` in ENU."""
    twice = 2.0 * cross(q[1:], v)
    return v + q[0] * twice + cross(q[1:], twice)


@njit(cache=True)
def rotation(phi: FloatArray) -> FloatArray:
    """Quaternion of a rotation vector in rad."""
    angle = math.sqrt((phi * phi).sum())
    out = np.zeros(4)
    out[0] = math.cos(0.5 * angle)
    if angle > 0.0:
        out[1:] = phi * (math.sin(0.5 * angle) / angle)
    return out


@njit(cache=True)
def turn(q: FloatArray, phi: FloatArray) -> None:
    """Turn the attitude by `phi` (rad, ENU), in place."""
    q[:] = multiply(rotation(phi), q)
    q /= math.sqrt((q * q).sum())


@njit(cache=True)
def integrate(
    accel: FloatArray,
    rate: FloatArray,
    gravity: float,
    dt: float,
    q: FloatArray,
    v: FloatArray,
    p: FloatArray,
) -> FloatArray:
    """One sample into attitude, velocity and position, in place; the specific force in ENU.

    `accel` m/s² and `rate` rad/s (free of bias) are the sample's; docs/algorithm.md, step 1.
    """
    h = 0.5 * dt * rate
    h2 = (h * h).sum()
    force = rotate(q, accel + cross(h, accel))
    step = np.empty(4)
    step[0] = 1.0 - h2 / 2.0 + h2 * h2 / 24.0
    step[1:] = h * (1.0 - h2 / 6.0 + h2 * h2 / 120.0)
    q[:] = multiply(q, step)
    q *= (3.0 - (q * q).sum()) / 2.0
    for i in range(3):
        old = v[i]
        v[i] += (force[i] - (gravity if i == 2 else 0.0)) * dt
        p[i] += 0.5 * (v[i] + old) * dt
    return force
