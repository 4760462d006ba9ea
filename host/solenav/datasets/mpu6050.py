"""An MPU-6050 (the MPU-9150's inertial die) with an HMC5883L by hand: rest, tilts, a full tumble.

A folder of `mpu6050_accelerometer.mat`, `mpu6050_gyroscope.mat`, `hmc5883l_compass.mat` (MATLAB
7.3, so HDF5), in g, °/s and gauss. A public set under the EUPL 1.2.

The stamps are those of bursts at the host, so only the first and last are believed. Axes: over the
tumble the gyro's turns fit the forces of (x, y, -z) and the fields of (-x, -y, z) best, of all 48
ways to name three axes of each; of the two mirror images that turns can't tell apart the one
with gravity up and the field's dip down.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np

from solenav.datasets import checks
from solenav.errors import SolenavError
from solenav.mpu9150 import STANDARD_GRAVITY, UT_PER_GAUSS
from solenav.recording import FloatArray, Recording

ACCELEROMETER = "mpu6050_accelerometer.mat"
GYRO = "mpu6050_gyroscope.mat"
COMPASS = "hmc5883l_compass.mat"


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of the folder that the accelerometer's file `path` is in.

    A reading of the compass goes to the first sample at or after it. `foot` has no use here.
    Raises SolenavError for a faulty or missing file, or without h5py.
    """
    checks.check_file(path, (".mat",))
    if path.name != ACCELEROMETER:
        raise SolenavError(f"{path} is not {ACCELEROMETER}", f"name the folder's {ACCELEROMETER}")
    accel = _buffer(path, "accelBuffer")
    gyro = _buffer(path.with_name(GYRO), "gyroBuffer")
    checks.check_lengths(path, accelerometer=accel, gyro=gyro)
    place = checks.row_place(path)
    # Before the stamps are used: they are numbers like the others.
    checks.check_finite(accel, ("time", "x", "y", "z"), place)
    time = np.linspace(accel[0, 0], accel[-1, 0], len(accel))
    return checks.make_recording(
        path,
        "mpu6050",
        time,
        accel[:, 1:] * [1, 1, -1] * STANDARD_GRAVITY,
        np.radians(gyro[:, 1:]),
        place,
        None,
        _field(path.with_name(COMPASS), time),
        folder=path.parent.name,
    )


def _field(path: Path, time: FloatArray) -> FloatArray | None:
    """Field (n, 3) in µT at the samples, NaN where there is no new reading."""
    if not path.exists():
        return None
    compass = _buffer(path, "compassBuffer")
    stamps = np.linspace(compass[0, 0], compass[-1, 0], len(compass))
    rows = np.searchsorted(time, stamps)
    known = rows < len(time)
    out = np.full((len(time), 3), np.nan)
    out[rows[known]] = compass[known, 1:] * [-1, -1, 1] * UT_PER_GAUSS
    return out


def _buffer(path: Path, name: str) -> FloatArray:
    """The variable `name` (n, 4): stamp in s, then the three axes."""
    checks.check_file(path, (".mat",))
    try:
        h5py = import_module("h5py")
    except ImportError:
        raise SolenavError(f"reading {path} needs h5py", "pip install 'solenav[import]'") from None
    try:
        with h5py.File(path) as file:
            value = np.asarray(file[name], dtype=np.float64).T
    except KeyError:
        raise SolenavError(f"{path} has no variable {name}", checks.CHOOSE_FORMAT) from None
    except (OSError, TypeError, ValueError) as error:
        reason = str(error).split("(")[0].strip()
        raise SolenavError(
            f"{path} is not a readable .mat file of version 7.3: {reason}", checks.CHOOSE_FORMAT
        ) from None
    if value.ndim != 2 or value.shape[1] != 4 or len(value) < 2:
        raise SolenavError(
            f"{path}: variable {name} is {value.shape}, not (n, 4)", checks.CHOOSE_FORMAT
        )
    return value
