"""Calibration: what is put into simulated sensors comes out again; what can't be is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from handheld import BETWEEN, RATE, SIX, FloatArray, attitude, held, recording, tumbled
from hypothesis import given
from hypothesis import strategies as st

from solenav import datasets, engines, mpu9150, parameters
from solenav.calibration import IDENTITY, Calibration, accelerometer, gyro, load, magnetometer, save
from solenav.calibration.guide import Poses, Rest, Tumble
from solenav.calibration.still import DIRECTIONS, EDGES, FACES, poses
from solenav.errors import SolenavError
from solenav.recording import Recording
from solenav.sim.scenario import simulate
from solenav_core import layout

ERRS = Calibration(
    accel_matrix=((1.02, 0.0, 0.0), (0.008, 0.97, 0.0), (0.005, -0.004, 1.01)),
    accel_bias=(0.3, -0.2, 0.15),
    gyro_matrix=((0.98, -0.006, 0.01), (0.004, 1.03, 0.0), (-0.01, 0.008, 0.99)),
    gyro_bias=tuple(np.radians([2.0, -1.0, 0.5])),
    mag_matrix=((1.1, 0.05, -0.03), (0.05, 0.95, 0.02), (-0.03, 0.02, 1.0)),
    mag_bias=(30.0, -20.0, 12.0),
)


def leaning(poses: Any, seed: int = 3, by: float = 6.0) -> list[FloatArray]:
    """Attitudes as a hand holds them: none exact."""
    rng = np.random.default_rng(seed)
    return [attitude(pose, rng.uniform(-by, by, 3)) for pose in poses]


@pytest.fixture(scope="module")
def six() -> Recording:
    return recording(held(leaning(SIX)), ERRS)


@pytest.fixture(scope="module")
def many() -> Recording:
    return recording(held(leaning([*SIX, *BETWEEN])), ERRS)


@pytest.fixture(scope="module")
def tumble() -> Recording:
    return recording(tumbled(), ERRS)


def calibrated(many: Recording) -> Calibration:
    found = accelerometer.calibrate(many)
    return IDENTITY.merged("accelerometer", found.matrix, found.bias, found.report())


# The file and the integers


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


def matrices(diagonal: tuple[float, float], off: float) -> st.SearchStrategy[Any]:
    rows = [
        st.tuples(*(numbers(*diagonal) if i == j else numbers(-off, off) for j in range(3)))
        for i in range(3)
    ]
    return st.tuples(*rows)


def biases(most: float) -> st.SearchStrategy[Any]:
    return st.tuples(*[numbers(-most, most)] * 3)


CALIBRATIONS = st.builds(
    Calibration,
    accel_matrix=matrices((0.85, 1.15), 0.059),
    accel_bias=biases(1.99),
    gyro_matrix=matrices((0.85, 1.09), 0.06),
    gyro_bias=biases(0.136),
    mag_matrix=matrices((0.25, 4.0), 1.0),
    mag_bias=biases(600.0),
    mount=st.sampled_from(["auto", "+x+y+z", "-x+y-z", "+z+x+y", "-y+x+z"]),
)


@given(CALIBRATIONS)
def test_a_calibration_comes_back_from_its_file_unchanged(
    tmp_path_factory: pytest.TempPathFactory, found: Calibration
) -> None:
    path = tmp_path_factory.getbasetemp() / "calibration.json"
    save(path, found)
    assert load(path) == found


@given(CALIBRATIONS)
def test_the_integers_are_within_half_a_unit_and_come_back_the_same(found: Calibration) -> None:
    words = found.words()
    assert Calibration.from_words(words).words() == words
    scales = {"ACC": 2**22 * mpu9150.ACCEL_MPS2_PER_LSB, "GYRO": 2**14, "MAG": 2**12}
    for name, matrix in zip(
        scales, (found.accel_matrix, found.gyro_matrix, found.mag_matrix), strict=True
    ):
        for i, a in enumerate("XYZ"):
            for j, b in enumerate("XYZ"):
                exact = matrix[i][j] * scales[name]
                assert abs(words[f"{name}_{a}{b}"] - exact) <= 0.5
    for i, a in enumerate("XYZ"):
        counts = found.gyro_bias[i] / mpu9150.GYRO_RADPS_PER_LSB
        assert abs(words[f"ACC_B{a}"] - found.accel_bias[i] * 2**20) <= 0.5
        assert abs(words[f"GYRO_B{a}"] - counts * 2**20) <= 0.5 + 1e-6
        assert abs(words[f"MAG_B{a}"] - found.mag_bias[i] / 0.3 * 16) <= 0.5 + 1e-9
    settings = parameters.Settings(calibration=found)
    assert parameters.named(parameters.to_integers(settings, 200.0)).items() >= words.items()


def test_nothing_to_correct_is_the_unit_matrix_of_the_core() -> None:
    words = IDENTITY.words()
    assert (words["ACC_XX"], words["GYRO_YY"], words["MAG_ZZ"]) == (20084, 16384, 4096)
    assert not any(words[name] for name in ("ACC_XY", "GYRO_BX", "MAG_BZ", "MOUNT_R"))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ([], "no calibration"),
        ({"accelerometer": {}}, "no calibration"),
        ({"solenav_calibration": 1, "gyros": {}}, "'gyros'"),
        ({"solenav_calibration": 1, "gyro": {"bias_deg_s": [0, 0, 0]}}, "'bias_deg_s'"),
        ({"solenav_calibration": 1, "gyro": {"bias_rad_s": [0, 0]}}, "gyro bias is not 3 numbers"),
        ({"solenav_calibration": 1, "gyro": {"matrix": [[1, 0], [0, 1]]}}, "3 by 3 numbers"),
        ({"solenav_calibration": 1, "gyro": {"bias_rad_s": [0, 0, float("nan")]}}, "3 numbers"),
        ({"solenav_calibration": 1, "gyro": {"bias_rad_s": [0, 1, 0]}}, "gyro bias y = 1 rad/s"),
        ({"solenav_calibration": 1, "accelerometer": {"bias_m_s2": [0, 0, -3]}}, "bias z = -3"),
        ({"solenav_calibration": 1, "mount": "+x+x+z"}, "names an axis twice"),
        ({"solenav_calibration": 1, "mount": "+x+y-z"}, "left-handed"),
        ({"solenav_calibration": 1, "mount": "up"}, "no mounting"),
    ],
)
def test_a_file_that_is_no_calibration_is_refused_by_name(
    tmp_path: Path, content: Any, says: str
) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SolenavError, match=r"c\.json") as refusal:
        load(path)
    assert says in refusal.value.message and refusal.value.remedy


# Accelerometer


def test_six_inexact_positions_give_scale_and_bias(six: Recording) -> None:
    found = accelerometer.calibrate(six)
    assert not found.skew
    # The axes' angles stay unknown and cost a little; half of the error is still gone.
    assert np.abs(np.diag(found.matrix) - np.diag(ERRS.accel_matrix)).max() < 0.002
    assert np.abs(found.bias - ERRS.accel_bias).max() < 0.02


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_more_attitudes_give_the_axes_angles_too_within_the_errors_stated(seed: int) -> None:
    rests = recording(held(leaning([*SIX, *BETWEEN], seed)), ERRS, seed)
    found = accelerometer.calibrate(rests)
    assert found.skew
    assert np.all(np.abs(found.bias - ERRS.accel_bias) < 4 * found.bias_sigma)
    assert np.all(
        np.abs(np.diag(found.matrix) - np.diag(ERRS.accel_matrix)) < 4 * found.scale_sigma
    )
    assert np.abs(found.matrix - ERRS.accel_matrix).max() < 0.001
    assert np.sqrt(np.mean(found.residual**2)) < 0.01 * np.sqrt(np.mean(found.before**2))
    assert found.spread is not None and found.spread.max() < 0.003 and found.condition < 5


def test_a_face_that_was_never_up_is_named() -> None:
    with pytest.raises(SolenavError, match=r"5 of 6 positions are there; missing: -x up$"):
        accelerometer.calibrate(recording(held(leaning(SIX[:5]))))


def shaken(rests: Recording, first: float, last: float) -> Recording:
    rows = (rests.time_s > first) & (rests.time_s < last)
    rests.accel[rows] += 0.5 * np.sin(30 * rests.time_s[rows])[:, None]
    return rests


def test_bad_poses_are_refused_with_the_reason_and_the_face() -> None:
    exact = [attitude(pose) for pose in SIX]
    tipped = [*exact[:4], attitude("+x", (0.0, 35.0, 0.0)), exact[5]]
    with pytest.raises(SolenavError, match=r"missing: \+x up; refused: \+x up at .* leans 35°"):
        accelerometer.calibrate(recording(held(tipped)))
    with pytest.raises(SolenavError, match=r"missing: \+y up; refused: \+y up at .* moving"):
        accelerometer.calibrate(shaken(recording(held(exact)), 7.4, 9.9))
    brief = np.vstack([held(exact[:3]), held(exact[2:4], 0.5)[100:], held(exact[3:])[400:]])
    with pytest.raises(SolenavError, match=r"missing: -y up; refused: -y up at .* too short"):
        accelerometer.calibrate(recording(brief))
    turning = held(exact)
    slowly = held([exact[3], attitude("-y", (0.0, 0.0, 12.0))], 0.0, 2.5)
    at = round(11.1 * RATE)
    turning[at : at + len(slowly)] = slowly
    with pytest.raises(SolenavError, match=r"missing: -y up; refused: -y up at .* moving"):
        accelerometer.calibrate(recording(turning))


def test_a_refused_pose_held_again_well_is_no_fault(six: Recording) -> None:
    exact = [attitude(pose) for pose in SIX]
    again = shaken(recording(held([*exact, exact[2]]), ERRS), 7.4, 9.9)
    found = accelerometer.calibrate(again)
    assert len(found.used) == 6
    assert [pose.face for pose in found.refused] == ["+y"]


def test_rests_that_contradict_each_other_are_refused() -> None:
    rests = recording(held(leaning([*SIX, *BETWEEN])))
    rests.accel[rests.time_s > 30.0] *= 1.1
    with pytest.raises(SolenavError, match="the rests don't agree"):
        accelerometer.calibrate(rests)


def test_a_recording_shorter_than_a_window_has_no_pose() -> None:
    assert poses(recording(held([attitude("+z")], 0.3))) == []


# Gyro


def test_rest_gives_the_gyros_bias_and_noise_and_says_what_it_can_not_give() -> None:
    found = gyro.calibrate(recording(held([attitude("+z")], 10.0), ERRS))
    measured = np.linalg.inv(ERRS.gyro_matrix) @ ERRS.gyro_bias
    assert np.abs(found.bias - measured).max() < 1e-4
    assert found.noise == pytest.approx(np.full(3, 0.001 / np.sqrt(RATE)), rel=0.3)
    assert np.array_equal(found.matrix, np.eye(3))
    assert "0 turns" in found.why and found.report()["matrix_found"] is False


def test_turns_between_rests_give_the_gyros_scale_and_axes(many: Recording) -> None:
    found = gyro.calibrate(many, calibrated(many))
    assert not found.why and found.sigma is not None
    assert np.all(np.abs(found.matrix - ERRS.gyro_matrix) < 4 * found.sigma + 2e-4)
    assert np.abs(found.bias - ERRS.gyro_bias).max() < 5e-5
    assert found.after_deg < 0.05 < 2.0 < found.before_deg


def test_turns_about_one_axis_leave_the_gyros_matrix_alone() -> None:
    to_and_fro = [attitude((turn, 0.0, 0.0)) for turn in (0.0, 90.0, 0.0, -90.0) * 3]
    found = gyro.calibrate(recording(held(to_and_fro, 2.0), ERRS))
    assert np.array_equal(found.matrix, np.eye(3))
    assert "unsure" in found.why


def test_a_sensor_that_never_rests_gives_no_bias(tumble: Recording) -> None:
    with pytest.raises(SolenavError, match=r"rests for 0\.0 s only"):
        gyro.calibrate(tumble)


# Magnetometer


def normal(matrix: Any) -> FloatArray:
    return np.array(matrix) / np.cbrt(np.linalg.det(matrix))


def test_a_tumble_gives_hard_and_soft_iron(tumble: Recording) -> None:
    found = magnetometer.calibrate(tumble, ERRS)
    scale = np.cbrt(np.linalg.det(ERRS.mag_matrix))
    assert np.abs(found.bias - np.array(ERRS.mag_bias) / scale).max() < 0.1
    assert np.abs(found.matrix - normal(ERRS.mag_matrix)).max() < 0.003
    assert found.covered == 26
    assert np.sqrt(np.mean(found.residual**2)) == pytest.approx(0.4, rel=0.1)
    assert found.dip_deg == pytest.approx(66.0, abs=0.5)


def test_the_fields_dip_turns_the_axes_to_those_of_the_accelerometer() -> None:
    """Soft iron with a twist: the ellipsoid alone can't see it."""
    twist = np.array([[1.0, 0.05, 0.0], [-0.05, 1.0, 0.03], [0.0, -0.03, 1.0]])
    twisted = Calibration(mag_matrix=twist, mag_bias=(5.0, 0.0, 0.0))
    found = magnetometer.calibrate(recording(tumbled(seed=2), twisted))
    assert np.abs(found.matrix - normal(twist)).max() < 0.004
    assert found.turned_deg == pytest.approx(np.degrees(np.hypot(0.05, 0.03)), abs=0.2)
    assert found.dip_before_deg is not None and found.dip_after_deg is not None
    assert found.dip_after_deg < 0.5 * found.dip_before_deg


def test_wild_readings_move_the_fit_little(tumble: Recording) -> None:
    rng = np.random.default_rng(5)
    assert tumble.mag is not None
    spoilt = tumble.mag.copy()
    hit = rng.choice(len(spoilt), len(spoilt) // 20, replace=False)
    spoilt[hit] += rng.normal(0, 60, (len(hit), 3))
    found = magnetometer.calibrate(parameters.replace(tumble, mag=spoilt), ERRS)
    good = magnetometer.calibrate(tumble, ERRS)
    assert np.abs(found.bias - good.bias).max() < 0.2
    assert found.outliers > 0.8 * np.isfinite(spoilt[hit]).all(axis=1).sum()


def test_a_tumble_that_leaves_directions_out_is_refused_by_their_names() -> None:
    level = [attitude((0.0, 0.0, turn)) for turn in (0.0, 90.0, 180.0, -90.0)]
    with pytest.raises(SolenavError, match=r"leaves out \d+ of 26 directions.* \+z"):
        magnetometer.calibrate(recording(held(level, 1.0, 4.0)))


def test_no_magnetometer_is_told(tumble: Recording) -> None:
    with pytest.raises(SolenavError, match="0 readings"):
        magnetometer.calibrate(parameters.replace(tumble, mag=None))


def test_a_field_that_changes_is_refused(tumble: Recording) -> None:
    assert tumble.mag is not None
    field = tumble.mag * (1 + 0.6 * np.sin(tumble.time_s)[:, None])
    with pytest.raises(SolenavError, match=r"wasn't the same|no ellipsoid"):
        magnetometer.calibrate(parameters.replace(tumble, mag=field))


# A real MPU-6050 with an HMC5883L, tumbled by hand; see docs/calibration.md


def hand(data: Path, folder: str) -> Recording:
    return datasets.read(
        data / "static" / "mpu6050" / folder / "mpu6050_accelerometer.mat", "mpu6050"
    )


def test_a_real_tumbles_ellipsoid_becomes_a_sphere(data: Path) -> None:
    found = magnetometer.calibrate(hand(data, "full-sphere"))
    assert np.sqrt(np.mean(found.before**2)) > 7.0
    assert np.sqrt(np.mean(found.residual**2)) < 0.3
    assert found.covered == 26


def test_a_real_rests_gravity_is_put_right_by_another_recording(data: Path) -> None:
    """Scale and bias from the tumble's slow moments; a hand's own force averages out."""
    tumble = hand(data, "full-sphere")
    blocks = tumble.accel[: len(tumble.accel) // 30 * 30].reshape(-1, 30, 3)
    slow = np.linalg.norm(blocks.std(axis=1), axis=1) < 1.0
    matrix, bias, _residual = accelerometer.sphere(blocks.mean(axis=1)[slow], skew=False)
    rest = hand(data, "unmoved-with-x-pointing-forward-10min").accel.mean(axis=0)
    assert np.linalg.norm(rest) - mpu9150.STANDARD_GRAVITY > 0.35
    assert abs(np.linalg.norm(matrix @ rest - bias) - mpu9150.STANDARD_GRAVITY) < 0.03


def test_a_real_tumble_and_tilts_are_no_six_positions(data: Path) -> None:
    for folder in ("full-sphere", "roll-and-tilt-at-45-90"):
        with pytest.raises(SolenavError, match=r"missing: .*refused: .*moving"):
            accelerometer.calibrate(hand(data, folder))


# Guides


def follow(guide: Any, source: Recording) -> list[str]:
    """What a guide says over a recording that arrives bit by bit."""
    said = guide.opening()
    step = round(guide.every_s * source.rate_hz)
    for end in range(step, len(source.time_s) + 1, step):
        rows = slice(guide.first, end)
        part = parameters.replace(
            source,
            time_s=source.time_s[rows] - source.time_s[guide.first],
            accel=source.accel[rows],
            gyro=source.gyro[rows],
            mag=None if source.mag is None else source.mag[rows],
        )
        said += guide.look(part)
        if guide.done:
            break
    return said


def test_the_guide_leads_through_six_positions(six: Recording) -> None:
    guide = Poses()
    said = follow(guide, six)
    assert guide.done and guide.lacks() == ""
    assert [line for line in said if line.startswith("good")] == [
        f"good: {face} up ({k} of 6)" for k, face in enumerate(SIX, 1)
    ]
    assert not [line for line in said if line.startswith("refused")]
    found = accelerometer.fit(list(guide.taken.values()), [])
    assert np.abs(found.bias - ERRS.accel_bias).max() < 0.02


def test_the_guide_refuses_a_bad_pose_says_why_and_goes_on() -> None:
    way = ["+z", "-z", "-z", "+y", "-y", "+x", "-x"]
    held_so = [attitude(pose) for pose in way]
    held_so.insert(3, attitude("-z", (40.0, 0.0, 0.0)))
    held_so.insert(4, attitude("+z"))
    guide = Poses()
    said = follow(guide, shaken(recording(held(held_so, 4.0)), 26.0, 30.0))
    refusals = [line for line in said if line.startswith("refused")]
    assert any("leans 40° from" in line for line in refusals)
    assert "refused: +z up is there already" in refusals
    assert any("moving" in line for line in refusals)
    assert not guide.done and guide.lacks().startswith("missing: +y")
    assert said[-1].startswith("next:")


def test_positions_on_edge_make_the_guide_find_the_axes_angles() -> None:
    turns = []
    for name in EDGES:
        up = DIRECTIONS[name]
        axis = np.cross(up, [0.0, 0.0, 1.0])
        angle = np.degrees(np.arctan2(np.linalg.norm(axis), up[2]))
        turns.append(tuple(axis / np.linalg.norm(axis) * angle))
    guide = Poses(FACES + EDGES)
    follow(guide, recording(held(leaning([*SIX, *turns])), ERRS))
    assert guide.done
    found = accelerometer.fit(list(guide.taken.values()), [])
    assert found.skew
    assert np.abs(found.matrix - ERRS.accel_matrix).max() < 0.002


def test_the_guide_waits_for_a_rest_and_starts_again_when_it_is_moved() -> None:
    way = [attitude("+z"), attitude((20.0, 0.0, 0.0))]
    quiet = held(way, 6.0)
    guide = Rest()
    said = follow(guide, recording(np.vstack([quiet, np.repeat(quiet[-1:], 1200, axis=0)])))
    assert guide.done
    assert [line for line in said if "refused: moved after 6" in line]


def test_the_guide_tells_which_directions_the_tumble_still_lacks(tumble: Recording) -> None:
    guide = Tumble()
    said = follow(guide, tumble)
    assert guide.done
    assert any("of 26 directions; missing: the field from" in line for line in said)


# All of it


def end(accel: FloatArray, gyro: FloatArray, calibration: Calibration) -> FloatArray:
    settings = parameters.Settings(calibration=calibration)
    engine = engines.create("fast", parameters.to_integers(settings, RATE))
    engine.advance(mpu9150.to_counts(accel, gyro).counts)
    at = layout.offsets(layout.STATE_FIELDS)["POS"]
    return np.array(engine.state[at : at + 3]) / 2**18


def test_a_calibrated_bad_sensor_walks_as_a_perfect_one(many: Recording, tmp_path: Path) -> None:
    found = calibrated(many)
    turned = gyro.calibrate(many, found)
    save(tmp_path / "c.json", found.merged("gyro", turned.matrix, turned.bias, turned.report()))
    walk = simulate("line35", seed=2).first(60.0)
    ideal = end(walk.accel, walk.gyro, IDENTITY)
    raw = [
        (true + ERRS.bias(name)) @ np.linalg.inv(ERRS.matrix(name)).T
        for name, true in (("accelerometer", walk.accel), ("gyro", walk.gyro))
    ]
    after = np.linalg.norm(end(raw[0], raw[1], load(tmp_path / "c.json")) - ideal)
    before = np.linalg.norm(end(raw[0], raw[1], IDENTITY) - ideal)
    assert after < 0.1 and before > 5 * after
