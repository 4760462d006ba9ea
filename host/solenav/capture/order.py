"""What the order of the frames says of a frame that its CRC lets through.

One in 65536 damaged frames has a CRC that fits by accident, and a link or an editor may repeat
frames. Ticks, time stamps and positions go on steadily; a single frame that doesn't, between two
that agree with each other, is no message of the board. A restart, where all that follows is
different, is left alone, and so is the last frame of all: nothing speaks against it.

`solenav.verification` compares whatever has a tick; only what is drawn or measured leaves out
positions.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Frames further apart than this are another run's, though they be equal.
_REPEATED_WITHIN = 256
# Neighbours this far apart (5 min at 200 Hz) say nothing of what is between them.
_TICKS_MAX = 1 << 16
_TIME_MAX_US = 60_000_000
# No foot leaves and comes back further than this from one pose to the next: at once, and a tick.
POSITION_M = (0.5, 0.1)
VELOCITY_MPS = (2.0, 1.0)


def misplaced(
    rows: NDArray[Any], tick: NDArray[np.int64], order: NDArray[np.int64]
) -> dict[str, NDArray[np.bool_]]:
    """Rows of a message type to be left out, (n,), by reason: repeated, or with a tick astray."""
    repeated, astray = np.zeros(len(tick), bool), np.zeros(len(tick), bool)
    # Whatever is wrong with ticks, one of them doesn't rise.
    if not (np.diff(tick) < 1).any():
        return {"repeated": repeated, "tick out of order": astray}
    ticks, orders = tick.tolist(), order.tolist()
    seen: dict[int, int] = {}
    last = -1
    for row, now in enumerate(ticks):
        before = seen.get(now)
        if (
            before is not None
            and orders[row] - orders[before] < _REPEATED_WITHIN
            and rows[row].tobytes() == rows[before].tobytes()
        ):
            repeated[row] = True
            continue
        if last >= 0 and row + 1 < len(ticks):
            a, c = ticks[last], ticks[row + 1]
            if a <= c <= a + _TICKS_MAX and not a <= now <= c:
                astray[row] = True
                continue
        seen[now] = last = row
    return {"repeated": repeated, "tick out of order": astray}


def untimely(time_us: NDArray[Any]) -> NDArray[np.bool_]:
    """Samples (n,) whose stamp is outside those of its neighbours, which are close together."""
    out = np.zeros(len(time_us), bool)
    if len(time_us) > 2:
        stamps = time_us.astype(np.int64)
        across = (stamps[2:] - stamps[:-2]) % 2**32
        out[1:-1] = (across <= _TIME_MAX_US) & ((stamps[1:-1] - stamps[:-2]) % 2**32 > across)
    return out


def leaping(
    values: NDArray[np.float64], tick: NDArray[np.int64], reach: tuple[float, float]
) -> NDArray[np.bool_]:
    """Poses (n,) whose `values` (n, 3) are out of reach of both neighbours', which are near."""
    out = np.zeros(len(tick), bool)
    if len(tick) > 2:
        at_once, a_tick = reach
        step = np.linalg.norm(np.diff(values, axis=0), axis=1)
        far = step > at_once + a_tick * np.abs(np.diff(tick))
        across = np.linalg.norm(values[2:] - values[:-2], axis=1)
        near = across <= at_once + a_tick * np.abs(tick[2:] - tick[:-2])
        out[1:-1] = far[:-1] & far[1:] & near
    return out


def counted(found: dict[str, NDArray[np.bool_]]) -> Counter[str]:
    """How many rows each reason leaves out."""
    return Counter({reason: int(rows.sum()) for reason, rows in found.items() if rows.any()})
