"""Float64 oracle of the adaptive particle filter for a foot-mounted IMU.

An independent reading of the algorithm that the integer core runs, written for clarity and
compared with the core statistically: nothing here is shared with it. SI units throughout; ENU
navigation frame, right-front-up body frame, quaternions scalar first and body to navigation.
Covariances are one scalar set (p, v, theta) per navigation axis; theta of the East entry is the
tilt that accelerates to the East, and so on. The quantities that only exist in stance (m2, M,
n_eff) are NaN in swing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.stats import norm, qmc

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

PARTICLES = 100
STRIDE = 37
"""Step through the Gaussian table from one particle to the next when particles diffuse."""

REFERENCE_RATE = 200.0


@dataclass(frozen=True)
class Params:
    """Every number of the algorithm, in SI units, as it stands at 200 Hz."""

    # Static start.
    static_time: float = 1.0
    static_accel: float = 0.5
    static_rate: float = math.radians(3.0)
    heading: float = 0.0
    """Azimuth of the body y axis at the end of the static start, clockwise from North."""
    start_p_vv: float = 1e-4
    start_p_tt: float = 1.2e-3

    # Covariance.
    q_horizontal: float = 0.1
    q_vertical: float = 0.01
    q_tilt: float = 3e-5
    freeze_time: float = 10.0

    # Detector.
    accel_min: float = 8.3
    accel_max: float = 11.3
    rate_max: float = math.radians(50.0)
    accel_variance_max: float = 9.0
    window_time: float = 0.05

    # Zero angular rate.
    still_rate: float = math.radians(3.0)
    still_time: float = 0.5
    bias_time: float = 5.0

    # Observation.
    r: float = 0.01
    m2_limit: float = 2.0
    log_weight_floor: float = -16.0

    # Adaptive threshold and recovery.
    m_a: float = 0.1
    m_b: float = 0.5
    k_e: float = 0.4
    lockout_time: float = 1.5
    lockout_samples: int = 5
    restart_p_vv: float = 0.01
    restart_p_tt: float = 1.2e-3

    # Feedback and secondary resampling.
    rotation_max: float = 0.5
    k: float = 0.5
    min_heavy: int = PARTICLES // 2


@dataclass(frozen=True)
class Result:
    """The run, one row per sample; rows before `aligned_at` are zero (identity attitude).

    `aligned_at` is the index of the last sample of the static start (-1 if there was none): that
    row holds the initial state and the next sample is the first one navigated. Each row is the
    state when its tick ended; `t` is the count before H1 cleared it.
    """

    position_enu: FloatArray
    velocity_enu: FloatArray
    quaternion: FloatArray
    stance: BoolArray
    gyro_bias: FloatArray
    m2: FloatArray
    M: FloatArray
    n_eff: FloatArray
    t: NDArray[np.int64]
    resampled: BoolArray
    h1: BoolArray
    p_vv: FloatArray
    p_pv: FloatArray
    p_vt: FloatArray
    p_tt: FloatArray
    p_pt: FloatArray
    aligned_at: int
    gravity: float


class _Start(NamedTuple):
    aligned_at: int
    gravity: float
    bias: FloatArray
    quaternion: FloatArray


class _Run(NamedTuple):
    """Params brought to one sample rate, as numba wants them."""

    dt: float
    window: int
    start_p_vv: float
    start_p_tt: float
    q_horizontal: float
    q_vertical: float
    q_tilt: float
    freeze_time: float
    accel_min: float
    accel_max: float
    rate_max: float
    accel_variance_max: float
    still_rate: float
    still_time: float
    bias_gain: float
    r: float
    m2_limit: float
    log_weight_floor: float
    m_a: float
    m_b: float
    k_e: float
    lockout_time: float
    lockout_samples: int
    restart_p_vv: float
    restart_p_tt: float
    rotation_max: float
    k: float
    min_heavy: int


def gaussian_table(seed: int = 0) -> FloatArray:
    """100 standard normal three-vectors: 50 antithetic pairs, mean 0, covariance identity."""
    half = norm.ppf(qmc.Halton(d=3, scramble=True, seed=seed).random(PARTICLES // 2))
    covariance = half.T @ half / len(half)
    half = half @ np.linalg.inv(np.linalg.cholesky(covariance)).T
    return np.concatenate([half, -half])


def run(
    accel: FloatArray,
    gyro: FloatArray,
    rate_hz: float,
    *,
    params: Params | None = None,
    seed: int = 1,
    gauss: FloatArray | None = None,
) -> Result:
    """Navigate a recording: specific force in m/s², angular rate in rad/s, both (n, 3)."""
    params = Params() if params is None else params
    accel = np.ascontiguousarray(accel, dtype=np.float64)
    gyro = np.ascontiguousarray(gyro, dtype=np.float64)
    table = gaussian_table() if gauss is None else np.ascontiguousarray(gauss, dtype=np.float64)
    if accel.ndim != 2 or accel.shape[1] != 3 or gyro.shape != accel.shape:
        raise ValueError("accel and gyro must both be (n, 3)")
    if table.shape != (PARTICLES, 3):
        raise ValueError(f"gauss must be ({PARTICLES}, 3)")
    if seed % 2**32 == 0:
        raise ValueError("xorshift32 needs a seed other than 0")

    n = len(accel)
    position, velocity, bias, p_vv, p_pv, p_vt, p_tt, p_pt = (np.zeros((n, 3)) for _ in range(8))
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    stance, resampled, h1 = (np.zeros(n, dtype=np.bool_) for _ in range(3))
    m2, m, n_eff = (np.full(n, np.nan) for _ in range(3))
    t = np.zeros(n, dtype=np.int64)

    start = static_start(accel, gyro, rate_hz, params)
    if start is not None:
        _navigate(
            accel,
            gyro,
            table,
            np.uint32(seed % 2**32),
            start,
            _at_rate(params, rate_hz),
            (position, velocity, quaternion, bias),
            (stance, resampled, h1),
            (m2, m, n_eff, t),
            (p_vv, p_pv, p_vt, p_tt, p_pt),
        )
    return Result(
        position_enu=position,
        velocity_enu=velocity,
        quaternion=quaternion,
        stance=stance,
        gyro_bias=bias,
        m2=m2,
        M=m,
        n_eff=n_eff,
        t=t,
        resampled=resampled,
        h1=h1,
        p_vv=p_vv,
        p_pv=p_pv,
        p_vt=p_vt,
        p_tt=p_tt,
        p_pt=p_pt,
        aligned_at=-1 if start is None else start.aligned_at,
        gravity=math.nan if start is None else start.gravity,
    )


def static_start(
    accel: FloatArray, gyro: FloatArray, rate_hz: float, params: Params
) -> _Start | None:
    """Find the first second of stillness; gravity, gyro bias and attitude from its means."""
    needed = max(1, round(params.static_time * rate_hz))
    last = _first_still_run(accel, gyro, needed, params.static_accel, params.static_rate)
    if last < 0:
        return None
    still = slice(last + 1 - needed, last + 1)
    mean = accel[still].mean(axis=0)
    quaternion = attitude_from_gravity(mean, params.heading)
    return _Start(last, float(np.linalg.norm(mean)), gyro[still].mean(axis=0), quaternion)


def attitude_from_gravity(up_body: FloatArray, heading: float) -> FloatArray:
    """Attitude with `up_body` pointing up and the body y axis at azimuth `heading`.

    With y vertical the azimuth is that of the z axis instead.
    """
    up = up_body / np.linalg.norm(up_body)
    front = np.array([0.0, 1.0, 0.0])
    if abs(up[1]) > 1.0 - 1e-9:
        front = np.array([0.0, 0.0, 1.0])
    ahead = front - up * (front @ up)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, up)
    s, c = math.sin(heading), math.cos(heading)
    rotation = np.array([c * right + s * ahead, c * ahead - s * right, up])
    return _quaternion_from_matrix(rotation)


def _quaternion_from_matrix(r: FloatArray) -> FloatArray:
    # The column of the largest diagonal of 4 q qᵀ, which is never small.
    outer = np.array(
        [
            [
                1 + r[0, 0] + r[1, 1] + r[2, 2],
                r[2, 1] - r[1, 2],
                r[0, 2] - r[2, 0],
                r[1, 0] - r[0, 1],
            ],
            [
                r[2, 1] - r[1, 2],
                1 + r[0, 0] - r[1, 1] - r[2, 2],
                r[0, 1] + r[1, 0],
                r[0, 2] + r[2, 0],
            ],
            [
                r[0, 2] - r[2, 0],
                r[0, 1] + r[1, 0],
                1 - r[0, 0] + r[1, 1] - r[2, 2],
                r[1, 2] + r[2, 1],
            ],
            [
                r[1, 0] - r[0, 1],
                r[0, 2] + r[2, 0],
                r[1, 2] + r[2, 1],
                1 - r[0, 0] - r[1, 1] + r[2, 2],
            ],
        ]
    )
    column: FloatArray = outer[:, np.argmax(np.diag(outer))]
    return column / np.linalg.norm(column)


def _at_rate(p: Params, rate_hz: float) -> _Run:
    return _Run(
        dt=1.0 / rate_hz,
        window=max(1, round(p.window_time * rate_hz)),
        start_p_vv=p.start_p_vv,
        start_p_tt=p.start_p_tt,
        q_horizontal=p.q_horizontal,
        q_vertical=p.q_vertical,
        q_tilt=p.q_tilt,
        freeze_time=p.freeze_time,
        accel_min=p.accel_min,
        accel_max=p.accel_max,
        rate_max=p.rate_max,
        accel_variance_max=p.accel_variance_max,
        still_rate=p.still_rate,
        still_time=p.still_time,
        bias_gain=1.0 / (rate_hz * p.bias_time),
        r=p.r * rate_hz / REFERENCE_RATE,
        m2_limit=p.m2_limit,
        log_weight_floor=p.log_weight_floor,
        m_a=p.m_a,
        m_b=p.m_b,
        k_e=p.k_e * REFERENCE_RATE / rate_hz,
        lockout_time=p.lockout_time,
        lockout_samples=p.lockout_samples,
        restart_p_vv=p.restart_p_vv,
        restart_p_tt=p.restart_p_tt,
        rotation_max=p.rotation_max,
        k=p.k,
        min_heavy=p.min_heavy,
    )


@njit(cache=True)
def _first_still_run(
    accel: FloatArray, gyro: FloatArray, needed: int, accel_limit: float, rate_limit: float
) -> int:
    """Index at which a run of `needed` samples near its first one is complete, or -1."""
    first = 0
    for i in range(len(accel)):
        for j in range(3):
            if (
                abs(accel[i, j] - accel[first, j]) > accel_limit
                or abs(gyro[i, j] - gyro[first, j]) > rate_limit
            ):
                first = i
                break
        if i - first + 1 >= needed:
            return i
    return -1


@njit(cache=True)
def _xorshift32(x: np.uint32) -> np.uint32:
    x = np.uint32(x ^ np.uint32(x << np.uint32(13)))
    x = np.uint32(x ^ (x >> np.uint32(17)))
    return np.uint32(x ^ np.uint32(x << np.uint32(5)))


@njit(cache=True)
def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@njit(cache=True)
def _multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    product = np.empty(4)
    product[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    product[1:] = a[0] * b[1:] + b[0] * a[1:] + _cross(a[1:], b[1:])
    return product


@njit(cache=True)
def _rotate(q: FloatArray, x: FloatArray) -> FloatArray:
    twice = 2.0 * _cross(q[1:], x)
    return x + q[0] * twice + _cross(q[1:], twice)


@njit(cache=True)
def _rotation(phi: FloatArray) -> FloatArray:
    """Quaternion of a rotation vector."""
    angle = math.sqrt((phi**2).sum())
    q = np.zeros(4)
    q[0] = math.cos(0.5 * angle)
    if angle > 0.0:
        q[1:] = phi * (math.sin(0.5 * angle) / angle)
    return q


@njit(cache=True)
def _strapdown(
    accel: FloatArray,
    rate: FloatArray,
    gravity: float,
    dt: float,
    q: FloatArray,
    v: FloatArray,
    p: FloatArray,
) -> None:
    """Step 1, in place; `rate` is free of bias."""
    h = 0.5 * dt * rate
    h2 = (h**2).sum()
    force = _rotate(q, accel + _cross(h, accel))
    turn = np.empty(4)
    turn[0] = 1.0 - h2 / 2.0 + h2 * h2 / 24.0
    turn[1:] = h * (1.0 - h2 / 6.0 + h2 * h2 / 120.0)
    q[:] = _multiply(q, turn)
    q *= (3.0 - (q**2).sum()) / 2.0
    force[2] -= gravity
    v_old = v.copy()
    v += force * dt
    p += 0.5 * (v + v_old) * dt


@njit(cache=True)
def _grow_covariance(
    run: _Run,
    gravity: float,
    p_vv: FloatArray,
    p_pv: FloatArray,
    p_vt: FloatArray,
    p_tt: FloatArray,
    p_pt: FloatArray,
) -> FloatArray:
    """Step 2, in place; returns the growth of P_vv."""
    dt = run.dt
    growth = np.zeros(3)
    for j in range(3):
        gamma = gravity * dt if j < 2 else 0.0
        q = run.q_horizontal if j < 2 else run.q_vertical
        growth[j] = 2.0 * gamma * p_vt[j] + gamma * gamma * p_tt[j] + q * dt
        p_pv[j] += dt * p_vv[j] + gamma * (p_pt[j] + dt * p_vt[j])
        p_pt[j] += dt * p_vt[j]
        p_vv[j] += growth[j]
        p_vt[j] += gamma * p_tt[j]
        p_tt[j] += run.q_tilt * dt
    return growth


@njit(cache=True)
def _draw(variance: FloatArray, table: FloatArray, first: int, stride: int) -> FloatArray:
    cloud = np.empty((PARTICLES, 3))
    for j in range(3):
        sigma = math.sqrt(max(variance[j], 0.0))
        for i in range(PARTICLES):
            cloud[i, j] = sigma * table[(stride * i + first) % PARTICLES, j]
    return cloud


@njit(cache=True)
def _navigate(
    accel: FloatArray,
    gyro: FloatArray,
    table: FloatArray,
    seed: np.uint32,
    start: _Start,
    run: _Run,
    pose: tuple[FloatArray, ...],
    flags: tuple[BoolArray, ...],
    figures: tuple[NDArray[Any], ...],
    covariance: tuple[FloatArray, ...],
) -> None:
    """Fill the output arrays, from the end of the static start on."""
    position, velocity, quaternion, bias = pose
    stance_out, resampled_out, h1_out = flags
    m2_out, m_out, n_eff_out, t_out = figures
    p_vv_out, p_pv_out, p_vt_out, p_tt_out, p_pt_out = covariance

    dt = run.dt
    random = seed
    b = start.bias.copy()
    q = start.quaternion.copy()
    v, p, anchor = np.zeros(3), np.zeros(3), np.zeros(3)
    p_vv = np.full(3, run.start_p_vv)
    p_tt = np.array([run.start_p_tt, run.start_p_tt, 0.0])
    p_pv, p_vt, p_pt = np.zeros(3), np.zeros(3), np.zeros(3)
    x = np.zeros((PARTICLES, 3))
    log_w = np.zeros(PARTICLES)

    in_stance = False
    since_stance = 0  # samples without stance
    since_agreed = 0  # samples since m² was last within its limit
    still = 0  # samples of unbroken stillness within the stance
    t = 0

    for n in range(start.aligned_at, len(accel)):
        growth = np.zeros(3)
        if n > start.aligned_at:
            # 1, 2. Strapdown and covariance.
            _strapdown(accel[n], gyro[n] - b, start.gravity, dt, q, v, p)
            if since_stance * dt <= run.freeze_time:
                growth = _grow_covariance(run, start.gravity, p_vv, p_pv, p_vt, p_tt, p_pt)
            since_agreed += 1

            # 3. Stance.
            window = accel[max(0, n + 1 - run.window) : n + 1]
            norms = np.sqrt((window**2).sum(axis=1))
            stance = (
                run.accel_min < norms[-1] < run.accel_max
                and math.sqrt((gyro[n] ** 2).sum()) < run.rate_max
                and norms.var() < run.accel_variance_max
            )
            if stance:
                entering = not in_stance
                since_stance = 0
                stance_out[n] = True

                # 4. Zero angular rate.
                excess = gyro[n] - b
                if math.sqrt((excess**2).sum()) < run.still_rate:
                    still += 1
                else:
                    still = 0
                if still * dt > run.still_time:
                    b += excess * run.bias_gain

                # 5. Particles.
                random = _xorshift32(random)
                if entering:
                    x = _draw(p_vv, table, random % PARTICLES, 1)
                    moved = x.copy()
                    log_w[:] = 0.0
                else:
                    moved = x + _draw(growth, table, random % PARTICLES, STRIDE)

                # 6. Adaptive observation noise.
                m2 = (v**2 / (p_vv + run.r)).sum()
                agrees = m2 <= run.m2_limit
                r_eff = run.r if agrees else run.r * (m2 / run.m2_limit) ** 2

                # 7. Weights.
                for i in range(PARTICLES):
                    log_w[i] -= ((v - moved[i]) ** 2).sum() / (2.0 * r_eff)
                log_w = np.maximum(log_w - log_w.max(), run.log_weight_floor)
                w = np.exp(log_w)
                total = w.sum()
                d = np.zeros(3)
                s2 = np.zeros(3)
                for j in range(3):
                    d[j] = (w * moved[:, j]).sum() / total
                    s2[j] = (w * (moved[:, j] - d[j]) ** 2).sum() / total
                n_eff = total**2 / (w**2).sum()

                # 8. Adaptive threshold.
                if agrees:
                    t = 0
                    since_agreed = 0
                else:
                    t += 1
                m = min(run.m_b, run.m_a + run.k_e * t / n_eff)
                if since_agreed * dt > run.lockout_time and t >= run.lockout_samples:
                    m = run.m_b
                for i in range(PARTICLES):
                    if w[i] > m:
                        x[i] = moved[i]
                t_out[n] = t

                # 9. H1: the filter is locked out, accept zero velocity.
                h1 = m >= run.m_b
                if h1:
                    d = v.copy()
                    s2[:] = run.restart_p_vv

                # 10. Feedback.
                phi = np.array([p_vt[1] / p_vv[1] * d[1], -p_vt[0] / p_vv[0] * d[0], 0.0])
                size = math.sqrt((phi**2).sum())
                if size > run.rotation_max:
                    phi *= run.rotation_max / size
                travelled = p - anchor
                v -= d
                for j in range(3):
                    rho = min(1.0, s2[j] / p_vv[j])
                    k_p = p_pv[j] / p_vv[j]
                    k_t = p_vt[j] / p_vv[j]
                    p[j] -= k_p * d[j]
                    p_tt[j] -= k_t * p_vt[j] * (1.0 - rho)
                    p_pt[j] -= k_p * p_vt[j] * (1.0 - rho)
                    p_pv[j] *= rho
                    p_vt[j] *= rho
                    p_vv[j] *= rho
                    x[:, j] -= d[j]
                p[2] += phi[0] * travelled[1] - phi[1] * travelled[0]
                q = _multiply(_rotation(phi), q)
                if h1:
                    for j in range(3):
                        p_vv[j] = run.restart_p_vv
                        p_tt[j] = max(p_tt[j], run.restart_p_tt)

                # 11. Secondary resampling.
                h2 = (w > run.k).sum() < run.min_heavy
                if h1 or h2:
                    random = _xorshift32(random)
                    x = _draw(p_vv, table, random % PARTICLES, 1)
                    log_w[:] = 0.0
                    resampled_out[n] = True
                if h1:
                    t = 0

                m2_out[n], m_out[n], n_eff_out[n], h1_out[n] = m2, m, n_eff, h1
            else:
                if in_stance:
                    anchor = position[n - 1].copy()
                since_stance += 1
                still = 0
                t_out[n] = t
            in_stance = stance

        position[n], velocity[n], quaternion[n], bias[n] = p, v, q, b
        p_vv_out[n], p_pv_out[n], p_vt_out[n] = p_vv, p_pv, p_vt
        p_tt_out[n], p_pt_out[n] = p_tt, p_pt
