"""Allan deviation of resting sensors: what is put in is found, what isn't at rest is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli import refused, solenav

from solenav import importing
from solenav.calibration import allan
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording

pytest.importorskip("allantools")

RATE_HZ = 100.0


def white(n: int, density: float, seed: int) -> FloatArray:
    """Noise of `density` per root Hz."""
    return density * np.sqrt(RATE_HZ) * np.random.default_rng(seed).standard_normal(n)


def walk(n: int, k: float, seed: int) -> FloatArray:
    """Rate random walk of coefficient `k`."""
    return np.cumsum(np.random.default_rng(seed).standard_normal(n)) * k / np.sqrt(RATE_HZ)


def flicker(n: int, b: float, seed: int) -> FloatArray:
    """Bias instability `b`: one-sided density b² / (2 pi f)."""
    f = np.fft.rfftfreq(n, 1 / RATE_HZ)
    f[0] = np.inf
    rng = np.random.default_rng(seed)
    phase = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
    size = np.sqrt(b**2 / (2 * np.pi * f) * n * RATE_HZ / 4)
    values: FloatArray = np.fft.irfft(size * phase, n)
    return values


def at_rest(seconds: float, seed: int = 1) -> Recording:
    """A resting sensor with white noise: 0.4 mg and 0.01 °/s per root Hz."""
    n = round(seconds * RATE_HZ)
    accel = np.column_stack([white(n, 0.4e-3 * 9.80665, seed + i) for i in range(3)])
    gyro = np.column_stack([white(n, np.deg2rad(0.01), seed + 3 + i) for i in range(3)])
    return Recording("rest", np.arange(n) / RATE_HZ, accel + [0, 0, 9.80665], gyro, RATE_HZ)


def within(figure: allan.Figure, truth: float) -> bool:
    """Truth lies within three times the error that the figure claims."""
    assert not figure.limit
    return abs(figure.value - truth) <= 3 * (figure.high - figure.value)


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_is_found_within_its_error(seed: int) -> None:
    found = allan.axis("gyro x", "°/s", white(60_000, 0.01, seed), RATE_HZ)
    assert within(found.random_walk, 0.01)
    assert found.random_walk.value == pytest.approx(0.01, rel=0.03)
    assert found.rate_random_walk.limit
    assert found.at(1.0) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_rate_random_walk_is_found_within_its_error(seed: int) -> None:
    found = allan.axis("gyro x", "°/s", walk(60_000, 0.002, seed), RATE_HZ)
    assert within(found.rate_random_walk, 0.002)
    assert found.random_walk.limit


@pytest.mark.parametrize("seed", range(5))
def test_bias_instability_is_found_over_white_noise(seed: int) -> None:
    values = white(180_000, 0.001, seed) + flicker(180_000, 0.01, seed + 50)
    found = allan.axis("gyro x", "°/s", values, RATE_HZ)
    assert found.bias_instability.value == pytest.approx(0.01, rel=0.25)


def test_a_falling_deviation_gives_bias_instability_as_a_limit() -> None:
    found = [allan.axis("a", "mg", white(30_000, 0.4, s), RATE_HZ) for s in range(8)]
    limits = [a.bias_instability for a in found if a.bias_instability.limit]
    assert limits
    assert all("at most" in figure.how for figure in limits)


def test_too_short_a_rest_is_refused() -> None:
    with pytest.raises(SolenavError, match=r"60\.0 s long, 120 s are the least") as caught:
        allan.analyse(at_rest(60.0))
    assert caught.value.remedy


def shaken(r: Recording) -> None:
    r.accel[::50] += 4.0


def turned(r: Recording) -> None:
    r.gyro[len(r.gyro) // 2 :, 2] += 0.3


def tilted(r: Recording) -> None:
    r.accel[len(r.accel) // 2 :, 0] += 1.0


@pytest.mark.parametrize("move", [shaken, turned, tilted])
def test_a_sensor_that_moved_is_refused(move: Callable[[Recording], None]) -> None:
    recording = at_rest(200.0)
    move(recording)
    with pytest.raises(SolenavError, match="the sensor moved: the longest rest is") as caught:
        allan.analyse(recording)
    assert caught.value.remedy


def test_only_the_longest_rest_is_used() -> None:
    recording = at_rest(300.0)
    recording.gyro[5000:5100, 0] += 1.0
    report = allan.analyse(recording)
    assert report.start_s == pytest.approx(51.0, abs=0.6)
    assert report.end_s == pytest.approx(300.0, abs=0.6)
    assert within(report.axes[3].random_walk, 0.01)


def test_a_dead_axis_is_refused() -> None:
    recording = at_rest(150.0)
    recording.gyro[:, 1] = 0.0
    with pytest.raises(SolenavError, match="one value all the time"):
        allan.analyse(recording)


def test_the_mpu6050_at_rest_has_the_noise_of_its_data_sheet(data: Path) -> None:
    pytest.importorskip("h5py")
    from solenav.datasets import read

    folder = data / "static" / "mpu6050" / "unmoved-with-x-pointing-forward-10min"
    report = allan.analyse(read(folder / "mpu6050_accelerometer.mat", "mpu6050"))
    assert report.end_s - report.start_s > 600
    for axis in report.axes[:3]:
        assert 0.295 < axis.at(1.0) < 0.495
    for axis in report.axes[3:]:
        assert 0.0085 < axis.at(1.0) < 0.0135


def test_the_command_reports_and_draws_a_rest(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    path = tmp_path / "rest.solcap"
    importing.to_capture(at_rest(200.0), path)
    done = solenav("calibrate", "allan", path, "-o", tmp_path / "rest.png", "--json")
    assert done.returncode == 0, done.stderr
    axes = json.loads(done.stdout)["axes"]
    # Rounding to counts adds 0.49 mg and 0.061 °/s over root 12, at 100 Hz.
    assert axes["gyro x"]["N"]["value"] == pytest.approx(0.0102, rel=0.05)
    assert axes["accel x"]["N"]["value"] == pytest.approx(0.4, rel=0.05)
    assert (tmp_path / "rest.png").read_bytes().startswith(b"\x89PNG")
    text = solenav("calibrate", "allan", path)
    assert "gyro z" in text.stdout and "°/s/√Hz" in text.stdout


def test_the_command_refuses_a_short_rest(tmp_path: Path) -> None:
    path = tmp_path / "rest.solcap"
    importing.to_capture(at_rest(20.0), path)
    refused(solenav("calibrate", "allan", path), 2, "120 s are the least")
