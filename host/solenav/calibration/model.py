"""The calibration of one board: matrices and biases of its sensors, and how it is mounted.

For each sensor: corrected = matrix · measured - bias, in the sensor's axes (right-handed, those
of the accelerometer). The same formula with integers is in `solenav_core.calibration`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from solenav import mpu9150
from solenav.errors import SolenavError, unreadable, unwritable
from solenav.recording import FloatArray

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

SENSORS = ("accelerometer", "gyro", "magnetometer")
_FORMAT = "solenav_calibration"
_VERSION = 1
_AXES = "xyz"
_MOUNT = ("MOUNT_R", "MOUNT_F", "MOUNT_U")
_ONE: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Form:
    """A sensor's names in a file and in the parameters, and its integers' scales and limits."""

    field: str  # of Calibration: <field>_matrix, <field>_bias
    unit: str  # of the bias in a file
    word: str  # of the parameters: <word>_XX, <word>_BX
    one: float  # the matrix's integer for 1
    bias: float  # the bias's integer for 1 in its unit
    diagonal: tuple[int, int]
    off: int
    bias_max: int


_FORMS = {
    "accelerometer": _Form(
        "accel",
        "m_s2",
        "ACC",
        2.0**22 * mpu9150.ACCEL_MPS2_PER_LSB,
        2.0**20,
        (0, 24000),
        1200,
        2**21,
    ),
    "gyro": _Form(
        "gyro",
        "rad_s",
        "GYRO",
        2.0**14,
        2.0**20 / mpu9150.GYRO_RADPS_PER_LSB,
        (0, 18000),
        1000,
        2**27,
    ),
    "magnetometer": _Form(
        "mag", "ut", "MAG", 2.0**12, 2.0**4 / mpu9150.MAG_UT_PER_LSB, (0, 16384), 4096, 2**15
    ),
}


def _limits() -> dict[str, tuple[int, int]]:
    out: dict[str, tuple[int, int]] = dict.fromkeys(_MOUNT, (-3, 3))
    for form in _FORMS.values():
        for a in "XYZ":
            for b in "XYZ":
                out[f"{form.word}_{a}{b}"] = form.diagonal if a == b else (-form.off, form.off)
            out[f"{form.word}_B{a}"] = (-form.bias_max, form.bias_max)
    return out


LIMITS = _limits()
"""Least and largest integer of each of the calibration's parameters that the core can hold."""


@dataclass(frozen=True)
class Calibration:
    """What turns measured into true values: corrected = matrix · measured - bias.

    Matrices (3, 3) without unit; biases (3,) of the accelerometer in m/s², of the gyro in rad/s,
    of the magnetometer in µT. `mount` says which sensor axis is the body's right, front and up,
    such as "+x+y+z"; "auto" lets the core find it from the static start. `made_from` keeps for
    each sensor what its part was found from, for people. Sequences and arrays are taken and kept
    as tuples. SolenavError for what is no number or what the core's words can't hold.
    """

    accel_matrix: Matrix = _ONE
    accel_bias: Vector = _ZERO
    gyro_matrix: Matrix = _ONE
    gyro_bias: Vector = _ZERO
    mag_matrix: Matrix = _ONE
    mag_bias: Vector = _ZERO
    mount: str = "auto"
    made_from: Mapping[str, Mapping[str, Any]] = field(
        default_factory=dict, compare=False, hash=False
    )

    def __post_init__(self) -> None:
        for sensor, form in _FORMS.items():
            for part, shape in (("matrix", (3, 3)), ("bias", (3,))):
                name = f"{form.field}_{part}"
                value = _tuples(getattr(self, name), shape, f"{sensor} {part}")
                object.__setattr__(self, name, value)
        _axes(self.mount)
        for name, value in self.words().items():
            low, high = LIMITS[name]
            if not low <= value <= high:
                raise _outside(name, value)

    def words(self) -> dict[str, int]:
        """The core's parameters by name, each the integer nearest to its value."""
        out: dict[str, int] = {}
        for form in _FORMS.values():
            matrix = getattr(self, f"{form.field}_matrix")
            bias = getattr(self, f"{form.field}_bias")
            for i, a in enumerate("XYZ"):
                for j, b in enumerate("XYZ"):
                    out[f"{form.word}_{a}{b}"] = round(matrix[i][j] * form.one)
                out[f"{form.word}_B{a}"] = round(bias[i] * form.bias)
        return out | dict(zip(_MOUNT, _axes(self.mount), strict=True))

    @classmethod
    def from_words(cls, words: Mapping[str, int]) -> Calibration:
        """The calibration that parameters hold; other names in `words` don't matter."""
        found: dict[str, Any] = {}
        for form in _FORMS.values():
            found[f"{form.field}_matrix"] = [
                [words[f"{form.word}_{a}{b}"] / form.one for b in "XYZ"] for a in "XYZ"
            ]
            found[f"{form.field}_bias"] = [words[f"{form.word}_B{a}"] / form.bias for a in "XYZ"]
        axes = [words[name] for name in _MOUNT]
        names = ["+-"[axis < 0] + _AXES[abs(axis) - 1] for axis in axes]
        return cls(**found, mount="".join(names) if any(axes) else "auto")

    def merged(
        self,
        sensor: str,
        matrix: Sequence[Sequence[float]],
        bias: Sequence[float],
        made_from: Mapping[str, Any],
    ) -> Calibration:
        """This calibration with one of SENSORS found anew."""
        form = _FORMS[sensor]
        found: dict[str, Any] = {f"{form.field}_matrix": matrix, f"{form.field}_bias": bias}
        return replace(self, **found, made_from={**self.made_from, sensor: dict(made_from)})

    def matrix(self, sensor: str) -> FloatArray:
        """The matrix (3, 3) of one of SENSORS."""
        return np.array(getattr(self, f"{_FORMS[sensor].field}_matrix"))

    def bias(self, sensor: str) -> FloatArray:
        """The bias (3,) of one of SENSORS in its unit."""
        return np.array(getattr(self, f"{_FORMS[sensor].field}_bias"))

    def corrected(self, sensor: str, measured: FloatArray) -> FloatArray:
        """Measured values (n, 3) of one of SENSORS, corrected, in the sensor's axes."""
        out = measured @ self.matrix(sensor).T - self.bias(sensor)
        return np.asarray(out, dtype=np.float64)

    def as_dict(self) -> dict[str, Any]:
        """What a file holds."""
        out: dict[str, Any] = {_FORMAT: _VERSION}
        for sensor, form in _FORMS.items():
            out[sensor] = {
                "matrix": [list(row) for row in getattr(self, f"{form.field}_matrix")],
                f"bias_{form.unit}": list(getattr(self, f"{form.field}_bias")),
            }
            if sensor in self.made_from:
                out[sensor]["made_from"] = self.made_from[sensor]
        return out | {"mount": self.mount}


def from_dict(content: Any) -> Calibration:
    """The calibration that a file holds; what it doesn't name is not corrected.

    SolenavError for anything else than a calibration.
    """
    if not isinstance(content, dict) or content.get(_FORMAT) != _VERSION:
        raise SolenavError(
            f'no calibration: it has no "{_FORMAT}": {_VERSION}',
            "give a file that `solenav calibrate` wrote",
        )
    _known(content, {_FORMAT, "mount", *SENSORS}, "the calibration")
    found: dict[str, Any] = {"mount": content.get("mount", "auto")}
    made_from: dict[str, Any] = {}
    for sensor, form in _FORMS.items():
        part = content.get(sensor, {})
        if not isinstance(part, dict):
            raise SolenavError(f"{sensor} is no object", "give it a matrix and a bias")
        _known(part, {"matrix", f"bias_{form.unit}", "made_from"}, sensor)
        if "matrix" in part:
            found[f"{form.field}_matrix"] = part["matrix"]
        if f"bias_{form.unit}" in part:
            found[f"{form.field}_bias"] = part[f"bias_{form.unit}"]
        if isinstance(part.get("made_from"), dict):
            made_from[sensor] = part["made_from"]
    return Calibration(**found, made_from=made_from)


def load(path: Path) -> Calibration:
    """Read a calibration. SolenavError where it is missing or none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise unreadable(path, error) from None
    except ValueError as error:
        raise SolenavError(f"{path} is no JSON: {error}", "mend it or make it anew") from None
    try:
        return from_dict(content)
    except SolenavError as error:
        raise SolenavError(f"{path}: {error.message}", error.remedy, error.exit_code) from None


def save(path: Path, calibration: Calibration) -> None:
    """Write a calibration. SolenavError where that fails."""
    text = json.dumps(calibration.as_dict(), indent=2, ensure_ascii=False) + "\n"
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable(path, error) from None


def _known(content: Mapping[str, Any], names: set[str], where: str) -> None:
    unknown = sorted(set(content) - names)
    if unknown:
        raise SolenavError(
            f"{where} has an entry {unknown[0]!r} that means nothing here",
            f"known are {', '.join(sorted(names))}",
        )


def _tuples(value: Any, shape: tuple[int, ...], what: str) -> Any:
    """`value` as (nested) tuples of floats."""
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != shape or not np.isfinite(found).all():
        raise SolenavError(
            f"{what} is not {' by '.join(str(n) for n in shape)} numbers",
            "make it anew with `solenav calibrate`",
        )
    if len(shape) == 1:
        return tuple(float(v) for v in found)
    return tuple(tuple(float(v) for v in row) for row in found)


def _axes(mount: str) -> list[int]:
    """MOUNT_R, MOUNT_F and MOUNT_U of a mounting. SolenavError where it is none."""
    if mount == "auto":
        return [0, 0, 0]
    if not isinstance(mount, str) or not re.fullmatch(r"([+-][xyz]){3}", mount):
        raise SolenavError(
            f"{mount!r} is no mounting",
            'say "auto", or which sensor axis is right, front and up, such as "+x+y+z"',
        )
    axes = [int(f"{mount[k]}{_AXES.index(mount[k + 1]) + 1}") for k in (0, 2, 4)]
    rows = np.zeros((3, 3))
    for row, axis in enumerate(axes):
        rows[row, abs(axis) - 1] = np.sign(axis)
    if np.linalg.det(rows) < 0.5:
        raise SolenavError(
            f"mounting {mount} names an axis twice or is left-handed",
            "give each of the sensor's axes once; turn one round where all three are there",
        )
    return axes


def _outside(name: str, value: int) -> SolenavError:
    """What a parameter outside its limits means in the units that people know."""
    sensor, form = next((s, f) for s, f in _FORMS.items() if name.startswith(f.word))
    low, high = LIMITS[name]
    is_bias = name[-2] == "B"
    scale = form.bias if is_bias else form.one
    unit = {"m_s2": " m/s²", "rad_s": " rad/s", "ut": " µT"}[form.unit] if is_bias else ""
    what = f"bias {name[-1].lower()}" if is_bias else f"matrix {name[-2:].lower()}"
    shown = value / scale
    return SolenavError(
        f"{sensor} {what} = {shown:.4g}{unit} is outside {low / scale:.3g} to "
        f"{high / scale:.3g}{unit}",
        "no sound sensor errs so much: calibrate anew, in a quiet place away from steel",
    )


IDENTITY = Calibration()
