"""LLIO: LORD 3DM-GX5-25 on a foot, 200 Hz, with surveyed ground control points (GCP).

`SensorConnectData_NN_LLIO.mat` holds SI units; the sensor's own csv export (`SC_NN.csv`) holds g
and rad/s, and the magnetometer in gauss, a reading at every sample. Its axes are the
accelerometer's (docs/heading.md), but it lags the gyro by some 25 ms. The export has no deltas;
its roll, pitch and yaw are the sensor's own filter, and not read.
Source: the LLIO foot recordings published by Tā-Hā (2024), MIT licence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solenav.datasets import checks
from solenav.mpu9150 import STANDARD_GRAVITY, UT_PER_GAUSS
from solenav.recording import Recording, Truth

EXPORT_COLUMNS = ["Time", *(f"scaled{kind}{axis}" for kind in ("Accel", "Gyro") for axis in "XYZ")]
MAG_COLUMNS = [f"scaledMag{axis}" for axis in "XYZ"]
GCP_COLUMNS = ["timestamp", "gcpX", "gcpY"]
AXES_NOTE = "sensor z points down"


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of a `.mat`, with the GCP csv beside it as truth, or of a csv export.

    `foot` has no use here: there is one sensor. Raises SolenavError for a faulty file.
    """
    checks.check_file(path, (".mat", ".csv"))
    return _read_mat(path) if path.suffix.lower() == ".mat" else _read_export(path)


def _read_mat(path: Path) -> Recording:
    content = checks.load_mat(path, ("timestamps", "imu_data"))
    time_s = checks.mat_array(path, content, "timestamps", 1)
    imu = checks.mat_array(path, content, "imu_data", 6)
    checks.check_lengths(path, timestamps=time_s, imu_data=imu)
    place = checks.row_place(path)
    recording = checks.make_recording(
        path, "llio", time_s, imu[:, :3], imu[:, 3:], place, axes=AXES_NOTE
    )
    stem = path.stem.removesuffix("_LLIO")
    recording.truth = _read_gcp(
        path.with_name(f"{stem}_strideIndex_timestamp_gcpX_gcpY.csv"), float(time_s[0])
    )
    return recording


def _read_gcp(path: Path, start_s: float) -> Truth | None:
    if not path.exists():
        return None
    names, rows = checks.read_csv(path)
    wanted = checks.find_columns(path, names, GCP_COLUMNS)
    place = checks.line_place(path, 1)
    table = checks.to_numbers(rows, len(names), wanted, place)
    checks.check_finite(table, GCP_COLUMNS, place)
    time_s, x, y = table.T
    checks.check_increasing(time_s, place)
    # The points were fitted to a track with z down, so that seen from above they are mirrored.
    return Truth(time_s - start_s, np.column_stack([x, -y, np.full(len(x), np.nan)]))


def _read_export(path: Path) -> Recording:
    names, rows = checks.read_csv(path)
    # SensorConnect puts the node's address before each channel: "inertial-6253.76535:scaledAccelX".
    channels = [name.rpartition(":")[2] for name in names]
    optional = checks.present(channels, MAG_COLUMNS)
    wanted = checks.find_columns(path, channels, [*EXPORT_COLUMNS, *optional])
    place = checks.line_place(path, 1)
    table = checks.to_numbers(rows, len(names), wanted, place)
    return checks.make_recording(
        path,
        "llio",
        table[:, 0],
        table[:, 1:4] * STANDARD_GRAVITY,
        table[:, 4:7],
        place,
        mag=table[:, 7:] * UT_PER_GAUSS,
        axes=AXES_NOTE,
    )
