"""Allan deviation of a resting IMU: random walk N, bias instability B, rate random walk K.

As IEEE Std 952 has it (annex C): where the overlapping Allan deviation falls with the square root
of time, N = deviation * sqrt(tau); at its lowest, B = deviation / 0.664; where it rises with the
square root, K = deviation * sqrt(3 / tau).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import plot as plotting
from solenav.errors import SolenavError
from solenav.mpu9150 import STANDARD_GRAVITY
from solenav.recording import FloatArray, Recording

SHORTEST_S = 120.0
"""A rest must be as long: the bias instability of such sensors shows after 10 to 100 s."""

LONGEST_SHARE = 1 / 8  # of the rest, the longest tau: some ten independent averages
POINTS_PER_DECADE = 10
WINDOW_S = 0.5
STILL_ACCEL = 0.15  # m/s², standard deviation in a window
STILL_RATE_DPS = 2.0
SHIFT_ACCEL = 0.1  # m/s², of a window's mean from the stretch's: half a degree, or a push
SHIFT_RATE_DPS = 0.5
FLICKER = float(np.sqrt(2 * np.log(2) / np.pi))  # 0.664
SLOPE_TOLERANCE = 0.15
FEWEST_POINTS = 4
CONFIDENCE = 0.683
MOVED = "put the sensor on something heavy and soft, leave it alone for 10 minutes or more"


@dataclass(frozen=True)
class Figure:
    """A value in the axis' unit with `low` to `high` at 68 %, read at `tau_s` (first, last).

    `limit`: the noise wasn't seen by itself, so the value is the most that it can be.
    """

    value: float
    low: float
    high: float
    tau_s: tuple[float, float]
    limit: bool
    how: str


@dataclass(frozen=True)
class Axis:
    """`tau_s`, `deviation`, `low`, `high` (k,); units "mg" or "°/s", N per root Hz, K times it."""

    name: str
    unit: str
    tau_s: FloatArray
    deviation: FloatArray
    low: FloatArray
    high: FloatArray
    random_walk: Figure
    bias_instability: Figure
    rate_random_walk: Figure

    def at(self, tau_s: float) -> float:
        """Deviation at `tau_s`, between points along the line of the logarithms."""
        return float(np.exp(np.interp(np.log(tau_s), np.log(self.tau_s), np.log(self.deviation))))


@dataclass(frozen=True)
class Report:
    """Axes accel x to gyro z, and the stretch of the recording that was used."""

    source: str
    rate_hz: float
    start_s: float
    end_s: float
    recording_s: float
    axes: tuple[Axis, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "source": self.source,
            "rate_hz": self.rate_hz,
            "used_s": [self.start_s, self.end_s],
            "recording_s": self.recording_s,
            "confidence": CONFIDENCE,
            "axes": {
                axis.name: {
                    "unit": axis.unit,
                    "at_1_s": axis.at(1.0),
                    "N": asdict(axis.random_walk),
                    "B": asdict(axis.bias_instability),
                    "K": asdict(axis.rate_random_walk),
                    "tau_s": axis.tau_s.tolist(),
                    "deviation": axis.deviation.tolist(),
                }
                for axis in self.axes
            },
        }


def analyse(recording: Recording) -> Report:
    """Allan deviation over the longest still stretch. SolenavError if that's under SHORTEST_S."""
    first, last = still(recording)
    rate = recording.rate_hz
    whole = len(recording.time_s) / rate
    length = (last - first) / rate
    if whole < SHORTEST_S:
        raise SolenavError(
            f"the recording is {whole:.1f} s long, {SHORTEST_S:.0f} s are the least",
            "leave the sensor alone for 10 minutes or more",
        )
    if length < SHORTEST_S:
        raise SolenavError(
            f"the sensor moved: the longest rest is {length:.1f} of {whole:.1f} s, "
            f"{SHORTEST_S:.0f} s are the least",
            MOVED,
        )
    accel = recording.accel[first:last] / STANDARD_GRAVITY * 1e3
    gyro = np.rad2deg(recording.gyro[first:last])
    axes = [
        axis(f"{sensor} {name}", unit, values[:, i], rate)
        for sensor, unit, values in (("accel", "mg", accel), ("gyro", "°/s", gyro))
        for i, name in enumerate("xyz")
    ]
    return Report(recording.source, rate, first / rate, last / rate, whole, tuple(axes))


def still(recording: Recording) -> tuple[int, int]:
    """Rows first and last (excluded) of the longest time without movement or missing samples."""
    n = max(2, round(WINDOW_S * recording.rate_hz))
    count = len(recording.time_s) // n
    accel = recording.accel[: count * n].reshape(count, n, 3)
    gyro = np.rad2deg(recording.gyro[: count * n]).reshape(count, n, 3)
    steps = np.diff(recording.time_s, prepend=recording.time_s[0])[: count * n].reshape(count, n)
    quiet = (
        (np.linalg.norm(accel.std(axis=1), axis=1) < STILL_ACCEL)
        & (np.linalg.norm(gyro.std(axis=1), axis=1) < STILL_RATE_DPS)
        & (steps.max(axis=1, initial=0.0) < WINDOW_S / 5)
    )
    force, rate = accel.mean(axis=1), gyro.mean(axis=1)
    best, start = (0, 0), 0
    for i in range(count + 1):
        if i < count and quiet[i]:
            # From the window before as well as from the start: warming up is slow, a push isn't.
            back = max(start, i - 20)
            near = np.linalg.norm(force[i] - force[back : i + 1].mean(axis=0)) < SHIFT_ACCEL
            if near and np.linalg.norm(rate[i] - rate[back : i + 1].mean(axis=0)) < SHIFT_RATE_DPS:
                continue
        if i - start > best[1] - best[0]:
            best = (start, i)
        start = i if i < count and quiet[i] else i + 1
    return best[0] * n, best[1] * n


def axis(name: str, unit: str, values: FloatArray, rate_hz: float) -> Axis:
    """Allan deviation and its figures, of `values` (n,) at `rate_hz`."""
    tau, deviation, freedom = _deviation(values, rate_hz)
    relative = 1 / np.sqrt(2 * freedom)
    slope = np.gradient(np.log(deviation), np.log(tau))
    return Axis(
        name,
        unit,
        tau,
        deviation,
        deviation * (1 - relative),
        deviation * (1 + relative),
        _slope_figure(tau, deviation, relative, slope, -0.5),
        _lowest(tau, deviation, relative),
        _slope_figure(tau, deviation, relative, slope, 0.5),
    )


def _deviation(values: FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Averaging times, overlapping Allan deviations, and their degrees of freedom, each (k,)."""
    try:
        allantools = import_module("allantools")
    except ImportError:
        raise SolenavError(
            "the Allan deviation needs allantools", "pip install 'solenav[calibrate]'"
        ) from None
    if not np.ptp(values):
        raise SolenavError("a sensor gives one value all the time", "check that it is alive")
    longest = len(values) * LONGEST_SHARE
    decades = np.log10(longest)
    factors = np.unique(np.rint(np.logspace(0, decades, round(decades * POINTS_PER_DECADE) + 1)))
    tau, deviation, _, _ = allantools.oadev(
        values, rate=rate_hz, data_type="freq", taus=factors / rate_hz
    )
    # Those of white noise: fewest assumptions, a little generous for slower noise.
    freedom = [allantools.edf_simple(len(values), round(t * rate_hz), 0) for t in tau]
    return np.asarray(tau), np.asarray(deviation), np.asarray(freedom, dtype=np.float64)


def _slope_figure(
    tau: FloatArray, deviation: FloatArray, relative: FloatArray, slope: FloatArray, wanted: float
) -> Figure:
    """N (`wanted` slope -0.5) or K (0.5): weighted mean where the slope is so for longest."""
    scaled = deviation * np.sqrt(tau) if wanted < 0 else deviation * np.sqrt(3 / tau)
    first, last = _longest(np.abs(slope - wanted) < SLOPE_TOLERANCE)
    if last - first < FEWEST_POINTS:
        i = int(np.argmin(scaled))
        error = scaled[i] * relative[i]
        why = f"no slope of {wanted:+} seen; at most this, from the lowest line of it"
        place = (float(tau[i]), float(tau[i]))
        return Figure(
            float(scaled[i]), float(scaled[i] - error), float(scaled[i] + error), place, True, why
        )
    part = slice(first, last)
    weights = relative[part] ** -2
    value = float(np.exp(np.average(np.log(scaled[part]), weights=weights)))
    spread = np.sqrt(np.average(np.log(scaled[part] / value) ** 2, weights=weights))
    # Overlapping points share their samples: as good as the best of them, no better.
    error = value * float(max(spread, relative[part].min()))
    how = f"mean over {last - first} points of slope {wanted:+}"
    place = (float(tau[first]), float(tau[last - 1]))
    return Figure(value, value - error, value + error, place, False, how)


def _lowest(tau: FloatArray, deviation: FloatArray, relative: FloatArray) -> Figure:
    i = int(np.argmin(deviation))
    value = float(deviation[i]) / FLICKER
    error = value * float(relative[i])
    at_end = i >= len(tau) - 2
    how = "still falling at the longest time: at most this" if at_end else "lowest point / 0.664"
    place = (float(tau[i]), float(tau[i]))
    return Figure(value, value - error, value + error, place, at_end, how)


def _longest(good: NDArray[np.bool_]) -> tuple[int, int]:
    """First and last (excluded) of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.r_[0, good.astype(np.int8), 0]))
    if not edges.size:
        return 0, 0
    runs = edges.reshape(-1, 2)
    first, last = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))]
    return int(first), int(last)


def plot(report: Report, out: Path) -> None:
    """PNG of both sensors' deviations with 68 % bands and N's lines. SolenavError as `sheet`."""
    colours = (plotting.BLUE, plotting.RED, plotting.GREEN)
    with plotting.sheet(out, (12.0, 5.5)) as figure:
        left, right = figure.subplots(1, 2)
        for panel, axes, title in (
            (left, report.axes[:3], "Accelerometer"),
            (right, report.axes[3:], "Gyro"),
        ):
            for a, colour in zip(axes, colours, strict=True):
                panel.loglog(a.tau_s, a.deviation, color=colour, label=a.name[-1])
                panel.fill_between(a.tau_s, a.low, a.high, color=colour, alpha=0.2, linewidth=0)
                if not a.random_walk.limit:
                    line = a.random_walk.value / np.sqrt(a.tau_s)
                    panel.loglog(
                        a.tau_s, line, color=colour, linestyle=plotting.DASHED, linewidth=0.8
                    )
                b = a.bias_instability
                panel.plot(b.tau_s[0], b.value * FLICKER, "o", color=colour, markersize=5)
            low = min(float(a.deviation.min()) for a in axes)
            panel.set_ylim(bottom=low / 2)
            panel.set_title(title)
            panel.set_xlabel("averaging time, s")
            panel.set_ylabel(f"Allan deviation, {axes[0].unit}")
            panel.legend()
        figure.suptitle(
            f"{report.source}: {report.end_s - report.start_s:.0f} s of rest; "
            "dashed: N, dots: lowest points, bands: 68 %",
            fontsize=10,
            parse_math=False,
        )
        figure.tight_layout()
