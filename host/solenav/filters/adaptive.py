"""`apf-float` and `kf-twin`: the core's adaptive zero-velocity update, in floats.

Both are the algorithm of docs/algorithm.md, steps 1 to 12, with the core's parameters, and differ
in one thing: how the velocity error's mean and variance come from the prior and the observation.
`apf-float` has the core's particles (Guo, Xu, Ji 2020, J. Northwestern Polytechnical University
38(2), section 2), the same random numbers and the same table of Gaussians; `kf-twin` has a scalar
Kalman filter per axis (Kalman 1960). The twin is what the particles must at least equal.

A `Variant` of either is what might let a cloud do what a Gaussian can't; docs/particles.md tells
what came of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from solenav import mpu9150
from solenav.filters import motion
from solenav.filters import still as stillness
from solenav.filters.walk import Aids, BoolArray, Inputs, Track, Walk
from solenav.parameters import named
from solenav.recording import FloatArray
from solenav_core.tables.lookup import TABLES

PARTICLES = 100
_STRIDE = 37
_GAUSS = np.array(TABLES[273:573], float).reshape(3, PARTICLES).T / 2**11
# The core limits what goes into its words; so do the floats, where it makes a difference.
_V_SEEN = 8.0  # m/s
_SCATTERED = 16.0  # sigma
# Variants: the kernel's share of the deviation, the far tenth and what keeps the variance.
_KERNEL = 0.3
_FAR = 3.0
_NEAR = 1.0 / math.sqrt(0.9 + 0.1 * _FAR**2)


class Noise(NamedTuple):
    """The core's parameters in SI units, per tick."""

    dt: float
    gamma: float
    t_rate: float
    t_accel: float
    t_growth: float
    u_max: float
    u_sure: float
    q_h: float
    q_u: float
    strike: float
    long_ticks: int
    step_swing: int
    q_tt: float
    freeze: int
    p_vv_0: float
    p_tt_0: float
    r: float
    m2_max: float
    log_floor: float
    m_a: float
    m_b: float
    k_e: float
    k: float
    heavy_min: int
    lockout_ticks: int
    lockout_min: int
    p_vv_h1: float
    seed: int


def _sigma(one: int, weight: int) -> float:
    """The deviation that a weight in the unrest stands for; weight 0 leaves that part out."""
    return math.sqrt(one / weight) if weight else math.inf


def _noise(walk: Walk) -> Noise:
    p = named(walk.params)
    return Noise(
        dt=p["DT"] / 2**30,
        gamma=p["GAMMA"] / 2**30,
        t_rate=_sigma(2**32, p["UNREST_RATE"]) * 2 * mpu9150.GYRO_RADPS_PER_LSB,
        t_accel=_sigma(2**18, p["UNREST_ACC"]),
        t_growth=p["UNREST_GROWTH"] / 2**30,
        u_max=p["UNREST_MAX"] / 2**8,
        u_sure=p["UNREST_SURE"] / 2**8,
        q_h=p["Q_VV_H"] / 2**26,
        q_u=p["Q_VV_U"] / 2**26,
        strike=p["STRIKE"] / 2**40,
        long_ticks=2 * p["ALIGN_TICKS"],
        step_swing=p["STEP_SWING"],
        q_tt=p["Q_TT"] / 2**30,
        freeze=p["FREEZE_TICKS"],
        p_vv_0=p["P_VV_0"] / 2**26,
        p_tt_0=p["P_TT_0"] / 2**30,
        r=p["R"] / 2**24,
        m2_max=p["M2_MAX"] / 2**10,
        log_floor=p["LOG_FLOOR"] / 2**16 * math.log(2),
        m_a=p["M_A"] / 2**14,
        m_b=p["M_B"] / 2**14,
        k_e=p["K_E"] / 2**14,
        k=p["K"] / 2**14,
        heavy_min=p["HEAVY_MIN"],
        lockout_ticks=p["LOCKOUT_TICKS"],
        lockout_min=p["LOCKOUT_MIN"],
        p_vv_h1=p["P_VV_H1"] / 2**26,
        seed=p["SEED"],
    )


class Variant(NamedTuple):
    """Ways to differ from the core.

    `doubt` is how probable it is that the foot moves though it is said to stand; its velocity is
    then normal with a deviation of `spread` m/s. So an observation's likelihood is a mixture, and
    far from zero it says nothing more. With `per_stance` the doubt is not each sample's but a
    stance's: so many of the particles take it for none, and the weights decide. `widen` False
    leaves out the widening of R by m². With `keep` the cloud is never drawn anew from P_vv but
    after H1: in swing it grows with P_vv, and H2 resamples it (systematic, with a kernel that
    leaves mean and variance: Liu and West 2001). `freedom` finite makes the likelihood a Student t
    of so many degrees. With `tails` a tenth of what is drawn has three times the deviation of the
    rest, the variance being P_vv as ever.

    The twin knows `widen`, and `doubt` per sample: it takes the Gaussian with the mean and the
    variance of the mixture (probabilistic data association, Bar-Shalom and Tse 1975).
    """

    doubt: float = 0.0
    spread: float = 1.0
    per_stance: bool = False
    widen: bool = True
    keep: bool = False
    freedom: float = math.inf
    tails: bool = False


CORE = Variant()


def particles(walk: Walk, aids: Aids, variant: Variant = CORE) -> Track:
    """`apf-float`, or a variant of it."""
    return _run(walk, True, variant)


def twin(walk: Walk, aids: Aids, variant: Variant = CORE) -> Track:
    """`kf-twin`, or a variant of it."""
    return _run(walk, False, variant)


def _run(walk: Walk, particles: bool, variant: Variant) -> Track:
    n = len(walk.counts)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    _navigate(
        walk.inputs(),
        _noise(walk),
        stillness.of_walk(walk, True),
        particles,
        variant,
        _GAUSS,
        position,
        velocity,
    )
    return Track(position, velocity)


@njit(cache=True)
def _stir(random: np.uint32) -> np.uint32:
    """xorshift32 (Marsaglia 2003)."""
    x = np.uint32(random ^ np.uint32(random << np.uint32(13)))
    x = np.uint32(x ^ (x >> np.uint32(17)))
    return np.uint32(x ^ np.uint32(x << np.uint32(5)))


@njit(cache=True)
def _row(random: np.uint32) -> int:
    """The row of the table that the lower half of a random number chooses."""
    return (np.int64(random & np.uint32(65535)) * PARTICLES) >> 16


@njit(cache=True)
def _draw(variance: FloatArray, table: FloatArray, first: int, stride: int) -> FloatArray:
    cloud = np.empty((PARTICLES, 3))
    for j in range(3):
        sigma = math.sqrt(max(variance[j], 0.0))
        for i in range(PARTICLES):
            cloud[i, j] = sigma * table[(first + stride * i) % PARTICLES, j]
    return cloud


@njit(cache=True)
def _grow(
    noise: Noise,
    q_u: float,
    p_vv: FloatArray,
    p_pv: FloatArray,
    p_vt: FloatArray,
    p_pt: FloatArray,
    p_tt: FloatArray,
) -> FloatArray:
    """Step 2, in place, with `q_u` (m/s)² added to P_vv of U; the growth of P_vv."""
    dt = noise.dt
    growth = np.zeros(3)
    for j in range(3):
        gamma = noise.gamma if j < 2 else 0.0
        growth[j] = 2.0 * gamma * p_vt[j] + gamma * gamma * p_tt[j]
        growth[j] += noise.q_h if j < 2 else q_u
        p_pt[j] += dt * p_vt[j]
        p_pv[j] += dt * p_vv[j] + gamma * p_pt[j]
        p_vv[j] += growth[j]
        p_vt[j] += gamma * p_tt[j]
        if j < 2:
            p_tt[j] += noise.q_tt
    return growth


@njit(cache=True)
def _fatten(cloud: FloatArray, first: int) -> None:
    """Heavy tails, in place, for particles just drawn from row `first` on; pairs stay pairs."""
    for i in range(PARTICLES):
        cloud[i] *= _NEAR * (_FAR if (first + i) % 10 == 0 else 1.0)


@njit(cache=True)
def _doubt(share: float, first: int) -> BoolArray:
    """Which particles take a stance for none: a share of them, in pairs, as chance has it."""
    pairs = PARTICLES // 2
    doubts = np.zeros(PARTICLES, np.bool_)
    for i in range(PARTICLES):
        doubts[i] = (_STRIDE * i + first) % pairs < round(share * pairs)
    return doubts


@njit(cache=True)
def _resample(
    x: FloatArray, doubts: BoolArray, w: FloatArray, table: FloatArray, first: int
) -> None:
    """The cloud by its weights, in place: copies, spread a little."""
    old, before = x.copy(), doubts.copy()
    total = w.sum()
    mean, sigma = np.zeros(3), np.zeros(3)
    for j in range(3):
        mean[j] = (w * old[:, j]).sum() / total
        sigma[j] = math.sqrt((w * (old[:, j] - mean[j]) ** 2).sum() / total)
    at, summed = 0, w[0]
    for i in range(PARTICLES):
        while summed < (i + 0.5) / PARTICLES * total and at < PARTICLES - 1:
            at += 1
            summed += w[at]
        noise = _KERNEL * sigma * table[(first + i) % PARTICLES]
        x[i] = mean + math.sqrt(1.0 - _KERNEL**2) * (old[at] - mean) + noise
        doubts[i] = before[at]


@njit(cache=True)
def _log_likelihood(square: float, r: float, doubted: bool, variant: Variant) -> float:
    """Of a foot whose speed is the root of `square` (m/s)², less that of one at rest for sure."""
    if variant.freedom < math.inf:
        return -0.5 * (variant.freedom + 3.0) * math.log1p(square / (variant.freedom * r))
    stands = -square / (2.0 * r)
    if variant.doubt == 0.0:
        return stands
    wide = variant.spread**2
    moves = 1.5 * math.log(r / wide) - square / (2.0 * wide)
    if variant.per_stance:
        return moves if doubted else stands
    stands += math.log(1.0 - variant.doubt)
    moves += math.log(variant.doubt)
    most = max(stands, moves)
    return most + math.log(math.exp(stands - most) + math.exp(moves - most))


@njit(cache=True)
def _moves(v: FloatArray, p_vv: FloatArray, r: float, variant: Variant) -> float:
    """How probable it is, to a Gaussian, that the foot moves."""
    if variant.doubt == 0.0:
        return 0.0
    log_odds = math.log(variant.doubt / (1.0 - variant.doubt))
    for j in range(3):
        near, far = p_vv[j] + r, p_vv[j] + variant.spread**2
        log_odds += 0.5 * (math.log(near / far) + v[j] ** 2 * (1.0 / near - 1.0 / far))
    return 1.0 / (1.0 + math.exp(-min(max(log_odds, -700.0), 700.0)))


@njit(cache=True)
def _navigate(
    given: Inputs,
    noise: Noise,
    still: stillness.Still,
    particles: bool,
    variant: Variant,
    table: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    accel, gyro, stance, first, attitude, gyro_bias, gravity, _dt = given
    random = np.uint32(noise.seed)
    q, bias = attitude.copy(), gyro_bias.copy()
    v, p = np.zeros(3), np.zeros(3)
    p_vv = np.full(3, noise.p_vv_0)
    p_tt = np.array([noise.p_tt_0, noise.p_tt_0, 0.0])
    p_pv, p_vt, p_pt = np.zeros(3), np.zeros(3), np.zeros(3)
    x = np.zeros((PARTICLES, 3))
    log_w, w = np.zeros(PARTICLES), np.ones(PARTICLES)
    doubts, left = np.zeros(PARTICLES, np.bool_), np.zeros(3)
    reach = np.zeros(3)
    growth = np.zeros(3)
    last, anchor = np.zeros(3), np.zeros(3)
    standing = observed = False
    stillest = 1.0
    swing = stood = still_ticks = inconsistent = since = 0

    for n in range(first, len(accel)):
        rate = gyro[n] - bias
        size = math.sqrt((accel[n] * accel[n]).sum())
        motion.integrate(accel[n], rate, gravity, noise.dt, q, v, p)
        if swing <= noise.freeze:
            q_u = noise.q_h if swing == 0 and stood > noise.long_ticks else noise.q_u
            q_u += noise.strike * ((accel[n] - accel[n - 1]) ** 2).sum()
            growth = _grow(noise, q_u, p_vv, p_pv, p_vt, p_pt, p_tt)
        random = _stir(random)
        since += 1
        still_ticks = stillness.count(rate, still, still_ticks)
        # 3. Unrest: how far this sample is from the stillest of late.
        t = (rate * rate).sum() / noise.t_rate**2 + ((size - gravity) / noise.t_accel) ** 2
        stillest = max(1.0, min(t, stillest * (1.0 + noise.t_growth)))
        unrest = t / stillest
        if not stance[n]:
            swing += 1
            if swing == noise.step_swing:
                stood = 0
            standing = observed = False
            position[n], velocity[n] = p, v
            continue
        if not standing:
            anchor = last.copy()
        swing = 0
        stood += 1
        standing = True
        stillness.learn(rate, still, still_ticks, bias)
        if unrest > noise.u_max:
            observed = False
            last = p.copy()
            position[n], velocity[n] = p, v
            continue

        # 7. Adaptive observation noise.
        seen = np.minimum(np.maximum(v, -_V_SEEN), _V_SEEN)
        r_eff = noise.r * (1.0 + unrest) ** 2
        m2 = (seen * seen / (p_vv + r_eff)).sum()
        if variant.widen and m2 > noise.m2_max:
            r_eff *= (m2 / 2.0) ** 2

        # 6, 8. The error's mean and variance.
        error, var = np.zeros(3), np.zeros(3)
        n_eff = float(PARTICLES)
        moved = x
        if particles:
            if not observed:
                if variant.keep and left.any():
                    _resample(x, doubts, np.exp(log_w), table, _row(random))
                    x += _draw(p_vv - left, table, _row(random), _STRIDE)
                else:
                    x = _draw(p_vv, table, _row(random), 1)
                    if variant.tails:
                        _fatten(x, _row(random))
                if variant.per_stance:
                    doubts = _doubt(variant.doubt, _row(random))
                moved = x.copy()
                log_w[:] = 0.0
                reach = 3.18 * np.sqrt(p_vv)
            else:
                moved = x + _draw(growth, table, _row(random), _STRIDE)
                reach += 3.18 * np.sqrt(growth)
            for i in range(PARTICLES):
                off = seen - moved[i]
                log_w[i] += _log_likelihood((off * off).sum(), r_eff, doubts[i], variant)
            log_w = np.maximum(log_w - log_w.max(), noise.log_floor)
            w = np.exp(log_w)
            total = w.sum()
            for j in range(3):
                error[j] = (w * moved[:, j]).sum() / total
                var[j] = (w * (moved[:, j] - error[j]) ** 2).sum() / total
                # No observation tells more than this of a Gaussian.
                var[j] = max(var[j], p_vv[j] * r_eff / (p_vv[j] + r_eff))
            n_eff = total**2 / (w * w).sum()
        else:
            moves = _moves(seen, p_vv, r_eff, variant)
            for j in range(3):
                gain = p_vv[j] / (p_vv[j] + r_eff)
                error[j] = gain * v[j]
                var[j] = (1.0 - gain) * p_vv[j]
                if moves > 0.0:
                    other = p_vv[j] / (p_vv[j] + variant.spread**2)
                    error[j] += moves * (other - gain) * v[j]
                    var[j] += moves * (gain - other) * p_vv[j]
                    var[j] += moves * (1.0 - moves) * ((gain - other) * v[j]) ** 2

        # 9, 10. Adaptive threshold and lock-out.
        sure = unrest <= noise.u_sure
        if sure and m2 > noise.m2_max:
            inconsistent += 1
        elif sure:
            inconsistent = 0
            since = 0
        threshold = min(noise.m_b, noise.m_a + noise.k_e * inconsistent / n_eff)
        if since > noise.lockout_ticks and inconsistent >= noise.lockout_min:
            threshold = noise.m_b
        locked = sure and threshold >= noise.m_b
        if locked:
            error = v.copy()
            var[:] = noise.p_vv_h1

        # 11. Feedback.
        phi = np.zeros(3)
        for j in range(3):
            rho = min(1.0, var[j] / p_vv[j])
            k_p = p_pv[j] / p_vv[j]
            k_t = p_vt[j] / p_vv[j]
            v[j] -= error[j]
            p[j] -= k_p * error[j]
            tilt = min(max(k_t * min(max(error[j], -_V_SEEN), _V_SEEN), -0.5), 0.5)
            if j == 0:
                phi[1] = -tilt
            elif j == 1:
                phi[0] = tilt
            taken = 1.0 - rho
            p_tt[j] = max(0.0, p_tt[j] - k_t * p_vt[j] * taken)
            p_pt[j] -= k_p * p_vt[j] * taken
            p_pv[j] *= rho
            p_vt[j] *= rho
            p_vv[j] *= rho
        p[2] += phi[0] * (p[1] - anchor[1]) - phi[1] * (p[0] - anchor[0])
        motion.turn(q, phi)

        # 12. What starts anew.
        if locked:
            inconsistent = since = 0
            for j in range(3):
                p_vv[j] = noise.p_vv_h1
                if j < 2:
                    p_tt[j] = max(p_tt[j], noise.p_tt_0)
        if particles:
            anew = locked or (w > noise.k).sum() < noise.heavy_min
            if not anew:
                for i in range(PARTICLES):
                    if w[i] > threshold:
                        x[i] = moved[i]
                    x[i] -= error
                reach += np.abs(error)
                anew = bool((reach > _SCATTERED * np.sqrt(p_vv)).any())
            elif variant.keep and not locked:
                x = moved - error
            if anew:
                other_half = _row(random) + PARTICLES // 2
                if variant.keep and not locked:
                    _resample(x, doubts, w, table, other_half)
                else:
                    x = _draw(p_vv, table, other_half, 1)
                    if variant.tails:
                        _fatten(x, other_half)
                    if variant.per_stance:
                        share = 0.0 if locked else (w * doubts).sum() / w.sum()
                        doubts = _doubt(share, other_half)
                log_w[:] = 0.0
                reach = 3.18 * np.sqrt(p_vv)

        last, left = p.copy(), p_vv.copy()
        observed = True
        position[n], velocity[n] = p, v
