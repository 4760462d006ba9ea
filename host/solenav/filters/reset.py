"""`ins` and `reset`: no correction at all, and velocity set to zero in stance.

`ins` is plain strapdown integration (Titterton, Weston 2004, "Strapdown Inertial Navigation
Technology"); `reset` the simplest zero-velocity update, as in the first shoe-mounted systems.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from solenav.filters import motion
from solenav.filters import still as stillness
from solenav.filters.walk import Aids, BoolArray, Inputs, Track, Walk
from solenav.recording import FloatArray


@dataclass(frozen=True)
class Tuning:
    """What a gated `reset` needs to be told; chosen by tools/studies/rivals.py.

    It believes a stance whose velocity is below `gate` m/s after a second since the stance
    before; with time it grows as its root, as the velocity's error from white noise does.
    """

    gate: float = 4.64


def ins(walk: Walk, aids: Aids) -> Track:
    """Dead reckoning."""
    return _run(walk, np.zeros_like(walk.stance), math.inf, aids)


def reset(walk: Walk, aids: Aids, *, tuning: Tuning | None = None) -> Track:
    """Dead reckoning with the velocity set to zero on each stance sample."""
    gate = (tuning or Tuning()).gate if aids.gate else math.inf
    return _run(walk, walk.stance, gate, aids)


def _run(walk: Walk, zero: BoolArray, gate: float, aids: Aids) -> Track:
    n = len(walk.counts)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    _navigate(
        walk.inputs(),
        zero,
        gate,
        stillness.of_walk(walk, aids.still),
        position,
        velocity,
    )
    return Track(position, velocity)


@njit(cache=True)
def _navigate(
    given: Inputs,
    zero: BoolArray,
    gate: float,
    still: stillness.Still,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    accel, gyro, stance, first, attitude, gyro_bias, gravity, dt = given
    q, bias = attitude.copy(), gyro_bias.copy()
    v, p = np.zeros(3), np.zeros(3)
    still_ticks = since = 0
    for n in range(first, len(accel)):
        rate = gyro[n] - bias
        motion.integrate(accel[n], rate, gravity, dt, q, v, p)
        still_ticks = stillness.count(rate, still, still_ticks)
        since += 1
        if stance[n]:
            stillness.learn(rate, still, still_ticks, bias)
        if zero[n] and math.sqrt((v * v).sum()) <= gate * math.sqrt(since * dt):
            v[:] = 0.0
            since = 0
        position[n], velocity[n] = p, v
