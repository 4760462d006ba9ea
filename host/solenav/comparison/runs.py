"""Every filter over every recording, condition and seed: here, in processes, or on a cluster.

The unit of work is a recording in one condition with one seed, all filters, so that they share the
spoilt decisions. Results come in the order of the arguments, wherever they were made.
"""

from __future__ import annotations

import os
import statistics
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import combinations

from solenav import spreading
from solenav.comparison.faults import spoil
from solenav.comparison.metrics import Score, score
from solenav.filters import FILTERS, named
from solenav.filters.walk import Walk
from solenav_core import params

REFERENCE = "reset"
"""What the others' time per tick is a ratio to."""
DEFAULT = (
    "reset",
    "ekf",
    "ekf+still+gate",
    "ekf15",
    "pf",
    "apf-literal",
    "kf-twin",
    "apf-float",
    "apf",
)
"""The filters of a comparison where none is named."""
MANY = 100
"""From so much work on a local Dask cluster is used, where it is installed."""

# Samples times filters that take about as long as a process to start.
_ROWS_A_PROCESS = 1_000_000
_TIMED_ROWS = 3000
_REPEATS = 3
_SEED = params.NAMES.index("SEED")


@dataclass(frozen=True)
class Condition:
    """What is done to the stance decisions, as `faults.spoil` understands it."""

    false_share: float = 0.0
    missed_share: float = 0.0


CLEAN = Condition()


@dataclass(frozen=True)
class Run:
    """One filter over one recording. `time_ratio` is its time per tick over `REFERENCE`'s.

    Times are taken of the first seed in the first condition only, else None.
    """

    recording: str
    filter: str
    condition: Condition
    seed: int
    score: Score
    time_ratio: float | None = None


@dataclass(frozen=True)
class Task:
    """What is to be done with a walk. `with_evo` as in `metrics.score`."""

    filters: tuple[str, ...]
    condition: Condition
    seed: int
    with_evo: bool
    timed: bool


Done = Callable[[int], None]
Results = dict[int, list[Run]]


def compare(
    walks: Sequence[Walk],
    filters: Sequence[str],
    conditions: Sequence[Condition] = (CLEAN,),
    seeds: Sequence[int] = (1,),
    *,
    jobs: int | None = None,
    dask: str | None = None,
    with_evo: bool = True,
    timed: bool = True,
    progress: Done = lambda done: None,
) -> list[Run]:
    """Run `filters` (names of `solenav.filters`) over all walks, conditions and seeds.

    A seed spoils the decisions, and counts on the core's own seed (1 leaves it as it is). `jobs`
    processes at a time, None for as many as pay, at most one a core; or the cluster whose
    scheduler listens at `dask`. `progress` gets how many of `amount(...)` pieces of work are done.

    Raises SolenavError for an unknown filter and for a cluster that can't be reached or used.
    """
    for name in filters:
        named(name)
    work = [
        (
            walk,
            Task(
                tuple(filters),
                condition,
                seed,
                with_evo,
                timed and condition == conditions[0] and seed == seeds[0],
            ),
        )
        for walk in walks
        for condition in conditions
        for seed in seeds
    ]
    results = _spread(work, jobs or _worthwhile(work), dask, progress)
    return [run for i in range(len(work)) for run in results[i]]


def every() -> list[str]:
    """Every filter, with and without each aid that it takes."""
    return [
        "+".join([one.name, *aids])
        for one in FILTERS.values()
        for count in range(len(one.aids) + 1)
        for aids in combinations(one.aids, count)
    ]


def amount(walks: int, conditions: int, seeds: int) -> int:
    """Pieces of work in a comparison."""
    return walks * conditions * seeds


def run(walk: Walk, task: Task) -> list[Run]:
    """One piece of work."""
    ratios = cost(walk, task.filters) if task.timed else {}
    condition = task.condition
    spoilt = spoil(
        reseeded(walk, task.seed), task.seed, condition.false_share, condition.missed_share
    )
    return [
        Run(
            walk.name,
            name,
            condition,
            task.seed,
            score(spoilt, named(name)(spoilt), with_evo=task.with_evo),
            ratios.get(name),
        )
        for name in task.filters
    ]


def reseeded(walk: Walk, seed: int) -> Walk:
    """The walk with the core's seed `seed` - 1 further on."""
    values = walk.params.tolist()
    values[_SEED] += seed - 1
    return replace(walk, params=array("i", values))


def cost(walk: Walk, filters: Sequence[str]) -> dict[str, float]:
    """Each filter's time per tick as a ratio to `REFERENCE`'s, median of repeats.

    Over the walk's beginning, in turns, so that what else the machine does meets all alike.
    """
    short = beginning(walk, walk.start.row + 1 + _TIMED_ROWS)
    names = list(dict.fromkeys([REFERENCE, *filters]))
    took: dict[str, list[float]] = {name: [] for name in names}
    # The first time loads the compiled code.
    for repeat in range(_REPEATS + 1):
        for name in names:
            start = time.perf_counter()
            named(name)(short)
            if repeat:
                took[name].append(time.perf_counter() - start)
    middle = {name: statistics.median(times) for name, times in took.items()}
    return {name: middle[name] / middle[REFERENCE] for name in filters}


def beginning(walk: Walk, rows: int) -> Walk:
    """The first samples of a walk, without truth."""
    return replace(
        walk,
        counts=walk.counts[:rows],
        accel=walk.accel[:rows],
        gyro=walk.gyro[:rows],
        stance=walk.stance[:rows],
        clean=walk.clean[:rows],
        truth=None,
    )


def _worthwhile(work: list[tuple[Walk, Task]]) -> int:
    """So many processes that starting them pays."""
    rows = sum(len(walk.counts) * len(task.filters) for walk, task in work)
    return max(1, min(os.cpu_count() or 1, rows // _ROWS_A_PROCESS))


def _spread(work: list[tuple[Walk, Task]], jobs: int, dask: str | None, progress: Done) -> Results:
    if dask is not None:
        with spreading.client(dask) as client:
            return spreading.on_cluster(client, run, work, progress)
    if jobs == 1 or len(work) == 1:
        results = {}
        for i, (walk, task) in enumerate(work):
            results[i] = run(walk, task)
            progress(i + 1)
        return results
    # Compiled once and kept, not by each process.
    walk, task = work[0]
    for name in task.filters:
        named(name)(beginning(walk, walk.start.row + 2))
    if len(work) >= MANY and find_spec("distributed"):
        with spreading.local_client(jobs) as client:
            return spreading.on_cluster(client, run, work, progress)
    return spreading.in_processes(run, work, jobs, progress)
