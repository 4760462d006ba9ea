"""KAIST: Samsung S9 in the hand, 50 Hz, walks on one floor, with its magnetic map and its walls.

A recording is a folder of `Accelerometer.csv` (m/s²), `Gyroscope.csv` (rad/s) and
`MagneticField.csv` (µT), each with its own times in ns, and `Timestamp.csv`: when each way point
was passed, from the beginning on, and when the recording ended, in ms. Where the way points are is
in a file of their own (`ki-gt-s1.json`): x, y in m, in the map's axes. Source: S. Lee, MIT licence.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from solenav.datasets import checks
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording, Truth

RATE_HZ = 50.0
CLOCK_STEP_S = 0.5
SENSORS = ("Accelerometer", "Gyroscope", "MagneticField")


def read(path: Path, *, foot: str = "right", way_points: Path | None = None) -> Recording:
    """Recording of a folder, resampled to 50 Hz, its truth at the way points where a file has them.

    `foot` has no use here. Raises SolenavError for whatever is missing, broken, or doesn't fit.
    """
    if not path.is_dir():
        raise SolenavError(f"{path} is no folder of sensor files", "name the recording's folder")
    files = {name: path / f"{name}.csv" for name in SENSORS}
    accel_s, accel, shift_ms = _sensor(files["Accelerometer"])
    gyro_s, gyro, _ = _sensor(files["Gyroscope"])
    series = [(accel_s, accel), (gyro_s, gyro)]
    if files["MagneticField"].exists():
        mag_s, mag, _ = _sensor(files["MagneticField"])
        series.append((mag_s, mag))
    begin, end = max(t[0] for t, _ in series), min(t[-1] for t, _ in series)
    if end - begin < 1.0:
        raise SolenavError(
            f"{path}: its sensors have less than a second in common", "copy all files of one walk"
        )
    time_s = begin + np.arange(int((end - begin) * RATE_HZ)) / RATE_HZ
    values = [np.column_stack([np.interp(time_s, t, column) for column in v.T]) for t, v in series]
    truth = None
    if way_points is not None:
        stamps_ms = _stamps(path / "Timestamp.csv")
        points = read_way_points(way_points)
        # The walk begins at the first way point, with the recording; the last stamp is its end.
        passed = stamps_ms[:-1]
        if len(passed) != len(points):
            raise SolenavError(
                f"{way_points} has {len(points)} way points, {path} passed {len(passed)}",
                "give the file of this walk",
            )
        known = np.column_stack([points, np.full(len(points), np.nan)])
        truth = Truth((passed - shift_ms) / 1e3 - begin, known, frame="enu")
    return checks.make_recording(
        path,
        "kaist",
        time_s - time_s[0],
        values[0],
        values[1],
        lambda i: f"{path}, {i / RATE_HZ:.2f} s",
        truth,
        values[2] if len(values) > 2 else None,
        **_floor(path / "Transition.csv"),
    )


def read_way_points(path: Path) -> FloatArray:
    """(n, 2) m, in the map's axes."""
    points = _json(path)
    try:
        found = np.array(points, np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.ndim != 2 or found.shape[1] != 2 or not np.isfinite(found).all():
        raise SolenavError(f"{path} is no list of way points [x, y]", checks.MEND_FILE)
    return found


def read_floor(path: Path) -> list[FloatArray]:
    """Polygons (n, 2) m: the first is where one can walk, the others are holes in it."""
    content = _json(path)
    try:
        floor = [np.array(p, np.float64) for p in (content["in"], *content["out"])]
    except (TypeError, ValueError, KeyError):
        floor = []
    if not floor or any(p.ndim != 2 or p.shape[1] != 2 or len(p) < 3 for p in floor):
        raise SolenavError(f"{path} is no floor with polygons 'in' and 'out'", checks.MEND_FILE)
    return floor


def read_field(path: Path) -> FloatArray:
    """Cells of the floor's magnetic map (n, 5): x, y in m, field along x, y and up in µT.

    The file's own horizontal components are a quarter turn off the map's axes: laid so, the three
    walks' fields fit it best, and directions follow it along every leg.
    """
    checks.check_file(path, (".mat",))
    try:
        import h5py
    except ImportError:
        raise SolenavError(f"reading {path} needs h5py", "pip install 'solenav[import]'") from None
    try:
        with h5py.File(path) as file:
            cells = np.array(file["map"], np.float64)
    except (OSError, KeyError, ValueError, TypeError):
        raise SolenavError(
            f"{path} is no .mat file (v7.3) with a variable `map`", checks.CHOOSE_FORMAT
        ) from None
    if cells.ndim != 2 or cells.shape[0] != 5 or not np.isfinite(cells).all():
        raise SolenavError(f"{path}: `map` is {cells.shape}, not (5, n)", checks.CHOOSE_FORMAT)
    x, y, against_y, along_x, up = cells
    return np.column_stack([x, y, along_x, -against_y, up])


def _sensor(path: Path) -> tuple[FloatArray, FloatArray, float]:
    """Times in s of the sensor's clock, values (n, 3), its zero on the wall clock in ms."""
    names, rows = checks.read_csv(path)
    wanted = checks.find_columns(path, names, ("timeMillis", "timeNanos", "x", "y", "z"))
    place = checks.line_place(path, 1)
    table = checks.to_numbers(rows, len(names), wanted, place)
    if len(table) < 2:
        raise SolenavError(f"{path} has {len(table)} samples", "record it again")
    checks.check_finite(table, ("timeMillis", "timeNanos", "x", "y", "z"), place)
    time_s = _mended(table[:, 1] / 1e9)
    checks.check_increasing(time_s, place)
    checks.check_gaps(time_s, place)
    return time_s, table[:, 2:], float(np.median(table[:, 0] - table[:, 1] / 1e6))


def _floor(path: Path) -> dict[str, str]:
    """The floor that the walk began on, where the folder says it."""
    if not path.exists():
        return {}
    names, rows = checks.read_csv(path)
    (column,) = checks.find_columns(path, names, ("floor",))
    return {"floor": rows[0][column]} if rows and len(rows[0]) > column else {}


def _mended(time_s: FloatArray) -> FloatArray:
    """Times with one small step back taken out.

    The phone sets a sensor's clock within the first seconds: what was stamped before is moved, so
    that the samples stay a period apart. Other steps back are left, for the checks to find.
    """
    steps = np.diff(time_s)
    back = np.flatnonzero(steps <= 0)
    if len(back) == 1 and steps[back[0]] > -CLOCK_STEP_S and time_s[back[0]] - time_s[0] < 5.0:
        time_s = time_s.copy()
        time_s[: back[0] + 1] += steps[back[0]] - np.median(steps)
    return time_s


def _stamps(path: Path) -> FloatArray:
    names, rows = checks.read_csv(path)
    wanted = checks.find_columns(path, names, ("timestamp",))
    place = checks.line_place(path, 1)
    stamps = checks.to_numbers(rows, len(names), wanted, place)[:, 0]
    checks.check_finite(stamps[:, np.newaxis], ("timestamp",), place)
    if len(stamps) < 3:
        raise SolenavError(f"{path} has {len(stamps)} times, 3 are the least", "record it again")
    checks.check_increasing(stamps, place)
    return stamps


def _json(path: Path) -> Any:
    checks.check_file(path, (".json",))
    try:
        return json.loads(path.read_text("utf-8-sig"))
    except (OSError, ValueError):
        raise SolenavError(f"{path} is no readable JSON", checks.MEND_FILE) from None
