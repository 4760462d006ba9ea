"""Writing feed files: recordings as the simulated board's sensor will measure them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# As `solenav.sim.board.feed` describes it: the order of the sensor's registers.
RECORD = np.dtype(
    [
        ("time", "<u4"),
        ("acc", "<i2", 3),
        ("temperature", "<i2"),
        ("gyro", "<i2", 3),
        ("mag", "<i2", 3),
    ]
)
NO_FIELD = -32768


def write_feed(
    path: Path,
    time_us: NDArray[np.int64],
    counts: NDArray[np.int16],
    temperature: NDArray[np.int16],
    mag: NDArray[np.int16] | None = None,
) -> None:
    """Write samples for the simulated board.

    `time_us` (n,) in µs from the moment when the firmware starts to sample, not negative,
    strictly increasing, with steps below 2**32; `counts` (n, 6) ax ay az gx gy gz at ±16 g and
    ±2000 °/s; `temperature` (n,) as in the register: 340 counts a °C, 0 at 35 °C; `mag` (n, 3)
    the field in the accelerometer's axes, 0.3 µT counts, NO_FIELD in rows where it isn't known
    (without it, in all). ValueError where shapes or times are otherwise.
    """
    n = len(time_us)
    if mag is None:
        mag = np.full((n, 3), NO_FIELD, np.int16)
    shapes = time_us.shape, counts.shape, temperature.shape, mag.shape
    if shapes != ((n,), (n, 6), (n,), (n, 3)):
        raise ValueError(f"shapes {shapes} where (n,), (n, 6), (n,), (n, 3) were expected")
    steps = np.diff(time_us, prepend=-1)
    if n and (steps.min() < 1 or steps.max() > 2**32 - 1):
        raise ValueError("times must increase from 0 or more, in steps below 2**32 µs")
    records = np.empty(n, RECORD)
    records["time"] = time_us & 0xFFFFFFFF
    records["acc"] = counts[:, :3]
    records["temperature"] = temperature
    records["gyro"] = counts[:, 3:]
    records["mag"] = mag
    path.write_bytes(records.tobytes())
