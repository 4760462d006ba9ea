"""Detector parameters for one's own walks, and what the tuner says against them."""

from __future__ import annotations

import json
import math
import runpy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli import refused, solenav

from solenav import capture, importing
from solenav.capture import CaptureWriter, read_records
from solenav.errors import SolenavError
from solenav.filters.walk import Walk
from solenav.parameters import Settings, to_integers
from solenav.recording import Recording, Truth
from solenav.sim.scenario import simulate
from solenav_core.tables.defaults import PARAMS

pytest.importorskip("numba")
pytest.importorskip("scipy")

from solenav import tuning
from solenav.tuning import Report, configured, error_m, from_capture, from_recording, run, tune

# A foot at rest is outside: what remains are moments of the swing.
SPOILT = replace(Settings(), accel_min=10.5, accel_max=19.0)
BUDGET = 32
RATE_HZ = 50.0  # for speed
FIRMWARE = Path(__file__).parents[1] / "firmware"


def loop(seed: int) -> Recording:
    """A closed loop of which nothing else is known."""
    recording = simulate("loop", rate_hz=RATE_HZ, seed=seed)
    return replace(recording, truth=None, name=f"loop-{seed}")


@pytest.fixture(scope="module")
def loops() -> list[Walk]:
    return [from_recording(loop(seed), closed_loop=True) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def known() -> Walk:
    """A walk whose every position is known."""
    return from_recording(simulate("loop", rate_hz=RATE_HZ, seed=1))


@pytest.fixture(scope="module")
def one(loops: list[Walk]) -> Report:
    return tune(loops[:1], SPOILT, budget=BUDGET, jobs=1)


@pytest.fixture(scope="module")
def several(loops: list[Walk]) -> Report:
    return tune(loops, SPOILT, budget=BUDGET, jobs=1)


@pytest.fixture(scope="module")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of the loop whose end nobody marked."""
    path = tmp_path_factory.mktemp("tune") / "loop.solcap"
    importing.to_capture(loop(1), path)
    return path


def closure_m(walk: Walk, settings: Settings) -> float:
    return error_m(walk, run(walk, settings))


def warned(report: Report, text: str) -> bool:
    return any(text in warning for warning in report.warnings)


def test_a_spoilt_detector_is_mended(loops: list[Walk], one: Report) -> None:
    assert closure_m(loops[0], SPOILT) > 0.25
    assert closure_m(loops[0], one.settings) < 0.06
    assert one.gain > 4.0
    assert one.beyond_seeds


def test_what_was_found_serves_walks_that_it_never_saw(loops: list[Walk], one: Report) -> None:
    for walk in loops[1:]:
        assert closure_m(walk, one.settings) < 0.5 * closure_m(walk, SPOILT)


def test_one_recording_is_called_too_little(one: Report) -> None:
    assert warned(one, "one recording proves little")
    assert one.verdict == "unproven"
    assert one.held_out is None and one.held_out_gain is None
    assert one.recordings[0].held_out_m is None


def test_closure_is_called_blind_to_scale(one: Report) -> None:
    assert one.recordings[0].kind == "closure"
    assert warned(one, "wrong scale")


def test_several_recordings_are_left_out_in_turn(several: Report) -> None:
    assert several.held_out == "recordings"
    assert several.held_out_gain is not None and several.held_out_gain > 2.0
    for judged in several.recordings:
        assert judged.held_out_m is not None and judged.held_out_m < judged.start_m
    assert several.verdict == "better"
    assert not warned(several, "one recording")


def test_halves_of_the_truth_judge_a_single_recording(known: Walk) -> None:
    report = tune([known], SPOILT, budget=16, jobs=1)
    assert report.recordings[0].kind == "truth"
    assert report.held_out == "halves"
    assert report.held_out_gain is not None and report.held_out_gain > 1.0
    assert report.verdict == "unproven"


def test_good_parameters_are_kept(loops: list[Walk]) -> None:
    report = tune(loops[:2], budget=16, jobs=1)
    assert report.verdict == "no better"
    assert warned(report, "keep the parameters you have") or warned(report, "fitted to these walks")


def test_each_parameter_has_a_range_around_it(several: Report) -> None:
    names = [dimension.name for dimension in several.dimensions]
    assert names == ["accel_band", "rate_max_dps", "accel_variance_max", "window_s"]
    for d in several.dimensions:
        assert d.bounds[0] <= d.low <= d.value <= d.high <= d.bounds[1]


def landscape(walks: Sequence[Walk], settings: Settings) -> list[float]:
    """Errors least at 40 °/s, less the larger the variance, and the same for any window."""
    off = math.log(settings.rate_max_dps / 40.0)
    error = math.exp(off**2) * settings.accel_variance_max**-0.5
    return [error * (i + 1) for i in range(len(walks))]


def test_what_is_best_is_found_and_how_closely_it_is_known(
    loops: list[Walk], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tuning, "_errors", landscape)
    report = tune(loops, jobs=1)
    band, rate, variance, window = report.dimensions
    assert rate.value == pytest.approx(40.0, rel=0.1)
    # Where (ln(rate / 40))**2 reaches ln 1.1, to a step of the sweep.
    assert 25.0 < rate.low < rate.value < rate.high < 60.0
    assert variance.value > 90.0 and variance.at_bound
    assert [d.name for d in report.dimensions if d.at_bound] == ["accel_variance_max"]
    assert warned(report, "accel_variance_max ended at the bound")
    # What makes no difference stays where it was.
    assert band.inert and window.inert
    assert band.value == pytest.approx(band.start) and window.value == pytest.approx(window.start)
    assert report.gain == pytest.approx(
        landscape(loops, Settings())[0] / landscape(loops, report.settings)[0]
    )


def test_the_band_may_have_two_sides(loops: list[Walk]) -> None:
    report = tune(loops[:1], SPOILT, symmetric=False, budget=16, jobs=1)
    names = [dimension.name for dimension in report.dimensions]
    assert names[:2] == ["accel_below", "accel_above"]
    s = report.settings
    g = 9.80665
    assert g - s.accel_min == pytest.approx(report.dimensions[0].value)
    assert s.accel_max - g == pytest.approx(report.dimensions[1].value)


def test_other_settings_may_be_searched(loops: list[Walk]) -> None:
    report = tune(loops[:1], SPOILT, also=["freeze_s"], budget=16, jobs=1)
    freeze = report.dimensions[-1]
    assert freeze.name == "freeze_s"
    assert freeze.bounds == pytest.approx((1.0, 100.0))
    assert report.settings.freeze_s == pytest.approx(freeze.value)


def test_processes_change_nothing(loops: list[Walk]) -> None:
    alone, two = (tune(loops[:1], SPOILT, budget=16, jobs=jobs) for jobs in (1, 2))
    assert alone == two


def test_a_walk_is_judged_at_its_own_heading() -> None:
    recording = simulate("line35", rate_hz=RATE_HZ)
    assert recording.notes["initial_heading_rad"] != 0.0
    walk = from_recording(recording)
    assert error_m(walk, run(walk, Settings())) < 1.0


def test_a_marked_loop_needs_no_flag(tmp_path: Path) -> None:
    none = np.empty((0, 3))
    truth = Truth(np.empty(0), none, closed_loop=True)
    importing.to_capture(replace(loop(1), truth=truth), tmp_path / "marked.solcap")
    walk = from_capture(capture.load(tmp_path / "marked.solcap"))
    assert walk.truth is not None and walk.truth.closed_loop


def test_a_walk_without_a_judge_says_how_to_mark_it() -> None:
    with pytest.raises(SolenavError) as found:
        from_recording(loop(1))
    assert "neither a truth nor a closed loop" in found.value.message
    assert "--closed-loop" in found.value.remedy and '"closed_loop": true' in found.value.remedy


def test_a_walk_that_never_stands_still_is_refused() -> None:
    recording = loop(1)
    walking = recording.time_s > 20.0
    moving = replace(
        recording,
        time_s=recording.time_s[walking] - recording.time_s[walking][0],
        accel=recording.accel[walking] + np.array([0.0, 0.0, 5.0]),
        gyro=recording.gyro[walking],
    )
    with pytest.raises(SolenavError, match="no static start"):
        from_recording(moving, closed_loop=True)


def test_a_short_walk_is_refused() -> None:
    with pytest.raises(SolenavError, match="too short"):
        from_recording(loop(1).first(8.0), closed_loop=True)


def test_a_foot_that_stays_where_it_is_is_refused() -> None:
    with pytest.raises(SolenavError, match="never swings"):
        from_recording(simulate("stand", rate_hz=RATE_HZ))


def test_a_capture_with_holes_is_refused(captured: Path, tmp_path: Path) -> None:
    holed = tmp_path / "holed.solcap"
    with CaptureWriter(holed, flush=False) as writer:
        for i, (arrival, data) in enumerate(read_records(captured)):
            if not 1500 < i < 1600:
                writer.write(arrival, data)
    with pytest.raises(SolenavError, match="lost 99 of"):
        from_capture(capture.load(holed), closed_loop=True)


@pytest.mark.parametrize(
    "wrong", [{"budget": 15}, {"also": ["speed"]}, {"also": ["seed"]}, {"also": ["log_floor"]}]
)
def test_what_cannot_be_searched_is_refused(loops: list[Walk], wrong: dict[str, object]) -> None:
    with pytest.raises(SolenavError):
        tune(loops[:1], jobs=1, **wrong)  # type: ignore[arg-type]


def test_the_firmware_takes_the_configuration(
    several: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "config.json").write_text(json.dumps(several.config()))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(FIRMWARE)
    _settings, params, _forest, problems = runpy.run_path(str(FIRMWARE / "config.py"))["load"]()
    assert problems == []
    # The recordings' rate is not that of the firmware's defaults: everything follows.
    assert params == to_integers(several.settings, RATE_HZ)


def test_host_tools_take_the_configuration(several: Report) -> None:
    wanted = to_integers(several.settings, RATE_HZ)
    assert configured(PARAMS, several.config()) == wanted
    assert configured(PARAMS, {}) == PARAMS
    with pytest.raises(SolenavError, match="no parameter ACC_MEAN"):
        configured(PARAMS, {"params": {"ACC_MEAN": 1}})
    with pytest.raises(SolenavError, match="ACC_SCALE"):
        configured(PARAMS, {"params": {"ACC_SCALE": 0}})


def test_at_the_firmwares_rate_only_the_detector_changes() -> None:
    fragment = tuning.config(replace(Settings(), rate_max_dps=70.0), 200.0)
    assert set(fragment["params"]) == {"ACC_MIN", "ACC_MAX", "RATE_MAX", "VAR_MAX", "WINDOW"}


def test_the_command_writes_a_configuration(captured: Path, tmp_path: Path) -> None:
    target = tmp_path / "config.json"
    arguments = ("tune", captured, "--closed-loop", "--budget", "16", "--jobs", "1")
    done = solenav(*arguments, "-o", target, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["config"] == json.loads(target.read_text())
    assert found["recordings"][0]["name"] == "loop"
    assert any("one recording" in warning for warning in found["warnings"])
    told = solenav(*arguments)
    assert told.returncode == 0, told.stderr
    assert "rate_max_dps" in told.stdout and "within 10 %" in told.stdout
    assert "warning: one recording proves little" in " ".join(told.stderr.split())


def test_a_configuration_that_cannot_be_written_is_told(captured: Path, tmp_path: Path) -> None:
    (tmp_path / "folder.json").mkdir()
    done = solenav("tune", captured, "--closed-loop", "-o", tmp_path / "folder.json", "--budget=16")
    refused(done, 2, "can't write", "choose another file")


def test_the_command_explains_what_it_lacks(captured: Path, tmp_path: Path) -> None:
    refused(solenav("tune", captured), 2, "neither a truth nor a closed loop", "--closed-loop")
    sidecar = captured.with_suffix(".json")
    before = sidecar.read_text()
    refused(solenav("tune", captured, "--closed-loop", "-o", sidecar), 2, "beside the capture")
    assert sidecar.read_text() == before
    refused(solenav("tune", captured, "-o", tmp_path / "a.txt"), 2, "should end in .json")
