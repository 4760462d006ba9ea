"""The sensor as it is mounted and as it errs: what the core makes of both."""

from __future__ import annotations

from array import array
from itertools import permutations, product

import numpy as np
import pytest
from numpy.typing import NDArray

from solenav import engines, mpu9150, parameters
from solenav.errors import SolenavError
from solenav.sim.scenario import simulate
from solenav_core import layout, params

FloatArray = NDArray[np.float64]
PARAMS = parameters.to_integers(parameters.Settings(), 200.0)
AT = layout.offsets(layout.STATE_FIELDS)
ROTATIONS = [
    np.array(signs)[:, None] * np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if np.linalg.det(np.array(signs)[:, None] * np.eye(3)[list(order)]) > 0
]


@pytest.fixture(scope="module")
def walk() -> tuple[FloatArray, FloatArray]:
    recording = simulate("line35", seed=2)
    return recording.accel[:12000], recording.gyro[:12000]


def end(accel: FloatArray, gyro: FloatArray, values: array[int] = PARAMS) -> FloatArray:
    engine = engines.create("fast", values)
    engine.advance(mpu9150.to_counts(accel, gyro).counts)
    assert engine.navigating
    return np.array(engine.state[AT["POS"] : AT["POS"] + 3]) / 2**18


def changed(**words: int) -> array[int]:
    out = array("i", PARAMS)
    for name, value in words.items():
        out[params.NAMES.index(name)] = value
    return parameters.checked(out.tolist())


def test_there_are_24_mountings() -> None:
    assert len(ROTATIONS) == 24


@pytest.mark.parametrize("mounting", ROTATIONS, ids=lambda r: "".join(f"{int(v)}" for v in r.flat))
def test_however_the_sensor_is_mounted_the_walk_is_the_same(
    mounting: FloatArray, walk: tuple[FloatArray, FloatArray]
) -> None:
    """Found from the start but for quarter turns about Up, which gravity can't tell."""
    accel, gyro = walk
    straight = end(accel, gyro)
    # `mounting` takes body axes to the sensor's.
    found = end(accel @ mounting.T, gyro @ mounting.T)
    assert np.hypot(*found[:2]) == pytest.approx(np.hypot(*straight[:2]), abs=0.03)
    assert found[2] == pytest.approx(straight[2], abs=0.05)
    turn = np.degrees(np.arctan2(*found[:2]) - np.arctan2(*straight[:2]))
    assert (turn + 45) % 90 - 45 == pytest.approx(0, abs=0.5)
    # Told so, the quarter turns are right as well.
    axes = [int(np.sign(row[k]) * (k + 1)) for row in mounting.T for k in [np.argmax(np.abs(row))]]
    told = changed(MOUNT_R=axes[0], MOUNT_F=axes[1], MOUNT_U=axes[2])
    assert np.allclose(end(accel @ mounting.T, gyro @ mounting.T, told), straight, atol=0.03)


def test_a_sensor_that_leans_forward_keeps_its_heading(
    walk: tuple[FloatArray, FloatArray],
) -> None:
    """On an instep at 20° or upright at the ankle: front stays front."""
    accel, gyro = walk
    straight = end(accel, gyro)
    for degrees in (20, 40, 60, 85, -60, -85):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        lean = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
        assert np.allclose(end(accel @ lean.T, gyro @ lean.T), straight, atol=0.3), degrees


@pytest.mark.parametrize("axes", [(1, 1, 3), (1, 0, 3), (0, 0, 3), (2, 1, 3), (-1, 2, 3)])
def test_a_mounting_that_is_no_rotation_is_refused(axes: tuple[int, int, int]) -> None:
    with pytest.raises(SolenavError, match="MOUNT_R"):
        changed(MOUNT_R=axes[0], MOUNT_F=axes[1], MOUNT_U=axes[2])


def test_matrices_and_biases_undo_a_sensors_errors(walk: tuple[FloatArray, FloatArray]) -> None:
    accel, gyro = walk
    straight = end(accel, gyro)
    skew_a = np.array([[1.02, 0.01, -0.008], [0.0, 0.97, 0.012], [0.005, -0.004, 1.01]])
    skew_g = np.array([[0.98, -0.006, 0.01], [0.004, 1.03, 0.0], [-0.01, 0.008, 0.99]])
    off_a, off_g = np.array([0.3, -0.2, 0.15]), np.radians([2.0, -1.0, 0.5])
    raw_a = (accel + off_a) @ np.linalg.inv(skew_a).T
    raw_g = (gyro + off_g) @ np.linalg.inv(skew_g).T
    words = {}
    one = PARAMS[params.NAMES.index("ACC_XX")]
    for i, a in enumerate("XYZ"):
        for j, b in enumerate("XYZ"):
            words[f"ACC_{a}{b}"] = round(skew_a[i, j] * one)
            words[f"GYRO_{a}{b}"] = round(skew_g[i, j] * 2**14)
        words[f"ACC_B{a}"] = round(off_a[i] * 2**20)
        words[f"GYRO_B{a}"] = round(off_g[i] / mpu9150.GYRO_RADPS_PER_LSB * 2**20)
    assert np.allclose(end(raw_a, raw_g, changed(**words)), straight, atol=0.1)
    assert np.linalg.norm(end(raw_a, raw_g) - straight) > 0.5
