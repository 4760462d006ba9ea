"""The magnetometer from a tumble: iron makes an ellipsoid of the sphere that it should measure.

Hard iron moves its centre, soft iron stretches it: |W m - b| = F with W symmetric. W leaves a
turn of the axes open; gravity closes it, because the field's dip against gravity is the same in
every attitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import mpu9150
from solenav.calibration.model import IDENTITY, Calibration
from solenav.calibration.still import DIRECTIONS, FACES
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording

READINGS_MIN = 100
_NEAR_DEG = 32.0  # a direction with a reading so near is covered
_COVERED_MIN = 22  # of 26
_WIDEST = 4.0  # of the longest to the shortest half-axis
_RESIDUAL_MAX = 0.1  # of the field
_SLOW = 0.5  # m/s², |a| so near to g is gravity
_DIP_MIN_READINGS = 100
_PARTS = 10
_SURE_DEG = 0.5
_DIP_MAX_DEG = 80.0  # nearer to the vertical the field tells no axes from gravity
_TUMBLE = (
    "turn the sensor slowly through every attitude for a minute, far from steel: each axis, each "
    "edge and each corner between them once along the field and once against it"
)


@dataclass(frozen=True)
class Found:
    """A magnetometer's calibration: corrected = matrix · measured - bias.

    `matrix` (3, 3) of determinant 1 but for the turn of the axes, so that µT stay µT; `bias`
    (3,) µT; `field_ut` the radius; `residual` (n,) of |corrected| less the radius in µT,
    `before` that of |measured| about its mean; `outliers` readings that the fit left aside.
    `dip_deg` is the field's below the horizontal and `turned_deg` the turn of the axes, unsure
    by `turned_unsure_deg`; `dip_before_deg` and `dip_after_deg` are the spread of the dip
    without and with it. None where gravity wasn't there, or parts of the tumble disagree on it.
    """

    matrix: FloatArray
    bias: FloatArray
    field_ut: float
    residual: FloatArray
    before: FloatArray
    outliers: int
    covered: int
    half_axes: FloatArray
    dip_deg: float | None = None
    turned_deg: float | None = None
    turned_unsure_deg: float | None = None
    dip_before_deg: float | None = None
    dip_after_deg: float | None = None

    def report(self) -> dict[str, Any]:
        """What it was made from and how well it fits."""
        out: dict[str, Any] = {
            "readings": len(self.residual),
            "outliers": self.outliers,
            "directions_covered": f"{self.covered} of {len(DIRECTIONS)}",
            "field_ut": round(self.field_ut, 2),
            "half_axes": [round(float(v), 3) for v in self.half_axes],
            "residual_ut": _spread(self.residual),
            "residual_before_ut": _spread(self.before),
        }
        for name in (
            "dip_deg",
            "turned_deg",
            "turned_unsure_deg",
            "dip_before_deg",
            "dip_after_deg",
        ):
            value = getattr(self, name)
            if value is not None:
                out[name] = round(float(value), 3)
        return out


def readings(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """The magnetometer's readings (n, 3) in µT, and the force (n, 3) in m/s² of the same time."""
    if recording.mag is None:
        return np.empty((0, 3)), np.empty((0, 3))
    there = np.isfinite(recording.mag).all(axis=1)
    return recording.mag[there], recording.accel[there]


def uncovered(field: FloatArray) -> list[str]:
    """The names of DIRECTIONS along which no corrected reading (n, 3) lies."""
    if not len(field):
        return list(DIRECTIONS)
    unit = field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), 1e-9)
    nearest = (unit @ np.array(list(DIRECTIONS.values())).T).max(axis=0)
    near = np.cos(np.radians(_NEAR_DEG))
    return [name for name, cosine in zip(DIRECTIONS, nearest, strict=True) if cosine < near]


def lacking(field: FloatArray) -> list[str]:
    """The directions that measured readings (n, 3) still lack; empty where they are enough."""
    if len(field) < READINGS_MIN:
        return list(DIRECTIONS)
    matrix, bias, _radius, _sound = _ellipsoid(field)
    if not _possible(matrix):
        # A part of an ellipsoid may fit anything; the middle of the readings is near enough.
        matrix, bias = np.eye(3), np.percentile(field, [2, 98], axis=0).mean(axis=0)
    missed = uncovered(field @ matrix.T - bias)
    enough = len(DIRECTIONS) - len(missed) >= _COVERED_MIN and not set(missed) & set(FACES)
    return [] if enough else missed


def calibrate(recording: Recording, calibration: Calibration = IDENTITY) -> Found:
    """The calibration that a tumble gives; `calibration` is that of its accelerometer.

    SolenavError where there is no magnetometer, where the tumble leaves directions out (it names
    them), or where the readings lie on no ellipsoid.
    """
    field, force = readings(recording)
    if len(field) < READINGS_MIN:
        raise SolenavError(
            f"{len(field)} readings of the magnetometer, at least {READINGS_MIN} are needed",
            "record a board with a magnetometer (an MPU-6050 has none) for a minute",
        )
    missed = lacking(field)
    if missed:
        raise SolenavError(
            f"the tumble leaves out {len(missed)} of {len(DIRECTIONS)} directions: the field never "
            f"came from {', '.join(missed)}",
            _TUMBLE,
            1,
        )
    matrix, bias, radius, sound = _ellipsoid(field)
    corrected = field @ matrix.T - bias
    residual = np.linalg.norm(corrected, axis=1) - radius
    if not _possible(matrix):
        raise SolenavError(
            "the readings lie on no ellipsoid that iron could make", "tumble it anew: " + _TUMBLE, 1
        )
    if _spread(residual[sound]) > _RESIDUAL_MAX * radius or sound.mean() < 0.7:
        raise SolenavError(
            f"the field wasn't the same throughout: {_spread(residual):.1f} µT are left of "
            f"{radius:.0f} µT after the fit",
            "go where no steel is near, take phone and keys out of the pocket, tumble it anew",
            1,
        )
    size = np.linalg.norm(field, axis=1)
    turn, dips = _turn(corrected[sound], calibration.corrected("accelerometer", force)[sound])
    return Found(
        matrix=turn @ matrix,
        bias=turn @ bias,
        field_ut=radius,
        residual=residual,
        before=size - size.mean(),
        outliers=int((~sound).sum()),
        covered=len(DIRECTIONS) - len(uncovered(corrected)),
        half_axes=1 / np.linalg.eigvalsh(matrix)[::-1],
        **dips,
    )


def _possible(matrix: FloatArray) -> bool:
    """Whether a symmetric matrix (3, 3) is an ellipsoid's that iron could make."""
    axes = np.linalg.eigvalsh(matrix)
    return bool(axes[0] > 0 and axes[2] < _WIDEST * axes[0])


def _ellipsoid(field: FloatArray) -> tuple[FloatArray, FloatArray, float, NDArray[np.bool_]]:
    """W (3, 3), symmetric, determinant 1; b (3,); the radius; which readings (n,) are sound."""
    from scipy.optimize import least_squares

    centre = np.percentile(field, [2, 98], axis=0).mean(axis=0)
    radius = float(np.median(np.linalg.norm(field - centre, axis=1))) or 1.0
    unit = field / radius
    upper = np.triu_indices(3)

    def parts(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        matrix = np.zeros((3, 3))
        matrix[upper] = point[:6]
        return matrix + np.triu(matrix, 1).T, point[6:]

    def off(point: FloatArray) -> FloatArray:
        matrix, bias = parts(point)
        return np.asarray(np.linalg.norm(unit @ matrix - bias, axis=1) - 1)

    start = np.concatenate([[1, 0, 0, 1, 0, 1], centre / radius])
    found = least_squares(off, start, loss="soft_l1", f_scale=0.02).x
    left = off(found)
    # A robust sigma: of a normal spread half lies within 0.6745 of it.
    sound = np.abs(left) < max(0.02, 5 * float(np.median(np.abs(left))) / 0.6745)
    matrix, bias = parts(found)
    scale = float(np.cbrt(abs(np.linalg.det(matrix)))) or 1.0
    return matrix / scale, bias * radius / scale, radius / scale, sound


def _turn(field: FloatArray, force: FloatArray) -> tuple[FloatArray, dict[str, float]]:
    """The turn (3, 3) that gives the field one dip, and figures of it; the identity without."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    size = np.linalg.norm(force, axis=1)
    slow = np.abs(size - mpu9150.STANDARD_GRAVITY) < _SLOW
    if slow.sum() < _DIP_MIN_READINGS:
        return np.eye(3), {}
    up = force[slow] / size[slow, None]
    unit = field[slow] / np.linalg.norm(field[slow], axis=1, keepdims=True)

    def sines(turn: FloatArray) -> FloatArray:
        return np.asarray((Rotation.from_rotvec(turn).apply(unit) * -up).sum(axis=1))

    def solved(rows: NDArray[np.bool_]) -> FloatArray:
        start = np.append(np.zeros(3), np.median(sines(np.zeros(3))))
        done = least_squares(
            lambda p: sines(p[:3])[rows] - p[3], start, loss="soft_l1", f_scale=0.05
        )
        return np.asarray(done.x)

    found = solved(np.ones(len(unit), np.bool_))
    turn = found[:3]
    angle = float(np.degrees(np.linalg.norm(turn)))
    dip = float(np.degrees(np.arcsin(np.clip(found[3], -1, 1))))
    before, after = (
        _robust(np.degrees(np.arcsin(np.clip(sines(t), -1, 1)))) for t in (np.zeros(3), turn)
    )
    # Errors of a moving hand hang together for a while, so parts of the tumble are compared.
    parts = np.arange(len(unit)) * _PARTS // len(unit) % 2 == 0
    apart = float(np.degrees(np.linalg.norm(solved(parts)[:3] - solved(~parts)[:3])))
    figures = {"dip_deg": dip, "dip_before_deg": before}
    if abs(dip) > _DIP_MAX_DEG or after > before or apart > max(0.5 * angle, _SURE_DEG):
        return np.eye(3), figures
    figures |= {"turned_deg": angle, "turned_unsure_deg": apart / 2, "dip_after_deg": after}
    return Rotation.from_rotvec(turn).as_matrix(), figures


def _robust(values: FloatArray) -> float:
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _spread(values: FloatArray) -> float:
    return round(float(np.sqrt(np.mean(values**2))), 4)
