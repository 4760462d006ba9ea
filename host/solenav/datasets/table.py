"""Anybody's own recording: a CSV whose heading says what each column is, and in which unit.

A line a sample, a heading such as ``t_s, ax_g, ay_g, az_g, gx_dps, gy_dps, gz_dps`` and, with a
magnetometer, ``mx_uT, my_uT, mz_uT`` (empty cells where it gave nothing). The unit stands behind
the name, after `_` or in brackets; capitals and further columns don't matter. Specific force points
up at rest; axes are the sensor's, right-handed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from solenav.datasets import checks
from solenav.errors import SolenavError
from solenav.mpu9150 import STANDARD_GRAVITY, UT_PER_GAUSS
from solenav.recording import FloatArray, Recording

_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_FORCES = {
    **dict.fromkeys(("mps2", "m/s2", "m/s²", "m/s^2"), 1.0),
    "g": STANDARD_GRAVITY,
    "mg": STANDARD_GRAVITY / 1000,
}
_RATES = {
    **dict.fromkeys(("rad/s", "radps", "rad_s", "rps"), 1.0),
    **dict.fromkeys(("deg/s", "dps", "deg_s", "°/s"), math.pi / 180),
}
_FIELDS = {
    **dict.fromkeys(("ut", "µt"), 1.0),
    "nt": 1e-3,
    **dict.fromkeys(("gauss", "gs"), UT_PER_GAUSS),
    **dict.fromkeys(("mgauss", "mg"), UT_PER_GAUSS / 1000),
}
_NAME = re.compile(r"(t|time|[agm][xyz])(?:[ _]*\[(.+)\]|[ _](.+))?")


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of a CSV file. `foot` has no use here.

    SolenavError for a column that is missing, a unit that isn't known, and as every reader.
    """
    names, rows = checks.read_csv(path)
    place = checks.line_place(path, 1)
    found = _columns(path, names)
    wanted = ["t", *(f"{sensor}{axis}" for sensor in "ag" for axis in "xyz")]
    missing = [name for name in wanted if name not in found]
    if missing:
        raise SolenavError(
            f"{path} has no column {', '.join(missing)}",
            "name the columns t_s, ax_g, ay_g, az_g, gx_dps, gy_dps, gz_dps, each with its unit",
        )
    wanted += [name for name in ("mx", "my", "mz") if name in found]
    table = checks.to_numbers(rows, len(names), [found[name][0] for name in wanted], place)
    table = table * np.array([found[name][1] for name in wanted])
    mag: FloatArray | None = table[:, 7:] if table.shape[1] == 10 else None
    return checks.make_recording(
        path, "csv", table[:, 0], table[:, 1:4], table[:, 4:7], place, mag=mag
    )


def _columns(path: Path, names: list[str]) -> dict[str, tuple[int, float]]:
    """Place and factor of each column that is known, by `t`, `ax` and so on."""
    out = {}
    for place, name in enumerate(names):
        matched = _NAME.fullmatch(name.strip().lower().removeprefix("\ufeff"))
        if matched is None:
            continue
        what, unit = "t" if matched[1] == "time" else matched[1], matched[2] or matched[3]
        units = _units(what)
        if unit is None or unit.strip() not in units:
            raise SolenavError(
                f"{path}: column {name!r} has {'no unit' if unit is None else 'an unknown unit'}",
                f"put one behind its name, as {what}_{next(iter(units))}: {', '.join(units)}",
            )
        out[what] = place, units[unit.strip()]
    return out


def _units(what: str) -> Mapping[str, float]:
    return {"t": _TIMES, "a": _FORCES, "g": _RATES, "m": _FIELDS}[what[0]]
