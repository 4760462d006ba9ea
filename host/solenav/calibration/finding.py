"""A sensor's calibration from a capture: which procedure, and what is kept of it."""

from __future__ import annotations

import time

from solenav.calibration import accelerometer, gyro, magnetometer
from solenav.calibration.model import IDENTITY, Calibration
from solenav.calibration.still import from_capture
from solenav.capture import Capture
from solenav.errors import SolenavError

SENSORS = ("accelerometer", "gyro", "magnetometer")
Found = accelerometer.Found | gyro.Found | magnetometer.Found


def calibrate(sensor: str, run: Capture, before: Calibration = IDENTITY) -> Calibration:
    """`before` with what a capture tells of a sensor: `SENSORS`.

    Accelerometer: rests with each of the six faces up. Gyro: a rest; turns between rests give scale
    and axes too. Magnetometer: a tumble through all attitudes. SolenavError where that isn't in it.
    """
    if sensor not in SENSORS:
        raise SolenavError(f"there is no sensor {sensor}", f"choose {', '.join(SENSORS)}")
    recording = from_capture(run)
    found: Found
    if sensor == "accelerometer":
        found = accelerometer.calibrate(recording)
    elif sensor == "gyro":
        found = gyro.calibrate(recording, before)
    else:
        found = magnetometer.calibrate(recording, before)
    return kept(sensor, found, before, run.path.name)


def kept(sensor: str, found: Found, before: Calibration, source: str) -> Calibration:
    """`before` with what was found, and from what: `source`, a capture's or port's name."""
    made_from = {"source": source, "made": time.strftime("%Y-%m-%d"), **found.report()}
    return before.merged(sensor, found.matrix.tolist(), found.bias.tolist(), made_from)
