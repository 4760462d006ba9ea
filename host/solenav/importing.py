"""From a recording in SI units to a capture of MPU-9150 counts."""

from __future__ import annotations

import math
from array import array
from pathlib import Path
from typing import Any

import numpy as np

from solenav import mpu9150, parameters, replay
from solenav.recording import Recording
from solenav_core import messages

ROOM_TEMPERATURE = round(
    (25.0 - mpu9150.TEMPERATURE_OFFSET_DEGC) * mpu9150.TEMPERATURE_LSB_PER_DEGC
)


def parameters_of(recording: Recording, settings: parameters.Settings | None = None) -> array[int]:
    """The core's parameters for a recording: its rate, and its heading at the start if known.

    SolenavError for a rate that the core can't run at.
    """
    settings = settings or parameters.Settings()
    if "initial_heading_rad" in recording.notes:
        heading = math.degrees(recording.notes["initial_heading_rad"])
        settings = parameters.replace(settings, initial_heading_deg=heading)
    return parameters.to_integers(settings, recording.rate_hz)


def to_capture(
    recording: Recording, path: Path, settings: parameters.Settings | None = None
) -> dict[str, Any]:
    """Write a recording as a capture of samples; returns the sidecar's notes.

    The counts are those of an MPU-9150 at ±16 g and ±2000 °/s: clipped at full scale, each such
    sample flagged and counted. The recording's own heading at the start, where it has one,
    becomes a parameter. SolenavError for a rate that the core can't run at.
    """
    params = parameters_of(recording, settings)
    counted = mpu9150.to_counts(recording.accel, recording.gyro)
    full = (counted.counts == -32768) | (counted.counts == 32767)
    flags = full[:, :3].any(axis=1) * messages.CLIPPED_ACC
    flags = flags + full[:, 3:].any(axis=1) * messages.CLIPPED_GYRO
    samples = replay.Samples(
        np.rint(recording.time_s * 1e6).astype(np.int64),
        counted.counts,
        np.full(len(counted.counts), ROOM_TEMPERATURE, np.int16),
        flags.astype(np.uint8),
        np.zeros((len(counted.counts), 3), np.int16),
        np.zeros(len(counted.counts), np.uint8),
    )
    notes = {
        "name": recording.name,
        "source": recording.source,
        "rate_hz": recording.rate_hz,
        "samples": len(counted.counts),
        "clipped_accel": counted.clipped_accel,
        "clipped_gyro": counted.clipped_gyro,
        "notes": recording.notes,
    }
    text = f"host; {recording.source}"
    replay.write_samples(path, samples, params, text=text, notes=notes, truth=recording.truth)
    return notes
