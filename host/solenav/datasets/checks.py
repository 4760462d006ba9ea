"""What every reader needs: opening files, finding columns, and judging the samples.

Each fault of a file is a `SolenavError` that says where it is and what to do about it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording, Truth

CHOOSE_FORMAT = "choose the format that the file has, or export it again"
MEND_FILE = "correct or cut the file there, or export it again"

AXES = ("accel x", "accel y", "accel z", "gyro x", "gyro y", "gyro z")

# Factors that go wrong are 9.8 and more, so these leave room for a run, where the median is
# half as much again as gravity.
ACCEL_MEDIAN_MPS2 = (5.0, 30.0)
# Three times what any foot does, and what a slow walk in °/s passes.
GYRO_PEAK_RADPS = 100.0
# Indoors the field is a third to three times the Earth's 25 to 65 µT; gauss and mT are far off.
MAG_MEDIAN_UT = (8.0, 200.0)
# Half a swing: what was lost over a longer time, no filter can bridge.
GAP_LIMIT_S = 0.1

Place = Callable[[int], str]
"""Says for a sample (from 0) where a person finds it."""


def line_place(path: Path, header_lines: int) -> Place:
    """Places of samples in a text file with one sample per line."""
    return lambda sample: f"{path}, line {sample + header_lines + 1}"


def row_place(path: Path) -> Place:
    """Places of samples in a file without lines; the first row is 1."""
    return lambda sample: f"{path}, row {sample + 1}"


def check_file(path: Path, suffixes: Sequence[str]) -> None:
    """Raise SolenavError unless `path` is a file with one of `suffixes`."""
    if path.is_dir():
        raise SolenavError(f"{path} is a directory", "name one recording inside it")
    if not path.exists():
        raise SolenavError(f"{path} does not exist", "check the path")
    if path.suffix.lower() not in suffixes:
        raise SolenavError(f"{path} is not a {' or '.join(suffixes)} file", CHOOSE_FORMAT)


def read_lines(path: Path, suffix: str) -> list[str]:
    """Lines of a text file; SolenavError if it's absent, empty or not text."""
    check_file(path, (suffix,))
    try:
        text = path.read_bytes().decode("utf-8-sig").rstrip()
    except UnicodeDecodeError:
        raise SolenavError(f"{path} is not a text file", CHOOSE_FORMAT) from None
    except OSError as error:
        raise SolenavError(f"cannot read {path}: {error.strerror}", "check permissions") from None
    if not text:
        raise SolenavError(f"{path} is empty", "export or copy it again")
    # Not splitlines(): OpenShoe's logger doubles a carriage return now and then.
    return [line.rstrip("\r") for line in text.split("\n")]


def read_csv(path: Path, header_lines: int = 1) -> tuple[list[str], list[list[str]]]:
    """Column names and rows of cells of a comma separated file.

    With several header lines, a column's name is its cells joined by a space.
    """
    cells = [line.split(",") for line in read_lines(path, ".csv")]
    header, rows = cells[:header_lines], cells[header_lines:]
    return [" ".join(parts).strip() for parts in zip(*header, strict=False)], rows


def find_columns(path: Path, names: Sequence[str], wanted: Sequence[str]) -> list[int]:
    """Positions of the `wanted` columns; SolenavError names those that are missing."""
    missing = [name for name in wanted if name not in names]
    if missing:
        raise SolenavError(f"{path} has no column {', '.join(missing)}", CHOOSE_FORMAT)
    return [names.index(name) for name in wanted]


def present(names: Sequence[str], optional: Sequence[str]) -> list[str]:
    """The `optional` columns if the file has them all, else none."""
    return list(optional) if set(optional) <= set(names) else []


def to_numbers(
    rows: Sequence[Sequence[str]], width: int, columns: Sequence[int], place: Place
) -> FloatArray:
    """Array (len(rows), len(columns)) of the chosen cells, NaN where one is blank.

    Raises SolenavError at the first row without `width` cells, or with a cell that is no number.
    """
    table = np.empty((len(rows), len(columns)))
    for i, row in enumerate(rows):
        if len(row) != width:
            raise SolenavError(f"{place(i)}: {len(row)} cells, expected {width}", MEND_FILE)
        try:
            table[i] = [float(row[k].strip() or "nan") for k in columns]
        except ValueError as error:
            raise SolenavError(f"{place(i)}: {error}", MEND_FILE) from None
    return table


def load_mat(path: Path, wanted: Sequence[str]) -> dict[str, Any]:
    """Variables of a MATLAB file (up to v7.2); SolenavError if any `wanted` one is missing."""
    check_file(path, (".mat",))
    try:
        scipy_io = import_module("scipy.io")
    except ImportError:
        raise SolenavError(f"reading {path} needs scipy", "pip install 'solenav[import]'") from None
    try:
        content: dict[str, Any] = scipy_io.loadmat(path)
    except Exception as error:  # a damaged file makes scipy raise a dozen kinds
        raise SolenavError(f"{path} is not a readable .mat file: {error}", CHOOSE_FORMAT) from None
    missing = [name for name in wanted if name not in content]
    if missing:
        raise SolenavError(f"{path} has no variable {', '.join(missing)}", CHOOSE_FORMAT)
    return content


def mat_array(path: Path, content: dict[str, Any], name: str, width: int) -> FloatArray:
    """Numeric variable with `width` columns, as (n, width), or (n,) for a width of 1."""
    value = content[name]
    if width == 1:
        value = value.reshape(-1, 1)
    if value.dtype.kind not in "fiub" or value.ndim != 2 or value.shape[1] != width:
        raise SolenavError(
            f"{path}: variable {name} is {value.dtype} {value.shape}, not numbers (n, {width})",
            CHOOSE_FORMAT,
        )
    array: FloatArray = value.astype(np.float64)
    return array[:, 0] if width == 1 else array


def check_lengths(path: Path, **arrays: NDArray[Any]) -> None:
    """Raise SolenavError unless all arrays have as many rows as the first."""
    rows = {name: len(array) for name, array in arrays.items()}
    if len(set(rows.values())) > 1:
        counts = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise SolenavError(f"{path}: lengths differ ({counts} rows)", "export it again")


def check_samples(
    time_s: FloatArray, accel: FloatArray, gyro: FloatArray, place: Place, repeats: bool = False
) -> None:
    """Raise SolenavError unless the samples can be navigated on.

    `time_s` (n,) in s, must increase (with `repeats`: must not decrease) without long gaps;
    `accel` (n, 3) in m/s² and `gyro` (n, 3) in rad/s must be finite and of credible size;
    `place` says where sample i is.
    """
    if len(time_s) < 2:
        raise SolenavError(
            f"{place(len(time_s))}: the data end after {len(time_s)} samples, 2 are the least",
            "record or export it again",
        )
    check_finite(np.column_stack([time_s, accel, gyro]), ("time", *AXES), place)
    check_increasing(time_s, place, repeats)
    check_gaps(time_s, place)
    _check_units(accel, gyro, place)


def check_finite(table: FloatArray, names: Sequence[str], place: Place) -> None:
    """Raise SolenavError at the first NaN or infinity in `table` (n, len(names))."""
    bad = np.argwhere(~np.isfinite(table))
    if bad.size:
        row, column = (int(k) for k in bad[0])
        raise SolenavError(f"{place(row)}: {names[column]} is {table[row, column]}", MEND_FILE)


def check_increasing(time_s: FloatArray, place: Place, repeats: bool = False) -> None:
    """Raise SolenavError where time goes back or, unless `repeats`, stands."""
    steps = np.diff(time_s)
    wrong = np.flatnonzero(steps < 0 if repeats else steps <= 0)
    if wrong.size:
        i = int(wrong[0])
        verb = "repeats" if steps[i] == 0 else "goes back"
        raise SolenavError(
            f"{place(i + 1)}: time {verb} ({time_s[i]:.6f} s, then {time_s[i + 1]:.6f} s)",
            MEND_FILE,
        )


def make_recording(
    path: Path,
    format: str,
    time_s: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    place: Place,
    truth: Truth | None = None,
    mag: FloatArray | None = None,
    **notes: Any,
) -> Recording:
    """Checked recording, its time counted from the first sample. Units as in `check_samples`.

    `mag` (n, 3) in µT; (n, 0) counts as none. What is NaN in one axis becomes so in all.
    """
    check_samples(time_s, accel, gyro, place)
    if mag is not None:
        mag = _checked_mag(mag, place)
    return Recording(
        name=path.stem,
        time_s=time_s - time_s[0],
        accel=accel,
        gyro=gyro,
        rate_hz=float((len(time_s) - 1) / (time_s[-1] - time_s[0])),
        truth=truth,
        source=f"{format} {path.name}",
        notes=notes,
        mag=mag,
    )


def closed_loop() -> Truth:
    """Truth that knows only that the walk ends where it began."""
    return Truth(time_s=np.empty(0), position_enu=np.empty((0, 3)), closed_loop=True)


def _check_units(accel: FloatArray, gyro: FloatArray, place: Place) -> None:
    low, high = ACCEL_MEDIAN_MPS2
    median = float(np.median(np.linalg.norm(accel, axis=1)))
    if not low <= median <= high:
        guess = "in g, or free of gravity" if median < low else "in mg or raw counts"
        raise SolenavError(
            f"{place(0)} and on: the median acceleration is {median:.4g} m/s², "
            f"but a foot's is near 9.8; perhaps the file is {guess}",
            CHOOSE_FORMAT,
        )
    peak = np.linalg.norm(gyro, axis=1)
    fastest = int(np.argmax(peak))
    if peak[fastest] > GYRO_PEAK_RADPS:
        raise SolenavError(
            f"{place(fastest)}: the angular rate is {peak[fastest]:.4g} rad/s, "
            "more than a foot's; perhaps the file is in °/s",
            CHOOSE_FORMAT,
        )


def _checked_mag(mag: FloatArray, place: Place) -> FloatArray | None:
    """Whole readings of a magnetometer in µT, or None where it never gave one."""
    infinite = np.flatnonzero(np.isinf(mag).any(axis=1))
    if infinite.size:
        raise SolenavError(f"{place(int(infinite[0]))}: the magnetic field is infinite", MEND_FILE)
    known = np.asarray(np.isfinite(mag).all(axis=1))
    if not mag.shape[1] or not known.any():
        return None
    low, high = MAG_MEDIAN_UT
    median = float(np.median(np.linalg.norm(mag[known], axis=1)))
    if not low <= median <= high:
        raise SolenavError(
            f"{place(0)} and on: the median magnetic field is {median:.4g} µT, but the Earth's is "
            "25 to 65; perhaps the file is in another unit",
            CHOOSE_FORMAT,
        )
    return np.where(known[:, np.newaxis], mag, np.nan)


def check_gaps(time_s: FloatArray, place: Place) -> None:
    """Raise SolenavError where more than GAP_LIMIT_S pass without a sample."""
    steps = np.diff(time_s)
    longest = int(np.argmax(steps))
    if steps[longest] > GAP_LIMIT_S:
        raise SolenavError(
            f"{place(longest + 1)}: {steps[longest]:.3f} s without samples before it",
            "cut the file at the gap and read the parts one by one",
        )
