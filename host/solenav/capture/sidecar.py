"""What stands beside a capture: a JSON sidecar and, where known, the truth.

``walk.solcap`` has ``walk.json`` (host version, source, notes) and ``walk.truth.csv`` (time_s,
east_m, north_m, up_m and, where known, vel_e, vel_n, vel_u and stance; empty where unknown).
"""

from __future__ import annotations

import csv
import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from solenav.errors import SolenavError
from solenav.recording import FloatArray, Truth

_POSITION = ["east_m", "north_m", "up_m"]
_FARTHEST = 1e8
_VELOCITY = ["vel_e", "vel_n", "vel_u"]


def sidecar_path(capture: Path) -> Path:
    return capture.with_suffix(".json")


def truth_path(capture: Path) -> Path:
    return capture.with_suffix(".truth.csv")


def host_version() -> str:
    """The installed version of solenav."""
    try:
        return version("solenav")
    except PackageNotFoundError:
        return "not installed"


def write_sidecar(capture: Path, content: dict[str, Any]) -> None:
    text = json.dumps({"solenav": host_version(), **content}, indent=2, ensure_ascii=False)
    sidecar_path(capture).write_text(text + "\n", encoding="utf-8")


def read_sidecar(capture: Path) -> dict[str, Any]:
    """The sidecar, or an empty one: a capture stands without it."""
    try:
        content = json.loads(sidecar_path(capture).read_text(encoding="utf-8"))
        # It goes on into other sidecars, which half a character can't.
        json.dumps(content, ensure_ascii=False).encode("utf-8")
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise SolenavError(
            f"{sidecar_path(capture)} can't be read: {error}", "mend or delete it"
        ) from None
    return content if isinstance(content, dict) else {}


def write_truth(capture: Path, truth: Truth) -> None:
    """Write the truth's arrays; its frame and `closed_loop` belong into the sidecar."""
    columns = ["time_s", *_POSITION]
    arrays = [truth.time_s[:, None], truth.position_enu]
    if truth.velocity_enu is not None:
        columns += _VELOCITY
        arrays.append(truth.velocity_enu)
    if truth.stance is not None:
        columns.append("stance")
        arrays.append(truth.stance[:, None].astype(float))
    with truth_path(capture).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in np.hstack(arrays):
            writer.writerow(["" if np.isnan(v) else f"{v:.9g}" for v in row])


def read_truth(capture: Path) -> Truth | None:
    """The truth beside a capture, or None. SolenavError where the file is damaged."""
    about = read_sidecar(capture).get("truth")
    path = truth_path(capture)
    if about is None and not path.exists():
        return None
    about = about if isinstance(about, dict) else {}
    frame, closed = str(about.get("frame", "local")), bool(about.get("closed_loop", False))
    if not path.exists():
        empty = np.empty((0, 3))
        return Truth(np.empty(0), empty, frame=frame, closed_loop=closed) if closed else None
    try:
        with path.open(newline="", encoding="utf-8") as file:
            names, rows = _whole_rows(file)
        table = {
            name: np.array([float(row[name]) if row[name] else np.nan for row in rows])
            for name in names
        }
        position = _stack(table, _POSITION)
        velocity = _stack(table, _VELOCITY) if "vel_e" in table else None
        stance = table["stance"] > 0.5 if "stance" in table else None
        time_s = table["time_s"]
        if not (np.diff(time_s) >= 0).all() or not np.isfinite(time_s).all():
            raise ValueError("its times run backwards or aren't known")
        for values in (position,) if velocity is None else (position, velocity):
            if (np.abs(values) > _FARTHEST).any():
                raise ValueError("it holds numbers that are no metres on this planet")
        return Truth(time_s, position, velocity, stance, frame, closed)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise SolenavError(
            f"{path} is no truth table: {error}",
            "it needs the columns time_s, east_m, north_m, up_m; delete it to go without",
        ) from None


def _whole_rows(file: TextIO) -> tuple[list[str], list[dict[str, str]]]:
    """The table's columns and rows; not a last row that was cut off.

    ValueError where a row has another number of cells than the heading.
    """
    lines = file.readlines()
    # Our own tables end each line with both characters; others may leave out the last line's end.
    if len(lines) > 1 and lines[0].endswith("\r\n") and not lines[-1].endswith("\r\n"):
        lines.pop()
    reader = csv.DictReader(lines)
    rows = list(reader)
    if rows and None in rows[-1].values() and not lines[-1].endswith("\n"):
        rows.pop()
    for row in rows:
        if None in row or None in row.values():
            raise ValueError("a row has more or fewer cells than the heading")
    return list(reader.fieldnames or []), rows


def _stack(table: dict[str, FloatArray], names: list[str]) -> FloatArray:
    return np.stack([table[name] for name in names], axis=1)


def truth_notes(truth: Truth | None) -> dict[str, Any] | None:
    """The sidecar's entry for a truth."""
    if truth is None:
        return None
    return {"frame": truth.frame, "closed_loop": truth.closed_loop}
