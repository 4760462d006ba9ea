"""Indoor location competition: phones in the hand, 50 Hz, walks between way points on one floor.

Tab separated text, `#` comments: time in ms, type, values. Read are TYPE_ACCELEROMETER (m/s²),
TYPE_GYROSCOPE (rad/s), TYPE_MAGNETIC_FIELD (µT, the phone's own calibration), TYPE_WAYPOINT (x, y
in m from the floor plan's lower left corner). Source: the data of XYZ10 and Microsoft Research's
"Indoor Location & Navigation" competition, MIT licence.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from solenav.datasets import checks
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording, Truth

WIDTHS = {
    "TYPE_ACCELEROMETER": 3,
    "TYPE_GYROSCOPE": 3,
    "TYPE_MAGNETIC_FIELD": 3,
    "TYPE_WAYPOINT": 2,
}
NOTES = {"SiteID": "site", "FloorName": "floor"}


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of a file, on the accelerometer's times, its truth at the way points.

    `foot` has no use here. The magnetic field is None where the phone had none. Raises SolenavError
    for whatever is missing or broken.
    """
    notes: dict[str, str] = {}
    found: dict[str, list[list[float]]] = {name: [] for name in WIDTHS}
    lines_of: dict[str, list[int]] = {kind: [] for kind in WIDTHS}
    for number, line in enumerate(checks.read_lines(path, ".txt"), 1):
        cells = line.split("\t")
        if line.startswith("#"):
            notes |= {
                NOTES[key]: value
                for key, _, value in (cell.partition(":") for cell in cells)
                if key in NOTES
            }
        if line.startswith("#") or len(cells) < 2 or cells[1] not in WIDTHS:
            continue
        width = WIDTHS[cells[1]]
        if len(cells) < 2 + width:
            raise SolenavError(f"{path}, line {number}: {len(cells)} cells", checks.MEND_FILE)
        try:
            row = [float(cells[0]), *(float(cell) for cell in cells[2 : 2 + width])]
        except ValueError as error:
            raise SolenavError(f"{path}, line {number}: {error}", checks.MEND_FILE) from None
        if not np.isfinite(row).all():
            raise SolenavError(f"{path}, line {number}: a value is not finite", checks.MEND_FILE)
        lines_of[cells[1]].append(number)
        found[cells[1]].append(row)
    accel = np.array(found["TYPE_ACCELEROMETER"])
    gyro = np.array(found["TYPE_GYROSCOPE"])
    if len(accel) < 2 or len(gyro) < 2:
        raise SolenavError(
            f"{path} has no acceleration or no rate of turn", "record it again, or another format"
        )

    def place_of(kind: str) -> checks.Place:
        lines = lines_of[kind]
        return lambda sample: f"{path}, line {lines[min(sample, len(lines) - 1)]}"

    place = place_of("TYPE_ACCELEROMETER")
    time_s = accel[:, 0] / 1e3
    checks.check_increasing(time_s, place, repeats=True)
    # Two samples of one millisecond: the later replaces the first.
    kept = np.r_[np.diff(time_s) > 0, True]
    time_s, accel = time_s[kept], accel[kept]
    points = np.array(found["TYPE_WAYPOINT"])
    truth = None
    if len(points):
        known = np.column_stack([points[:, 1:], np.full(len(points), np.nan)])
        truth = Truth(points[:, 0] / 1e3 - time_s[0], known, frame="enu")
    field = np.array(found["TYPE_MAGNETIC_FIELD"])
    return checks.make_recording(
        path,
        "indoor",
        time_s - time_s[0],
        accel[:, 1:],
        _on(time_s, gyro, place_of("TYPE_GYROSCOPE")),
        place,
        truth,
        _on(time_s, field, place_of("TYPE_MAGNETIC_FIELD")) if len(field) else None,
        **notes,
    )


def read_size(path: Path) -> tuple[float, float]:
    """Width and height in m of a floor's plan, from its `floor_info.json`."""
    checks.check_file(path, (".json",))
    try:
        info = json.loads(path.read_text("utf-8"))["map_info"]
        return float(info["width"]), float(info["height"])
    except (OSError, ValueError, KeyError, TypeError):
        raise SolenavError(
            f"{path} has no map_info with width and height", "copy it anew"
        ) from None


def _on(time_s: FloatArray, rows: FloatArray, place: checks.Place) -> FloatArray:
    """Rows (n, 1 + k), ms first, interpolated at `time_s`, (m, k). SolenavError for holes."""
    at = rows[:, 0] / 1e3
    checks.check_increasing(at, place, repeats=True)
    # What lacks at the ends is a hole too.
    whole = np.r_[time_s[0], np.clip(at, time_s[0], time_s[-1]), time_s[-1]]
    checks.check_gaps(whole, lambda sample: place(max(sample - 1, 0)))
    return np.column_stack([np.interp(time_s, at, column) for column in rows[:, 1:].T])
