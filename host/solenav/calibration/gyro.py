"""The gyro: bias and noise from rest; scale and axes from turns between rests.

A turn from one rest to the next, integrated from the corrected rate, must take the first rest's
gravity to the second's (Tedaldi, Pretto, Menegatti 2014, section V). The accelerometer's axes
are the reference, so it is calibrated first.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from solenav.calibration.model import IDENTITY, Calibration
from solenav.calibration.still import Pose, poses
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording
from solenav.sim.gait import multiply
from solenav.sim.imu import from_rotation_vector, rotate

REST_S = 3.0
"""So long in all it must rest."""
_BLOCK_S = 0.1
_TURN_MIN_DEG = 30.0
_TURN_MAX_S = 30.0
_TURNS_MIN = 6
_SURE = 0.004  # largest standard error of an element that is worth more than the identity
_DISAGREE_DEG = 1.0


@dataclass(frozen=True)
class Found:
    """A gyro's calibration: corrected = matrix · measured - bias.

    `matrix` (3, 3), `bias` (3,) rad/s; `noise` (3,) rad/s/√Hz at rest; `rest_s` of
    all rests, `spread` (3,) rad/s of the rests' means; of the turns their number, the error in
    gravity's direction before and after in degrees and the `sigma` (3, 3) of the matrix. `why`
    says why the matrix is the identity; empty where it was found.
    """

    matrix: FloatArray
    bias: FloatArray
    noise: FloatArray
    rest_s: float
    spread: FloatArray
    turns: int
    before_deg: float
    after_deg: float
    sigma: FloatArray | None
    why: str

    def report(self) -> dict[str, Any]:
        """What it was made from and how well it fits."""
        degrees = 180 / np.pi
        out: dict[str, Any] = {
            "rest_s": round(self.rest_s, 2),
            "bias_deg_s": [round(float(v), 4) for v in self.bias * degrees],
            "bias_spread_deg_s": [round(float(v), 4) for v in self.spread * degrees],
            "random_walk_deg_s_rthz": [round(float(v), 5) for v in self.noise * degrees],
            "turns": self.turns,
            "matrix_found": not self.why,
        }
        if self.turns:
            out["turn_error_before_deg"] = round(self.before_deg, 3)
            out["turn_error_deg"] = round(self.after_deg, 3)
        if self.sigma is not None:
            out["matrix_sigma"] = round(float(self.sigma.max()), 5)
        return out | ({"why_not": self.why} if self.why else {})


@dataclass(frozen=True)
class _Turns:
    """Turns between rests: `rate` (n, m, 3) rad/s, `dt` (n, m) s, zero after a turn's end;
    gravity's direction before and after (n, 3) in the sensor's axes."""

    rate: FloatArray
    dt: FloatArray
    start: FloatArray
    end: FloatArray


def calibrate(recording: Recording, calibration: Calibration = IDENTITY) -> Found:
    """The calibration that a recording gives; `calibration` is that of its accelerometer.

    SolenavError where it doesn't rest for REST_S, or where the turns don't agree.
    """
    rests = [pose for pose in poses(recording) if not pose.fault]
    seconds = sum(pose.end_s - pose.start_s for pose in rests)
    if seconds < REST_S:
        raise SolenavError(
            f"the sensor rests for {seconds:.1f} s only, {REST_S:g} s are needed",
            "lay it down on something that doesn't shake, and don't touch it",
            1,
        )
    length = np.array([pose.last - pose.first for pose in rests], dtype=np.float64)
    means = np.array([pose.rate for pose in rests])
    raw = length @ means / length.sum()
    noise = _noise(recording, rests)
    turns = _turns(recording, rests, calibration, raw)
    count = 0 if turns is None else len(turns.start)
    matrix, sigma, why = np.eye(3), None, ""
    before = after = 0.0
    if turns is None or count < _TURNS_MIN:
        why = f"{count} turns between rests, at least {_TURNS_MIN} about all axes are needed"
    else:
        before = _degrees(_misses(np.eye(3), turns))
        matrix, sigma = _solve(turns)
        after = _degrees(_misses(matrix, turns))
        if float(sigma.max()) > _SURE:
            why = f"the turns leave an element unsure by {float(sigma.max()):.3f}"
        elif after > _DISAGREE_DEG:
            raise SolenavError(
                f"the turns don't agree with the rests between them: {after:.1f}° are left of "
                f"{before:.1f}°",
                "turn it slower, below 500 °/s, and hold it still for two seconds after each turn",
                1,
            )
        if why:
            matrix, after = np.eye(3), before
    return Found(
        matrix=matrix,
        bias=matrix @ raw,
        noise=noise,
        rest_s=seconds,
        spread=means.std(axis=0),
        turns=count,
        before_deg=before,
        after_deg=after,
        sigma=sigma,
        why=why,
    )


def _noise(recording: Recording, rests: list[Pose]) -> FloatArray:
    """The random walk (3,) rad/s/√Hz in rests: the Allan deviation at _BLOCK_S, times its root."""
    n = max(1, round(_BLOCK_S * recording.rate_hz))
    steps = []
    for pose in rests:
        rate = recording.gyro[pose.first : pose.last]
        whole = len(rate) // n
        steps.append(np.diff(rate[: whole * n].reshape(whole, n, 3).mean(axis=1), axis=0))
    return np.asarray(np.sqrt((np.vstack(steps) ** 2).mean(axis=0) / 2 * n / recording.rate_hz))


def _turns(
    recording: Recording, rests: list[Pose], calibration: Calibration, bias: FloatArray
) -> _Turns | None:
    """The turns between one rest and the next that are large and short enough."""
    force = calibration.corrected("accelerometer", np.array([pose.force for pose in rests]))
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    dt = np.diff(recording.time_s, prepend=recording.time_s[0])
    kept = [
        k
        for k, (a, b) in enumerate(pairwise(rests))
        if up[k] @ up[k + 1] < np.cos(np.radians(_TURN_MIN_DEG))
        and b.start_s - a.end_s < _TURN_MAX_S
    ]
    if not kept:
        return None
    spans = [slice(rests[k].last, rests[k + 1].first) for k in kept]
    longest = max(span.stop - span.start for span in spans)
    rate = np.zeros((len(kept), longest, 3))
    step = np.zeros((len(kept), longest))
    for row, span in enumerate(spans):
        count = span.stop - span.start
        rate[row, :count] = recording.gyro[span] - bias
        step[row, :count] = dt[span]
    return _Turns(rate, step, up[kept], up[[k + 1 for k in kept]])


def _misses(matrix: FloatArray, turns: _Turns) -> FloatArray:
    """By how much (n, 3) each turn misses the second rest's gravity."""
    vectors = turns.rate @ matrix.T * turns.dt[:, :, None]
    shape = vectors.shape
    q = from_rotation_vector(vectors.reshape(-1, 3)).reshape(shape[0], shape[1], 4)
    # The product in order, pair by pair: the number of steps is the length's logarithm.
    while q.shape[1] > 1:
        if q.shape[1] % 2:
            q = np.concatenate([q, np.broadcast_to([1.0, 0, 0, 0], (len(q), 1, 4))], axis=1)
        left, right = q[:, ::2].reshape(-1, 4), q[:, 1::2].reshape(-1, 4)
        q = multiply(left, right).reshape(len(q), -1, 4)
    back = q[:, 0] * [1, -1, -1, -1]
    return np.asarray(rotate(back, turns.start) - turns.end)


def _solve(turns: _Turns) -> tuple[FloatArray, FloatArray]:
    """The matrix (3, 3) and its standard errors."""
    from scipy.optimize import least_squares

    done = least_squares(
        lambda point: _misses(point.reshape(3, 3), turns).ravel(),
        np.eye(3).ravel(),
        loss="huber",
        f_scale=0.01,
    )
    # Two of three components are free: a direction has no length.
    free = max(1, 2 * len(turns.start) - 9)
    noise = max(np.sqrt((done.fun**2).sum() / free), 3e-4)
    covariance = np.linalg.pinv(done.jac.T @ done.jac, rcond=1e-10)
    sigma = noise * np.sqrt(np.diag(covariance))
    # pinv gives what can't be seen at all no error.
    if np.linalg.cond(done.jac) > 1e4:
        sigma = np.full(9, np.inf)
    return done.x.reshape(3, 3), sigma.reshape(3, 3)


def _degrees(misses: FloatArray) -> float:
    return float(np.degrees(np.sqrt((misses**2).sum(axis=1).mean())))
