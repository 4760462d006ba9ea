"""Dead reckoning with a phone: readers, steps, length, heading, and steps of a foot beside them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from solenav import capture, evaluation, pdr, plotting
from solenav.datasets import indoor, kaist
from solenav.errors import SolenavError
from solenav.pdr import step_table, steps
from solenav.pdr.length import features
from solenav.pdr.track import SOURCES
from solenav.recording import FloatArray, Recording, Truth

pytest.importorskip("dtaidistance")

RATE = 50.0


def carried(
    seconds: float = 30.0, *, cadence: float = 1.8, turn: float = 0.0, noise: float = 0.05
) -> Recording:
    """A phone held level, its y axis ahead, walked at `cadence` Hz while turning `turn` rad/s."""
    rng = np.random.default_rng(1)
    time_s = np.arange(round(seconds * RATE)) / RATE
    accel = np.column_stack([np.zeros((len(time_s), 2)), np.full(len(time_s), 9.81)])
    accel[:, 2] += 3.0 * np.sin(2 * np.pi * cadence * time_s) * (cadence > 0)
    gyro = np.zeros_like(accel)
    gyro[:, 2] = turn
    yaw = turn * time_s
    # North, 30 µT, is straight ahead at the start.
    mag = np.column_stack([30 * np.sin(yaw), 30 * np.cos(yaw), np.full(len(yaw), -40.0)])
    return Recording("walk", time_s, accel + rng.normal(0, noise, accel.shape), gyro, RATE, mag=mag)


def phone_traces(data: Path) -> list[Recording]:
    folder = data / "phone"
    runs = sorted((folder / "kaist/rawdata/test-KI-1F-S9").iterdir())
    found = [
        kaist.read(run, way_points=folder / f"kaist/est-result/ki-gt-s{k}.json")
        for k, run in enumerate(runs, 1)
    ]
    files = sorted((folder / "indoor_competition/site2/F8/path_data_files").glob("*.txt"))
    return found + [indoor.read(file) for file in files]


# --- steps ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("cadence", [1.4, 1.8, 2.3])
def test_every_step_of_a_steady_walk_is_counted(cadence: float) -> None:
    seen = pdr.level(carried(30.0, cadence=cadence))
    assert len(pdr.detect(seen.time_s, seen.vertical)) == pytest.approx(30 * cadence, abs=1.5)


def test_no_step_is_counted_while_standing() -> None:
    for noise in (0.0, 0.05, 0.3):
        seen = pdr.level(carried(60.0, cadence=0.0, noise=noise))
        assert len(pdr.detect(seen.time_s, seen.vertical)) == 0


def test_a_single_jolt_is_no_step() -> None:
    standing = carried(20.0, cadence=0.0)
    accel = standing.accel.copy()
    accel[500:510, 2] += 8.0
    seen = pdr.level(replace(standing, accel=accel))
    found = pdr.detect(seen.time_s, seen.vertical)
    assert len(found) == 0
    assert found.refused >= 1


def test_steps_of_steady_walking_are_those_that_the_gyro_counts_within_2_percent(
    data: Path,
) -> None:
    """The reference is another sensor's: cycles of the gyro's main axis, by their phase."""
    signal = pytest.importorskip("scipy.signal")
    detected = reference = 0.0
    for trace in phone_traces(data):
        seen = pdr.level(trace)
        found = pdr.detect(seen.time_s, seen.vertical)
        band = signal.butter(2, (1.2, 2.8), "bandpass", fs=trace.rate_hz, output="sos")
        size = np.linalg.norm(trace.accel, axis=1)
        sway = np.abs(signal.hilbert(signal.sosfiltfilt(band, size - size.mean())))
        turning = signal.sosfiltfilt(band, trace.gyro - trace.gyro.mean(axis=0), axis=0)
        for a, b in stretches(sway > 1.5, 4 * trace.rate_hz):
            begin, end = trace.time_s[a], trace.time_s[b - 1]
            within = np.minimum(found.time_s, end) - np.maximum(found.begin_s, begin)
            detected += float((within.clip(0) / (found.time_s - found.begin_s)).sum())
            axis = np.linalg.svd(turning[a:b], full_matrices=False)[2][0]
            phase = np.unwrap(np.angle(signal.hilbert(turning[a:b] @ axis)))
            reference += float(phase[-1] - phase[0]) / (2 * np.pi)
    assert reference > 1000
    assert detected == pytest.approx(reference, rel=0.02)


def test_no_step_lies_within_a_stand_of_the_phone_traces(data: Path) -> None:
    stands = 0
    for trace in phone_traces(data):
        seen = pdr.level(trace)
        found = pdr.detect(seen.time_s, seen.vertical)
        size = np.linalg.norm(trace.accel, axis=1)
        for a, b in stretches(np.abs(size - np.median(size)) < 1.0, 0.5 * trace.rate_hz):
            within = (found.begin_s >= trace.time_s[a]) & (found.time_s <= trace.time_s[b - 1])
            assert not within.any(), (trace.name, trace.time_s[a])
            stands += 1
    assert stands > 20


def stretches(mask: NDArray[np.bool_], least: float) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(np.int8)))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a >= least]


def test_the_foot_recordings_resting_sensor_makes_no_step(data: Path) -> None:
    from solenav import datasets

    folder = data / "static/mpu6050/unmoved-with-x-pointing-forward-10min"
    file = folder / "mpu6050_accelerometer.mat"
    resting = datasets.read(file, "mpu6050").first(60.0)
    seen = pdr.level(resting)
    assert len(pdr.detect(seen.time_s, seen.vertical)) == 0


# --- length, heading, track ----------------------------------------------------------------------


def test_length_adapts_to_a_user_whose_steps_are_longer() -> None:
    seen = pdr.level(carried(30.0))
    found = pdr.detect(seen.time_s, seen.vertical)
    own = pdr.GENERIC
    metres = 1.2 * float(own.of(found).sum())
    for _ in range(3):
        own = own.adapted(found, metres)
    assert own.of(found).sum() == pytest.approx(metres, rel=0.02)
    assert features(found).shape == (len(found), 3)


def test_way_points_make_the_length_of_later_legs_better(data: Path) -> None:
    generic, own = [], []
    for trace in phone_traces(data)[:3]:
        assert trace.truth is not None
        _, legs = pdr.adapted(trace, trace.truth)
        generic.append(abs(legs[:, 1].sum() - legs[:, 0].sum()) / legs[:, 0].sum())
        own.append(abs(legs[:, 2].sum() - legs[:, 0].sum()) / legs[:, 0].sum())
    assert np.mean(own) < np.mean(generic)


def test_a_walk_round_a_circle_comes_back() -> None:
    walk = pdr.reckon(carried(40.0, turn=2 * np.pi / 40))
    assert np.hypot(*walk.position[-1, :2]) < 0.05 * walk.distance_m
    assert walk.distance_m == pytest.approx(walk.position_s[-1] * 1.8 * 0.65, rel=0.1)


def test_the_gyro_heading_starts_where_it_is_told() -> None:
    walk = pdr.reckon(carried(20.0), start=(3.0, 4.0), start_heading=np.pi / 2)
    assert walk.position[0].tolist() == [3.0, 4.0, 0.0]
    assert walk.displacement[:, 0] == pytest.approx(0.0, abs=0.05)
    assert (walk.displacement[:, 1] > 0.4).all()


def test_the_magnetometer_heading_knows_north() -> None:
    walk = pdr.reckon(carried(20.0), heading="magnetometer")
    assert (walk.displacement[:, 1] > 0.4).all()


def test_covariance_grows_along_the_way() -> None:
    walk = pdr.reckon(carried(20.0))
    sizes = np.trace(walk.position_covariance, axis1=1, axis2=2)
    assert sizes[0] == 0.0
    assert (np.diff(sizes) > 0).all()
    assert (np.linalg.eigvalsh(walk.covariance[:, :2, :2]) > 0).all()


def test_a_foots_step_messages_make_the_same_kind_of_track(replayed: Path) -> None:
    run = capture.load(replayed)
    walk = pdr.of_capture(run)
    assert walk.source == "foot"
    assert len(walk) == len(run.steps)
    # The core sums lengths in space, from the same displacements.
    lengths = np.linalg.norm(walk.displacement, axis=1).sum()
    assert lengths == pytest.approx(run.steps.rows["distance"][-1] / 2**10, rel=0.01)
    assert (walk.covariance >= 0).all()


def test_a_capture_without_steps_is_refused(walk: Path) -> None:
    with pytest.raises(SolenavError, match="no steps"):
        pdr.of_capture(capture.load(walk))


def test_evaluate_and_plot_take_steps_of_waist_and_foot(replayed: Path, tmp_path: Path) -> None:
    pytest.importorskip("evo")
    walks = {"foot": pdr.of_capture(capture.load(replayed)), "waist": pdr.reckon(carried(20.0))}
    for source, walk in walks.items():
        truth = Truth(
            walk.position_s[1:], walk.position[1:] + np.array([1.0, 0.0, 0.0]), frame="enu"
        )
        found = evaluation.evaluate_steps(walk, truth)
        assert found.steps == len(walk)
        assert found.distance_m == pytest.approx(walk.distance_m)
        assert found.truth is not None
        assert found.truth.position_rmse_m.east == pytest.approx(1.0, abs=1e-6)
        assert evaluation.evaluate_steps(walk, None).truth is None
        picture = tmp_path / f"{source}.png"
        plotting.plot_steps(walk, picture, truth=truth)
        assert picture.stat().st_size > 5_000


# --- steps in a file ---------------------------------------------------------------------------


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), source=st.sampled_from(SOURCES))
def test_a_walk_comes_back_from_its_table(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int, source: str
) -> None:
    rng = np.random.default_rng(seed)
    spread = rng.normal(0, 0.1, (count, 3, 3))
    walk = pdr.StepTrack(
        "steps",
        np.cumsum(rng.uniform(0.3, 2.0, count)),
        rng.normal(0, 1, (count, 3)),
        rng.uniform(0, 2 * np.pi, count),
        spread @ spread.transpose(0, 2, 1),
        rng.normal(0, 100, 3),
        -1.0,
        source,
    )
    path = tmp_path_factory.mktemp("table") / "steps.csv"
    truth = Truth(walk.time_s, walk.position[1:], frame="enu")
    step_table.write(path, walk, truth)
    back, known = step_table.read(path)
    assert (back.name, back.source, back.start_s) == ("steps", source, -1.0)
    assert back.position == pytest.approx(walk.position, abs=1e-5)
    assert back.position_s == pytest.approx(walk.position_s, rel=1e-8)
    assert back.covariance == pytest.approx(walk.covariance, abs=1e-7)
    assert np.cos(back.heading - walk.heading) == pytest.approx(np.ones(count), abs=1e-9)
    assert known is not None and known.frame == "enu"
    assert known.position_enu == pytest.approx(truth.position_enu, abs=1e-5)
    # Another walk under the same name doesn't get this one's truth.
    step_table.write(path, walk)
    assert step_table.read(path)[1] is None


@pytest.mark.parametrize(
    ("column", "cell", "says"),
    [
        ("time_s", "0.0", r"steps\.csv, line 5: time goes back"),
        ("x_m", "nan", r"line 5: x_m is nan"),
        ("x_m", "east", r"line 5: could not convert"),
        ("heading_deg", "", r"line 5: heading_deg is nan"),
        ("xx_m2", "-1", r"line 5: the step's variances are negative"),
        ("source", "horse", r"line 5: the source is 'horse'"),
        ("source", "foot", r"line 5: the source is 'foot'"),
        ("source", "waist,more", r"line 5: 14 cells, expected 13"),
    ],
)
def test_a_broken_table_is_refused_with_its_line(
    tmp_path: Path, column: str, cell: str, says: str
) -> None:
    lines = step_table.table(pdr.reckon(carried(20.0))).splitlines()
    cells = lines[4].split(",")
    cells[lines[0].split(",").index(column)] = cell
    lines[4] = ",".join(cells)
    path = tmp_path / "steps.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(SolenavError, match=says):
        step_table.read(path)
    path.write_text("\n".join(lines[:2]))
    with pytest.raises(SolenavError, match="no steps"):
        step_table.read(path)


def test_steps_need_a_truth_where_one_is_required() -> None:
    walk = pdr.reckon(carried(20.0))
    with pytest.raises(SolenavError, match="no truth"):
        evaluation.evaluate_steps(walk, None, require_truth=True)


# --- bad input -----------------------------------------------------------------------------------


def test_what_cannot_be_reckoned_is_refused() -> None:
    good = carried(10.0)
    with pytest.raises(SolenavError, match="no magnetometer"):
        pdr.reckon(replace(good, mag=None), heading="magnetometer")
    holes = np.array(good.mag)
    holes[100:120] = np.nan
    with pytest.raises(SolenavError, match=r"hole at 2\.00 s"):
        pdr.reckon(replace(good, mag=holes), heading="magnetometer")
    with pytest.raises(SolenavError, match="unknown heading"):
        pdr.reckon(good, heading="compass")
    with pytest.raises(SolenavError, match="contradict"):
        pdr.reckon(good, heading="magnetometer", start_heading=1.0)
    with pytest.raises(SolenavError, match="no steps"):
        pdr.reckon(carried(10.0, cadence=0.0))
    for values in (good.accel, good.gyro):
        broken = values.copy()
        broken[250, 1] = np.nan
        name = "accel" if values is good.accel else "gyro"
        with pytest.raises(SolenavError, match=rf"walk, 5\.00 s: {name} y is nan"):
            pdr.reckon(replace(good, **{name: broken}))
    late = good.time_s + 0.5 * (good.time_s >= 5.0)
    with pytest.raises(SolenavError, match=r"walk, 5\.50 s: 0\.520 s without samples"):
        pdr.reckon(replace(good, time_s=late))
    with pytest.raises(SolenavError, match="NaN"):
        steps.detect(good.time_s, np.full(len(good.time_s), np.nan))
    with pytest.raises(SolenavError, match="too few"):
        steps.detect(np.arange(50) / 5.0, np.ones(50))


# --- readers -------------------------------------------------------------------------------------


def write_kaist(folder: Path, seconds: float = 4.0, mag: bool = True) -> Path:
    folder.mkdir(exist_ok=True)
    rows = {"Accelerometer": (0.0, 0.0, 9.8), "Gyroscope": (0.0, 0.0, 0.1)}
    if mag:
        rows["MagneticField"] = (20.0, 0.0, -40.0)
    for name, value in rows.items():
        lines = ["timeMillis,timeNanos,x,y,z"]
        for i in range(round(seconds * RATE)):
            x, y, z = value
            lines.append(f"{1000 + 20 * i},{500_000_000 + 20_000_000 * i},{x},{y},{z}")
        (folder / f"{name}.csv").write_text("\n".join(lines))
    (folder / "Timestamp.csv").write_text("timestamp\n1000\n3000\n4000\n")
    return folder


def write_points(path: Path, points: list[list[float]]) -> Path:
    path.write_text(json.dumps(points))
    return path


def test_kaist_way_points_get_their_times(tmp_path: Path) -> None:
    points = write_points(tmp_path / "gt.json", [[1.0, 2.0], [3.0, 4.0]])
    trace = kaist.read(write_kaist(tmp_path / "run"), way_points=points)
    assert trace.truth is not None and trace.mag is not None
    assert trace.truth.time_s.tolist() == pytest.approx([0.0, 2.0])
    assert trace.truth.position_enu[:, :2].tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_kaist_faults_are_named(tmp_path: Path) -> None:
    run = write_kaist(tmp_path / "run", mag=False)
    assert kaist.read(run).mag is None
    with pytest.raises(SolenavError, match="3 way points"):
        kaist.read(run, way_points=write_points(tmp_path / "gt.json", [[1.0, 2.0]] * 3))
    with pytest.raises(SolenavError, match="no list of way points"):
        kaist.read(run, way_points=write_points(tmp_path / "gt.json", [[1.0]]))
    with pytest.raises(SolenavError, match="no folder"):
        kaist.read(tmp_path / "absent")
    text = (run / "Gyroscope.csv").read_text()
    (run / "Gyroscope.csv").write_text(text.replace(",0.1", ",nan", 1))
    with pytest.raises(SolenavError, match=r"Gyroscope\.csv, line 2: z is nan"):
        kaist.read(run)
    cut = text.splitlines()
    (run / "Gyroscope.csv").write_text("\n".join(cut[:50] + cut[70:]))
    with pytest.raises(SolenavError, match="without samples"):
        kaist.read(run)


def indoor_lines(seconds: float = 3.0) -> list[str]:
    lines = [
        "#\tSiteID:5dbc\tSiteName:mall\tFloorId:x\tFloorName:F8",
        "1000\tTYPE_WAYPOINT\t1.0\t2.0",
    ]
    for i in range(round(seconds * RATE)):
        ms = 1000 + 20 * i
        lines.append(f"{ms}\tTYPE_ACCELEROMETER\t0.0\t0.0\t9.8\t3")
        lines.append(f"{ms}\tTYPE_GYROSCOPE\t0.0\t0.0\t0.1\t3")
        lines.append(f"{ms}\tTYPE_MAGNETIC_FIELD\t20.0\t0.0\t-40.0\t3")
    return lines


def test_the_indoor_format_knows_floor_way_points_and_field(tmp_path: Path) -> None:
    file = tmp_path / "walk.txt"
    file.write_text("\n".join(indoor_lines()))
    trace = indoor.read(file)
    assert trace.notes["floor"] == "F8"
    assert trace.truth is not None and trace.mag is not None
    assert trace.truth.position_enu[0, :2].tolist() == [1.0, 2.0]
    file.write_text("\n".join(line for line in indoor_lines() if "MAGNETIC" not in line))
    assert indoor.read(file).mag is None
    file.write_text("\n".join(line for line in indoor_lines() if "GYRO" not in line))
    with pytest.raises(SolenavError, match="no rate of turn"):
        indoor.read(file)


@pytest.mark.parametrize("kind", ["ACCELEROMETER", "GYROSCOPE", "MAGNETIC_FIELD"])
@pytest.mark.parametrize(("first", "last"), [(0, 20), (60, 80), (130, 150)])
def test_a_hole_in_one_sensor_of_an_indoor_file_is_refused_with_its_line(
    tmp_path: Path, kind: str, first: int, last: int
) -> None:
    missing = {f"{1000 + 20 * i}\tTYPE_{kind}" for i in range(first, last)}
    left = [line for line in indoor_lines() if "\t".join(line.split("\t")[:2]) not in missing]
    file = tmp_path / "walk.txt"
    file.write_text("\n".join(left))
    if kind == "ACCELEROMETER" and (first == 0 or last == 150):
        # A recording begins and ends with its accelerometer.
        assert len(indoor.read(file).time_s) == 130
    else:
        with pytest.raises(SolenavError, match=r"line \d+: 0\.4.* s without samples"):
            indoor.read(file)


@settings(max_examples=40)
@given(
    row=st.integers(1, 300),
    junk=st.sampled_from(["", "nan", "x", "1e999", "\t", "-5\tTYPE_GYROSCOPE\t1\t2\t3"]),
)
def test_a_damaged_indoor_file_is_read_or_refused_with_its_line(
    tmp_path_factory: pytest.TempPathFactory, row: int, junk: str
) -> None:
    lines = indoor_lines()
    cells = lines[row].split("\t")
    cells[-2] = junk
    lines[row] = "\t".join(cells)
    file = tmp_path_factory.mktemp("indoor") / "walk.txt"
    file.write_text("\n".join(lines))
    try:
        trace = indoor.read(file)
    except SolenavError as error:
        assert str(file) in error.message and error.remedy
    else:
        assert np.isfinite(trace.accel).all() and np.isfinite(trace.gyro).all()


def test_the_phone_recordings_read_whole(data: Path) -> None:
    traces = phone_traces(data)
    assert len(traces) == 27
    walked: list[float] = []
    for trace in traces:
        assert trace.mag is not None and np.isfinite(trace.mag).all()
        assert 49 < trace.rate_hz < 51
        assert isinstance(trace.truth, Truth)
        points: FloatArray = trace.truth.position_enu[:, :2]
        walked.append(float(np.hypot(*np.diff(points, axis=0).T).sum()))
    assert [round(w) for w in walked[:3]] == [139, 57, 67]
