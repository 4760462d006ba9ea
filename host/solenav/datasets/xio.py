"""x-io: NGIMU on a foot, about 400 Hz, walks that end where they began.

csv with °/s and g. Source: x-io Technologies' gait tracking example, MIT licence.

About 1 % of the samples are missing, nearly as many repeated exactly, often side by side. Every
step of time is a whole multiple of one period, to 2 µs. So repeats go, missing samples are
interpolated in place, and every sample that was received stays as it was.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solenav.datasets import checks
from solenav.errors import SolenavError
from solenav.mpu9150 import STANDARD_GRAVITY
from solenav.recording import FloatArray, Recording

COLUMNS = [
    "Time (s)",
    *(f"Gyroscope {axis} (deg/s)" for axis in "XYZ"),
    *(f"Accelerometer {axis} (g)" for axis in "XYZ"),
]
# Of a period; the walks stay within 0.001.
STEP_TOLERANCE = 0.25


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording on a constant sample period; `notes` count what was repaired.

    `foot` has no use here: there is one sensor. Raises SolenavError for a faulty file, also
    where samples differ under one time stamp, or stamps don't fit one period.
    """
    names, rows = checks.read_csv(path)
    wanted = checks.find_columns(path, names, COLUMNS)
    place = checks.line_place(path, 1)
    table = checks.to_numbers(rows, len(names), wanted, place)
    time_s, gyro, accel = table[:, 0], np.deg2rad(table[:, 1:4]), table[:, 4:] * STANDARD_GRAVITY
    checks.check_samples(time_s, accel, gyro, place, repeats=True)

    kept = _first_of_repeats(table, place)
    tick = _ticks(time_s, kept, place)
    ticks = np.arange(tick[-1] + 1)
    period_s = (time_s[-1] - time_s[0]) / tick[-1]
    return checks.make_recording(
        path,
        "xio",
        ticks * period_s,
        _fill(ticks, tick, accel[kept]),
        _fill(ticks, tick, gyro[kept]),
        place,
        checks.closed_loop(),
        duplicates_dropped=len(table) - len(kept),
        samples_filled=len(ticks) - len(kept),
        longest_gap_s=float(np.diff(time_s).max()),
    )


def _first_of_repeats(table: FloatArray, place: checks.Place) -> NDArray[np.intp]:
    """Indices of the rows without repeats, of `table` (n, 7) with time first."""
    repeat = np.diff(table[:, 0]) == 0
    differs = np.flatnonzero(repeat & (np.diff(table, axis=0) != 0).any(axis=1))
    if differs.size:
        raise SolenavError(
            f"{place(int(differs[0]) + 1)}: same time as the line before, other values",
            checks.MEND_FILE,
        )
    return np.flatnonzero(np.r_[True, ~repeat])


def _ticks(time_s: FloatArray, kept: NDArray[np.intp], place: checks.Place) -> NDArray[np.int64]:
    """Number of periods from the first sample to each kept one."""
    steps = np.diff(time_s[kept])
    if not steps.size:
        raise SolenavError(f"{place(0)} and on: all lines repeat one sample", "record it again")
    exact = steps / np.median(steps)
    whole = np.rint(exact)
    wrong = np.flatnonzero((np.abs(exact - whole) > STEP_TOLERANCE) | (whole < 1))
    if wrong.size:
        i = int(wrong[0])
        raise SolenavError(
            f"{place(int(kept[i + 1]))}: the step of {steps[i] * 1e3:.3f} ms is no multiple of the "
            f"sample period, {np.median(steps) * 1e3:.3f} ms",
            "export the sensor's own time stamps, not the computer's",
        )
    return np.r_[0, np.cumsum(whole)].astype(np.int64)


def _fill(ticks: NDArray[np.int64], known: NDArray[np.int64], values: FloatArray) -> FloatArray:
    """`values` (k, 3) at ticks `known`, interpolated linearly to all `ticks`."""
    return np.column_stack([np.interp(ticks, known, column) for column in values.T])
