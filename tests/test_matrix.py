"""Every engine gives the same digest on every tick, over real, simulated and hostile input."""

from __future__ import annotations

import json
import shutil
import sys
import warnings
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from cli import refused, solenav

from solenav import capture, datasets, engines, mpu9150, parameters
from solenav.engines.source import core_path
from solenav.errors import SolenavError
from solenav.sim import torture
from solenav_core import layout, navigator
from solenav_core.layout import STATE_FIELDS, locate
from solenav_tools import matrix, micropython32
from solenav_tools.matrix import ALL, REFERENCE, Matrix, Outcome, Run

PARAMS = parameters.to_integers(parameters.Settings(), 200.0)
WALKS = {case.name: case.counts for case in torture.walks()}
AT = layout.offsets(STATE_FIELDS)
FORCE_MAX = 1300  # Q7 m/s²; strides exceed it, rest does not
# Engines that run a copy of the core, which can be another core than the reference's.
COPIES = ("micropython", "micropython32-viper", "micropython32-mpy", "thumb")
# Format, file, where the slice begins and how long it is in seconds: rest, then some strides.
RECORDINGS = [
    ("llio", "llio/SensorConnectData_34_LLIO.mat", 0.5, 8),
    ("openshoe", "openshoe/Measurement_100521_2_data_inert.txt", 1, 8),
    ("pyshoe", "pyshoe_vicon/2017-11-22-11-22-03.mat", 1, 8),
    ("xio", "xio/short_walk.csv", 13.5, 7),
    ("gaitmap", "gaitmap/imu_sample_healthy_stair_up.csv", 0, 8),
]

Compare = Callable[..., list[Outcome]]
Plant = Callable[[str, str, int], Path]


@pytest.fixture(scope="module")
def every_engine() -> Iterator[Matrix]:
    with Matrix() as found:
        yield found


@pytest.fixture
def all_equal(every_engine: Matrix, record_property: Callable[[str, object], None]) -> Compare:
    """Compares runs on all engines and asserts that those which are here are equal.

    What ran and what didn't goes to the summary at the end, which the log of CI keeps.
    """

    def compare(runs: list[Run], params: array[int] = PARAMS) -> list[Outcome]:
        outcomes = every_engine.compare(runs, params)
        for outcome in outcomes:
            record_property("matrix", [outcome.engine, outcome.skipped])
            if outcome.skipped:
                warnings.warn(f"{outcome.engine} is skipped: {outcome.skipped}", stacklevel=2)
        wrong = {o.engine: str(o) for o in outcomes if not (o.equal or o.skipped)}
        assert not wrong
        ticks = sum(len(run.counts) for run in runs)
        assert all(outcome.ticks == ticks for outcome in outcomes if not outcome.skipped)
        assert sum(outcome.equal for outcome in outcomes) >= 2, "nothing to compare with"
        return outcomes

    return compare


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    """Makes a copy of the core with another value of one module's constant."""

    def other(module: str, line: str, value: int) -> Path:
        core = tmp_path / "planted"
        shutil.copytree(core_path(), core)
        path = core / f"{module}.py"
        text = path.read_text(encoding="utf-8")
        assert text.count(line) == 1
        path.write_text(text.replace(line, f"{line.split()[0]} = const({value})"), encoding="utf-8")
        return core

    return other


def fast_over(run: Run, params: array[int]) -> tuple[engines.Engine, int]:
    """The fast engine after a run, and the steps that it saw."""
    engine = engines.create("fast", params)
    if run.start is not None:
        engine.restore(run.start.tobytes())
    steps = row = 0
    while row < len(run.counts):
        row, events = engine.advance(run.counts, row, mask=navigator.STEP)
        steps += bool(events & navigator.STEP)
    return engine, steps


def as_run(case: torture.Case) -> Run:
    start = navigator.new_state()
    if case.prepare:
        case.prepare(start)
    return Run(case.counts, start, case.name)


# The same digest on every tick


@pytest.mark.parametrize(("kind", "file", "begin", "length"), RECORDINGS, ids=lambda v: str(v))
def test_a_real_recording(
    kind: str, file: str, begin: float, length: float, data: Path, all_equal: Compare
) -> None:
    if kind in ("llio", "pyshoe"):
        pytest.importorskip("scipy")
    path = data / "foot" / file
    if not path.exists():
        pytest.skip(f"{file} is not here")
    recording = datasets.read(path, kind)
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    first = round(begin * recording.rate_hz)
    run = Run(counts[first : first + round(length * recording.rate_hz)], name=kind)
    params = parameters.to_integers(parameters.Settings(), recording.rate_hz)
    engine, steps = fast_over(run, params)
    assert engine.navigating and steps >= 2
    all_equal([run], params)


def test_a_simulated_walk(walk: Path, all_equal: Compare) -> None:
    source = capture.load(walk)
    params = source.params[0][1]
    counts = source.sample_counts
    # A start, and strides from the middle: their distance is the scenario's choice.
    run = Run(np.vstack([counts[:260], counts[3000:4000]]))
    engine, steps = fast_over(run, params)
    assert engine.navigating and steps >= 2
    all_equal([run], params)


def test_the_golden_walks(all_equal: Compare) -> None:
    # 1300 ticks: a start and a few strides, full-scale noise, a flight.
    all_equal([Run(counts[:1300], name=name) for name, counts in WALKS.items()])


def test_the_torture_set(all_equal: Compare) -> None:
    all_equal([as_run(case) for case in torture.short()])


@pytest.mark.parametrize("mounted", [False, True], ids=["as found", "mounting given"])
def test_a_magnetometer_that_steers(mounted: bool, all_equal: Compare) -> None:
    runs = [as_run(case) for case in torture.fields()]
    all_equal(runs, torture.steering(PARAMS, mounted))


@pytest.mark.parametrize("which", [0, 1], ids=["stance", "swing"])
def test_a_minute(which: int, all_equal: Compare) -> None:
    """A whole minute of stance and of swing: at 50 Hz on all engines, at 200 Hz on quick ones."""
    slow = parameters.to_integers(parameters.Settings(), 50.0)
    all_equal([as_run(torture.minutes(50)[which])], slow)
    with Matrix(["fast", "micropython32-viper"]) as quick:
        run = as_run(torture.minutes(200)[which])
        found = {outcome.engine: outcome for outcome in quick.compare([run], PARAMS)}
    assert found["fast"].equal, found["fast"]
    assert not found["micropython32-viper"].wrong, found["micropython32-viper"]


# What the matrix finds


@pytest.mark.parametrize("engine", COPIES)
def test_a_planted_difference_is_found(engine: str, plant: Plant) -> None:
    planted = plant("detector", "_NORM_MAX = const(8191)", FORCE_MAX)
    counts = WALKS["walk"][:300]
    (outcome,) = matrix.run(counts, PARAMS, [engine], core=planted)
    if outcome.skipped:
        pytest.skip(outcome.skipped)
    d = outcome.difference
    assert outcome.wrong and d is not None
    assert outcome.ticks == d.tick - 1
    assert d.tick > 240 and d.stage == "detector" and d.field.startswith("RING[")
    assert d.value == FORCE_MAX
    # Both values are those of the states after that tick.
    pure = engines.create("pure", PARAMS)
    pure.advance(counts, 0, d.tick)
    words = {locate(STATE_FIELDS, i)[1]: word for i, word in enumerate(pure.state)}
    assert words[d.field] == d.reference != d.value
    assert f"tick {d.tick}, stage detector, field {d.field}: {engine} {d.value}" in str(outcome)
    (before,) = matrix.run(counts[: d.tick - 1], PARAMS, [engine], core=planted)
    assert before.equal


@pytest.mark.parametrize("engine", COPIES)
def test_a_difference_in_a_later_run_is_named(engine: str, plant: Plant) -> None:
    planted = plant("strapdown", "_VEL_MAX = const(419430400)", 100)
    walk = WALKS["walk"][:300]
    runs = [Run(np.zeros((5, 6), np.int16), name="dead"), Run(walk, name="walk")]
    with Matrix([engine], planted) as one:
        (outcome,) = one.compare(runs, PARAMS)
    if outcome.skipped:
        pytest.skip(outcome.skipped)
    d = outcome.difference
    assert d is not None and d.run == "walk" and outcome.ticks == 5 + d.tick - 1
    assert d.stage == "navigator" and d.field == "SATURATED" and d.value > d.reference
    assert any(word.startswith("VEL[") for word in d.also)


def test_an_engine_that_gives_up_says_where() -> None:
    start = navigator.new_state()
    torture.navigate(start)
    start[AT["VEL"]] = 2**31 - 1
    counts = np.full((3, 6), 32767, np.int16)
    (outcome,) = matrix.run(counts, PARAMS, ["checked"], start)
    assert outcome.wrong and not outcome.equal
    assert outcome.failed.startswith("run, tick 1: ") and "overflow" in outcome.failed


def test_what_micropython_says_is_a_failure(plant: Plant) -> None:
    planted = plant("detector", "_NORM_MAX = const(8191)", FORCE_MAX)
    (planted / "navigator.py").write_text("raise ValueError('planted')\n", encoding="utf-8")
    (outcome,) = matrix.run(np.zeros((1, 6), np.int16), PARAMS, ["micropython"], core=planted)
    if outcome.skipped:
        pytest.skip(outcome.skipped)
    assert outcome.wrong and "ValueError: planted" in outcome.failed


def test_what_is_not_here_is_skipped_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere() -> list[str]:
        raise SolenavError("no 32-bit MicroPython here: planted", "have one")

    monkeypatch.setattr(micropython32, "command", nowhere)
    monkeypatch.setenv("SOLENAV_MICROPYTHON", "/nowhere/micropython")
    for package in ("unicorn", "numba"):
        monkeypatch.setitem(sys.modules, package, None)
    counts = np.zeros((3, 6), np.int16)
    found = {outcome.engine: outcome for outcome in matrix.run(counts, PARAMS)}
    assert list(found) == list(ALL)
    for name in ("micropython32-viper", "micropython32-mpy"):
        assert found[name].skipped == "no 32-bit MicroPython here: planted; have one"
    assert "/nowhere/micropython" in found["micropython"].skipped
    assert "thumb" in found["thumb"].skipped
    assert found[REFERENCE].equal and found["checked"].equal
    assert all(found[name].skipped for name in COPIES)


def test_progress_reaches_all_ticks_of_all_engines() -> None:
    seen: list[int] = []
    counts = WALKS["walk"][:250]
    matrix.run(counts, PARAMS, ["pure", "fast"], progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 500


def test_an_unknown_engine_is_refused() -> None:
    with pytest.raises(SolenavError, match="no engine 'warp' in the matrix") as caught:
        matrix.run(np.zeros((1, 6), np.int16), PARAMS, ["warp"])
    assert "thumb" in caught.value.remedy


# The command


def test_the_command_prints_a_line_for_each_engine(walk: Path) -> None:
    done = solenav("matrix", walk, "--ticks", "300")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(ALL)
    assert lines[0].endswith("the reference, 300 ticks")
    assert all(line.endswith("equal on 300 ticks") or "skipped: " in line for line in lines[1:]), (
        done.stdout
    )
    assert lines[1].endswith("equal on 300 ticks")


def test_the_command_s_json(walk: Path) -> None:
    arguments = ["--ticks", "50", "--engine", "checked", "--json"]
    done = solenav("matrix", walk, *arguments)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["ticks"] == 50 and result["reference"] == "pure"
    (outcome,) = result["engines"]
    assert outcome["engine"] == "checked" and outcome["equal"] is True
    assert outcome["ticks"] == 50 and outcome["difference"] is None


def test_the_command_refuses_what_it_cannot_compare(walk: Path, tmp_path: Path) -> None:
    refused(solenav("matrix", tmp_path / "none.solcap"), 2, "No such file")
    bad = tmp_path / "bad.solcap"
    bad.write_bytes(b"\x89PNG\r\n\x1a\n123")
    refused(solenav("matrix", bad), 2, "no solenav capture")
    refused(solenav("matrix", walk, "--ticks", "9", "--engine", "pure"), 2, "nothing was compared")


def test_the_command_refuses_an_engine_that_is_not_here(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOLENAV_MICROPYTHON", "/nowhere/micropython")
    done = solenav("matrix", walk, "--ticks", "9", "--engine", "micropython", "--engine", "checked")
    refused(done, 2, "asked for and not here: micropython")
    assert "micropython  skipped: " in done.stdout
    assert "checked      equal on 9 ticks" in done.stdout
