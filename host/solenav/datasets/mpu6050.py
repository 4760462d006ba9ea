"""MPU-6050 with an HMC5883L: rests and a tumble, 99.3 Hz and 77 Hz, HDF5 (MATLAB v7.3).

One folder a recording, one file a sensor; rows of time, x, y, z. Accelerometer in g with the sign
of gravity, gyro in °/s, compass in gauss. The MPU-6050 is the MPU-9150's inertial die.

The time stamps are when bursts of samples reached the computer, so samples are laid out evenly
between the first and the last. Signs were found from the tumble: df/dt = f x w holds only with the
gyro's x and y turned round (rms 0.17 /s, the next best 0.35 /s), and the angle of field to gravity
is constant only with the compass's axes as they are (spread of its cosine 0.02 after removing hard
iron and scales, any other turn 0.29). Both would hold in a mirror as well.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from solenav.datasets import checks
from solenav.errors import SolenavError
from solenav.mpu9150 import STANDARD_GRAVITY, UT_PER_GAUSS
from solenav.recording import FloatArray, Recording

ACCEL_FILE, GYRO_FILE, MAG_FILE = (
    "mpu6050_accelerometer.mat",
    "mpu6050_gyroscope.mat",
    "hmc5883l_compass.mat",
)
GYRO_SIGNS = np.array([-1.0, -1.0, 1.0])


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of the folder whose accelerometer file is `path`; its name is the folder's.

    `mag` holds each compass reading at the nearest sample, uncalibrated, in the accelerometer's
    axes; without a compass file there is none. `foot` has no use here. Raises SolenavError for a
    faulty or missing file.
    """
    checks.check_file(path, (".mat",))
    if path.name != ACCEL_FILE:
        raise SolenavError(f"{path} is not a {ACCEL_FILE}", checks.CHOOSE_FORMAT)
    accel = _load(path, "accelBuffer")
    gyro = _load(path.with_name(GYRO_FILE), "gyroBuffer")
    checks.check_lengths(path, accelerometer=accel, gyro=gyro)
    place = checks.row_place(path)
    if len(accel) < 2:
        checks.check_samples(accel[:, 0], accel[:, 1:], gyro[:, 1:], place)
    stamps = accel[:, 0]
    checks.check_finite(accel, ("time", *checks.AXES[:3]), place)
    checks.check_increasing(stamps, place)
    time_s = np.linspace(stamps[0], stamps[-1], len(stamps))
    compass = path.with_name(MAG_FILE)
    recording = checks.make_recording(
        path,
        "mpu6050",
        time_s,
        -accel[:, 1:] * STANDARD_GRAVITY,
        np.deg2rad(gyro[:, 1:]) * GYRO_SIGNS,
        place,
        mag=_mag(compass, time_s) if compass.is_file() else None,
        longest_burst_s=float(np.diff(stamps).max()),
    )
    return replace(recording, name=path.absolute().parent.name)


def _load(path: Path, name: str) -> FloatArray:
    """Columns time, x, y, z (n, 4) of variable `name`."""
    checks.check_file(path, (".mat",))
    try:
        h5py = import_module("h5py")
    except ImportError:
        raise SolenavError(f"reading {path} needs h5py", "pip install 'solenav[import]'") from None
    try:
        with h5py.File(path, "r") as file:
            if name not in file:
                raise SolenavError(f"{path} has no variable {name}", checks.CHOOSE_FORMAT)
            # MATLAB's arrays lie transposed in HDF5.
            content = {name: np.asarray(file[name][()]).T}
    except OSError as error:
        raise SolenavError(
            f"{path} is not a readable .mat file: {error}", checks.CHOOSE_FORMAT
        ) from None
    return checks.mat_array(path, content, name, 4)


def _mag(path: Path, time_s: FloatArray) -> FloatArray:
    """Compass in µT at the samples nearest to its readings, NaN at the others."""
    compass = _load(path, "compassBuffer")
    mag = np.full((len(time_s), 3), np.nan)
    if not len(compass):
        return mag
    checks.check_finite(compass, ("time", "mag x", "mag y", "mag z"), checks.row_place(path))
    times = np.linspace(compass[0, 0], compass[-1, 0], len(compass))
    period = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    at = np.rint((times - time_s[0]) / period).astype(np.int64)
    inside = (at >= 0) & (at < len(time_s))
    mag[at[inside]] = compass[inside, 1:] * UT_PER_GAUSS
    return mag
