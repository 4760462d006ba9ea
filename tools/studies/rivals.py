"""Tunes the rival filters: `python tools/studies/rivals.py DATA [FILTER ...]`.

DATA is a folder with the public recordings (see recordings.py); a rival gets one parameter set for
all of them, on a strict detector's clean stances (`solenav.comparison.strict`), with the still-time
bias update. It prints a Markdown table per rival; what wins stands as the default in
`host/solenav/filters/`.

The objective is the geometric mean over the recordings of the horizontal error
(`solenav.comparison.metrics`), each held between 0.1 % of the distance (a closure of 0 is luck) and
the whole distance (lost is lost). The search goes along one parameter at a time, up and down by a
factor, as long as that helps by 0.1 %; the factor is the root of 10, then its root, then the root
of that. Random filters run with seeds 1 to 3. A gate can only lose on clean stances, so it is the
narrowest of a row, three a decade, that costs less than 10 %: one running walk of the lot may get
lost, for a gate that lets a running foot's stances pass stops nothing. Minutes on two cores.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from recordings import FLOOR_SHARE, walks

from solenav.comparison.metrics import score
from solenav.comparison.strict import strictly
from solenav.errors import SolenavError
from solenav.filters import ekf, particle, reset
from solenav.filters.walk import Aids, Track, Walk

WORTH = 1e-3
FACTORS = (10**0.5, 10**0.25, 10**0.125)
GATES = 10 ** (np.arange(-2, 13) / 3)
GATE_COST = 0.1
SEEDS = (1, 2, 3)

Run = Callable[..., Track]


@dataclass(frozen=True)
class Rival:
    """How a filter runs on a `tuning`, where the search starts and along which parameters.

    Without a gate only the ratios of a Kalman filter's noises count, so one of them isn't searched.
    """

    run: Run
    start: Any
    keys: tuple[str, ...]
    random: bool = False


_EKF = ("zupt", "gyro_noise", "start_tilt", "start_heading", "start_velocity")
_EKF_START = ekf.Tuning(
    accel_noise=0.2,
    gyro_noise=math.radians(0.3),
    zupt=0.1,
    start_velocity=0.01,
    start_tilt=math.radians(0.5),
    start_heading=math.radians(0.1),
    accel_bias=0.05,
    gyro_bias=math.radians(0.05),
    accel_bias_walk=1e-4,
    gyro_bias_walk=math.radians(1e-3),
)
RIVALS = {
    "reset": Rival(reset.reset, reset.Tuning(), ()),
    "ekf": Rival(partial(ekf.run, states=9), _EKF_START, _EKF),
    "ekf15": Rival(
        partial(ekf.run, states=15),
        _EKF_START,
        (*_EKF, "accel_bias", "gyro_bias", "accel_bias_walk", "gyro_bias_walk"),
    ),
    "pf": Rival(
        particle.bootstrap,
        particle.Tuning(accel_noise=0.3, zupt=0.1, start_velocity=0.01),
        ("accel_noise", "zupt", "start_velocity"),
        random=True,
    ),
}

_walks: list[Walk] = []


def _load(data: Path) -> None:
    _walks.extend(map(strictly, walks(data)))


def _error(run: Run, tuning: Any, gated: bool, row: int) -> float:
    """The error in m of the recording `row`, within its bounds; mean logarithm over seeds."""
    walk = _walks[row]
    track = run(walk, Aids(still=True, gate=gated), tuning=tuning)
    error = score(walk, track, with_evo=False).error_m
    if error is None:
        raise ValueError(f"{walk.name} has no truth")
    return min(max(error, FLOOR_SHARE * walk.distance_m), walk.distance_m)


class Bench:
    """Runs a rival over every recording, on two processes."""

    def __init__(self, data: Path) -> None:
        _load(data)
        self.pool = ProcessPoolExecutor(2, initializer=_load, initargs=(data,))

    def cost(self, rival: Rival, tuning: Any, gated: bool = False) -> float:
        """Geometric mean over recordings and seeds, m."""
        tunings = [replace(tuning, seed=seed) for seed in SEEDS] if rival.random else [tuning]
        jobs = [
            self.pool.submit(_error, rival.run, one, gated, row)
            for row in range(len(_walks))
            for one in tunings
        ]
        return float(np.exp(np.mean([math.log(job.result()) for job in jobs])))

    def tuned(self, rival: Rival) -> Any:
        """The best tuning found; prints every step that helped."""
        best, cost, tried = rival.start, self.cost(rival, rival.start), 1
        print("| factor | tried |", " | ".join(rival.keys), "| error, m |")
        print("|---" * (len(rival.keys) + 3) + "|")
        _say(["start", "1"], best, rival.keys, cost)
        for factor in FACTORS:
            again = True
            while again:
                again = False
                for key in rival.keys:
                    for step in (factor, 1 / factor):
                        while True:
                            new = replace(best, **{key: getattr(best, key) * step})
                            found = self.cost(rival, new)
                            tried += 1
                            if found > cost * (1 - WORTH):
                                break
                            best, cost, again = new, found, True
                            _say([f"{factor:.2f}", str(tried)], best, rival.keys, cost)
        return best

    def gate(self, rival: Rival, tuning: Any) -> float:
        """The narrowest gate that costs little enough; prints the row."""
        free = self.cost(rival, tuning)
        costs = [self.cost(rival, replace(tuning, gate=gate), True) for gate in GATES]
        print("\n| gate |", " | ".join(f"{gate:.3g}" for gate in GATES), "| none |")
        print("|---" * (len(GATES) + 2) + "|")
        print("| error, m |", " | ".join(f"{cost:.4f}" for cost in costs), f"| {free:.4f} |")
        passing = [g for g, cost in zip(GATES, costs, strict=True) if cost < free * (1 + GATE_COST)]
        return float(passing[0]) if passing else math.inf


def _say(head: Sequence[str], tuning: Any, keys: Sequence[str], cost: float) -> None:
    values = [f"{getattr(tuning, key):.3g}" for key in keys]
    print("|", " | ".join([*head, *values, f"{cost:.4f}"]), "|", flush=True)


def main() -> None:
    if len(sys.argv) < 2 or not set(sys.argv[2:]) <= set(RIVALS):
        sys.exit(f"usage: python tools/studies/rivals.py DATA [{' | '.join(RIVALS)} ...]")
    try:
        bench = Bench(Path(sys.argv[1]))
    except SolenavError as error:
        sys.exit(error.message)
    for name in sys.argv[2:] or RIVALS:
        rival = RIVALS[name]
        print(f"\n### {name}\n")
        tuning = bench.tuned(rival)
        gate = bench.gate(rival, tuning)
        print("\nWinner:", replace(tuning, gate=gate), flush=True)


if __name__ == "__main__":
    main()
