"""`pf` and `apf-literal`: what particle filters make of a stance without the core's additions.

`pf` is the bootstrap filter (Gordon, Salmond, Smith 1993, IEE Proceedings F 140(2)) in its usual
form of sampling, importance and resampling (Arulampalam et al. 2002, IEEE Transactions on Signal
Processing 50(2), algorithms 2 and 4). `apf-literal` is Guo, Xu, Ji 2020 (J. Northwestern
Polytechnical University 38(2), section 2) read word for word. Both filter the 3-D velocity alone,
so neither corrects the way of the swing or the attitude: an error of velocity that a stance takes
away has already gone into the position.
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

PARTICLES = 100


@dataclass(frozen=True)
class Tuning:
    """What `pf` needs to be told, SI units; chosen by tools/studies/rivals.py.

    Since it can't correct the way of the swing, nothing is gained by trusting the INS in stance:
    what serves best comes close to a velocity reset.

    `accel_noise` m/s/√s drives the velocity error, `zupt` m/s is the noise of the zero velocity
    per stance sample at 200 Hz, `gate` the largest m² of three degrees of freedom that a gated
    filter accepts.
    """

    accel_noise: float = 3.0
    zupt: float = 0.0316
    start_velocity: float = 0.01
    gate: float = 4.64
    seed: int = 1


class Table1(NamedTuple):
    """The paper's table 1; noises as variances in (m/s)², per sample at any rate."""

    initial: float = 0.01
    process: float = 0.01
    measurement: float = 0.01
    k_s: float = 0.2
    m_a: float = 0.1
    m_b: float = 0.5
    k: float = 0.5


LITERAL_GATE = 16.27
"""The largest m² that the gated `apf-literal` accepts: 99.9 % of three degrees of freedom."""
LITERAL_SEED = 1


class _Noise(NamedTuple):
    start: float
    q: float
    r: float
    gate: float


def bootstrap(walk: Walk, aids: Aids, *, tuning: Tuning | None = None) -> Track:
    """`pf`: particles are errors of the INS velocity, which observes them, for the foot stands.

    Process noise grows since the stance before; each stance sample weighs the particles, takes
    their mean off the velocity and resamples them (systematic resampling).
    """
    t = tuning or Tuning()
    noise = _Noise(
        t.start_velocity**2,
        t.accel_noise**2 * walk.dt,
        # As in the EKF, and in the core.
        t.zupt**2 * walk.rate_hz / 200.0,
        t.gate if aids.gate else math.inf,
    )
    n = len(walk.counts)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    _bootstrap(
        walk.inputs(),
        noise,
        stillness.of_walk(walk, aids.still),
        np.random.default_rng(t.seed),
        position,
        velocity,
    )
    return Track(position, velocity)


def literal(walk: Walk, aids: Aids) -> Track:
    """`apf-literal`: the paper's section 2 with table 1 as printed.

    Where the text says one thing, that is done, though it defeats the text's purpose: the state
    is the velocity and the observation the INS velocity in stance; weights are normalised to sum
    1, so that none but a dominating one passes M, and H2 nearly always holds; N_e = N/(1 + σ²_w)
    stays close to N; t counts the iterations. So all particles are drawn anew on every sample.

    Where the text can't be run as printed: a zero-velocity interval starts at step 1, with
    particles around zero velocity of the initial variance and t = 0, since that is all that is
    known there; "draw anew" is step 1 as well, without the count; "x > M" is the particle's
    weight, since a velocity has no threshold; H1 + H2 = 1 is a logical or, for as exclusive or the
    filter wanders off in a stance of more than a second; Φ = I; the estimate replaces the INS
    velocity, and strapdown goes on from it; `K_s` of the table is K_e of the text. The gate, not
    the paper's, compares the INS velocity with the predicted particles.
    """
    n = len(walk.counts)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    _literal(
        walk.inputs(),
        Table1(),
        LITERAL_GATE if aids.gate else math.inf,
        stillness.of_walk(walk, aids.still),
        np.random.default_rng(LITERAL_SEED),
        position,
        velocity,
    )
    return Track(position, velocity)


@njit(cache=True)
def _spread(random: np.random.Generator, variance: float, x: FloatArray) -> None:
    """Process noise onto every particle, in place."""
    sigma = math.sqrt(variance)
    for i in range(PARTICLES):
        for j in range(3):
            x[i, j] += sigma * random.standard_normal()


@njit(cache=True)
def _distance2(v: FloatArray, x: FloatArray, r: float) -> float:
    """m² of an observation (3,) against the predicted particles: squared, in sigma."""
    out = 0.0
    for j in range(3):
        out += (v[j] - x[:, j].mean()) ** 2 / (x[:, j].var() + r)
    return out


@njit(cache=True)
def _weigh(v: FloatArray, x: FloatArray, r: float, log_w: FloatArray) -> FloatArray:
    """The likelihood of observation `v` onto the log weights, in place; weights of sum 1.

    Logarithms, with the largest at 0, for weights of far particles are below any float.
    """
    for i in range(PARTICLES):
        for j in range(3):
            log_w[i] -= (v[j] - x[i, j]) ** 2 / (2.0 * r)
    log_w -= log_w.max()
    w = np.exp(log_w)
    return w / w.sum()


@njit(cache=True)
def _mean(w: FloatArray, x: FloatArray) -> FloatArray:
    out = np.zeros(3)
    for i in range(PARTICLES):
        for j in range(3):
            out[j] += w[i] * x[i, j]
    return out


@njit(cache=True)
def _resampled(random: np.random.Generator, w: FloatArray, x: FloatArray) -> FloatArray:
    """Particles drawn from the weights, all alike after (Arulampalam et al., algorithm 2)."""
    out = np.empty_like(x)
    pointer = random.random() / PARTICLES
    total = w[0]
    i = 0
    for k in range(PARTICLES):
        while pointer > total and i < PARTICLES - 1:
            i += 1
            total += w[i]
        for j in range(3):
            out[k, j] = x[i, j]
        pointer += 1.0 / PARTICLES
    return out


@njit(cache=True)
def _bootstrap(
    given: Inputs,
    noise: _Noise,
    still: stillness.Still,
    random: np.random.Generator,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    accel, gyro, stance, first, attitude, gyro_bias, gravity, dt = given
    q, bias = attitude.copy(), gyro_bias.copy()
    v, p = np.zeros(3), np.zeros(3)
    x = np.zeros((PARTICLES, 3))
    growth = noise.start
    still_ticks = 0
    for n in range(first, len(accel)):
        rate = gyro[n] - bias
        motion.integrate(accel[n], rate, gravity, dt, q, v, p)
        growth += noise.q
        still_ticks = stillness.count(rate, still, still_ticks)
        if stance[n]:
            stillness.learn(rate, still, still_ticks, bias)
            # One draw for the whole swing: its sum has the same distribution.
            _spread(random, growth, x)
            growth = 0.0
            if _distance2(v, x, noise.r) <= noise.gate:
                w = _weigh(v, x, noise.r, np.zeros(PARTICLES))
                error = _mean(w, x)
                v -= error
                x = _resampled(random, w, x) - error
        position[n], velocity[n] = p, v


@njit(cache=True)
def _literal(
    given: Inputs,
    table: Table1,
    gate: float,
    still: stillness.Still,
    random: np.random.Generator,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    accel, gyro, stance, first, attitude, gyro_bias, gravity, dt = given
    q, bias = attitude.copy(), gyro_bias.copy()
    v, p = np.zeros(3), np.zeros(3)
    x = np.zeros((PARTICLES, 3))
    log_w = np.zeros(PARTICLES)
    standing = False
    still_ticks = iterations = 0
    for n in range(first, len(accel)):
        rate = gyro[n] - bias
        motion.integrate(accel[n], rate, gravity, dt, q, v, p)
        still_ticks = stillness.count(rate, still, still_ticks)
        if stance[n]:
            stillness.learn(rate, still, still_ticks, bias)
            if not standing:
                x[:] = 0.0
                _spread(random, table.initial, x)
                log_w[:] = 0.0
                iterations = 0
            moved = x.copy()
            _spread(random, table.process, moved)
            if _distance2(v, moved, table.measurement) <= gate:
                iterations += 1
                w = _weigh(v, moved, table.measurement, log_w)
                v[:] = _mean(w, moved)
                n_e = PARTICLES / (1.0 + w.var())
                threshold = table.m_a + table.k_s / n_e * iterations
                threshold = min(max(threshold, table.m_a), table.m_b)
                for i in range(PARTICLES):
                    if w[i] > threshold:
                        x[i] = moved[i]
                h1 = threshold >= table.m_b
                h2 = (w > table.k).sum() < PARTICLES / 2
                if h1 or h2:
                    x[:] = 0.0
                    _spread(random, table.initial, x)
                    log_w[:] = 0.0
        standing = stance[n]
        position[n], velocity[n] = p, v
