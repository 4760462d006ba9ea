"""Every filter over every recording, condition and seed: here, in processes, or on a cluster.

The unit of work is a recording in one condition with one seed, all filters, so that they share the
spoilt decisions. Results come in the order of the arguments, wherever they were made.
"""

from __future__ import annotations

import logging
import os
import statistics
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from itertools import combinations
from multiprocessing import get_context
from typing import Any

from solenav.comparison.faults import spoil
from solenav.comparison.metrics import Score, score
from solenav.errors import SolenavError
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
_CONNECT_S = 10


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
        with _client(dask) as client:
            return _on_cluster(client, work, progress)
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
        with _local_client(jobs) as client:
            return _on_cluster(client, work, progress)
    return _in_processes(work, jobs, progress)


def _in_processes(work: list[tuple[Walk, Task]], jobs: int, progress: Done) -> Results:
    results = {}
    # Spawned: a fork of a process with threads may hang.
    with ProcessPoolExecutor(min(jobs, len(work)), mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(run, walk, task): i for i, (walk, task) in enumerate(work)}
        try:
            for done, future in enumerate(as_completed(futures), 1):
                results[futures[future]] = future.result()
                progress(done)
        except BrokenProcessPool:
            raise SolenavError(
                "a process of the comparison died", "give it less to do at once: --jobs 1"
            ) from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def _on_cluster(client: Any, work: list[tuple[Walk, Task]], progress: Done) -> Results:
    """The work on the workers of a Dask client; each walk travels once."""
    distributed = _distributed()
    results = {}
    sent: dict[int, Any] = {}
    futures = {}
    for i, (walk, task) in enumerate(work):
        if id(walk) not in sent:
            sent[id(walk)] = client.scatter(walk, hash=False)
        futures[client.submit(run, sent[id(walk)], task, pure=False)] = i
    try:
        with client.as_current():
            for done, future in enumerate(distributed.as_completed(futures), 1):
                results[futures[future]] = future.result()
                progress(done)
    except SolenavError:
        raise
    except Exception as error:
        raise SolenavError(
            f"the cluster failed: {type(error).__name__}: {error}",
            "install this solenav[fast,evaluate,cluster] on its workers, and look at their logs",
        ) from None
    finally:
        client.cancel(list(futures))
    return results


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """A client of the cluster at an address that has a worker."""
    distributed = _distributed()
    remedy = "start one with `dask scheduler` and `dask worker`, and give tcp://HOST:PORT"
    try:
        # A client of what is no address leaves a thread behind, so that is looked at before.
        import_module("distributed.comm").resolve_address(address)
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SolenavError(f"no Dask scheduler at {address}: {error}", remedy) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError:
            raise SolenavError(f"the Dask cluster at {address} has no workers", remedy) from None
        yield client


@contextmanager
def _local_client(jobs: int) -> Iterator[Any]:
    """A client of a cluster on this machine alone, for this comparison."""
    distributed = _distributed()
    # It reports its own shutdown as a loss of workers.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with (
        distributed.LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError:
        raise SolenavError(
            "a Dask cluster needs distributed", "pip install 'solenav[cluster]'"
        ) from None
