"""The core's windows of motion: their features and what the forest made of them, on any engine."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solenav import engines
from solenav_core import features, layout, navigator

_S = layout.offsets(layout.STATE_FIELDS)


def _names() -> tuple[str, ...]:
    signals = (
        ("force x", "force y", "force z", "force", "velocity up"),
        ("rate x", "rate y", "rate z", "rate", "speed"),
    )
    kinds = ("mean", "deviation", "skewness", "largest", "least")
    return tuple(
        name
        for group, vector in zip(signals, ("force", "rate"), strict=True)
        for name in (
            *(f"{signal}: {kind}" for signal in group for kind in kinds),
            *(f"{vector} {pair}: correlation" for pair in ("xy", "yz", "xz")),
        )
    )


NAMES = _names()
"""Of the features, in their order."""


@dataclass(frozen=True)
class Windows:
    """What the core held after each window, a row a window.

    `row` (k,) the sample after which the window was dealt with; `last` (k,) its own last sample;
    `features` (k, 56) as `solenav_core.features` has them; `score` (k, 5) the forest's weights for
    this window alone, `motion` (k,) the motion that holds from then on.
    """

    row: NDArray[np.intp]
    last: NDArray[np.intp]
    features: NDArray[np.int32]
    score: NDArray[np.int32]
    motion: NDArray[np.int32]


def windows(
    counts: NDArray[np.int16],
    params: array[int],
    *,
    engine: str | None = None,
    forest: array[int] | None = None,
) -> Windows:
    """Run the core from nothing over `counts` (n, 6 or 10) and keep its windows.

    A window is of 128 samples, MOTION_STRIDE apart; `forest` replaces the shipped one.
    SolenavError for an unknown engine.
    """
    runner = engines.create(engine or engines.default_name(), params, forest)
    rows, lasts, found, scores, motions = [], [], [], [], []
    row = 0
    while row < len(counts):
        row, events = runner.advance(counts, row, mask=navigator.CLASSIFIED)
        if not events & navigator.CLASSIFIED:
            break
        state = runner.state
        at = _S["SUMS"] + layout.FEATURES * features.slot(state[_S["BLOCK_SLOT"]])
        rows.append(row - 1)
        since = (state[_S["BLOCK_FILL"]] + 1) * state[_S["STRIDE"]] - state[_S["PAUSE"]]
        lasts.append(row - 1 - since)
        found.append(state[at : at + layout.FEATURES])
        scores.append(state[_S["SCORE"] : _S["SCORE"] + layout.CLASSES])
        motions.append(state[_S["MOTION"]])
    return Windows(
        np.array(rows, np.intp),
        np.array(lasts, np.intp),
        np.array(found, np.int32).reshape(-1, layout.FEATURES),
        np.array(scores, np.int32).reshape(-1, layout.CLASSES),
        np.array(motions, np.int32),
    )
