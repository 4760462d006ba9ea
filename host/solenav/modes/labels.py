"""Labels: how a foot moves when, and the table beside a capture that says so.

``walk.solcap`` has ``walk.modes.csv`` with the columns start_s, end_s, mode: seconds from the
first sample, in order, none overlapping. What no line covers has no label, and nothing is trained
or judged there.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from solenav.errors import SolenavError

MODES = ("still", "walk", "run", "upstairs", "downstairs")
"""In the order of the forest's classes."""
_COLUMNS = ["start_s", "end_s", "mode"]


@dataclass(frozen=True)
class Label:
    """From `start_s` to `end_s`, in seconds from the first sample, the foot moves as `mode`."""

    start_s: float
    end_s: float
    mode: str


def labels_path(capture: Path) -> Path:
    return capture.with_suffix(".modes.csv")


def write(capture: Path, labels: Iterable[Label]) -> None:
    """The table of `labels` beside a capture."""
    with labels_path(capture).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_COLUMNS)
        for label in labels:
            writer.writerow([f"{label.start_s:.3f}", f"{label.end_s:.3f}", label.mode])


def read(capture: Path) -> tuple[Label, ...]:
    """The labels beside a capture, none where there is no table.

    SolenavError for a table that is damaged, names an unknown mode, runs backwards or overlaps.
    """
    path = labels_path(capture)
    if not path.exists():
        return ()
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise SolenavError(f"{path} can't be read: {error}", "mend or delete it") from None
    if not rows or [cell.strip() for cell in rows[0]] != _COLUMNS:
        raise SolenavError(
            f"{path} is no table of motion modes", f"its first line is {','.join(_COLUMNS)}"
        )
    found: list[Label] = []
    for number, row in enumerate(rows[1:], 2):
        if row:
            found.append(_label(row, f"{path}, line {number}", found[-1].end_s if found else 0.0))
    return tuple(found)


def _label(row: list[str], place: str, after: float) -> Label:
    """A line's label. SolenavError where it's none, or begins before `after`."""
    try:
        start, end, mode = row[0], row[1], row[2].strip()
        label = Label(float(start), float(end), mode)
    except (ValueError, IndexError):
        raise SolenavError(
            f"{place}: not two times and a mode: {','.join(row)}", "write start_s,end_s,mode"
        ) from None
    if len(row) > len(_COLUMNS):
        raise SolenavError(f"{place}: {len(row)} cells, expected 3", "write start_s,end_s,mode")
    if label.mode not in MODES:
        raise SolenavError(
            f"{place}: there is no mode {label.mode!r}", f"choose from {', '.join(MODES)}"
        )
    if not (math.isfinite(label.end_s) and after <= label.start_s < label.end_s):
        raise SolenavError(
            f"{place}: {start} to {end} s ends before it begins or overlaps the line before",
            "list the stretches in order, each from its start to its end",
        )
    return label
