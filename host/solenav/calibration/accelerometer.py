"""The accelerometer from rests in many attitudes: wherever it rests, it must measure gravity.

|M a - b| = g over all rests (Tedaldi, Pretto, Menegatti 2014, "A robust and easy to implement
method for IMU calibration without external equipments"): no pose has to be exact. g is the
standard one, because the core takes that off again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solenav import mpu9150
from solenav.calibration.still import FACES, Pose, missing, poses
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording

_LOWER = np.tril_indices(3, -1)
_SKEW_MIN_POSES = 10
_SKEW_SURE = 0.003  # a standard error above this is no news: parts are within 2 %
_NOISE_LEAST = 0.003  # m/s² of a rest's mean: counts, temperature
_RESIDUAL_MAX = 0.1
_CLEAR = "hold each of the six faces up for two seconds, with the sensor pressed against a box"


@dataclass(frozen=True)
class Found:
    """An accelerometer's calibration: corrected = matrix · measured - bias.

    `matrix` (3, 3) lower triangular, `bias` (3,) m/s²; `residual` (n,) of |corrected| - g at
    each rest in m/s², `before` the same uncorrected; `*_sigma` (3,) standard errors; `condition`
    of the fit; `spread` (3,) how far the bias moves when a rest is left out, None where none can
    be; `skew` is False where the rests don't tell how far the axes are from right angles.
    """

    matrix: FloatArray
    bias: FloatArray
    residual: FloatArray
    before: FloatArray
    bias_sigma: FloatArray
    scale_sigma: FloatArray
    condition: float
    spread: FloatArray | None
    skew: bool
    used: tuple[Pose, ...]
    refused: tuple[Pose, ...]

    def report(self) -> dict[str, Any]:
        """What it was made from and how well it fits."""
        return {
            "rests": len(self.used),
            "refused": [str(pose) for pose in self.refused],
            "residual_m_s2": _rms(self.residual),
            "residual_before_m_s2": _rms(self.before),
            "bias_sigma_m_s2": _list(self.bias_sigma),
            "scale_sigma": _list(self.scale_sigma),
            "leave_one_out_m_s2": _list(self.spread),
            "condition": round(self.condition, 2),
            "skew_found": self.skew,
        }


def calibrate(recording: Recording) -> Found:
    """The calibration that a recording's rests give.

    SolenavError where a face is missing (it names the refused poses of that face), or where the
    rests don't agree on one calibration.
    """
    found = poses(recording)
    lacking = missing(found)
    if lacking:
        raise SolenavError(complaint(found, lacking), _CLEAR, 1)
    used = [pose for pose in found if not pose.fault]
    refused = [pose for pose in found if pose.fault]
    return fit(used, refused)


def complaint(found: list[Pose], lacking: list[str]) -> str:
    """Which faces are missing, and what was wrong with the last pose that was meant for each."""
    good = len(FACES) - len(lacking)
    last = {pose.face: str(pose) for pose in found if pose.complaint}
    bad = [last[face] for face in lacking if face in last]
    text = f"{good} of {len(FACES)} positions are there; missing: {', '.join(lacking)} up"
    return text + ("; refused: " + "; ".join(bad) if bad else "")


def fit(used: list[Pose], refused: list[Pose]) -> Found:
    """The fit over rests that stand for all FACES. SolenavError where they don't agree."""
    force = np.array([pose.force for pose in used])
    skew = len(used) >= _SKEW_MIN_POSES
    point, jacobian, residual = _solve(force, skew)
    if skew and _sigma(jacobian, residual)[6:].max() > _SKEW_SURE:
        skew = False
        point, jacobian, residual = _solve(force, skew)
    if _rms(residual) > _RESIDUAL_MAX:
        worst = used[int(np.abs(residual).argmax())]
        raise SolenavError(
            f"the rests don't agree: |a| differs from g by {_rms(residual):.2f} m/s² after the "
            f"fit, most at {worst}",
            f"{_CLEAR}; if it stays so, the sensor is broken",
            1,
        )
    sigma = _sigma(jacobian, residual)
    scaled = jacobian / np.linalg.norm(jacobian, axis=0)
    # A face's last rest can't be left out: the rest wouldn't fix the fit.
    others = [
        _solve(np.delete(force, k, axis=0), skew)[0][3:6]
        for k in range(len(used))
        if not missing(used[:k] + used[k + 1 :])
    ]
    matrix, bias = _parts(point)
    return Found(
        matrix=matrix,
        bias=bias,
        residual=residual,
        before=np.linalg.norm(force, axis=1) - mpu9150.STANDARD_GRAVITY,
        bias_sigma=sigma[3:6],
        scale_sigma=sigma[:3],
        condition=float(np.linalg.cond(scaled)),
        spread=np.abs(np.array(others) - bias).max(axis=0) if others else None,
        skew=skew,
        used=tuple(used),
        refused=tuple(refused),
    )


def sphere(force: FloatArray, *, skew: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matrix (3, 3), bias (3,) and residual (n,) in m/s² that put forces (n, 3) on g's sphere.

    Without `skew` the matrix is diagonal.
    """
    point, _jacobian, residual = _solve(force, skew)
    return *_parts(point), residual


def _solve(force: FloatArray, skew: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The fit's point (6 or 9,), Jacobian and residual (n,) in m/s² over forces (n, 3)."""
    from scipy.optimize import least_squares

    def off(point: FloatArray) -> FloatArray:
        matrix, bias = _parts(point)
        out = np.linalg.norm(force @ matrix.T - bias, axis=1) - mpu9150.STANDARD_GRAVITY
        return np.asarray(out)

    plain = least_squares(off, np.concatenate([np.ones(3), np.zeros(6 if skew else 3)]))
    # A rest with a hand's tremor may be off; it shall not pull the others. From afar a robust
    # loss would get stuck.
    done = least_squares(off, plain.x, loss="huber", f_scale=0.05)
    return done.x, done.jac, off(done.x)


def _parts(point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Matrix (3, 3) and bias (3,) of a point: scales, biases and, if found, the lower part."""
    matrix = np.diag(point[:3])
    if len(point) > 6:
        matrix[_LOWER] = point[6:]
    return matrix, point[3:6]


def _sigma(jacobian: FloatArray, residual: FloatArray) -> FloatArray:
    """Standard errors of a point."""
    free = len(residual) - jacobian.shape[1]
    noise = np.sqrt((residual**2).sum() / free) if free > 0 else 0.0
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    return np.asarray(max(noise, _NOISE_LEAST) * np.sqrt(np.diag(covariance)))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _list(values: FloatArray | None) -> list[float] | None:
    return None if values is None else [float(f"{v:.3g}") for v in values]
