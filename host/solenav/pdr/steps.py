"""Steps of a carried phone, from its vertical acceleration.

After the patent application in docs/pdr.md: an FIR low-pass at 3 Hz; a step is a peak between two
valleys; two steps are 0.3 to 2.0 s apart; and a step must look like the one before the last, which
the same foot made, by dynamic time warping (dtaidistance). A walk's first two steps have none
before them: they count where the step after next looks like them.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.errors import SolenavError
from solenav.recording import FloatArray


@dataclass(frozen=True)
class StepTuning:
    """What the detector goes by: Hz, s, m/s².

    `swing` is the least rise from valley to peak; `alike` the largest DTW distance of two steps, as
    a share of the larger swing and per sample.
    """

    cutoff_hz: float = 3.0
    taps_s: float = 0.5
    closest_s: float = 0.3
    farthest_s: float = 2.0
    swing: float = 1.0
    alike: float = 0.25


TUNING = StepTuning()


@dataclass(frozen=True)
class Steps:
    """Steps found: `time_s` (n,) when each ended, `begin_s` (n,) when it began.

    `frequency_hz` (n,) and `variance` (n,) (m/s²)² of the vertical acceleration within each are
    what a step's length is made of. `refused` were peaks without a match.
    """

    time_s: FloatArray
    begin_s: FloatArray
    frequency_hz: FloatArray
    variance: FloatArray
    refused: int = 0

    def __len__(self) -> int:
        return len(self.time_s)


def detect(time_s: FloatArray, vertical: FloatArray, tuning: StepTuning = TUNING) -> Steps:
    """The steps in vertical acceleration (n,), m/s² free of gravity, at regular times (n,).

    SolenavError where scipy or dtaidistance is missing, or the samples are not finite or too few.
    """
    signal = need("scipy.signal")
    if len(time_s) < 2 or not np.isfinite(vertical).all() or not np.isfinite(time_s).all():
        raise SolenavError(
            "the acceleration has holes (NaN), or fewer than two samples",
            "cut the trace there and read the parts one by one",
        )
    rate = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    smooth = low_pass(vertical, rate, tuning)
    peaks, _ = signal.find_peaks(
        smooth, distance=max(1, round(tuning.closest_s * rate)), prominence=tuning.swing
    )
    if not len(peaks):
        return _none(0)
    valleys = _valleys(smooth, peaks, round(tuning.farthest_s * rate / 2))
    begins, ends = valleys[:-1].copy(), valleys[1:].copy()
    shapes = [smooth[a : b + 1] for a, b in zip(begins, ends, strict=True)]
    far = np.diff(time_s[peaks]) > tuning.farthest_s
    bout = np.r_[0, np.cumsum(far)]
    counted = _matched(shapes, bout, tuning)
    # The time to the peak before is steadier than between valleys.
    apart = np.diff(time_s[peaks], prepend=np.nan)
    apart[np.r_[True, far]] = np.nan
    usual = float(np.nanmedian(apart)) if np.isfinite(apart).any() else 0.5
    apart = np.where(np.isfinite(apart), apart, usual)
    variance = np.array(
        [vertical[a : b + 1].var() for a, b in zip(begins, ends, strict=True)], np.float64
    )
    return Steps(
        time_s[ends[counted]],
        time_s[begins[counted]],
        1.0 / apart[counted],
        variance[counted],
        int((~counted).sum()),
    )


def low_pass(values: FloatArray, rate_hz: float, tuning: StepTuning = TUNING) -> FloatArray:
    """Values (n,) through the FIR, its delay taken out."""
    signal = need("scipy.signal")
    taps = 2 * round(tuning.taps_s * rate_hz / 2) + 1
    if rate_hz <= 2 * tuning.cutoff_hz:
        raise SolenavError(
            f"{rate_hz:.3g} Hz are too few for steps", "record at 20 Hz or faster, 50 is usual"
        )
    weights = signal.firwin(taps, tuning.cutoff_hz, fs=rate_hz)
    padded = np.pad(values, taps // 2, mode="edge")
    return np.asarray(np.convolve(padded, weights, mode="valid"))


def need(module: str) -> Any:
    """A module of the extra `related`; SolenavError where it's missing."""
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise SolenavError(f"this needs {name}", "pip install 'solenav[related]'") from None


def _none(refused: int) -> Steps:
    return Steps(np.empty(0), np.empty(0), np.empty(0), np.empty(0), refused)


def _valleys(smooth: FloatArray, peaks: NDArray[np.intp], reach: int) -> NDArray[np.intp]:
    """The lowest sample between each two peaks, before the first and after the last."""
    edges = [max(0, int(peaks[0]) - reach), *peaks.tolist(), min(len(smooth), peaks[-1] + reach)]
    return np.array(
        [a + int(np.argmin(smooth[a : b + 1])) for a, b in pairwise(edges)],
        np.intp,
    )


def _matched(
    shapes: list[FloatArray], bout: NDArray[np.intp], tuning: StepTuning
) -> NDArray[np.bool_]:
    """Whether each step looks like the one before the last, or is looked like by one after next."""
    dtw = need("dtaidistance.dtw")
    counted = np.zeros(len(shapes), bool)
    for i in range(2, len(shapes)):
        if bout[i] != bout[i - 2]:
            continue
        a, b = shapes[i], shapes[i - 2]
        swing = max(float(np.ptp(a)), float(np.ptp(b)))
        # The distance is a root of summed squares over a path as long as the longer step.
        apart = dtw.distance(a, b) / (swing * max(len(a), len(b)) ** 0.5)
        if apart <= tuning.alike:
            counted[[i - 2, i]] = True
    return counted
