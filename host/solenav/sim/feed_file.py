"""Writing feed files: recordings as the simulated board's sensor will measure them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# As `solenav.sim.board.feed` describes it: the order of the sensor's registers.
RECORD = np.dtype([("time", "<u4"), ("acc", "<i2", 3), ("temperature", "<i2"), ("gyro", "<i2", 3)])


def write_feed(
    path: Path,
    time_us: NDArray[np.int64],
    counts: NDArray[np.int16],
    temperature: NDArray[np.int16],
) -> None:
    """Write samples for the simulated board.

    `time_us` (n,) in µs from the moment when the firmware starts to sample, not negative,
    strictly increasing, with steps below 2**32; `counts` (n, 6) ax ay az gx gy gz at ±16 g and
    ±2000 °/s; `temperature` (n,) as in the register: 340 counts a °C, 0 at 35 °C. ValueError
    where shapes or times are otherwise.
    """
    n = len(time_us)
    if time_us.shape != (n,) or counts.shape != (n, 6) or temperature.shape != (n,):
        raise ValueError(
            f"shapes {time_us.shape}, {counts.shape}, {temperature.shape} "
            "where (n,), (n, 6), (n,) were expected"
        )
    steps = np.diff(time_us, prepend=-1)
    if n and (steps.min() < 1 or steps.max() > 2**32 - 1):
        raise ValueError("times must increase from 0 or more, in steps below 2**32 µs")
    records = np.empty(n, RECORD)
    records["time"] = time_us & 0xFFFFFFFF
    records["acc"] = counts[:, :3]
    records["temperature"] = temperature
    records["gyro"] = counts[:, 3:]
    path.write_bytes(records.tobytes())
