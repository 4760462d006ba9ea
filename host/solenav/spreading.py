"""Work in many processes, or on a Dask cluster: the same function over many arguments."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from typing import Any, TypeVar

from solenav.errors import SolenavError

Result = TypeVar("Result")
Work = Sequence[tuple[Any, ...]]
Done = Callable[[int], None]
_CONNECT_S = 10


def in_processes(
    function: Callable[..., Result], work: Work, jobs: int, progress: Done
) -> dict[int, Result]:
    """`function` of each tuple of arguments, by its place, in `jobs` processes.

    SolenavError where a process dies; what the function raises is raised.
    """
    results: dict[int, Result] = {}
    # Spawned: a fork of a process with threads may hang.
    with ProcessPoolExecutor(min(jobs, len(work)), mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(function, *arguments): i for i, arguments in enumerate(work)}
        try:
            for done, future in enumerate(as_completed(futures), 1):
                results[futures[future]] = future.result()
                progress(done)
        except BrokenProcessPool:
            raise SolenavError("a process died", "give it less to do at once: --jobs 1") from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def on_cluster(
    client: Any, function: Callable[..., Result], work: Work, progress: Done
) -> dict[int, Result]:
    """The same on the workers of a Dask client; each first argument travels once."""
    distributed = _distributed()
    results: dict[int, Result] = {}
    sent: dict[int, Any] = {}
    futures = {}
    for i, (first, *others) in enumerate(work):
        if id(first) not in sent:
            sent[id(first)] = client.scatter(first, hash=False)
        futures[client.submit(function, sent[id(first)], *others, pure=False)] = i
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
def client(address: str) -> Iterator[Any]:
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
def local_client(jobs: int) -> Iterator[Any]:
    """A client of a cluster on this machine alone, for this work."""
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
