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

from solenav.errors import SolenavError

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from studies.recordings import sources

SOLENAV = Path(sys.executable).parent / "solenav"
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
    try:
        jobs = sources(Path(sys.argv[1]))
    except SolenavError as error:
        sys.exit(error.message)
    print("|", " | ".join(COLUMNS), "|")
    print("|---" * len(COLUMNS) + "|")
    with ThreadPoolExecutor(2) as pool:
        for line in pool.map(row, jobs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
