"""`solenav calibrate` as a person uses it: on captures, and live against a board."""

from __future__ import annotations

import contextlib
import json
import os
import select
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cli import refused, solenav
from handheld import BETWEEN, SIX, attitude, held, recording, tumbled
from test_calibration import ERRS, end, leaning, shaken
from test_device_cli import sender, served

from solenav import calibration, capture, importing, mpu9150
from solenav.calibration import IDENTITY, finding
from solenav.errors import SolenavError
from solenav.sim.scenario import simulate
from solenav_core import params


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captures of a bad sensor: six positions, many, five, a shaken one, rest, tumble."""
    out = tmp_path_factory.mktemp("hand")
    exact = [attitude(pose) for pose in SIX]
    made = {
        "six": recording(held(leaning(SIX)), ERRS),
        "many": recording(held(leaning([*SIX, *BETWEEN])), ERRS),
        "five": recording(held(exact[:5])),
        "again": shaken(recording(held([*exact, exact[2]], 4.0), ERRS), 10.4, 14.4),
        "rest": recording(held(exact[:1], 14.0), ERRS),
        "tumble": recording(tumbled(40.0), ERRS),
    }
    for name, found in made.items():
        importing.to_capture(found, out / f"{name}.solcap")
    return out


@contextlib.contextmanager
def pouring(data: bytes) -> Iterator[str]:
    """A port at which `data` arrives for as long as anybody reads."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    over = threading.Event()

    def pour() -> None:
        # What comes before the client has opened and discarded its input would be lost.
        while not over.is_set() and not select.select([master], [], [], 0.05)[0]:
            pass
        left = memoryview(data)
        while left and not over.is_set():
            if select.select([], [master], [], 0.05)[1]:
                left = left[os.write(master, left[:512]) :]

    thread = threading.Thread(target=pour)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        over.set()
        thread.join()
        os.close(slave)
        os.close(master)


def test_three_recordings_make_one_calibration_that_walks_straight(
    folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "calibration.json"
    for sensor, name in (("accelerometer", "many"), ("gyro", "many"), ("magnetometer", "tumble")):
        done = solenav("calibrate", sensor, folder / f"{name}.solcap", "-o", out)
        assert done.returncode == 0, done.stderr
        assert f"{sensor} calibrated from {name}.solcap" in done.stdout
    found = calibration.load(out)
    assert set(found.made_from) == {"accelerometer", "gyro", "magnetometer"}
    assert np.abs(found.bias("accelerometer") - ERRS.accel_bias).max() < 0.005
    assert np.abs(found.matrix("gyro") - ERRS.gyro_matrix).max() < 0.001
    walk = simulate("line35", seed=2).first(60.0)
    raw = [
        (true + ERRS.bias(name)) @ np.linalg.inv(ERRS.matrix(name)).T
        for name, true in (("accelerometer", walk.accel), ("gyro", walk.gyro))
    ]
    ideal = end(walk.accel, walk.gyro, IDENTITY)
    assert np.linalg.norm(end(raw[0], raw[1], found) - ideal) < 0.1


def test_json_says_how_well_it_fits(folder: Path, tmp_path: Path) -> None:
    done = solenav(
        "calibrate", "accelerometer", folder / "six.solcap", "-o", tmp_path / "c.json", "--json"
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    made = result["made_from"]
    assert made["rests"] == 6 and made["refused"] == []
    assert made["residual_m_s2"] < 0.01 < made["residual_before_m_s2"]
    assert result["bias_m_s2"] == list(calibration.load(tmp_path / "c.json").accel_bias)
    assert "axes' angles" in done.stderr


def test_missing_and_bad_positions_are_refused_and_nothing_is_written(
    folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "c.json"
    done = solenav("calibrate", "accelerometer", folder / "five.solcap", "-o", out)
    refused(done, 1, "5 of 6 positions are there; missing: -x up")
    done = solenav("calibrate", "magnetometer", folder / "six.solcap", "-o", out)
    refused(done, 1, "the tumble leaves out", "26 directions")
    done = solenav("calibrate", "gyro", folder / "tumble.solcap", "-o", out)
    refused(done, 1, "rests for 0.0 s only")
    assert not out.exists()


def test_a_wrong_file_is_refused_before_any_work(folder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "c.json"
    broken.write_text('{"solenav_calibration": 1, "mount": "sideways"}')
    done = solenav("calibrate", "gyro", folder / "rest.solcap", "-o", broken)
    refused(done, 2, "c.json", "'sideways' is no mounting")
    done = solenav("calibrate", "gyro", folder / "rest.solcap", "-o", folder / "rest.json")
    refused(done, 2, "stands beside the capture")
    refused(solenav("calibrate", "gyro", tmp_path / "no.solcap"), 2, "no.solcap")
    refused(solenav("calibrate", "gyro", "/dev/ttyNOSUCH7"), 2, "there is no port")


def test_show_prints_a_calibration_and_its_integers(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    calibration.save(path, ERRS)
    done = solenav("calibrate", "show", path)
    assert done.returncode == 0 and "1.02000" in done.stdout and "mounting: auto" in done.stdout
    done = solenav("calibrate", "show", path, "--json")
    assert json.loads(done.stdout)["params"] == ERRS.words()


def test_apply_changes_the_calibration_in_config_json_and_nothing_else(tmp_path: Path) -> None:
    path, config = tmp_path / "c.json", tmp_path / "config.json"
    calibration.save(path, ERRS)
    before = {"pose_every": 2, "params": {"K": 8000, "MAG_XX": 5000, "MOUNT_U": -3}}
    config.write_text(json.dumps(before))
    for _again in range(2):
        assert solenav("calibrate", "apply", path, config).returncode == 0
        content = json.loads(config.read_text())
        assert content["pose_every"] == 2 and content["params"]["K"] == 8000
        assert content["params"]["MOUNT_U"] == -3
        words = {**IDENTITY.words(), "MOUNT_U": -3}
        chosen = {n: v for n, v in content["params"].items() if n in words}
        assert {**words, **chosen} == {**ERRS.words(), "MOUNT_U": -3}
    calibration.save(path, IDENTITY)
    assert solenav("calibrate", "apply", path, config).returncode == 0
    assert json.loads(config.read_text())["params"] == {"K": 8000, "MOUNT_U": -3}
    config.write_text("[1]")
    refused(solenav("calibrate", "apply", path, config), 2, "is no object")


def test_simulate_and_import_put_a_calibration_into_the_parameters(
    tmp_path: Path, data: Path
) -> None:
    path = tmp_path / "c.json"
    calibration.save(path, ERRS)
    done = solenav(
        "simulate", "stand", "-o", tmp_path / "s.solcap", "--duration", "3", "--calibration", path
    )
    assert done.returncode == 0, done.stderr
    source = sorted((data / "foot" / "openshoe").glob("*.txt"))[0]
    done = solenav(
        "import", source, "--format", "openshoe", "-o", tmp_path / "i.solcap", "--duration", "3",
        "--calibration", path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for name in ("s", "i"):
        values = capture.load(tmp_path / f"{name}.solcap").params[0][1]
        found = dict(zip(params.NAMES, values, strict=True))
        assert found.items() >= ERRS.words().items()


def test_a_board_is_led_through_six_positions(folder: Path, tmp_path: Path) -> None:
    """The bad pose is refused, the reason said, and the guide goes on."""
    kept = tmp_path / "kept.solcap"
    with served(folder / "again.solcap") as port:
        done = solenav(
            "calibrate", "accelerometer", port, "-o", tmp_path / "c.json", "--record", kept
        )
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert lines[1] == "next: turn it so that +x points up, and hold it still"
    assert any(line.startswith("refused: +y up: moving") for line in lines)
    assert [line for line in lines if line.startswith("good")][-1] == "good: +y up (6 of 6)"
    found = calibration.load(tmp_path / "c.json")
    assert np.abs(found.bias("accelerometer") - ERRS.accel_bias).max() < 0.03
    # What was kept gives the same by itself.
    done = solenav("calibrate", "accelerometer", kept, "-o", tmp_path / "again.json")
    assert done.returncode == 0, done.stderr
    again = calibration.load(tmp_path / "again.json")
    assert np.abs(again.bias("accelerometer") - found.bias("accelerometer")).max() < 0.01


def test_a_board_that_goes_before_all_is_there_leaves_word_of_what_is_missing(
    folder: Path, tmp_path: Path
) -> None:
    with served(folder / "five.solcap") as port:
        done = solenav("calibrate", "accelerometer", port, "-o", tmp_path / "c.json")
    refused(done, 1, "vanished before all was there", "missing: -x up")
    assert not (tmp_path / "c.json").exists()


def test_a_boards_gyro_is_calibrated_at_rest(folder: Path, tmp_path: Path) -> None:
    with served(folder / "rest.solcap") as port:
        done = solenav("calibrate", "gyro", port, "-o", tmp_path / "c.json")
    assert done.returncode == 0, done.stderr
    assert "good: it rested" in done.stderr and "scale and axes stay as they are" in done.stderr
    measured = np.linalg.inv(ERRS.matrix("gyro")) @ ERRS.bias("gyro")
    found = calibration.load(tmp_path / "c.json").bias("gyro")
    assert np.abs(found - measured).max() < 2 * mpu9150.GYRO_RADPS_PER_LSB


def test_a_boards_magnetometer_is_calibrated_until_all_directions_are_there(
    folder: Path, tmp_path: Path
) -> None:
    """From bytes of a capture: the simulated chip's magnetometer doesn't tumble."""
    stream = b"".join(d for _t, d in capture.read_records(folder / "tumble.solcap"))
    with pouring(stream) as port:
        done = solenav("calibrate", "magnetometer", port, "-o", tmp_path / "c.json")
    assert done.returncode == 0, done.stderr
    assert "missing: the field from" in done.stderr
    assert "good: enough directions are there" in done.stderr
    scale = np.cbrt(np.linalg.det(ERRS.matrix("magnetometer")))
    found = calibration.load(tmp_path / "c.json")
    assert np.abs(found.bias("magnetometer") - ERRS.bias("magnetometer") / scale).max() < 1.0


def test_a_port_without_samples_is_told(tmp_path: Path) -> None:
    with sender(b"$GPGGA,123519*47\r\n" * 20, then_vanish=False) as port:
        done = solenav("calibrate", "gyro", port, "-o", tmp_path / "c.json")
    refused(done, 1, "no samples came from", "send_samples")


def test_from_python_the_same_is_found_as_by_the_command(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    found = IDENTITY
    for sensor, name in (("accelerometer", "six"), ("gyro", "rest"), ("magnetometer", "tumble")):
        path = folder / f"{name}.solcap"
        done = solenav("calibrate", sensor, path, "-o", file)
        assert done.returncode == 0, done.stderr
        found = finding.calibrate(sensor, capture.load(path), found)
    assert calibration.load(file).words() == found.words() != IDENTITY.words()
    with pytest.raises(SolenavError, match="no sensor barometer"):
        finding.calibrate("barometer", capture.load(folder / "six.solcap"))
