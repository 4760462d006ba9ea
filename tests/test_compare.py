"""Filters side by side: figures that are known beforehand, faults as asked for, one command."""

from __future__ import annotations

import csv
import json
import math
import shutil
import sys
from array import array
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli import refused, solenav
from hypothesis import given
from hypothesis import strategies as st

from solenav import importing, spreading
from solenav.comparison import faults, metrics, runs, table
from solenav.comparison.faults import spoil, stances
from solenav.comparison.metrics import score
from solenav.comparison.runs import CLEAN, Condition
from solenav.errors import SolenavError
from solenav.evaluation import Errors
from solenav.filters import Track, Walk, walk
from solenav.recording import Recording, Truth
from solenav.sim.scenario import simulate
from solenav_tools.cli import compare as command

image = pytest.importorskip("matplotlib.image")
FILTERS = ("reset", "ekf+still", "apf")


def walk_of(recording: Recording, folder: Path) -> Walk:
    """The walk of a recording, by way of a capture."""
    path = folder / f"{recording.name}.solcap"
    importing.to_capture(recording, path)
    return walk.load(command.capture.load(path))


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """The first strides of the paper's line, after 30 s of standing, then 5 s of a last stand."""
    return walk_of(simulate("line35").first(55.0), tmp_path_factory.mktemp("line"))


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two captures: one with truth, one that knows only that it is a loop."""
    folder = tmp_path_factory.mktemp("captures")
    importing.to_capture(simulate("line35", seed=2).first(45.0), folder / "line.solcap")
    whole = simulate("loop", seed=1)
    nothing = Truth(np.empty(0), np.empty((0, 3)), closed_loop=True)
    importing.to_capture(replace(whole, truth=nothing), folder / "loop.solcap")
    return folder


def true_track(walk: Walk) -> Track:
    """What a filter without error would say."""
    truth = walk.truth
    assert truth is not None and truth.velocity_enu is not None
    return Track(truth.position_enu.copy(), truth.velocity_enu.copy())


def moved(track: Track, east: Any = 0.0, north: Any = 0.0, up: Any = 0.0) -> Track:
    """The track shifted by metres, the same or (n,) at each sample."""
    shift = np.column_stack([np.broadcast_to(a, len(track.position)) for a in (east, north, up)])
    return Track(track.position + shift, track.velocity)


def axes(found: Errors | None) -> tuple[float, float, float | None]:
    assert found is not None
    return found.east, found.north, found.up


# What is said of a track


def test_the_truth_itself_has_no_error(line: Walk) -> None:
    found = score(line, true_track(line))
    assert found.kind == "truth"
    assert found.error_m == pytest.approx(0, abs=1e-9)
    for errors in (
        found.stance_velocity_rmse_mps,
        found.stance_position_rmse_m,
        found.final_m,
    ):
        assert axes(errors) == pytest.approx((0, 0, 0), abs=1e-9)
    assert found.ape_m == pytest.approx(0, abs=1e-9)
    assert found.rpe_m == pytest.approx(0, abs=1e-9)
    assert not found.lost


def test_a_shift_is_found_in_every_position_error(line: Walk) -> None:
    found = score(line, moved(true_track(line), 0.3, -0.4, 0.1))
    assert found.error_m == pytest.approx(0.5)
    assert axes(found.stance_position_rmse_m) == pytest.approx((0.3, 0.4, 0.1))
    assert axes(found.final_m) == pytest.approx((0.3, -0.4, 0.1))
    assert found.ape_m == pytest.approx(0.5)
    assert found.rpe_m == pytest.approx(0, abs=1e-9)


def test_a_velocity_in_stance_is_an_error_whatever_decisions_the_filter_had(line: Walk) -> None:
    track = true_track(line)
    track.velocity[line.clean] += [0.1, 0.2, -0.3]
    track.velocity[~line.clean] += 5.0
    for stance in (line.stance, ~line.stance):
        found = score(line.with_stance(stance), track)
        assert axes(found.stance_velocity_rmse_mps) == pytest.approx((0.1, 0.2, 0.3))


def test_without_true_velocity_a_stance_should_have_none(line: Walk) -> None:
    assert line.truth is not None
    blind = replace(line, truth=replace(line.truth, velocity_enu=None))
    nothing = Track(true_track(line).position, np.full((len(line.counts), 3), 0.2))
    assert axes(score(blind, nothing).stance_velocity_rmse_mps) == pytest.approx((0.2, 0.2, 0.2))


def test_a_wrong_scale_shows_in_the_relative_error(line: Walk) -> None:
    truth = true_track(line)
    found = score(line, Track(1.02 * truth.position, truth.velocity))
    # A stretch ends with the first point past its length.
    assert found.rpe_m == pytest.approx(0.02 * metrics.STRETCH_M, rel=0.25)


def test_a_local_truth_is_laid_onto_the_track(line: Walk) -> None:
    assert line.truth is not None
    local = replace(line, truth=replace(line.truth, frame="local"))
    track = true_track(line)
    turned = track.position @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert score(local, Track(turned, track.velocity)).error_m == pytest.approx(0, abs=1e-6)


def test_a_closed_loop_is_measured_by_its_closure(line: Walk) -> None:
    loop = Truth(np.empty(0), np.empty((0, 3)), closed_loop=True)
    track = true_track(line)
    back = np.linspace(0, 1, len(track.position))[:, None] * track.position[-1]
    track = moved(Track(track.position - back, track.velocity))
    track.position[-1] = [0.6, 0.8, -0.5]
    found = score(replace(line, truth=loop), track)
    first = track.position[line.start.row + 1]
    expected = math.hypot(0.6 - first[0], 0.8 - first[1])
    assert found.kind == "closure"
    assert found.error_m == found.closure_m[0] == pytest.approx(expected)
    assert found.error_share == pytest.approx(expected / line.distance_m)
    assert found.final_m is found.ape_m is found.rpe_m is None


def test_where_nothing_is_known_there_is_no_error(line: Walk) -> None:
    found = score(replace(line, truth=None), true_track(line))
    assert (found.kind, found.error_m, found.error_share, found.lost) == (None, None, None, False)
    assert found.closure_m[0] > 5


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_track_that_ran_away_is_lost(line: Walk, bad: float) -> None:
    track = true_track(line)
    track.position[-1, 2] = bad
    found = score(line, track)
    assert found.lost and found.error_m == math.inf
    record = table.records([runs.Run("a", "ekf", CLEAN, 1, found)])[0]
    assert record["error_m"] is None and record["lost"] is True


def test_the_distance_is_the_walks_whatever_the_decisions(line: Walk) -> None:
    assert line.truth is not None
    way = np.linalg.norm(line.truth.position_enu[-1] - line.truth.position_enu[0])
    assert line.distance_m == pytest.approx(way, rel=0.05)
    assert spoil(line, 1, 0.2, 0.2).distance_m == line.distance_m


# Faults


def decided(line: Walk, lengths: list[tuple[int, int]]) -> Walk:
    """The walk on decisions of its own: standing, then (swing, stance) of so many samples."""
    stance = np.zeros(len(line.counts), bool)
    at = line.start.row + 200
    stance[:at] = True
    for swing, stood in lengths:
        stance[at + swing : at + swing + stood] = True
        at += swing + stood
    assert at < len(stance)
    return replace(line, stance=stance, clean=stance)


STRIDES = st.lists(st.tuples(st.integers(60, 150), st.integers(20, 150)), min_size=2, max_size=30)


def changed(spoilt: Walk) -> list[tuple[int, int]]:
    """Where swing became stance, as rows (begin, end)."""
    edges = np.flatnonzero(
        np.diff((spoilt.stance & ~spoilt.clean).astype(int), prepend=0, append=0)
    )
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


@given(STRIDES, st.integers(0, 2**32), st.floats(0, 0.3))
def test_false_stances_are_bursts_that_make_up_the_share(
    line: Walk, strides: list[tuple[int, int]], seed: int, share: float
) -> None:
    walk = decided(line, strides)
    spoilt = spoil(walk, seed, false_share=share)
    swing = ~walk.stance[walk.start.row + 1 :]
    lengths = [end - begin for begin, end in changed(spoilt)]
    # 15 to 50 ms at 200 Hz; the last burst may pass the share by less than the shortest.
    assert all(3 <= length <= 10 for length in lengths)
    assert 0 <= sum(lengths) - round(share * swing.sum()) < 3
    assert np.array_equal(spoilt.stance & spoilt.clean, walk.stance)
    assert np.array_equal(spoilt.clean, walk.clean)


@given(STRIDES, st.integers(0, 2**32), st.floats(0, 1))
def test_missed_stances_are_missed_as_a_whole(
    line: Walk, strides: list[tuple[int, int]], seed: int, share: float
) -> None:
    walk = decided(line, strides)
    spoilt = spoil(walk, seed, missed_share=share)
    whole = stances(walk)
    kept = [bool(spoilt.stance[begin:end].all()) for begin, end in whole]
    gone = [not spoilt.stance[begin:end].any() for begin, end in whole]
    assert len(whole) == len(strides)
    assert sum(gone) == round(share * len(whole))
    assert all(k != g for k, g in zip(kept, gone, strict=True))
    assert spoilt.stance[: whole[0][0]].tolist() == walk.stance[: whole[0][0]].tolist()


@given(STRIDES, st.integers(0, 2**32))
def test_a_seed_spoils_a_walk_in_one_way(
    line: Walk, strides: list[tuple[int, int]], seed: int
) -> None:
    walk = decided(line, strides)
    once, again = (spoil(walk, seed, 0.2, 0.1).stance for _ in range(2))
    assert np.array_equal(once, again)
    # The bursts don't depend on whether stances are missed as well.
    missed = spoil(walk, seed, 0.0, 0.1).stance
    false = spoil(walk, seed, 0.2, 0.0).stance
    assert np.array_equal(once, missed | (false & ~walk.stance))


def test_another_seed_spoils_it_in_another(line: Walk) -> None:
    spoilt = [spoil(line, seed, 0.2, 0.2).stance.tobytes() for seed in range(20)]
    assert len(set(spoilt)) == 20


def test_without_faults_nothing_changes(line: Walk) -> None:
    assert np.array_equal(spoil(line, 1).stance, line.stance)


def test_the_standing_at_either_end_is_no_stance_to_miss(line: Walk) -> None:
    spoilt = spoil(line, 1, missed_share=1.0)
    assert spoilt.stance[line.start.row + 1] and spoilt.stance[-1]
    swings = [end - begin for begin, end in faults._runs(~spoilt.stance)]
    assert max(swings) > 10 * line.rate_hz


def test_flicker_belongs_to_the_stance_beside_it(line: Walk) -> None:
    # Two samples of stance before a whole one, three of swing within it, four of stance after.
    walk = decided(line, [(80, 2), (35, 60), (3, 60), (40, 4), (90, 50)])
    assert [end - begin for begin, end in stances(walk)] == [2 + 35 + 60 + 3 + 60 + 40 + 4, 50]


def test_a_swing_too_short_for_the_share_holds_what_it_can(line: Walk) -> None:
    walk = decided(line, [(4, 50)] * 20)
    lengths = [end - begin for begin, end in changed(spoil(walk, 1, false_share=1.0))]
    assert lengths and all(3 <= length <= 10 for length in lengths)


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_share_is_from_0_to_1(line: Walk, share: float) -> None:
    with pytest.raises(ValueError, match="share"):
        spoil(line, 1, false_share=share)


# Many runs


def same(runs: list[runs.Run]) -> list[runs.Run]:
    """Runs without what differs from time to time."""
    return [replace(run, time_ratio=None) for run in runs]


def test_runs_come_in_order_and_are_the_same_in_processes(line: Walk) -> None:
    other = replace(line, name="other")
    conditions = (CLEAN, Condition(0.2, 0.1))
    asked = ((line, other), FILTERS, conditions, (1, 2))
    seen: list[int] = []
    here = runs.compare(*asked, jobs=1, progress=seen.append)
    assert seen == list(range(1, runs.amount(2, 2, 2) + 1))
    wanted = [
        (walk, condition, seed, name)
        for walk in (line.name, "other")
        for condition in conditions
        for seed in (1, 2)
        for name in FILTERS
    ]
    assert [(r.recording, r.condition, r.seed, r.filter) for r in here] == wanted
    assert same(runs.compare(*asked, jobs=2)) == same(here)


def test_time_is_a_ratio_to_reset(line: Walk) -> None:
    found = runs.compare([line], ["ekf15", "reset"], seeds=(1, 2), jobs=1)
    ratios = {run.filter: run.time_ratio for run in found if run.seed == 1}
    assert ratios["reset"] == 1.0
    assert ratios["ekf15"] is not None and ratios["ekf15"] > 1
    assert {run.time_ratio for run in found if run.seed == 2} == {None}


def test_a_seed_is_also_the_particles(line: Walk) -> None:
    errors = {run.score.error_m for run in runs.compare([line], ["apf"], seeds=range(1, 4), jobs=1)}
    assert len(errors) == 3
    kept = runs.reseeded(line, 1).params
    assert isinstance(kept, array) and kept == line.params


def test_faults_harm_a_filter_without_defence(line: Walk) -> None:
    clean, spoilt = runs.compare([line], ["reset"], (CLEAN, Condition(0.2)), jobs=1)
    assert spoilt.score.error_m > clean.score.error_m  # type: ignore[operator]


# A cluster


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A Dask cluster on this machine's own address."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        yield cluster


def test_a_cluster_gives_the_same_results(cluster: Any, captures: Path) -> None:
    filters = [f"--filter={name}" for name in FILTERS]
    asked = ("compare", captures, *filters, "--seeds", "2", "--false-share", "0.1", "--json")
    there = solenav(*asked, "--dask", cluster.scheduler_address)
    here = solenav(*asked, "--jobs", "1")
    assert there.returncode == here.returncode == 0, there.stderr

    def found(text: str) -> list[dict[str, Any]]:
        return [{**run, "time_ratio": None} for run in json.loads(text)["runs"]]

    assert found(there.stdout) == found(here.stdout)
    assert len(found(here.stdout)) == 2 * 2 * 3


def test_much_work_goes_to_a_cluster_of_its_own(
    line: Walk, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    asked = ([line], ["apf"], (CLEAN,), (1, 2))
    here = runs.compare(*asked, jobs=1)
    monkeypatch.setattr(runs, "MANY", 2)
    monkeypatch.setattr(spreading, "in_processes", None)
    assert same(runs.compare(*asked, jobs=2)) == same(here)


def test_what_is_no_cluster_is_refused(captures: Path) -> None:
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        done = solenav("compare", captures / "line.solcap", "--filter", "reset", "--dask", address)
        refused(done, 2, address, "dask scheduler")


def test_a_cluster_without_workers_is_refused(line: Walk, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(spreading, "_CONNECT_S", 1)
    options: dict[str, Any] = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp://", **options
        ) as none,
        pytest.raises(SolenavError, match="no workers"),
    ):
        runs.compare([line], ["reset"], dask=none.scheduler_address)


def test_a_cluster_needs_its_extra(line: Walk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SolenavError) as caught:
        runs.compare([line], ["reset"], dask="tcp://127.0.0.1:8786")
    assert "solenav[cluster]" in caught.value.remedy


# The command


def test_a_recording_is_compared_on_every_figure(captures: Path) -> None:
    done = solenav("compare", captures / "line.solcap")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    for name in runs.DEFAULT:
        assert name in done.stdout
    for figure in ("velocity E/N/U", "position E/N/U", "final E/N/U", "closure", "APE", "RPE"):
        assert figure in done.stdout
    assert "time / reset" in done.stdout


def test_a_strict_detector_helps_who_takes_every_decision_at_its_word(captures: Path) -> None:
    errors = []
    for options in ((), ("--strict",)):
        done = solenav("compare", captures / "line.solcap", *options, "--filter=reset", "--json")
        assert done.returncode == 0, done.stderr
        errors.append(json.loads(done.stdout)["runs"][0]["error_m"])
    assert errors[1] < 0.2 * errors[0]


def test_csv_json_and_markdown_say_the_same(captures: Path, tmp_path: Path) -> None:
    files = ("--csv", tmp_path / "runs.csv", "--markdown", tmp_path / "runs.md")
    filters = ("--filter", "apf", "--filter", "ekf+gate")
    done = solenav("compare", captures, *filters, *files, "--seeds", "2", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    with (tmp_path / "runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(told["runs"]) == 2 * 2 * 2
    for row, run in zip(rows, told["runs"], strict=True):
        assert row == {key: "" if value is None else str(value) for key, value in run.items()}
    # Markdown has a line a filter, then one a recording, medians over seeds.
    lines = (tmp_path / "runs.md").read_text().splitlines()
    cells = {
        line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")[2:-1]]
        for line in lines
        if line.startswith("|")
    }
    for summed in told["summary"]:
        assert cells[summed["filter"]][0] == f"{summed['median_error_m']:.3f}"
    for recording in ("line", "loop"):
        for at, name in enumerate(("apf", "ekf+gate")):
            errors = [
                run["error_m"]
                for run in told["runs"]
                if (run["recording"], run["filter"]) == (recording, name)
            ]
            assert float(cells[recording][at]) == pytest.approx(np.median(errors), abs=6e-4)
    assert {run["kind"] for run in told["runs"] if run["recording"] == "loop"} == {"closure"}


def test_pictures_show_something(captures: Path, tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    done = solenav("compare", captures, "--figures", folder, "--filter=apf", "--filter=reset")
    assert done.returncode == 0, done.stderr
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "line-tracks.png",
        "line-velocity.png",
        "line-position.png",
        "loop-tracks.png",
        "loop-velocity.png",
        "errors.png",
    }
    blue = np.array([0x00, 0x72, 0xB2]) / 255
    for name in names:
        pixels = image.imread(folder / name)[:, :, :3]
        assert (np.abs(pixels - blue).max(axis=2) < 0.3).sum() > 100, name
        assert (pixels.min(axis=2) > 0.99).mean() > 0.4, name


def test_all_filters_are_listed_and_can_be_run(captures: Path) -> None:
    told = json.loads(solenav("compare", "--list", "--json").stdout)["filters"]
    assert [one["name"] for one in told][:2] == ["ins", "reset"]
    assert all(one["source"] and one["about"] for one in told)
    text = solenav("compare", "--list").stdout
    assert "+still, +gate" in text and "Foxlin" in text
    done = solenav("compare", captures / "line.solcap", "--filters", "all", "--json")
    assert done.returncode == 0, done.stderr
    found = [run["filter"] for run in json.loads(done.stdout)["runs"]]
    assert found == runs.every()
    assert {"ins+still", "pf+still+gate", "kf-twin"} <= set(found)


def test_a_recording_without_a_static_start_is_left_out(captures: Path, tmp_path: Path) -> None:
    restless = Recording(
        "restless",
        np.arange(800) / 200,
        np.random.default_rng(1).normal([0, 0, 9.8], 3, (800, 3)),
        np.random.default_rng(2).normal(0, 2, (800, 3)),
        200.0,
    )
    importing.to_capture(restless, tmp_path / "restless.solcap")
    refused(solenav("compare", tmp_path), 2, "no static start", "stand still")
    done = solenav("compare", captures / "line.solcap", tmp_path, "--filter", "reset", "--json")
    assert done.returncode == 1
    assert "left out" in done.stderr and "restless" in done.stderr
    told = json.loads(done.stdout)
    assert told["left_out"] == [str(tmp_path / "restless.solcap")]
    assert [run["recording"] for run in told["runs"]] == ["line"]


def test_two_captures_of_one_name_keep_apart(captures: Path, tmp_path: Path) -> None:
    for path in captures.glob("line.*"):
        shutil.copy(path, tmp_path)
    both = (captures / "line.solcap", tmp_path, captures / "line.solcap")
    done = solenav("compare", *both, "--filter", "reset", "--json")
    names = [run["recording"] for run in json.loads(done.stdout)["runs"]]
    assert len(names) == len(set(names)) == 2


def test_a_walk_whose_end_is_unknown_has_no_error(captures: Path, tmp_path: Path) -> None:
    shutil.copy(captures / "line.solcap", tmp_path / "blind.solcap")
    done = solenav("compare", tmp_path / "blind.solcap", "--figures", tmp_path / "figures")
    assert done.returncode == 0, done.stderr
    assert "neither truth nor a closed loop" in done.stdout
    assert (tmp_path / "figures" / "blind-tracks.png").exists()
    assert not (tmp_path / "figures" / "errors.png").exists()


def test_bad_input_is_refused(captures: Path, tmp_path: Path) -> None:
    line = captures / "line.solcap"
    refused(solenav("compare"), 2, "no recording")
    refused(solenav("compare", tmp_path), 2, "no captures")
    refused(solenav("compare", tmp_path / "no.solcap"), 2, "No such file")
    refused(solenav("compare", line, "--filter", "ukf"), 2, "'ukf'", "apf-literal")
    refused(solenav("compare", line, "--filter", "apf+gate"), 2, "'gate'")
    refused(solenav("compare", line, "--csv", tmp_path / "x.txt"), 2, ".csv")
    refused(solenav("compare", line, "--figures", tmp_path / "no" / "where"), 2, "no/where")
    for wrong in (("--false-share", "2"), ("--seeds", "0"), ("--jobs", "0")):
        done = solenav("compare", line, *wrong)
        assert done.returncode == 2 and "Traceback" not in done.stderr


def test_comparing_needs_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    with pytest.raises(SolenavError) as caught:
        command.compare([])
    assert "solenav[fast]" in caught.value.remedy
