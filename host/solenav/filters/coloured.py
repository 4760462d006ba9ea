"""`coloured`: the 9-state EKF whose zero velocity carries coloured noise, AR(p).

Zhong, Zhong, Xiong, Guo 2021, "Pedestrian navigation algorithm based on improved Kalman
filtering", J. Navigation and Positioning 9(2): the velocity seen in stance is white noise no more
than the foot is at rest; what one sample gets wrong the next repeats. Two forms of one filter:

- differenced: the measurement less what the p before it foretell, so that only white noise is left
  (Bryson and Henrikson 1968; Chang 2014, J. Geodesy 88). The velocity errors of the p samples
  before ride along in the state, so that their correlation with the process noise is exact.
- augmented: the noise of the last p samples is in the state, and the measurement has no noise.

Each stance begins with noise of which nothing is known but its stationary covariance; in the
differenced form the predictors of lower order (Durbin-Levinson) say the same. The forms agree to
numerical precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from solenav.errors import SolenavError
from solenav.filters import ekf, motion
from solenav.filters import still as stillness
from solenav.filters.walk import Aids, Inputs, Track, Walk
from solenav.recording import FloatArray

FORMS = ("differenced", "augmented")
ORDERS = (1, 2, 3, 4)
LAGS = 20


@dataclass(frozen=True)
class Colour:
    """AR(p) noise of each axis of the velocity in stance: `phi` (p,), `sigma` m/s of what is new.

    For `rate_hz` samples a second; `at` another rate `phi` stays and the variance grows with it, as
    more samples of one stance say no more. SolenavError where it isn't stationary or has no size.
    """

    phi: tuple[float, ...]
    sigma: float
    rate_hz: float = 200.0

    def __post_init__(self) -> None:
        sound = bool(self.phi) and np.isfinite([*self.phi, self.sigma]).all() and self.sigma > 0
        if not sound or (np.abs(np.roots([1.0, *(-f for f in self.phi)])) >= 1).any():
            raise SolenavError(
                f"AR{self.phi} with {self.sigma:g} m/s is no stationary noise",
                "take a lower order, or more stances to estimate it from",
            )

    @property
    def autocovariance(self) -> FloatArray:
        """(p + 1,) m²/s² at lags 0 to p."""
        p = len(self.phi)
        step = np.zeros((p, p))
        step[0] = self.phi
        step[1:, :-1] = np.eye(p - 1)
        new = np.zeros((p, p))
        new[0, 0] = self.sigma**2
        inside = np.linalg.solve(np.eye(p * p) - np.kron(step, step), new.ravel()).reshape(p, p)
        return np.append(inside[0], np.dot(self.phi, inside[0, ::-1]))

    def at(self, rate_hz: float) -> Colour:
        """The noise that a walk of that rate has."""
        return Colour(self.phi, self.sigma * (rate_hz / self.rate_hz) ** 0.5, rate_hz)

    def predictors(self) -> tuple[FloatArray, FloatArray]:
        """Best predictors from m = 0 to p samples: coefficients (p + 1, p), variances (p + 1,)."""
        p, gamma = len(self.phi), self.autocovariance
        coefficients, variances = np.zeros((p + 1, p)), np.empty(p + 1)
        variances[0] = gamma[0]
        for m in range(1, p + 1):
            inside = gamma[np.abs(np.subtract.outer(np.arange(m), np.arange(m)))]
            coefficients[m, :m] = np.linalg.solve(inside, gamma[1 : m + 1])
            variances[m] = gamma[0] - coefficients[m, :m] @ gamma[1 : m + 1]
        return coefficients, variances


# AR(2) as in the paper, but chosen by closure: what stances yield by themselves trusts the foot to
# rest far more than it does (docs/coloured.md).
COLOUR = Colour((0.5, 0.2), 0.5)


def run(walk: Walk, aids: Aids, *, colour: Colour = COLOUR, form: str = "differenced") -> Track:
    """The walk by one of the two forms. SolenavError for an unknown one."""
    if form not in FORMS:
        raise SolenavError(f"unknown form {form!r}", f"choose {' or '.join(FORMS)}")
    t, colour = ekf.TUNING[9], colour.at(walk.rate_hz)
    n, p = len(walk.counts), len(colour.phi)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    deviations = np.zeros(9 + 3 * p)
    deviations[3:9] = [*[t.start_velocity] * 3, t.start_tilt, t.start_tilt, t.start_heading]
    coefficients, variances = colour.predictors()
    gamma = colour.autocovariance[:p]
    stationary = np.asarray(
        np.kron(gamma[np.abs(np.subtract.outer(np.arange(p), np.arange(p)))], np.eye(3)), np.float64
    )
    noise = _Noise(
        t.accel_noise**2 * walk.dt,
        t.gyro_noise**2 * walk.dt,
        np.array(colour.phi),
        colour.sigma**2,
        coefficients,
        variances,
        stationary,
    )
    _navigate(
        walk.inputs(),
        noise,
        stillness.of_walk(walk, aids.still),
        np.diag(deviations**2),
        form == "augmented",
        position,
        velocity,
    )
    return Track(position, velocity)


# --- estimating the noise ------------------------------------------------------------------------


class Order(NamedTuple):
    """One order tried: `aic` of all, `whiteness` the Ljung-Box p-value of what is left at LAGS."""

    order: int
    aic: float
    whiteness: float
    colour: Colour


def estimate(values: list[FloatArray], rate_hz: float) -> list[Order]:
    """Orders 1 to 4 on stretches (n, 3) of one noise, such as velocity in stance, m/s.

    Burg's recursion over all stretches and axes, whose noise is stationary whatever the values
    (de Waele, Broersen 2000, "The Burg algorithm for segments", IEEE Trans. Signal Processing
    48(10)); AIC = N ln sigma² + 2 p, every order on the same N samples. SolenavError with too few
    samples, values that never change, or without statsmodels.
    """
    longest = max(ORDERS)
    usable = [v for v in values if len(v) > longest + 1]
    if sum(len(v) - longest for v in usable) < 10 * longest:
        raise SolenavError("too little stance to estimate noise from", "take a longer walk")
    ahead, behind = list(usable), list(usable)
    phi, found = np.empty(0), []
    for order in ORDERS:
        ahead, behind = [f[1:] for f in ahead], [b[:-1] for b in behind]
        power = sum(float((f * f + b * b).sum()) for f, b in zip(ahead, behind, strict=True))
        if power == 0.0:
            raise SolenavError("there is no noise in these values", "take a longer walk")
        common = sum(float((f * b).sum()) for f, b in zip(ahead, behind, strict=True))
        reflected = 2 * common / power
        phi = np.append(phi - reflected * phi[::-1], reflected)
        ahead, behind = (
            [f - reflected * b for f, b in zip(ahead, behind, strict=True)],
            [b - reflected * f for f, b in zip(ahead, behind, strict=True)],
        )
        # An axis after the other: what is left of one says nothing of the next.
        left = np.concatenate([f[longest - order :].T.ravel() for f in ahead])
        sigma = float(np.sqrt(np.mean(left * left)))
        # statsmodels' own acorr_ljungbox takes minutes on a long walk: it knows no FFT.
        seen = _stattools().acf(left, nlags=LAGS, fft=True)[1:]
        _, chances = _stattools().q_stat(seen, len(left))
        found.append(
            Order(
                order,
                2 * len(left) * float(np.log(sigma)) + 2 * order,
                float(chances[-1]),
                Colour(tuple(phi.tolist()), sigma, rate_hz),
            )
        )
    return found


def best(orders: list[Order]) -> Order:
    """The order with the least AIC."""
    return min(orders, key=lambda one: one.aic)


def stances(walk: Walk) -> list[FloatArray]:
    """Velocities (n, 3) m/s of the white-noise EKF in each stance.

    That filter is soft: a sample corrects little of what it sees, so these are close to its
    innovations, if smoother.
    """
    track = ekf.run(walk, Aids(still=True), states=9)
    edges = np.flatnonzero(np.diff(np.r_[False, walk.stance, False].astype(np.int8)))
    begin = walk.start.row + 1
    return [track.velocity[max(a, begin) : b] for a, b in edges.reshape(-1, 2) if b > begin]


def _stattools() -> Any:
    try:
        return import_module("statsmodels.tsa.stattools")
    except ImportError:
        raise SolenavError(
            "estimating noise needs statsmodels", "pip install 'solenav[related]'"
        ) from None


class _Noise(NamedTuple):
    q_v: float
    q_t: float
    phi: FloatArray
    new: float
    coefficients: FloatArray
    variances: FloatArray
    stationary: FloatArray


@njit(cache=True)
def _navigate(
    given: Inputs,
    noise: _Noise,
    still: stillness.Still,
    cov: FloatArray,
    augmented: bool,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    accel, gyro, stance, first, attitude, gyro_bias, gravity, dt = given
    states = len(cov)
    p_order = len(noise.phi)
    q, b_g = attitude.copy(), gyro_bias.copy()
    v, p = np.zeros(3), np.zeros(3)
    # The noise of the last samples, or their velocities: the latest first.
    rider = np.zeros(3 * p_order)
    eye = np.eye(states)
    transition = np.eye(states)
    for i in range(3):
        transition[i, 3 + i] = dt
    # The noise of one more sample pushes out the oldest.
    onward = np.zeros((states, states))
    onward[:9, :9] = np.eye(9)
    # A copy of this sample's velocity error does the same.
    copied = onward.copy()
    for i in range(3):
        for k in range(p_order):
            onward[9 + i, 9 + 3 * k + i] = noise.phi[k]
            if k > 0:
                onward[9 + 3 * k + i, 9 + 3 * (k - 1) + i] = 1.0
                copied[9 + 3 * k + i, 9 + 3 * (k - 1) + i] = 1.0
        copied[9 + i, 3 + i] = 1.0
    still_ticks, stood = 0, 0
    for n in range(first, len(accel)):
        rate = gyro[n] - b_g
        force = motion.integrate(accel[n], rate, gravity, dt, q, v, p)
        transition[3:6, 6:9] = -dt * motion.skew(force)
        cov = transition @ cov @ transition.T
        for i in range(3):
            cov[3 + i, 3 + i] += noise.q_v
            cov[6 + i, 6 + i] += noise.q_t
        still_ticks = stillness.count(rate, still, still_ticks)
        if stance[n]:
            stillness.learn(rate, still, still_ticks, b_g)
            if stood == 0:
                rider[:] = 0.0
                cov[9:, :] = 0.0
                cov[:, 9:] = 0.0
                if augmented:
                    cov[9:, 9:] = noise.stationary
            elif augmented:
                ahead = np.zeros(3)
                for k in range(p_order):
                    ahead += noise.phi[k] * rider[3 * k : 3 * k + 3]
                for k in range(p_order - 1, 0, -1):
                    rider[3 * k : 3 * k + 3] = rider[3 * k - 3 : 3 * k]
                rider[0:3] = ahead
                cov = onward @ cov @ onward.T
                for i in range(3):
                    cov[9 + i, 9 + i] += noise.new
            seen = np.zeros((3, states))
            innovation = v.copy()
            r = 0.0
            m = min(stood, p_order)
            for i in range(3):
                seen[i, 3 + i] = 1.0
                if augmented:
                    seen[i, 9 + i] = 1.0
                    innovation[i] -= rider[i]
                else:
                    for k in range(m):
                        seen[i, 9 + 3 * k + i] = -noise.coefficients[m, k]
                        innovation[i] -= noise.coefficients[m, k] * rider[3 * k + i]
            if not augmented:
                r = noise.variances[m]
            spread = seen @ cov @ seen.T + r * np.eye(3)
            gain = cov @ seen.T @ np.linalg.inv(spread)
            error = gain @ innovation
            p -= error[0:3]
            v -= error[3:6]
            motion.turn(q, -error[6:9])
            if augmented:
                rider += error[9:]
            else:
                rider -= error[9:]
            left = eye - gain @ seen
            cov = left @ cov @ left.T + r * (gain @ gain.T)
            if not augmented:
                for k in range(p_order - 1, 0, -1):
                    rider[3 * k : 3 * k + 3] = rider[3 * k - 3 : 3 * k]
                rider[0:3] = v
                cov = copied @ cov @ copied.T
            stood += 1
        else:
            stood = 0
        position[n], velocity[n] = p, v
