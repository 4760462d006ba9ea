"""Readers of public recordings, on feet and on tables, one module per format.

None of the sets was made with an MPU-9150; `solenav.mpu9150.to_counts` makes counts of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from solenav.datasets import gaitmap, llio, mpu6050, openshoe, pyshoe, table, xio
from solenav.errors import SolenavError
from solenav.recording import Recording


class Reader(Protocol):
    """Reads one file; raises SolenavError where it's at fault."""

    def __call__(self, path: Path, *, foot: str = "right") -> Recording: ...


FORMATS: dict[str, Reader] = {
    "llio": llio.read,
    "openshoe": openshoe.read,
    "pyshoe": pyshoe.read,
    "xio": xio.read,
    "gaitmap": gaitmap.read,
    "mpu6050": mpu6050.read,
    "csv": table.read,
}


def read(path: Path, format: str, *, foot: str = "right") -> Recording:
    """Recording in `path`, SI units in the sensor's own axes, with truth where the set has it.

    `foot` is "left" or "right" and chooses one where a file holds both (gaitmap). Raises
    SolenavError for an unknown format or foot, and for whatever is wrong with the file.
    """
    if format not in FORMATS:
        raise SolenavError(f"unknown format {format!r}", f"choose one of {', '.join(FORMATS)}")
    if foot not in ("left", "right"):
        raise SolenavError(f"unknown foot {foot!r}", "choose left or right")
    return FORMATS[format](path, foot=foot)
