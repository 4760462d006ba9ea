"""Allan deviation: known noise is found again, and what is no rest is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from solenav import importing
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording

pytest.importorskip("allantools")
pytest.importorskip("scipy")

from solenav.calibration import allan
from solenav.datasets import read
from solenav_tools.cli.calibrate_allan import calibrate_allan

COMMAND = typer.Typer()
COMMAND.command()(calibrate_allan)

RATE = 100.0


def white(n: int, density: float, seed: int) -> FloatArray:
    """Noise of a one-sided density/√2 in unit/√Hz, as N counts it."""
    return density * math.sqrt(RATE) * np.random.default_rng(seed).standard_normal(n)


def walk(n: int, rate: float, seed: int) -> FloatArray:
    """A bias that wanders by `rate` a √s."""
    steps = np.random.default_rng(seed).standard_normal(n)
    return np.asarray(rate / math.sqrt(RATE) * np.cumsum(steps))


def flicker(n: int, instability: float, seed: int) -> FloatArray:
    """1/f noise, by its spectrum B²/(2 π f)."""
    rng = np.random.default_rng(seed)
    f = np.fft.rfftfreq(n, 1 / RATE)
    # One-sided density S gives bins of variance S n RATE / 2 in each of two parts.
    size = np.zeros(len(f))
    size[1:] = np.sqrt(instability**2 / (2 * np.pi * f[1:]) * n * RATE / 2)
    parts = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
    return np.fft.irfft(size * parts / math.sqrt(2), n)


def rest(seconds: float, **noise: FloatArray) -> Recording:
    n = round(seconds * RATE)
    rng = np.random.default_rng(7)
    accel = np.array([0.0, 0.0, 9.8]) + rng.normal(0, 0.02, (n, 3))
    gyro = np.radians(rng.normal(0, 0.05, (n, 3)))
    for name, values in noise.items():
        gyro[:, "xyz".index(name)] = np.radians(values)
    return Recording("rest", np.arange(n) / RATE, accel, gyro, RATE)


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_is_all_random_walk(seed: int) -> None:
    found = allan.noise("x", "°/s", white(60_000, 0.01, seed), RATE)
    value, error = found.walk
    assert abs(value - 0.01) < 4 * error and error < 0.0002
    assert found.at(1.0) == pytest.approx(0.01, rel=0.1)
    # What isn't there is below what its error says.
    assert found.instability[0] < 3 * found.instability[1] + 0.001
    assert found.drift[0] < 3 * found.drift[1] + 0.0002


@pytest.mark.parametrize("seed", range(4))
def test_the_three_kinds_of_noise_are_told_apart(seed: int) -> None:
    n = 600_000  # 100 minutes
    values = white(n, 0.005, seed) + flicker(n, 0.003, seed + 10) + walk(n, 2e-4, seed + 20)
    found = allan.noise("x", "°/s", values, RATE)
    assert found.walk[0] == pytest.approx(0.005, rel=0.05)
    assert found.instability[0] == pytest.approx(0.003, rel=0.4)
    assert found.drift[0] == pytest.approx(2e-4, rel=0.6)


def test_each_axis_has_its_own_figures() -> None:
    n = 60_000
    report = allan.of_recording(rest(600, x=white(n, 0.004, 1), z=white(n, 0.012, 2)))
    walks = {axis.name: axis.walk[0] for axis in report.axes}
    assert walks["gyro x"] == pytest.approx(0.004, rel=0.05)
    assert walks["gyro z"] == pytest.approx(0.012, rel=0.05)
    assert report.axes[0].unit == "mg" and report.axes[3].unit == "°/s"


def test_the_longest_rest_counts_where_the_sensor_was_touched() -> None:
    recording = rest(300)
    recording.gyro[5000:5400] += 1.0 * np.sin(np.arange(400) / 9)[:, None]
    recording.accel[5000:5400] += 4.0 * np.sin(np.arange(400) / 7)[:, None]
    report = allan.of_recording(recording)
    assert report.rest.start_s > 50 and report.seconds > 230


@pytest.mark.parametrize("seconds", [10, 59])
def test_a_short_rest_is_refused(seconds: float) -> None:
    with pytest.raises(SolenavError, match=r"the longest rest is .* 60 s are the least"):
        allan.of_recording(rest(seconds))


def test_a_sensor_that_moves_all_the_time_is_refused() -> None:
    recording = rest(120)
    recording.gyro[:] += np.sin(np.arange(12000) / 20)[:, None]
    recording.accel[:] += np.sin(np.arange(12000) / 20)[:, None]
    with pytest.raises(SolenavError, match="the longest rest is none at all"):
        allan.of_recording(recording)


def test_ten_minutes_of_a_real_sensor_give_the_figures_of_the_set(data: Path) -> None:
    """The set's own: 0.009 to 0.013 °/s and 0.30 to 0.49 mg at 1 s."""
    pytest.importorskip("h5py")
    folder = data / "static" / "mpu6050" / "unmoved-with-x-pointing-forward-10min"
    report = allan.of_recording(read(folder / "mpu6050_accelerometer.mat", "mpu6050"))
    assert report.seconds > 600
    for axis in report.axes:
        low, high = (0.0085, 0.0135) if axis.unit == "°/s" else (0.295, 0.495)
        assert low < axis.at(1.0) < high, axis.name


def test_the_picture_shows_six_lines(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    allan.draw(allan.of_recording(rest(90)), tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 10_000


def test_the_command_reports_and_draws_a_simulated_rest(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    path, picture = tmp_path / "rest.solcap", tmp_path / "rest.png"
    n = 20_000
    importing.to_capture(rest(200, x=white(n, 0.01, 1)), path)
    done = CliRunner().invoke(COMMAND, [str(path), "-o", str(picture), "--json"])
    assert done.exit_code == 0, done.output
    axes = {axis["axis"]: axis for axis in json.loads(done.stdout)["axes"]}
    # Rounding to counts of 0.061 °/s adds 0.0018 °/s/√Hz.
    found = axes["gyro x"]["random_walk_per_sqrt_hz"]["value"]
    assert found == pytest.approx(math.hypot(0.01, 0.0018), rel=0.05)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_command_refuses_a_short_rest(tmp_path: Path) -> None:
    path = tmp_path / "rest.solcap"
    importing.to_capture(rest(20), path)
    done = CliRunner().invoke(COMMAND, [str(path)])
    assert isinstance(done.exception, SolenavError)
    assert "60 s are the least" in done.exception.message and done.exception.remedy
