"""From a recording in SI units to a capture of MPU-9150 counts."""

from __future__ import annotations

import math
from array import array
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import mpu9150, parameters, replaying
from solenav.recording import FloatArray, Recording
from solenav_core import messages

ROOM_TEMPERATURE = round(
    (25.0 - mpu9150.TEMPERATURE_OFFSET_DEGC) * mpu9150.TEMPERATURE_LSB_PER_DEGC
)

MAG_PERIOD_S = 0.009
"""An AK8975's single measurement takes so long at most (its data sheet); then it is read."""


def parameters_of(recording: Recording, settings: parameters.Settings | None = None) -> array[int]:
    """The core's parameters for a recording: its rate, and its heading at the start if known.

    SolenavError for a rate that the core can't run at.
    """
    settings = settings or parameters.Settings()
    if "initial_heading_rad" in recording.notes:
        heading = math.degrees(recording.notes["initial_heading_rad"])
        settings = parameters.replace(settings, initial_heading_deg=heading)
    return parameters.to_integers(settings, recording.rate_hz)


def samples_of(recording: Recording) -> tuple[replaying.Samples, mpu9150.Counts]:
    """A recording as an MPU-9150 would have given it, and its counts with what was clipped.

    Samples at full scale are flagged. The magnetometer is read as the board reads an AK8975:
    the first sample at or after the end of a measurement takes its reading and starts the next,
    so that at 200 Hz every second sample is flagged MAG_NEW. Where the reading overflows, the
    flag is MAG_BAD and the last sound one stays.
    """
    counted = mpu9150.to_counts(recording.accel, recording.gyro)
    full = (counted.counts == mpu9150.COUNT_MIN) | (counted.counts == mpu9150.COUNT_MAX)
    flags = full[:, :3].any(axis=1) * messages.CLIPPED_ACC
    flags = flags + full[:, 3:].any(axis=1) * messages.CLIPPED_GYRO
    count = len(recording.time_s)
    mag = np.zeros((count, 3), np.int16)
    if recording.mag is not None:
        mag, mag_flags = _readings(recording.time_s, recording.mag)
        flags = flags + mag_flags
    samples = replaying.Samples(
        np.rint(recording.time_s * 1e6).astype(np.int64),
        counted.counts,
        np.full(count, ROOM_TEMPERATURE, np.int16),
        flags.astype(np.uint8),
        mag,
        np.zeros(count, np.uint8),
    )
    return samples, counted


def _readings(time_s: FloatArray, field: FloatArray) -> tuple[NDArray[np.int16], NDArray[np.int64]]:
    """The magnetometer's words (n, 3) and flags (n,) of a field (n, 3) in µT, NaN for none."""
    counts, overflow = mpu9150.mag_to_counts(field)
    known = np.flatnonzero(~np.isnan(field).any(axis=1))
    # A nanosecond of slack: recorded times are sums of periods.
    following = np.searchsorted(time_s[known], time_s[known] + MAG_PERIOD_S - 1e-9)
    flags = np.zeros(len(time_s), np.int64)
    at = 0
    while at < len(known):
        flags[known[at]] = messages.MAG_BAD if overflow[known[at]] else messages.MAG_NEW
        at = int(following[at])
    last = np.maximum.accumulate(np.where(flags == messages.MAG_NEW, np.arange(len(flags)), -1))
    words = np.where(last[:, np.newaxis] >= 0, counts[last], 0).astype(np.int16)
    return words, flags


def to_capture(
    recording: Recording, path: Path, settings: parameters.Settings | None = None
) -> dict[str, Any]:
    """Write a recording as a capture of samples; returns the sidecar's notes.

    The counts are those of an MPU-9150 at ±16 g and ±2000 °/s: clipped at full scale, each such
    sample flagged and counted; those of its magnetometer where the recording has one. The
    recording's own heading at the start, where it has one, becomes a parameter. SolenavError for
    a rate that the core can't run at.
    """
    params = parameters_of(recording, settings)
    samples, counted = samples_of(recording)
    notes = {
        "name": recording.name,
        "source": recording.source,
        "rate_hz": recording.rate_hz,
        "samples": len(counted.counts),
        "clipped_accel": counted.clipped_accel,
        "clipped_gyro": counted.clipped_gyro,
        "mag_readings": int(((samples.flags & messages.MAG_NEW) != 0).sum()),
        "mag_overflows": int(((samples.flags & messages.MAG_BAD) != 0).sum()),
        "notes": recording.notes,
    }
    text = f"host; {recording.source}"
    replaying.write_samples(
        path,
        samples,
        params,
        text=text,
        notes=notes,
        truth=recording.truth,
        modes=recording.modes,
    )
    return notes
