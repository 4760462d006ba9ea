"""The public recordings that studies and benches look at, from a folder of data."""

from __future__ import annotations

from pathlib import Path

from solenav import datasets
from solenav.errors import SolenavError
from solenav.filters.walk import Walk, of_recording
from solenav.recording import Recording

FLOOR_SHARE = 1e-3
"""A smaller error counts as so much of the distance: a closure of 0 is luck. Lost is at most 1."""
SETS = [
    ("llio", "llio", "*_LLIO.mat", ("right",)),
    ("openshoe", "openshoe", "*.txt", ("right",)),
    ("pyshoe", "pyshoe_vicon", "*.mat", ("right",)),
    ("xio", "xio", "*.csv", ("right",)),
    ("gaitmap", "gaitmap", "imu_sample.csv", ("left", "right")),
]
"""Format, folder under `foot/`, files and feet of each set."""


def sources(data: Path) -> list[tuple[str, Path, str]]:
    """Format, file and foot of every recording under `data`/foot. SolenavError for none."""
    found = [
        (format, path, foot)
        for format, folder, pattern, feet in SETS
        for path in sorted((data / "foot" / folder).glob(pattern))
        for foot in feet
    ]
    if not found:
        raise SolenavError(f"no recordings in {data / 'foot'}", "give the folder that holds foot/")
    return found


def recordings(data: Path) -> list[tuple[str, Recording]]:
    """Every recording under `data`/foot with its name, format first."""
    found = []
    for format, path, foot in sources(data):
        recording = datasets.read(path, format, foot=foot)
        found.append((f"{format} {recording.name}", recording))
    return found


def walks(data: Path) -> list[Walk]:
    """Every recording under `data`/foot as filters see it, on the core's default parameters."""
    return [of_recording(recording, name=name) for name, recording in recordings(data)]
