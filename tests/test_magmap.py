"""Magnetic maps: surveyed, kriged, kept, and walks found on them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solenav import magmap
from solenav.datasets import kaist
from solenav.errors import SolenavError
from solenav.magmap.positioning import TUNING, brighter, centre
from solenav.magmap.surveying import variograms_of
from solenav.recording import FloatArray, Recording, Truth

pytest.importorskip("pykrige")
pytest.importorskip("dtaidistance")

RATE = 50.0
CADENCE = 1.8
FAST = replace(TUNING, particles=200)


def field_at(points: FloatArray) -> FloatArray:
    """A floor's field (n, 3): waves of a few metres over the Earth's."""
    x, y = points.T
    return np.column_stack(
        [
            5 + 12 * np.sin(x / 1.7) * np.cos(y / 2.3),
            25 + 12 * np.cos(x / 2.1 + y / 3.0),
            -40 + 12 * np.sin(x / 2.6 - y / 1.9),
        ]
    )


def walked(corners: list[tuple[float, float]], name: str = "walk", seed: int = 1) -> Recording:
    """A phone carried from corner to corner at the generic step length, with way points."""
    rng = np.random.default_rng(seed)
    points = np.array(corners)
    legs = np.diff(points, axis=0)
    lengths = np.hypot(legs[:, 0], legs[:, 1])
    # Generic: 0.25 m/Hz, 0.01 of the variance 4.5 (m/s²)², 0.15 m.
    speed = (0.25 * CADENCE + 0.01 * 4.5 + 0.15) * CADENCE
    passed = np.r_[0.0, np.cumsum(lengths / speed)]
    time_s = np.arange(round((passed[-1] + 1.0) * RATE)) / RATE
    place = np.column_stack([np.interp(time_s, passed, points[:, k]) for k in (0, 1)])
    course = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    leg = np.clip(np.searchsorted(passed, time_s, side="right") - 1, 0, len(legs) - 1)
    # Corners take half a second.
    yaw = np.convolve(np.pad(course[leg], 12, mode="edge"), np.ones(25) / 25, "valid")
    east, north, up = field_at(place).T
    # The phone's y axis points ahead, x to the right.
    c, s = np.cos(yaw), np.sin(yaw)
    mag = np.column_stack([s * east - c * north, c * east + s * north, up])
    accel = np.zeros_like(mag)
    accel[:, 2] = 9.81 + 3.0 * np.sin(2 * np.pi * CADENCE * time_s)
    gyro = np.zeros_like(mag)
    gyro[:, 2] = np.gradient(yaw, time_s)
    known = np.column_stack([points, np.full(len(points), np.nan)])
    return Recording(
        name,
        time_s,
        accel + rng.normal(0, 0.05, accel.shape),
        gyro + rng.normal(0, 0.005, gyro.shape),
        RATE,
        Truth(passed, known, frame="enu"),
        mag=mag + rng.normal(0, 0.5, mag.shape),
        notes={"floor": "1F"},
    )


LOOP = [(0.0, 0.0), (15.0, 0.0), (15.0, 10.0), (0.0, 10.0), (0.0, 1.0)]


@pytest.fixture(scope="module")
def lanes() -> magmap.MagneticMap:
    """The map made from walks in lanes, two metres apart."""
    rows = [walked([(-2.0, y), (17.0, y)], f"row {y:g}", 7) for y in np.arange(-2.0, 13.0, 1.5)]
    made, _ = magmap.build([magmap.survey(row) for row in rows], site="hall", floor="1F")
    return made


@pytest.fixture(scope="module")
def exact() -> magmap.MagneticMap:
    """The map as it is."""
    x, y = np.meshgrid(np.arange(-3.0, 18.01, 0.5), np.arange(-3.0, 13.01, 0.5))
    points = np.column_stack([x.ravel(), y.ravel()])
    cells = np.column_stack([points, field_at(points)])
    return magmap.of_cells(cells, site="hall", floor="1F", deviation=1.0)


# --- survey and kriging --------------------------------------------------------------------------


def test_a_survey_knows_the_field_along_the_floors_axes() -> None:
    found = magmap.survey(walked(LOOP))
    straight = np.abs(found.points[:, 0] - 15.0) > 1.5
    off = (found.field - field_at(found.points))[straight]
    assert np.sqrt(np.mean(off**2)) < 3.0


def test_kriging_fills_between_the_lanes_and_knows_how_well(lanes: magmap.MagneticMap) -> None:
    points = np.column_stack([np.arange(1.0, 14.0, 0.5), np.full(26, 5.0)])
    field, variance = lanes.at(points)
    off = field - field_at(points)
    assert np.sqrt(np.mean(off**2)) < 3.0
    edge = lanes.at(np.array([[7.5, 13.0]]))[1]
    assert (edge > variance.mean(axis=0)).all()
    assert not np.isfinite(lanes.at(np.array([[60.0, 5.0]]))[0]).any()


def test_the_variogram_grows_with_distance() -> None:
    rows = [magmap.survey(walked([(0.0, y), (12.0, y)], str(y))) for y in (0.0, 2.0, 4.0)]
    _, variograms = magmap.build(rows, site="", floor="")
    assert [v.component for v in variograms] == ["x", "y", "up"]
    for one in variograms:
        assert one.at(np.array([5.0]))[0] > one.at(np.array([0.1]))[0] >= one.nugget


def test_a_map_keeps_its_variograms(lanes: magmap.MagneticMap, tmp_path: Path) -> None:
    lanes.save(tmp_path / "hall.magmap.npz")
    back = magmap.load(tmp_path / "hall.magmap.npz")
    kept = variograms_of(back)
    assert [v.component for v in kept] == ["x", "y", "up"]
    for one, before in zip(kept, variograms_of(lanes), strict=True):
        assert np.array_equal(one.semivariance, before.semivariance)
        assert np.array_equal(one.at(one.lags), before.at(before.lags))
    assert variograms_of(replace(lanes, notes={})) == []
    for damaged in (3, [{"component": "x"}], [{**lanes.notes["variograms"][0], "lags_m": [1.0]}]):
        with pytest.raises(SolenavError, match="variograms are damaged"):
            variograms_of(replace(lanes, notes={"variograms": damaged}))


def test_too_small_a_survey_is_refused() -> None:
    with pytest.raises(SolenavError, match="12 are the least"):
        magmap.build([], site="", floor="")
    with pytest.raises(SolenavError, match="positive"):
        magmap.build([], site="", floor="", spacing=0.0)
    walk = walked(LOOP)
    with pytest.raises(SolenavError, match="no way points"):
        magmap.survey(replace(walk, truth=None))
    with pytest.raises(SolenavError, match="no magnetometer"):
        magmap.survey(replace(walk, mag=None))


# --- the file ------------------------------------------------------------------------------------


def test_a_map_survives_its_file(lanes: magmap.MagneticMap, tmp_path: Path) -> None:
    path = tmp_path / "hall.magmap.npz"
    lanes.save(path)
    back = magmap.load(path)
    assert (back.site, back.floor, back.made_of) == (lanes.site, lanes.floor, lanes.made_of)
    assert np.array_equal(back.field, lanes.field, equal_nan=True)
    assert np.array_equal(back.deviation, lanes.deviation, equal_nan=True)


@settings(max_examples=60)
@given(cut=st.integers(0, 3000), flip=st.integers(0, 3000), what=st.booleans())
def test_a_damaged_map_is_refused_or_whole(
    exact: magmap.MagneticMap,
    tmp_path_factory: pytest.TempPathFactory,
    cut: int,
    flip: int,
    what: bool,
) -> None:
    path = tmp_path_factory.mktemp("maps") / "m.magmap.npz"
    exact.save(path)
    content = bytearray(path.read_bytes())
    if what:
        content = content[: cut % len(content)]
    else:
        content[flip % len(content)] ^= 0x55
    path.write_bytes(content)
    try:
        back = magmap.load(path)
    except SolenavError as error:
        assert str(path) in error.message
    else:
        assert np.array_equal(back.field, exact.field, equal_nan=True)


def test_a_map_that_contradicts_itself_is_refused(
    exact: magmap.MagneticMap, tmp_path: Path
) -> None:
    path = tmp_path / "m.magmap.npz"
    exact.save(path)
    with np.load(path) as content:
        parts = dict(content)
    changes = {
        "format": {"header": np.array(json.dumps({"format": "other", "version": 1}))},
        "equal steps": {"x": np.sort(np.random.default_rng(1).random(len(exact.x)))},
        "field or deviation": {"field": exact.field[:2]},
        "same places": {"deviation": np.full_like(exact.deviation, np.nan)},
        "µT": {"field": exact.field * 1e3},
        "no numbers": {"x": np.array(["a", "b"])},
    }
    for message, change in changes.items():
        np.savez(path, **{**parts, **change})
        with pytest.raises(SolenavError, match=message):
            magmap.load(path)
    with pytest.raises(SolenavError, match="no map"):
        magmap.load(tmp_path / "absent.magmap.npz")


# --- positioning ---------------------------------------------------------------------------------


@pytest.mark.parametrize("filter", list(magmap.FILTERS))
def test_every_filter_finds_a_walk_that_dead_reckoning_loses(
    exact: magmap.MagneticMap, filter: str
) -> None:
    walk = walked(LOOP)
    # A gyro that drifts by 1 °/s: dead reckoning alone ends metres away.
    walk = replace(walk, gyro=walk.gyro + np.array([0.0, 0.0, math.radians(1.0)]))
    assert walk.truth is not None
    found = magmap.locate(walk, exact, LOOP[0], filter=filter, tuning=FAST)
    off = found.at(walk.truth.time_s) - walk.truth.position_enu[:, :2]
    assert np.hypot(*off.T).mean() < 1.0


def test_a_seed_makes_the_same_walk_each_time(exact: magmap.MagneticMap) -> None:
    walk = walked(LOOP[:3])
    one, again, other = (
        magmap.locate(walk, exact, LOOP[0], seed=seed, tuning=FAST) for seed in (1, 1, 2)
    )
    assert np.array_equal(one.track.position, again.track.position)
    assert not np.array_equal(one.track.position, other.track.position)


def test_the_start_heading_comes_from_the_field_or_from_the_user(
    exact: magmap.MagneticMap,
) -> None:
    walk = walked([(2.0, 9.0), (2.0, 1.0)])
    for heading in (None, -math.pi / 2):
        found = magmap.locate(walk, exact, (2.0, 9.0), start_heading=heading, tuning=FAST)
        assert found.track.position[-1, 1] < 3.0


def test_what_cannot_be_located_is_refused(exact: magmap.MagneticMap) -> None:
    walk = walked(LOOP[:2])
    with pytest.raises(SolenavError, match="no filter 'best'"):
        magmap.locate(walk, exact, LOOP[0], filter="best")
    for start in ((40.0, 0.0), (math.nan, 0.0)):
        with pytest.raises(SolenavError, match="off the map 1F"):
            magmap.locate(walk, exact, start)
    with pytest.raises(SolenavError, match="no magnetometer"):
        magmap.locate(replace(walk, mag=None), exact, LOOP[0])
    holes = np.array(walk.mag)
    holes[50:60] = np.nan
    with pytest.raises(SolenavError, match="hole"):
        magmap.locate(replace(walk, mag=holes), exact, LOOP[0])
    with pytest.raises(SolenavError, match="floor 2F, the map is of floor 1F"):
        magmap.locate(replace(walk, notes={"floor": "2F"}), exact, LOOP[0])
    with pytest.raises(SolenavError, match="no steps"):
        magmap.locate(walk, exact, LOOP[0], begin_s=1e6)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=3, max_size=30))
def test_the_centre_is_no_farther_from_all_than_the_mean(points: list[tuple[float, float]]) -> None:
    cloud = np.array(points)

    def far(place: FloatArray) -> float:
        return float(np.hypot(*(cloud - place).T).sum())

    assert far(centre(cloud, 50)) <= far(cloud.mean(axis=0)) * 1.02 + 1e-6


def test_where_the_field_contradicts_all_particles_the_centroid_filter_starts_anew(
    exact: magmap.MagneticMap,
) -> None:
    walk = walked(LOOP)
    assert walk.mag is not None
    other = replace(walk, mag=-3.0 * walk.mag)
    assert magmap.locate(walk, exact, LOOP[0], filter="centroid", tuning=FAST).anew == 0
    assert magmap.locate(other, exact, LOOP[0], filter="centroid", tuning=FAST).anew > 0


@pytest.mark.parametrize("brightest", [True, False])
def test_fireflies_that_fly_to_brighter_ones_keep_apart_where_one_gathers_them_all(
    brightest: bool,
) -> None:
    rng = np.random.default_rng(5)
    weights = rng.exponential(size=400) ** 2
    weights /= weights.sum()
    to = brighter(weights, rng, replace(TUNING, brightest=brightest))
    drawn = np.bincount(to, minlength=400)
    above = weights > 1 / 400
    assert not drawn[~above].any()
    if brightest:
        assert drawn[np.argmax(weights)] == 400
    else:
        share = np.maximum(weights - 1 / 400, 0)
        assert (np.abs(drawn - 400 * share / share.sum()) <= 1.0 + 1e-9).all()


def test_the_kaist_runs_are_found_on_the_given_map(data: Path) -> None:
    folder = data / "phone/kaist"
    cells = kaist.read_field(folder / "mats/magmap-KI-1F-0.6a.mat")
    floor = magmap.of_cells(cells, site="KAIST", floor="1F", deviation=4.0)
    seeds = range(1, 9)
    errors: dict[str, list[float]] = {"plain": [], "firefly": []}
    for k, run in enumerate(sorted((folder / "rawdata/test-KI-1F-S9").iterdir()), 1):
        walk = kaist.read(run, way_points=folder / f"est-result/ki-gt-s{k}.json")
        assert walk.truth is not None
        points = walk.truth.position_enu[:, :2]
        ahead = math.atan2(*(points[1] - points[0])[::-1])
        paces = magmap.paces(walk)
        for filter, of in errors.items():
            for seed in seeds:
                found = magmap.locate(
                    paces, floor, tuple(points[0]), filter=filter, start_heading=ahead, seed=seed
                )
                of.append(np.hypot(*(found.at(walk.truth.time_s) - points).T).mean())
    plain, firefly = (np.mean(of) for of in errors.values())
    assert firefly < 1.1
    # The spread of a mean over so many seeds is 0.01 m.
    assert firefly < plain + 0.02
