"""Steps in a file: a table (.csv) with a line a step, the truth beside it as beside a capture.

The first line is where and when the first step began; each further one is where and when a step
ended: `x_m`, `y_m`, `z_m` in the axes of the walk, `length_m` in the plane, `heading_deg`
counterclockwise from x, the step's covariance in m² and whose steps they are (`source`).
``steps.csv`` may have ``steps.truth.csv`` and ``steps.json`` (see `capture.sidecar`).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from solenav.capture import sidecar
from solenav.datasets import checks
from solenav.errors import SolenavError, unwritable
from solenav.pdr.track import SOURCES, StepTrack
from solenav.recording import Truth

SUFFIX = ".csv"
_COVARIANCE = {"xx_m2": (0, 0), "xy_m2": (0, 1), "xz_m2": (0, 2)}
_COVARIANCE |= {"yy_m2": (1, 1), "yz_m2": (1, 2), "zz_m2": (2, 2)}
_NUMBERS = ("time_s", "x_m", "y_m", "z_m", "length_m", "heading_deg", *_COVARIANCE)


def table(walk: StepTrack) -> str:
    """The table of a walk, as text."""
    lengths = np.hypot(walk.displacement[:, 0], walk.displacement[:, 1])
    covariance = np.concatenate([np.zeros((1, 3, 3)), walk.covariance])
    columns = [
        walk.position_s,
        *walk.position.T,
        np.r_[0.0, lengths],
        np.degrees(np.r_[walk.heading[:1], walk.heading]) % 360,
        *(covariance[:, i, j] for i, j in _COVARIANCE.values()),
    ]
    lines = [",".join([*_NUMBERS, "source"])]
    lines += [
        ",".join([*(f"{v:.9g}" for v in row), walk.source]) for row in np.column_stack(columns)
    ]
    return "\n".join(lines) + "\n"


def read(path: Path) -> tuple[StepTrack, Truth | None]:
    """The walk in a table of steps, and the truth beside it.

    SolenavError, with the line, for what is missing or broken.
    """
    names, rows = checks.read_csv(path)
    place = checks.line_place(path, 1)
    wanted = checks.find_columns(path, names, (*_NUMBERS, "source"))
    values = checks.to_numbers(rows, len(names), wanted[:-1], place)
    if len(values) < 2:
        raise SolenavError(f"{path} has no steps", "write it with solenav pdr TRACE -o FILE")
    checks.check_finite(values, _NUMBERS, place)
    checks.check_increasing(values[:, 0], place)
    sources = [row[wanted[-1]].strip() for row in rows]
    for k, source in enumerate(sources):
        if source not in SOURCES or source != sources[0]:
            raise SolenavError(
                f"{place(k)}: the source is {source!r}",
                f"it is one of {', '.join(SOURCES)}, the same in all lines",
            )
    covariance = np.zeros((len(values), 3, 3))
    for column, (i, j) in enumerate(_COVARIANCE.values(), len(_NUMBERS) - len(_COVARIANCE)):
        covariance[:, i, j] = covariance[:, j, i] = values[:, column]
    # Nine digits of each number leave that much of the largest.
    slack = 1e-7 * np.abs(covariance).max(axis=(1, 2))
    wrong = np.flatnonzero(np.linalg.eigvalsh(covariance)[:, 0] < -slack)
    if len(wrong):
        raise SolenavError(
            f"{place(int(wrong[0]))}: the step's variances are negative in a direction",
            checks.MEND_FILE,
        )
    walk = StepTrack(
        path.stem,
        values[1:, 0],
        np.diff(values[:, 1:4], axis=0),
        values[1:, 5] * (math.pi / 180),
        covariance[1:],
        values[0, 1:4],
        float(values[0, 0]),
        sources[0],
    )
    return walk, sidecar.read_truth(path)


def write(path: Path, walk: StepTrack, truth: Truth | None = None) -> None:
    """Write the table and, beside it, the truth. SolenavError where that fails."""
    try:
        path.write_text(table(walk), encoding="utf-8")
        if truth is None:
            # That of another walk, which had this name before.
            sidecar.truth_path(path).unlink(missing_ok=True)
        else:
            sidecar.write_truth(path, truth)
            notes = {"name": walk.name, "truth": sidecar.truth_notes(truth)}
            sidecar.write_sidecar(path, notes)
    except OSError as error:
        raise unwritable(path, error) from None
