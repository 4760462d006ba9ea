"""The commands `pdr`, `magmap` and `locate`, as a user types them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from solenav.errors import SolenavError
from solenav_tools.cli.app import app

pytest.importorskip("pykrige")
pytest.importorskip("dtaidistance")


def run(*words: object) -> str:
    """What a command prints. Its SolenavError is raised."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    if isinstance(result.exception, SolenavError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_floor_is_surveyed_and_a_walk_left_out_is_found_on_it(data: Path, tmp_path: Path) -> None:
    folder = data / "phone/indoor_competition/site2/F8/path_data_files"
    walks = {stem: folder / f"{stem}.txt" for stem in ("5dd4e2a8d48f840006f1456d",)}
    survey = folder / "5dd4e29150e04e0006f55fbc.txt"
    tested = folder / "5ddbb912c5b77e0006b17a4d.txt"
    map_file = tmp_path / "F8.magmap.npz"
    built = run("magmap", "build", *walks.values(), survey, "-o", map_file, "--spacing", "1")
    assert "floor F8" in built and "variogram" in built
    shown = json.loads(run("magmap", "show", map_file, "-o", tmp_path / "map.png", "--json"))
    assert shown["floor"] == "F8" and len(shown["made_of"]) == 2
    assert (tmp_path / "map.png").stat().st_size > 10_000
    words = ["locate", tested, "-f", "indoor", "--map", map_file]
    found = json.loads(run(*words, "--plot", tmp_path / "way.png", "--json"))
    assert found["error_m"]["mean"] < 10
    assert (tmp_path / "way.png").stat().st_size > 10_000
    with pytest.raises(SolenavError, match="off the map"):
        run(*words, "--start", "5,5")
    with pytest.raises(SolenavError, match="no place"):
        run(*words, "--start", "here")


def test_a_map_of_another_floor_is_refused(data: Path, tmp_path: Path) -> None:
    kaist = data / "phone/kaist"
    map_file = tmp_path / "KI.magmap.npz"
    run("magmap", "build", kaist / "mats/magmap-KI-1F-0.6a.mat", "-o", map_file, "--floor", "2F")
    trace = kaist / "rawdata/test-KI-1F-S9/200204_221709_063"
    with pytest.raises(SolenavError, match="floor 1F, the map is of floor 2F"):
        run("locate", trace, "-f", "kaist", "--map", map_file, "--start", "40,28")


def test_a_trace_of_another_floor_or_without_magnetometer_makes_no_map(
    data: Path, tmp_path: Path
) -> None:
    walk = data / "phone/indoor_competition/site2/F8/path_data_files/5dd4da9e50e04e0006f55f21.txt"
    text = walk.read_text("utf-8")
    above, blind = tmp_path / "above.txt", tmp_path / "blind.txt"
    above.write_text(text.replace("FloorName:F8", "FloorName:F9"), "utf-8")
    lines = text.splitlines(keepends=True)
    blind.write_text("".join(line for line in lines if "MAGNETIC" not in line), "utf-8")
    map_file = tmp_path / "F8.magmap.npz"
    with pytest.raises(SolenavError, match="several floors"):
        run("magmap", "build", walk, above, "-o", map_file)
    with pytest.raises(SolenavError, match="blind has no magnetometer"):
        run("magmap", "build", walk, blind, "-o", map_file)
    assert not map_file.exists()


def test_pdr_writes_a_line_a_step(data: Path, tmp_path: Path) -> None:
    kaist = data / "phone/kaist"
    trace = kaist / "rawdata/test-KI-1F-S9/200204_221709_063"
    steps, points = tmp_path / "steps.csv", kaist / "est-result/ki-gt-s2.json"
    words = ["pdr", trace, "-f", "kaist", "--way-points", points, "--adapt"]
    told = json.loads(run(*words, "-o", steps, "--plot", tmp_path / "steps.png", "--json"))
    # The heading, the start, and a line a step.
    assert len(steps.read_text().splitlines()) == told["steps"] + 2
    assert told["distance_m"] == pytest.approx(57.0, rel=0.1)
    assert (tmp_path / "steps.png").stat().st_size > 10_000


def test_evaluate_and_plot_take_the_steps_of_pdr(data: Path, tmp_path: Path) -> None:
    kaist = data / "phone/kaist"
    trace = kaist / "rawdata/test-KI-1F-S9/200204_221709_063"
    steps, points = tmp_path / "steps.csv", kaist / "est-result/ki-gt-s2.json"
    told = json.loads(
        run("pdr", trace, "-f", "kaist", "--way-points", points, "-o", steps, "--json")
    )
    again = json.loads(run("evaluate", steps, "--require-truth", "--json"))
    assert again["steps"] == told["steps"]
    assert again["duration_s"] == pytest.approx(told["duration_s"], abs=1e-3)
    assert again["distance_m"] == pytest.approx(told["distance_m"], rel=1e-6)
    rmse = again["truth"]["position_rmse_m"]["horizontal"]
    assert rmse == pytest.approx(told["truth"]["position_rmse_m"]["horizontal"], rel=1e-4)
    assert again["truth"]["alignment"]["mode"] == "yaw"
    assert "against the truth, turned and shifted" in run("evaluate", steps)
    run("plot", steps, "-o", tmp_path / "steps.png")
    assert (tmp_path / "steps.png").stat().st_size > 10_000


def test_a_trace_without_magnetometer_is_reckoned_by_the_gyro_alone(tmp_path: Path) -> None:
    file = tmp_path / "walk.txt"
    with file.open("w") as lines:
        for i in range(1000):
            swing = 3 * math.sin(2 * math.pi * 1.8 * i / 50)
            lines.write(f"{20 * i}\tTYPE_ACCELEROMETER\t0\t0\t{9.81 + swing}\t3\n")
            lines.write(f"{20 * i}\tTYPE_GYROSCOPE\t0\t0\t0\t3\n")
    words = ["pdr", file, "-f", "indoor"]
    assert "steps" in run(*words)
    with pytest.raises(SolenavError, match="has no magnetometer"):
        run(*words, "--heading", "magnetometer")


def test_steps_that_are_no_table_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "steps.csv"
    file.write_text("time_s,x_m\n0,1\n")
    for words in (("evaluate", file), ("plot", file, "-o", tmp_path / "x.png")):
        with pytest.raises(SolenavError, match="no column y_m"):
            run(*words)
    assert not (tmp_path / "x.png").exists()


def test_wrong_outputs_are_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(SolenavError, match=r"\.magmap\.npz"):
        run("magmap", "build", tmp_path / "a.txt", "-o", tmp_path / "map.npz")
    with pytest.raises(SolenavError, match="does not exist"):
        run("magmap", "build", tmp_path / "a.txt", "-o", tmp_path / "a.magmap.npz")
    with pytest.raises(SolenavError, match=r"should end in \.csv"):
        run("pdr", tmp_path, "-f", "kaist", "-o", tmp_path / "steps.txt")
