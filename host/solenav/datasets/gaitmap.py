"""gaitmap: a sensor on each foot, 204.8 Hz, with motion capture at 100 Hz for one walk.

`imu_sample*.csv`, m/s² and °/s, both feet; `mocap_sample*.csv` beside it, markers in mm.
`aligned_data_with_mag_l_walks.csv`, 400 Hz, one foot, with a magnetometer in a unit that it
doesn't give. Source: example data of FAU's gaitmap (MaD Lab), MIT licence.

Over the L walks, indoors, the field's median is 1.02 of that unit: so it is the Earth's field,
as sensors that are normalised in a known field have it, and 1 stands for 49 µT, the field in
Central Europe. (Gauss would make it twice the Earth's for a whole walk.) Where the foot stands
first it is 0.82, along the walk 0.5 to 1.6: steel. The axes are the accelerometer's
(docs/heading.md).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solenav.datasets import checks
from solenav.recording import FloatArray, Recording, Truth

RATE_HZ = 204.8
MOCAP_RATE_HZ = 100.0
CHANNELS = [f"{kind}_{axis}" for kind in ("acc", "gyr") for axis in "xyz"]
# Toe, heel, fifth metatarsal: their mean follows the sensor better than the heel alone.
MARKERS = ("TOE", "FCC", "FM5")

SINGLE_RATE_HZ = 400.0
MAG_CHANNELS = [f"mag_{axis}" for axis in "xyz"]
MAG_UNIT_UT = 49.0
MAG_NOTE = f"unit not given; 1 taken as the Earth's field in Central Europe, {MAG_UNIT_UT:g} µT"


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of the "left" or "right" `foot`, with its mocap as truth if that is beside it.

    A file of a single sensor is that of either foot. Raises SolenavError for a faulty file.
    """
    names, _ = checks.read_csv(path)
    if set(CHANNELS) <= set(names):
        return _read_single(path)
    place = checks.line_place(path, 2)
    table = _read_table(path, [f"{foot}_sensor {channel}" for channel in CHANNELS], place)
    recording = checks.make_recording(
        path,
        "gaitmap",
        _seconds(table[:, 0]),
        table[:, 1:4],
        np.deg2rad(table[:, 4:]),
        place,
        _read_mocap(path.with_name(path.name.replace("imu_", "mocap_", 1)), path, foot),
        foot=foot,
    )
    recording.name += f"_{foot}"
    return recording


def _read_single(path: Path) -> Recording:
    names, rows = checks.read_csv(path)
    optional = checks.present(names, MAG_CHANNELS)
    place = checks.line_place(path, 1)
    columns = [0, *checks.find_columns(path, names, [*CHANNELS, *optional])]
    table = checks.to_numbers(rows, len(names), columns, place)
    recording = checks.make_recording(
        path,
        "gaitmap",
        table[:, 0] / SINGLE_RATE_HZ,
        table[:, 1:4],
        np.deg2rad(table[:, 4:7]),
        place,
        mag=table[:, 7:] * MAG_UNIT_UT,
    )
    if recording.mag is not None:
        recording.notes["magnetometer"] = MAG_NOTE
    return recording


def _read_table(path: Path, wanted: list[str], place: checks.Place) -> FloatArray:
    """The first column, which has no fixed name, and the `wanted` ones."""
    names, rows = checks.read_csv(path, header_lines=2)
    columns = [0, *checks.find_columns(path, names, wanted)]
    return checks.to_numbers(rows, len(names), columns, place)


def _seconds(index: FloatArray) -> FloatArray:
    """Time of the first column, which holds sample numbers in some files, seconds in others."""
    numbered = len(index) > 1 and np.median(np.diff(index)) == 1
    return index / RATE_HZ if numbered else index


def _read_mocap(path: Path, imu_path: Path, foot: str) -> Truth | None:
    """Mean of the foot's markers, NaN where one isn't seen.

    Both systems started together: the rate of the markers' rigid body and the gyro's agree best
    at an offset of 2 ms, less than half a sample.
    """
    if path == imu_path or not path.exists():
        return None
    place = checks.line_place(path, 2)
    wanted = [f"{foot[0].upper()}_{marker} {axis}" for marker in MARKERS for axis in "xyz"]
    table = _read_table(path, wanted, place)
    time_s = table[:, 0] / MOCAP_RATE_HZ
    checks.check_finite(time_s[:, np.newaxis], ["time"], place)
    checks.check_increasing(time_s, place)
    markers_mm = table[:, 1:].reshape(-1, len(MARKERS), 3)
    return Truth(time_s, markers_mm.mean(axis=1) / 1000.0)
