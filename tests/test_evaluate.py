"""What an evaluation says of captures whose errors are known."""

from __future__ import annotations

import json
import math
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from solenav import capture as captures
from solenav import importing, replaying
from solenav.capture import Capture, CaptureWriter, read_records
from solenav.capture.contents import Table
from solenav.errors import SolenavError
from solenav.evaluation import Errors, compare, evaluate, last_run
from solenav.recording import FloatArray, Recording, Truth
from solenav.sim.scenario import simulate

pytest.importorskip("numba")
geometry = pytest.importorskip("evo.core.geometry")


def replayed(recording: Recording, folder: Path, pose_every: int = 1) -> Path:
    """A capture with poses of a recording."""
    raw, path = folder / "raw.solcap", folder / "walk.solcap"
    importing.to_capture(recording, raw)
    replaying.replay(captures.load(raw), path, engine="fast", pose_every=pose_every)
    return path


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Ten strides of the loop, after 15 s of standing."""
    whole = simulate("loop")
    truth = whole.truth
    assert truth is not None and truth.velocity_enu is not None and truth.stance is not None
    n = 6000
    return replace(
        whole,
        time_s=whole.time_s[:n],
        accel=whole.accel[:n],
        gyro=whole.gyro[:n],
        mag=None,
        truth=Truth(
            truth.time_s[:n],
            truth.position_enu[:n],
            truth.velocity_enu[:n],
            truth.stance[:n],
            frame="enu",
        ),
    )


@pytest.fixture(scope="module")
def walk(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return replayed(recording, tmp_path_factory.mktemp("walk"))


@pytest.fixture(scope="module")
def loaded(walk: Path) -> Capture:
    return captures.load(walk)


@pytest.fixture
def with_truth(walk: Path, tmp_path: Path) -> WithTruth:
    return WithTruth(walk, tmp_path)


class WithTruth:
    """Gives the walk another truth, or none."""

    def __init__(self, walk: Path, folder: Path) -> None:
        self.walk = walk
        self.path = folder / "other.solcap"

    def __call__(self, truth: Truth | None) -> Capture:
        shutil.copy(self.walk, self.path)
        replaying.finish(self.path, {}, truth)
        return captures.load(self.path)


def estimate(
    capture: Capture, frame: str = "enu", stance: NDArray[np.bool_] | None = None
) -> Truth:
    """The capture's own estimate as a truth without any error."""
    return Truth(
        capture.time_of_tick(capture.poses.tick),
        capture.positions(),
        capture.poses.rows["velocity"] / 2**24,
        stance if stance is not None else (capture.poses.rows["flags"] & 1) > 0,
        frame=frame,
    )


def turned(vectors: FloatArray, degrees: float) -> FloatArray:
    """Vectors (n, 3) turned counter-clockwise about Up."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return vectors @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def elsewhere(truth: Truth, degrees: float, shift: tuple[float, float, float]) -> Truth:
    """The same truth in a frame that is turned and shifted."""
    assert truth.velocity_enu is not None
    return replace(
        truth,
        position_enu=turned(truth.position_enu, degrees) + np.array(shift),
        velocity_enu=turned(truth.velocity_enu, degrees),
        frame="local",
    )


def assert_errors(errors: Errors | None, east: float, north: float, up: float) -> None:
    assert errors is not None
    assert errors.up is not None and errors.total is not None
    assert [errors.east, errors.north, errors.up] == pytest.approx([east, north, up], abs=1e-6)
    assert errors.horizontal == pytest.approx(math.hypot(east, north), abs=1e-6)
    assert errors.total == pytest.approx(math.hypot(east, north, up), abs=1e-6)


def test_a_walk_is_measured_without_any_truth(loaded: Capture, with_truth: WithTruth) -> None:
    result = evaluate(with_truth(None))
    assert result.truth is None
    assert result.steps == loaded.poses.rows["steps"][-1] >= 9
    assert result.distance_m == pytest.approx(loaded.poses.rows["distance"][-1] / 1024)
    assert result.duration_s == pytest.approx(29.0, abs=0.02)  # the static start is no walk
    end = loaded.positions()[-1] - loaded.positions()[0]
    assert result.closure.total_m == pytest.approx(np.linalg.norm(end))
    assert result.closure.vertical_m == pytest.approx(end[2])
    assert not result.closure.meaningful


def test_a_truth_that_is_asked_for_must_be_there(with_truth: WithTruth) -> None:
    capture = with_truth(None)
    with pytest.raises(SolenavError, match="no truth") as caught:
        evaluate(capture, require_truth=True)
    assert "truth.csv" in caught.value.remedy


def test_a_known_loop_makes_the_closure_an_error(with_truth: WithTruth) -> None:
    nowhere = Truth(np.empty(0), np.empty((0, 3)), closed_loop=True)
    capture = with_truth(nowhere)
    result = evaluate(capture)
    assert result.closure.meaningful
    assert result.truth is None
    with pytest.raises(SolenavError):
        evaluate(capture, require_truth=True)


def test_the_simulated_loop_closes(tmp_path: Path) -> None:
    result = evaluate(captures.load(replayed(simulate("loop"), tmp_path)))
    assert result.closure.meaningful
    assert result.closure.horizontal_share is not None
    assert result.closure.horizontal_m < 1.0
    share = result.closure.horizontal_m / result.distance_m
    assert result.closure.horizontal_share == pytest.approx(share)
    assert result.distance_m == pytest.approx(68.6, abs=1.0)


def test_standing_still_goes_nowhere(tmp_path: Path) -> None:
    result = evaluate(captures.load(replayed(simulate("stand", duration_s=5.0), tmp_path)))
    assert result.steps == 0
    assert result.closure.horizontal_share is None
    assert result.truth is not None
    assert result.truth.final_share is None
    assert result.truth.position_rmse_m.horizontal < 0.05


def test_the_simulator_and_the_core_share_frame_and_clock(loaded: Capture) -> None:
    truth = evaluate(loaded).truth
    assert truth is not None
    assert truth.alignment.mode == "none"
    assert truth.position_rmse_m.horizontal < 0.2
    assert truth.stance_velocity_rmse_mps is not None
    assert truth.stance_velocity_rmse_mps.horizontal < 0.05
    # The static start gives no poses: its truth is not compared.
    assert truth.alignment.points == 6000 - 199


def test_a_known_offset_is_the_error(loaded: Capture, with_truth: WithTruth) -> None:
    exact = estimate(loaded)
    off = replace(exact, position_enu=exact.position_enu - np.array([3.0, -4.0, 1.0]))
    assert off.velocity_enu is not None
    off.velocity_enu = off.velocity_enu + np.array([0.1, 0.2, -0.2])
    result = evaluate(with_truth(off))
    truth = result.truth
    assert truth is not None
    assert_errors(truth.position_rmse_m, 3, 4, 1)
    assert_errors(truth.stance_position_rmse_m, 3, 4, 1)
    assert_errors(truth.final_m, 3, -4, 1)
    assert_errors(truth.stance_velocity_rmse_mps, 0.1, 0.2, 0.2)
    assert truth.final_share == pytest.approx(5 / result.distance_m)


def test_errors_of_stance_are_those_of_the_truths_stance(
    loaded: Capture, with_truth: WithTruth
) -> None:
    exact = estimate(loaded, stance=np.arange(len(loaded.poses)) >= 1000)
    exact.position_enu[:1000] += 7.0
    exact.position_enu[1000:] += [1.0, 2.0, 3.0]
    truth = evaluate(with_truth(exact)).truth
    assert truth is not None
    assert truth.stance_points == len(loaded.poses) - 1000
    assert_errors(truth.stance_position_rmse_m, 1, 2, 3)
    assert truth.position_rmse_m.east > 1


def test_unknown_stance_and_velocity_give_no_figures(
    loaded: Capture, with_truth: WithTruth
) -> None:
    truth = evaluate(with_truth(replace(estimate(loaded), velocity_enu=None))).truth
    assert truth is not None
    assert truth.stance_position_rmse_m is not None
    assert truth.stance_velocity_rmse_mps is None
    truth = evaluate(with_truth(replace(estimate(loaded), stance=None))).truth
    assert truth is not None
    assert truth.stance_points == 0
    assert truth.stance_position_rmse_m is None
    assert truth.stance_velocity_rmse_mps is None


def test_evo_agrees_with_the_errors_per_axis(loaded: Capture, with_truth: WithTruth) -> None:
    noisy = estimate(loaded)
    noisy.position_enu += np.random.default_rng(1).normal(0, 0.3, noisy.position_enu.shape)
    truth = evaluate(with_truth(noisy)).truth
    assert truth is not None
    plane, space = truth.ape_m["horizontal"], truth.ape_m["total"]
    assert plane is not None and space is not None
    assert plane["rmse"] == pytest.approx(truth.position_rmse_m.horizontal, rel=1e-6)
    assert space["rmse"] == pytest.approx(truth.position_rmse_m.total, rel=1e-6)
    assert plane["rmse"] == pytest.approx(0.3 * math.sqrt(2), rel=0.05)


def test_a_local_frame_is_turned_and_shifted_onto_the_estimate(
    loaded: Capture, with_truth: WithTruth
) -> None:
    capture = with_truth(elsewhere(estimate(loaded), 40.0, (10.0, -20.0, 5.0)))
    truth = evaluate(capture).truth
    assert truth is not None
    assert truth.alignment.mode == "yaw"
    assert truth.alignment.points == len(loaded.poses)
    assert math.degrees(truth.alignment.yaw_rad) == pytest.approx(-40.0, abs=1e-4)
    assert_errors(truth.position_rmse_m, 0, 0, 0)
    assert_errors(truth.stance_velocity_rmse_mps, 0, 0, 0)

    plain = evaluate(capture, align="none").truth
    assert plain is not None
    assert plain.alignment.mode == "none"
    assert plain.position_rmse_m.horizontal > 15


def test_a_real_east_and_north_is_left_as_it_is(loaded: Capture, with_truth: WithTruth) -> None:
    off = replace(elsewhere(estimate(loaded), 40.0, (10.0, -20.0, 5.0)), frame="enu")
    capture = with_truth(off)
    truth = evaluate(capture).truth
    assert truth is not None
    assert truth.alignment.mode == "none"
    assert truth.position_rmse_m.horizontal > 15
    fitted = evaluate(capture, align="yaw").truth
    assert fitted is not None
    assert_errors(fitted.position_rmse_m, 0, 0, 0)


def test_origin_joins_the_first_points_and_turns_nothing(
    loaded: Capture, with_truth: WithTruth
) -> None:
    capture = with_truth(elsewhere(estimate(loaded), 90.0, (10.0, -20.0, 5.0)))
    truth = capture.truth
    assert truth is not None
    comparison = compare(capture, truth, "origin")
    assert comparison.error[0] == pytest.approx(np.zeros(3), abs=1e-6)
    end = loaded.positions()[-1] - loaded.positions()[0]
    expected = end - turned(end[np.newaxis], 90.0)[0]
    assert comparison.error[-1] == pytest.approx(expected, abs=1e-6)


def test_the_fit_is_umeyamas(loaded: Capture, with_truth: WithTruth) -> None:
    noisy = elsewhere(estimate(loaded), -70.0, (3.0, 2.0, 1.0))
    noisy.position_enu += np.random.default_rng(2).normal(0, 0.5, noisy.position_enu.shape)
    capture = with_truth(noisy)
    truth = capture.truth
    assert truth is not None
    alignment = compare(capture, truth).alignment
    rotation, shift, _scale = geometry.umeyama_alignment(
        truth.position_enu[:, :2].T, loaded.positions()[:, :2].T
    )
    assert alignment.turned(np.eye(3))[:2, :2] == pytest.approx(rotation.T, abs=1e-9)
    assert alignment.shift_m[:2] == pytest.approx(shift, abs=1e-9)


def test_a_survey_point_per_stride_will_do(loaded: Capture, with_truth: WithTruth) -> None:
    exact = estimate(loaded)
    times = np.arange(2.0017, 28.0, 1.3)
    points = np.column_stack([np.interp(times, exact.time_s, c) for c in exact.position_enu.T])
    local = turned(points, 25.0) + np.array([4.0, 5.0, 0.0])
    local[:, 2] = np.nan
    result = evaluate(with_truth(Truth(times, local)))
    truth = result.truth
    assert truth is not None
    assert truth.alignment.points == len(times)
    assert truth.position_rmse_m.horizontal < 1e-6
    assert truth.position_rmse_m.up is None
    assert truth.position_rmse_m.total is None
    assert truth.final_m.up is None
    assert truth.ape_m["total"] is None
    assert truth.alignment.shift_m[2] == 0.0


def test_a_truth_with_another_rate_costs_nothing(
    recording: Recording, tmp_path: Path, loaded: Capture
) -> None:
    fewer = evaluate(captures.load(replayed(recording, tmp_path, pose_every=4))).truth
    all_poses = evaluate(loaded).truth
    assert fewer is not None and all_poses is not None
    expected = all_poses.position_rmse_m.horizontal
    assert fewer.position_rmse_m.horizontal == pytest.approx(expected, abs=0.005)
    assert fewer.alignment.points == pytest.approx(all_poses.alignment.points, abs=4)


def test_truth_that_knows_nothing_of_a_moment_is_left_out(
    loaded: Capture, with_truth: WithTruth
) -> None:
    exact = estimate(loaded)
    exact.position_enu[:500] = np.nan
    exact.position_enu[500:1000, 2] = np.nan
    exact.position_enu[1000:] += [0.0, 0.0, 2.0]
    truth = evaluate(with_truth(exact)).truth
    assert truth is not None
    assert truth.alignment.points == len(loaded.poses) - 500
    assert truth.position_rmse_m.up == pytest.approx(2.0, abs=1e-6)


def test_truth_in_a_gap_of_the_poses_is_left_out(loaded: Capture, with_truth: WithTruth) -> None:
    capture = with_truth(estimate(loaded))
    kept = np.ones(len(loaded.poses), bool)
    kept[4000:4600] = False
    kept[2000] = False
    poses = loaded.poses
    capture.poses = Table(poses.rows[kept], poses.tick[kept], poses.order[kept])
    truth = evaluate(capture).truth
    assert truth is not None
    assert truth.alignment.points == len(poses) - 600
    assert truth.position_rmse_m.horizontal < 0.001


def test_truth_of_another_time_is_refused(loaded: Capture, with_truth: WithTruth) -> None:
    exact = estimate(loaded)
    capture = with_truth(replace(exact, time_s=exact.time_s + 1.6e9))
    with pytest.raises(SolenavError, match="no point of the truth") as caught:
        evaluate(capture)
    assert "first sample" in caught.value.remedy


def test_a_capture_without_poses_is_refused(walk: Path) -> None:
    raw = captures.load(walk.with_name("raw.solcap"))
    with pytest.raises(SolenavError, match="no poses") as caught:
        evaluate(raw)
    assert "replay" in caught.value.remedy


def test_an_unknown_alignment_is_refused(loaded: Capture) -> None:
    with pytest.raises(SolenavError, match="sim3") as caught:
        evaluate(loaded, align="sim3")
    assert "origin" in caught.value.remedy


def test_evo_is_asked_for_only_where_it_is_needed(
    loaded: Capture, with_truth: WithTruth, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "evo.core.metrics", None)
    with pytest.raises(SolenavError, match="evo") as caught:
        evaluate(loaded)
    assert "solenav[evaluate]" in caught.value.remedy
    assert evaluate(with_truth(None)).steps > 0
    truth = loaded.truth
    assert truth is not None
    assert len(compare(loaded, truth).time_s) > 5000


def test_after_a_restart_the_last_run_counts(walk: Path, tmp_path: Path) -> None:
    path = tmp_path / "twice.solcap"
    pieces = list(read_records(walk))
    with CaptureWriter(path) as writer:
        for time, data in pieces[:4000] + pieces:
            writer.write(time, data)
    twice, once = evaluate(captures.load(path)), evaluate(captures.load(walk))
    assert twice.restarts == 1
    assert once.restarts == 0
    assert twice.poses == once.poses
    assert twice.duration_s == pytest.approx(once.duration_s)
    assert twice.distance_m == once.distance_m
    run, _restarts = last_run(captures.load(path))
    assert run.samples.tick[0] == 1
    assert len(run.aligns) == 1


def test_steps_are_counted_past_the_counters_wrap(loaded: Capture, with_truth: WithTruth) -> None:
    capture = with_truth(None)
    rows = loaded.poses.rows.copy()
    rows["steps"] += np.uint16(65530)
    capture.poses = Table(rows, loaded.poses.tick, loaded.poses.order)
    assert evaluate(capture).steps == 65530 + int(loaded.poses.rows["steps"][-1])


def test_the_result_is_json(loaded: Capture, with_truth: WithTruth) -> None:
    times = np.array([5.0, 20.0])
    blind = Truth(times, np.array([[0.0, 0.0, np.nan], [1.0, 1.0, np.nan]]))
    for capture in (loaded, with_truth(None), with_truth(blind)):
        text = json.dumps(evaluate(capture).as_dict(), allow_nan=False)
        assert json.loads(text)["closure"]["meaningful"] is False
