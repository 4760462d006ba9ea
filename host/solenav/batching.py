"""Every capture below a folder: verified and evaluated, in processes or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from solenav import capture, engines, spreading
from solenav.errors import SolenavError
from solenav.evaluation import evaluate
from solenav.verification import verify


@dataclass(frozen=True)
class Row:
    """One capture's outcome. What couldn't be found out is None; `problem` says why."""

    capture: str
    verified: bool | None = None
    proven_share: float | None = None  # of the samples
    difference: str = ""
    duration_s: float | None = None
    steps: int | None = None
    distance_m: float | None = None
    closure_m: float | None = None  # horizontal, where the walk is known to close
    rmse_m: float | None = None  # horizontal, where there is a truth
    damaged: int = 0
    problem: str = ""

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def find(folder: Path) -> list[Path]:
    """All captures below a folder, in the order of their names. SolenavError without any."""
    if not folder.is_dir():
        raise SolenavError(f"there is no folder {folder}", "check the name")
    found = sorted(path for path in folder.rglob("*.solcap") if path.is_file())
    if not found:
        raise SolenavError(
            f"no capture (.solcap) below {folder}", "record, import or download some first"
        )
    return found


def batch(
    captures: list[Path],
    *,
    jobs: int | None = None,
    dask: str | None = None,
    engine: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Row]:
    """A row for each capture, in their order; a bad one is a row with its problem.

    `jobs` processes (one a processor where None), or the Dask cluster at the address `dask`, whose
    workers must see the same paths. SolenavError where these can't be had.
    """
    name = engine or engines.default_name()
    work = [(str(path.resolve() if dask else path), name) for path in captures]
    if dask is not None:
        with spreading.client(dask) as client:
            found = spreading.on_cluster(client, row_of, work, progress)
    elif len(work) == 1 or jobs == 1:
        found = {}
        for i, arguments in enumerate(work):
            found[i] = row_of(*arguments)
            progress(i + 1)
    else:
        # The first one here: what it compiles is kept, and not compiled by each process.
        first = row_of(*work[0])
        progress(1)
        processes = jobs or os.cpu_count() or 1
        rest = spreading.in_processes(row_of, work[1:], processes, lambda done: progress(done + 1))
        found = {0: first, **{i + 1: row for i, row in rest.items()}}
    return [found[i] for i in range(len(work))]


def row_of(path: str, engine: str) -> Row:
    """One capture, verified and evaluated."""
    try:
        source = capture.load(Path(path))
        report = verify(source, engine)
    except SolenavError as error:
        return Row(path, problem=error.message)
    row: dict[str, Any] = {
        "verified": report.verified,
        "proven_share": report.covered_ticks / report.samples if report.samples else None,
        "difference": "" if report.difference is None else str(report.difference),
        "damaged": sum(source.damaged.values()),
    }
    try:
        result = evaluate(source)
    except SolenavError as error:
        return Row(path, **row, problem=error.message)
    row |= {"duration_s": result.duration_s, "steps": result.steps, "distance_m": result.distance_m}
    if result.closure.meaningful:
        row["closure_m"] = result.closure.horizontal_m
    if result.truth is not None:
        row["rmse_m"] = result.truth.position_rmse_m.horizontal
    return Row(path, **row)
