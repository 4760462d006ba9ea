"""Allan deviation of a long rest: what a sensor's noise is made of (IEEE Std 952, annex C).

Over averages of τ seconds the variance is N²/τ + (2 ln 2/π) B² + K² τ/3: random walk N of what
the sensor's output sums up to, instability B of its bias, random walk K of the bias. The three are
found together, none below 0, each point weighted by how many averages it rests on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solenav import plotting
from solenav.calibration.still import Pose, poses
from solenav.errors import SolenavError
from solenav.mpu9150 import STANDARD_GRAVITY
from solenav.recording import FloatArray, Recording

SHORTEST_S = 60.0
"""A rest shorter than this tells the white noise and little else."""
_POINTS = 60
_FLICKER = 2 * math.log(2) / math.pi
# Averages so long that fewer of them fit in are more luck than figure.
_FEWEST = 9
_AXES = list(enumerate("xyz"))

Figure = tuple[float, float]


@dataclass(frozen=True)
class Noise:
    """One axis. `tau_s`, `deviation` and its standard error (m,); then (value, standard error):

    `walk` N in unit/√Hz (unit·s/√s), `instability` B in the unit, `drift` K in unit/√s. A value
    of 0 wasn't seen: its standard error says how large it may be all the same.
    """

    name: str
    unit: str
    tau_s: FloatArray
    deviation: FloatArray
    error: FloatArray
    walk: Figure
    instability: Figure
    drift: Figure

    def at(self, seconds: float) -> float:
        """The measured deviation at an averaging time."""
        return float(np.exp(np.interp(np.log(seconds), np.log(self.tau_s), np.log(self.deviation))))

    def model(self, tau_s: FloatArray) -> FloatArray:
        """The deviation that the three figures make."""
        n, b, k = self.walk[0], self.instability[0], self.drift[0]
        return np.asarray(np.sqrt(n**2 / tau_s + _FLICKER * b**2 + k**2 * tau_s / 3))

    def as_dict(self) -> dict[str, Any]:
        pair = ("value", "standard_error")
        return {
            "axis": self.name,
            "unit": self.unit,
            "at_1_s": self.at(1.0),
            "random_walk_per_sqrt_hz": dict(zip(pair, self.walk, strict=True)),
            "bias_instability": dict(zip(pair, self.instability, strict=True)),
            "bias_random_walk_per_sqrt_s": dict(zip(pair, self.drift, strict=True)),
        }


@dataclass(frozen=True)
class Report:
    """The six axes over the longest rest of a recording."""

    rest: Pose
    seconds: float
    axes: list[Noise]

    def as_dict(self) -> dict[str, Any]:
        return {
            "from_s": self.rest.start_s,
            "to_s": self.rest.end_s,
            "seconds": self.seconds,
            "axes": [axis.as_dict() for axis in self.axes],
        }


def of_recording(recording: Recording) -> Report:
    """Allan deviation of accelerometer (mg) and gyro (°/s) over the longest rest.

    SolenavError where there is no rest of a minute in one attitude, or without allantools.
    """
    found = [pose for pose in poses(recording) if not pose.fault]
    rest = max(found, key=lambda pose: pose.end_s - pose.start_s, default=None)
    if rest is None or rest.end_s - rest.start_s < SHORTEST_S:
        longest = f"{rest.end_s - rest.start_s:.1f} s" if rest else "none at all"
        raise SolenavError(
            f"{recording.name}: the longest rest is {longest}, {SHORTEST_S:.0f} s are the least",
            "let the sensor lie on something solid for ten minutes or longer, untouched",
        )
    rows = slice(rest.first, rest.last)
    milli_g = recording.accel[rows] / STANDARD_GRAVITY * 1000
    dps = np.degrees(recording.gyro[rows])
    axes = [noise(f"accelerometer {a}", "mg", milli_g[:, i], recording.rate_hz) for i, a in _AXES]
    axes += [noise(f"gyro {a}", "°/s", dps[:, i], recording.rate_hz) for i, a in _AXES]
    return Report(rest, len(dps) / recording.rate_hz, axes)


def noise(name: str, unit: str, values: FloatArray, rate_hz: float) -> Noise:
    """Allan deviation of `values` (n,) at `rate_hz`, and the three figures that explain it."""
    try:
        allantools = import_module("allantools")
        optimize = import_module("scipy.optimize")
    except ImportError:
        raise SolenavError(
            "the Allan deviation needs allantools and scipy", "pip install 'solenav[calibrate]'"
        ) from None
    length = len(values) / rate_hz
    taus = np.geomspace(2 / rate_hz, length / _FEWEST, _POINTS)
    tau, deviation, _errors, _counts = allantools.oadev(
        values - values.mean(), rate=rate_hz, data_type="freq", taus=taus
    )
    # Overlapping or not, so many averages are independent.
    independent = np.maximum(length / tau - 1, 1)
    error = deviation / np.sqrt(2 * independent)
    # Of the variance, relative: so each point counts by what it is worth, small ones as well.
    weight = 1 / (2 * deviation * error)
    parts = np.column_stack([1 / tau, np.full(len(tau), _FLICKER), tau / 3])
    solution, _rest = optimize.nnls(parts * weight[:, None], deviation**2 * weight)
    found = _figures(solution, parts * weight[:, None], math.log2(tau[-1] / tau[0]))
    return Noise(name, unit, tau, deviation, error, *found)


def _figures(squares: FloatArray, weighted: FloatArray, doublings: float) -> list[Figure]:
    """Roots of the three squares with their standard errors.

    Points within a doubling of τ share most of their averages: together they count as one.
    """
    alike = max(1.0, len(weighted) / doublings)
    spread = np.sqrt(np.diag(np.linalg.pinv(weighted.T @ weighted)) * alike)
    out = []
    for square, error in zip(squares.tolist(), spread.tolist(), strict=True):
        value = math.sqrt(square)
        # Near 0 it is the square that is known to within its error.
        most = math.sqrt(error)
        out.append((value, min(error / (2 * value), most) if value else most))
    return out


def draw(report: Report, path: Path) -> None:
    """Two panels, accelerometer and gyro: measured with its error, and the model's line.

    SolenavError without matplotlib, or where `path` can't be written.
    """
    with plotting.sheet(path, (11.0, 4.6)) as figure:
        panels = figure.subplots(1, 2)
        for panel, axes in zip(panels, (report.axes[:3], report.axes[3:]), strict=True):
            for axis, colour in zip(
                axes, (plotting.BLUE, plotting.RED, plotting.GREEN), strict=True
            ):
                name = axis.name.split()[1]
                points = {"fmt": ".", "markersize": 3, "linewidth": 0.8, "color": colour}
                panel.errorbar(axis.tau_s, axis.deviation, axis.error, label=name, **points)
                panel.plot(axis.tau_s, axis.model(axis.tau_s), linewidth=1.2, color=colour)
            panel.set(xscale="log", yscale="log", xlabel="averaging time τ, s")
            panel.set_ylabel(f"Allan deviation, {axes[0].unit}")
            panel.set_title(axes[0].name.split()[0].capitalize())
            panel.legend()
        figure.tight_layout()
