"""Stance decisions spoilt on purpose, as detectors fail: false bursts in swing, missed stances.

That is where filters differ in practice. The same seed spoils a walk in the same way for all.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from solenav.filters.walk import BoolArray, Walk
from solenav.parameters import named

BURST_S = (0.015, 0.05)
"""Shortest and longest false stance, s."""

Stretch = tuple[int, int]
# So often a burst is dropped at random before the places that are left are looked for.
_TRIES = 20


def spoil(walk: Walk, seed: int, false_share: float = 0.0, missed_share: float = 0.0) -> Walk:
    """The walk with spoilt `stance`; `clean` stays as it is.

    `false_share` of the samples in swing are called stance, in bursts of `BURST_S`, each within
    one swing and apart from the others; where the swings hold no more bursts, as many as they do.
    `missed_share` of the whole stances (`stances`) are called swing from end to end.
    ValueError for a share outside 0 to 1.
    """
    for share in (false_share, missed_share):
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a share of {share}")
    # Apart, so that the bursts are the same whether or not stances are missed.
    bursts, missing = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    stance = walk.stance.copy()
    whole = stances(walk)
    for i in missing.choice(len(whole), round(missed_share * len(whole)), replace=False):
        begin, end = whole[i]
        stance[begin:end] = False
    first = walk.start.row + 1
    swing = ~walk.stance
    swing[:first] = False
    stance |= _bursts(swing, round(false_share * int(swing.sum())), walk.rate_hz, bursts)
    return walk.with_stance(stance)


def stances(walk: Walk) -> list[Stretch]:
    """The whole stances of the walk's decisions after the start, as rows (begin, end).

    A whole stance lies between real swings, which are as long as the core's STEP_SWING asks;
    so neither the standing at the start nor that at the end is one. What is shorter than
    STEP_STANCE is flicker, and belongs to the nearer of its neighbours.
    """
    params = named(walk.params)
    first = walk.start.row + 1
    joined: list[Stretch] = []
    for begin, end in _runs(walk.stance[first:]):
        if joined and begin - joined[-1][1] < params["STEP_SWING"]:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((begin, end))
    whole = [run for run in joined if run[1] - run[0] >= params["STEP_STANCE"]]
    for begin, end in joined:
        if whole and end - begin < params["STEP_STANCE"]:
            gaps = [max(b - end, begin - e) for b, e in whole]
            near = gaps.index(min(gaps))
            whole[near] = (min(begin, whole[near][0]), max(end, whole[near][1]))
    last = len(walk.stance) - first
    # The foot stands when navigation begins, or it moves on from that stand at once.
    standing = bool(whole) and whole[0][0] < params["STEP_SWING"]
    return [(first + b, first + e) for b, e in whole[standing:] if e < last]


def _runs(flags: BoolArray) -> list[Stretch]:
    """Where `flags` (n,) are True, as (begin, end)."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _bursts(swing: BoolArray, wanted: int, rate_hz: float, rng: np.random.Generator) -> BoolArray:
    """Samples of `swing` (n,) in bursts at random places, `wanted` of them."""
    shortest = max(1, math.ceil(BURST_S[0] * rate_hz))
    longest = max(shortest, math.floor(BURST_S[1] * rate_hz))
    burst = np.zeros(len(swing), bool)
    # Where a burst may begin or go on: in swing, not in another nor next to one.
    free = swing.copy()
    rows = np.flatnonzero(swing)
    done = 0
    while done < wanted:
        # The last one may not overshoot by more than the shortest asks.
        length = min(int(rng.integers(shortest, longest + 1)), max(wanted - done, shortest))
        begin = _place(free, rows, length, rng)
        if begin < 0:
            begin, length = _place(free, rows, shortest, rng), shortest
        if begin < 0:
            break
        burst[begin : begin + length] = True
        free[max(0, begin - 1) : begin + length + 1] = False
        done += length
    return burst


def _place(free: BoolArray, rows: NDArray[np.intp], length: int, rng: np.random.Generator) -> int:
    """A random row from which `length` samples are `free`; -1 where there is none."""
    for row in rng.choice(rows, _TRIES).tolist():
        if row + length <= len(free) and free[row : row + length].all():
            return int(row)
    if length > len(free):
        return -1
    counts = np.concatenate([[0], np.cumsum(free)])
    fitting = np.flatnonzero(counts[length:] - counts[:-length] == length)
    return int(rng.choice(fitting)) if len(fitting) else -1
