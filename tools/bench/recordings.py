"""Every real walk through the whole line: `python tools/bench/recordings.py DATA > table.md`.

DATA is a folder with the public recordings (`foot/llio`, `foot/openshoe`, ...). Each goes through
`solenav import`, `run-firmware`, `verify` and `evaluate`; the table says what came out.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

SOLENAV = Path(sys.executable).parent / "solenav"
SETS = [
    ("llio", "llio", "*_LLIO.mat", ("right",)),
    ("openshoe", "openshoe", "*.txt", ("right",)),
    ("pyshoe", "pyshoe_vicon", "*.mat", ("right",)),
    ("xio", "xio", "*.csv", ("right",)),
    ("gaitmap", "gaitmap", "imu_sample.csv", ("left", "right")),
]
COLUMNS = (
    "recording",
    "rate, Hz",
    "distance, m",
    "steps",
    "horizontal, m",
    "of distance",
    "height, m",
    "ticks proven",
)


def solenav(*arguments: str | Path) -> dict[str, Any]:
    """A command's JSON. CalledProcessError, with its stderr shown, where it fails."""
    done = subprocess.run([SOLENAV, *arguments, "--json"], capture_output=True, text=True)
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        done.check_returncode()
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def row(job: tuple[str, Path, str]) -> str:
    """The table's line for one recording."""
    format, path, foot = job
    with tempfile.TemporaryDirectory() as folder:
        walk, run = Path(folder) / "walk.solcap", Path(folder) / "run.solcap"
        about = solenav("import", path, "--format", format, "--foot", foot, "-o", walk)
        solenav("run-firmware", walk, "-o", run)
        proof = solenav("verify", run)
        result = solenav("evaluate", run)
    truth = result["truth"]
    if truth is not None:
        error = truth["position_rmse_m"]["horizontal"]
        height = truth["position_rmse_m"]["up"]
        what = "RMSE"
    else:
        error, height = result["closure"]["horizontal_m"], result["closure"]["vertical_m"]
        what = "closure"
    share = proof["covered_ticks"] / proof["samples"]
    up = "" if height is None else f"{height:.2f}"
    return (
        f"| {format} {about['name']} | {about['rate_hz']:.1f} | {result['distance_m']:.1f} "
        f"| {result['steps']} | {what} {error:.3f} | {error / result['distance_m']:.2%} "
        f"| {up} | {proof['covered_ticks']} of {proof['samples']} ({share:.2%}) |"
    )


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/bench/recordings.py DATA")
    data = Path(sys.argv[1]) / "foot"
    jobs = [
        (format, path, foot)
        for format, folder, pattern, feet in SETS
        for path in sorted((data / folder).glob(pattern))
        for foot in feet
    ]
    if not jobs:
        sys.exit(f"no recordings in {data}")
    print("|", " | ".join(COLUMNS), "|")
    print("|---" * len(COLUMNS) + "|")
    with ThreadPoolExecutor(2) as pool:
        for line in pool.map(row, jobs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
