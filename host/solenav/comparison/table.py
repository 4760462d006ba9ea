"""Runs as tables: for a terminal, Markdown, CSV and JSON."""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from solenav.comparison.metrics import LOST_SHARE
from solenav.comparison.runs import REFERENCE, Run
from solenav.evaluation import Errors

Record = dict[str, Any]


@dataclass(frozen=True)
class Sheet:
    """A table of texts. The first column is left-aligned, the others are numbers."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def records(runs: Iterable[Run]) -> list[Record]:
    """A flat record a run, None where nothing is known: SI units, shares of 1, signed finals."""
    return [_record(run) for run in runs]


def _record(run: Run) -> Record:
    score = run.score
    record: Record = {
        "recording": run.recording,
        "filter": run.filter,
        "false_share": run.condition.false_share,
        "missed_share": run.condition.missed_share,
        "seed": run.seed,
        "kind": score.kind,
        "distance_m": score.distance_m,
        "error_m": score.error_m,
        "error_share": score.error_share,
        "lost": score.lost,
        "closure_horizontal_m": score.closure_m[0],
        "closure_vertical_m": score.closure_m[1],
        "closure_share": score.closure_share,
    }
    for name, unit, axes in (
        ("stance_velocity_rmse", "mps", score.stance_velocity_rmse_mps),
        ("stance_position_rmse", "m", score.stance_position_rmse_m),
        ("final", "m", score.final_m),
    ):
        for axis in ("east", "north", "up"):
            record[f"{name}_{axis}_{unit}"] = getattr(axes, axis) if axes else None
    record |= {"ape_m": score.ape_m, "rpe_m": score.rpe_m, "time_ratio": run.time_ratio}
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in record.items()
    }


def summary(runs: Sequence[Run]) -> list[Record]:
    """A record a filter over all its runs whose error is known.

    Medians of the error (m, share of distance) and of the time ratio, the worst error as a share,
    how many runs are lost. A figure that isn't finite is None: the track ran away.
    """
    return [_summed(name, [run for run in runs if run.filter == name]) for name in _filters(runs)]


def _summed(name: str, runs: list[Run]) -> Record:
    known = [run.score for run in runs if run.score.error_m is not None]
    ratios = [run.time_ratio for run in runs if run.time_ratio is not None]
    shares = [score.error_share for score in known if score.error_share is not None]

    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "filter": name,
        "runs": len(runs),
        "with_error": len(known),
        "median_error_m": finite(statistics.median(s.error_m or 0.0 for s in known))
        if known
        else None,
        "median_error_share": finite(statistics.median(shares)) if shares else None,
        "worst_error_share": finite(max(shares)) if shares else None,
        "lost": sum(score.lost for score in known),
        "time_ratio": statistics.median(ratios) if ratios else None,
    }


def sheets(runs: Sequence[Run]) -> list[Sheet]:
    """What a person wants to see: of one recording every figure, of many the filters summed up."""
    recordings = list(dict.fromkeys(run.recording for run in runs))
    tables = [_summary_sheet(runs)]
    if len(recordings) == 1:
        tables += [_errors_sheet(runs), _paper_sheet(runs)]
    else:
        tables += [_each_sheet(runs, recordings)]
    return tables


def _summary_sheet(runs: Sequence[Run]) -> Sheet:
    head = (
        "filter",
        "error, m",
        "of distance",
        "worst",
        f"lost (> {LOST_SHARE:.0%})",
        f"time / {REFERENCE}",
    )
    rows = [
        (
            one["filter"],
            _metres(one["median_error_m"], bool(one["with_error"])),
            _percent(one["median_error_share"], bool(one["with_error"])),
            _percent(one["worst_error_share"], bool(one["with_error"])),
            f"{one['lost']} of {one['with_error']}",
            _plain(one["time_ratio"], "{:.1f}"),
        )
        for one in summary(runs)
    ]
    return Sheet("Horizontal error, median of all runs", head, rows)


def _errors_sheet(runs: Sequence[Run]) -> Sheet:
    head = ("filter", "distance, m", "closure, m", "of distance", "height, m", "APE, m", "RPE, m")
    rows = []
    for name in _filters(runs):
        scores = [run.score for run in runs if run.filter == name]
        rows.append(
            (
                name,
                f"{scores[0].distance_m:.1f}",
                _metres(_middle(scores, lambda s: s.closure_m[0])),
                _percent(_middle(scores, lambda s: s.closure_share)),
                _metres(_middle(scores, lambda s: s.closure_m[1])),
                _metres(_middle(scores, lambda s: s.ape_m), False),
                _metres(_middle(scores, lambda s: s.rpe_m), False),
            )
        )
    return Sheet("From start to end, and evo's errors in the plane (RMSE)", head, rows)


def _paper_sheet(runs: Sequence[Run]) -> Sheet:
    head = ("filter", "velocity E/N/U, m/s", "position E/N/U, m", "final E/N/U, m")
    rows = []
    for name in _filters(runs):
        scores = [run.score for run in runs if run.filter == name]
        rows.append(
            (
                name,
                _axes([s.stance_velocity_rmse_mps for s in scores]),
                _axes([s.stance_position_rmse_m for s in scores]),
                _axes([s.final_m for s in scores], "{:.2f}"),
            )
        )
    return Sheet("In stance (RMSE) and at the end, as in the paper", head, rows)


def _each_sheet(runs: Sequence[Run], recordings: list[str]) -> Sheet:
    names = _filters(runs)
    rows = []
    for recording in recordings:
        cells = [recording]
        for name in names:
            scores = [r.score for r in runs if r.recording == recording and r.filter == name]
            cells.append(_metres(_middle(scores, lambda s: s.error_m), scores[0].kind is not None))
        rows.append(tuple(cells))
    return Sheet("Horizontal error of each recording, m", ("recording", *names), rows)


def _filters(runs: Sequence[Run]) -> list[str]:
    return list(dict.fromkeys(run.filter for run in runs))


def _middle(scores: list[Any], of: Callable[[Any], float | None]) -> float | None:
    """The median of a figure where all know it."""
    values = [of(score) for score in scores]
    known = [value for value in values if value is not None]
    return statistics.median(known) if len(known) == len(values) else None


def _axes(found: list[Errors | None], form: str = "{:.3f}") -> str:
    parts = []
    for axis in ("east", "north", "up"):
        value = _middle(found, lambda e, axis=axis: getattr(e, axis) if e else None)  # type: ignore[misc]
        parts.append(_plain(value, form))
    return " / ".join(parts)


def _metres(value: float | None, known: bool = True) -> str:
    """Metres with as many digits as they deserve; where the track ran away, that."""
    if value is None:
        return "∞" if known else "-"
    if not math.isfinite(value):
        return "∞"
    return (
        f"{value:.3f}"
        if abs(value) < 10
        else f"{value:.1f}"
        if abs(value) < 1000
        else f"{value:.0f}"
    )


def _percent(value: float | None, known: bool = True) -> str:
    if value is None:
        return "∞" if known else "-"
    if not math.isfinite(value):
        return "∞"
    return f"{value:.2%}" if value < 10 else f"{value:.0%}"


def _plain(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def to_rich(sheet: Sheet, width: int) -> list[Table]:
    """The sheet for a terminal, side by side columns cut into tables that fit `width`."""
    heads = [
        name.replace("+", "\n+").replace("-", "\n-") if i else name
        for i, name in enumerate(sheet.columns)
    ]
    widths = [
        max(len(line) for line in [*head.split("\n"), *(row[i] for row in sheet.rows)]) + 3
        for i, head in enumerate(heads)
    ]
    parts: list[list[int]] = [[]]
    room = width - 1 - widths[0]
    for i in range(1, len(heads)):
        if parts[-1] and sum(widths[k] for k in [*parts[-1], i]) > room:
            parts.append([])
        parts[-1].append(i)
    tables = []
    for number, part in enumerate(parts):
        table = Table(title=sheet.title if not number else None, title_justify="left")
        table.add_column(heads[0], no_wrap=True)
        for i in part:
            table.add_column(heads[i], justify="right", no_wrap=True)
        for row in sheet.rows:
            table.add_row(row[0], *(row[i] for i in part))
        tables.append(table)
    return tables


def to_markdown(sheet: Sheet) -> str:
    """The sheet as a Markdown table, without its title."""
    lines = [sheet.columns, ("---", *["---:"] * (len(sheet.columns) - 1)), *sheet.rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _cell(text: str) -> str:
    # A recording's name may hold the character that parts cells.
    return text.replace("|", "\\|")


def markdown(tables: Iterable[Sheet]) -> str:
    """Sheets under their titles."""
    return "\n\n".join(f"**{sheet.title}**\n\n{to_markdown(sheet)}" for sheet in tables) + "\n"


def to_csv(runs: Iterable[Run]) -> str:
    """A line a run under the names of `records`; empty where nothing is known."""
    rows = records(runs)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
