"""MPU-9150 counts at ±16 g and ±2000 °/s and AK8975 counts, to and from SI units.

Scales are those of the MPU-9150 product specification, temperature that of its register map
(4.19; the offset differs from the MPU-6050's 36.53), magnetic field that of the AK8975's data
sheet (MS1187, table 8.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.recording import FloatArray

STANDARD_GRAVITY = 9.80665  # m/s²

ACCEL_LSB_PER_G = 2048.0
GYRO_LSB_PER_DPS = 16.4
ACCEL_MPS2_PER_LSB = STANDARD_GRAVITY / ACCEL_LSB_PER_G
GYRO_RADPS_PER_LSB = float(np.deg2rad(1.0 / GYRO_LSB_PER_DPS))

TEMPERATURE_LSB_PER_DEGC = 340.0
TEMPERATURE_OFFSET_DEGC = 35.0

COUNT_MIN, COUNT_MAX = -32768, 32767

UT_PER_GAUSS = 100.0
MAG_UT_PER_LSB = 0.3
MAG_COUNT_MIN, MAG_COUNT_MAX = -4096, 4095  # 13 bits, 1229 µT


@dataclass
class Counts:
    """What the sensor's registers would hold.

    `counts` (n, 6) in the order ax ay az gx gy gz; `clipped` (n,) is True where any axis went
    past full scale; `clipped_accel` and `clipped_gyro` say in how many samples that was so.
    """

    counts: NDArray[np.int16]
    clipped: NDArray[np.bool_]
    clipped_accel: int
    clipped_gyro: int


def to_counts(accel: FloatArray, gyro: FloatArray) -> Counts:
    """Round to the nearest count and clip at full scale, as the sensor does.

    `accel` (n, 3) in m/s², `gyro` (n, 3) in rad/s, both finite; axes are kept.
    """
    exact = np.rint(np.hstack([accel / ACCEL_MPS2_PER_LSB, gyro / GYRO_RADPS_PER_LSB]))
    outside: NDArray[np.bool_] = (exact < COUNT_MIN) | (exact > COUNT_MAX)
    return Counts(
        counts=np.clip(exact, COUNT_MIN, COUNT_MAX).astype(np.int16),
        clipped=np.asarray(outside.any(axis=1)),
        clipped_accel=int(outside[:, :3].any(axis=1).sum()),
        clipped_gyro=int(outside[:, 3:].any(axis=1).sum()),
    )


def from_counts(counts: NDArray[np.int16]) -> tuple[FloatArray, FloatArray]:
    """Specific force (n, 3) in m/s² and rate (n, 3) in rad/s of `counts` (n, 6 or more)."""
    values = counts.astype(np.float64)
    return values[:, :3] * ACCEL_MPS2_PER_LSB, values[:, 3:6] * GYRO_RADPS_PER_LSB


def celsius(counts: Any) -> Any:
    """Die temperature in °C from counts as SAMPLE and STATUS carry them."""
    return counts / TEMPERATURE_LSB_PER_DEGC + TEMPERATURE_OFFSET_DEGC


def mag_to_counts(field: FloatArray) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """AK8975 counts (n, 3) of a field (n, 3) in µT, and True (n,) where a reading overflowed.

    Axes are kept; an axis past full scale is clipped. A reading with a NaN has counts of 0 and
    is no overflow.
    """
    exact = np.rint(np.nan_to_num(field, nan=0.0) / MAG_UT_PER_LSB)
    exact[np.isnan(field).any(axis=1)] = 0.0
    overflow: NDArray[np.bool_] = (exact < MAG_COUNT_MIN) | (exact > MAG_COUNT_MAX)
    counts = np.clip(exact, MAG_COUNT_MIN, MAG_COUNT_MAX).astype(np.int16)
    return counts, np.asarray(overflow.any(axis=1))


def mag_from_counts(counts: NDArray[np.int16]) -> FloatArray:
    """Field (n, 3) in µT of AK8975 `counts` (n, 3)."""
    return counts.astype(np.float64) * MAG_UT_PER_LSB
