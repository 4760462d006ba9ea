"""The still-time update of the gyro bias: what helps the core helps every rival.

Where the foot hasn't turned for a while, the rate is the bias (docs/algorithm.md, step 5).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from solenav import mpu9150
from solenav.filters.walk import Walk
from solenav.parameters import named
from solenav.recording import FloatArray


class Still(NamedTuple):
    """`rate` rad/s, below it for more than `ticks` the share `gain` of the rate is bias."""

    rate: float
    ticks: int
    gain: float


def of_walk(walk: Walk, used: bool) -> Still:
    """The core's own parameters; a gain of 0 where the update is not `used`."""
    p = named(walk.params)
    return Still(
        rate=p["STILL_RATE"] / 4 * mpu9150.GYRO_RADPS_PER_LSB,
        ticks=p["STILL_TICKS"],
        gain=p["STILL_GAIN"] / 2**22 if used else 0.0,
    )


@njit(cache=True)
def count(rate: FloatArray, still: Still, ticks: int) -> int:
    """Ticks of unbroken stillness, this one (`rate`, free of bias) included."""
    return ticks + 1 if math.sqrt((rate * rate).sum()) < still.rate else 0


@njit(cache=True)
def learn(rate: FloatArray, still: Still, ticks: int, bias: FloatArray) -> None:
    """Take the rate, free of bias, of a stance tick into the bias, in place."""
    if ticks > still.ticks:
        bias += rate * still.gain
