"""Real recordings through the whole line: import, firmware, proof, evaluation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli import solenav

# One of each kind, cut where long; the whole of all of them: tools/bench/recordings.py.
KINDS = [
    ("llio", "llio/SensorConnectData_33_LLIO.mat", ["--duration", "20"]),
    ("openshoe", "openshoe/Measurement_100521_2_data_inert.txt", ["--duration", "15"]),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-51-23.mat", ["--duration", "20"]),
    ("xio", "xio/short_walk.csv", ["--duration", "25"]),
    ("gaitmap", "gaitmap/imu_sample.csv", ["--duration", "15", "--foot", "left"]),
    ("gaitmap", "gaitmap/imu_sample.csv", ["--duration", "15", "--foot", "right"]),
]


@pytest.mark.parametrize(("format", "file", "options"), KINDS)
def test_a_real_walk_runs_and_is_proven(
    format: str, file: str, options: list[str], data: Path, tmp_path: Path
) -> None:
    source = data / "foot" / file
    done = solenav("import", source, "-f", format, "-o", "in.solcap", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = solenav("run-firmware", "in.solcap", "-o", "run.solcap", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = solenav("verify", "run.solcap", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    report = json.loads(done.stdout)
    assert report["covered_ticks"] == report["samples"]
    done = solenav("evaluate", "run.solcap", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["steps"] >= 4
    if result["truth"] is not None:
        assert result["truth"]["position_rmse_m"]["horizontal"] < 0.03 * result["distance_m"]
