"""The GLRT (SHOE) zero-velocity statistic in floats: the reference of the core's.

Skog, Haendel, Nilsson, Rantakokko 2010, "Zero-velocity detection: an algorithm evaluation", IEEE
Trans. Biomed. Eng. 57(11), equation 13.
"""

from __future__ import annotations

import numpy as np

from solenav.recording import FloatArray


def statistic(
    accel: FloatArray,
    gyro: FloatArray,
    *,
    window: int,
    gravity: float,
    sigma_accel: float,
    sigma_rate: float,
) -> FloatArray:
    """T (n,) over the `window` samples up to and with each; infinite before there are as many.

    `accel` (n, 3) specific force in m/s², `gyro` (n, 3) rate less its bias, in the unit of
    `sigma_rate`; `gravity` and `sigma_accel` in m/s². With m the window's mean force,
    T = mean(|a - g m/|m||² / sigma_accel² + |w|² / sigma_rate²): as far from a foot at rest, with
    gravity from wherever it seems to come, as noise of these sigmas makes in T samples.
    """
    out = np.full(len(accel), np.inf)
    if len(accel) < window:
        return out
    force = np.lib.stride_tricks.sliding_window_view(accel, window, axis=0)  # (k, 3, window)
    turn = np.lib.stride_tricks.sliding_window_view((gyro**2).sum(1), window)
    mean = force.mean(2)
    length = np.linalg.norm(mean, axis=1)
    # Without a mean force every direction is as good: one of them.
    down = np.divide(
        mean, length[:, None], where=length[:, None] > 0, out=np.eye(1, 3).repeat(len(mean), 0)
    )
    off = ((force - gravity * down[:, :, None]) ** 2).sum(1).mean(1)
    out[window - 1 :] = off / sigma_accel**2 + turn.mean(1) / sigma_rate**2
    return out
