"""The picture of a walk: that it's there, of the right size, and shows what is known."""

from __future__ import annotations

import logging
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from solenav import capture as captures
from solenav import importing, replaying
from solenav.capture import Capture
from solenav.capture.contents import Table
from solenav.errors import SolenavError
from solenav.plotting import DPI, SIZE_IN, envelope, plot
from solenav.recording import Recording, Truth
from solenav.sim.scenario import simulate

pytest.importorskip("numba")
image = pytest.importorskip("matplotlib.image")

TRUTH_COLOUR = np.array([0xD5, 0x5E, 0x00]) / 255
ESTIMATE_COLOUR = np.array([0x00, 0x72, 0xB2]) / 255
# Of the picture, in shares of its height and width from the top left corner.
TRAJECTORY = (slice(0.1, 0.46), slice(0.06, 0.45))
TITLE = (slice(0.0, 0.04), slice(0.05, 0.5))
RATE = (slice(0.775, 0.845), slice(0.06, 0.45))


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten strides of the loop with poses and dense truth."""
    folder = tmp_path_factory.mktemp("walk")
    path = folder / "walk.solcap"
    n = 6000
    whole = simulate("loop")
    assert whole.truth is not None
    truth = Truth(whole.truth.time_s[:n], whole.truth.position_enu[:n], frame="enu")
    recording = Recording(
        "ten strides", whole.time_s[:n], whole.accel[:n], whole.gyro[:n], 200.0, truth
    )
    importing.to_capture(recording, folder / "raw.solcap")
    replaying.replay(captures.load(folder / "raw.solcap"), path, engine="fast")
    return path


def with_truth(walk: Path, folder: Path, truth: Truth | None) -> Capture:
    """The walk with another truth."""
    path = folder / "other.solcap"
    shutil.copy(walk, path)
    replaying.finish(path, {}, truth)
    return captures.load(path)


def drawn(capture: Capture, folder: Path, title: str | None = None) -> NDArray[np.float64]:
    """The picture's pixels (height, width, 3), 0 to 1."""
    out = folder / "walk.png"
    plot(capture, out, title=title)
    pixels: NDArray[np.float64] = image.imread(out)[:, :, :3]
    return pixels


def part(pixels: NDArray[np.float64], where: tuple[slice, slice]) -> NDArray[np.float64]:
    rows, columns = (
        slice(int(share.start * size), int(share.stop * size))
        for share, size in zip(where, pixels.shape, strict=False)
    )
    return pixels[rows, columns]


def count(pixels: NDArray[np.float64], colour: NDArray[np.float64]) -> int:
    """Pixels of a colour, or nearly."""
    return int((np.abs(pixels - colour).max(axis=2) < 0.1).sum())


def truth_of(walk: Path) -> Truth:
    truth = captures.load(walk).truth
    assert truth is not None
    return truth


def test_the_picture_has_its_size_and_is_not_blank(walk: Path, tmp_path: Path) -> None:
    pixels = drawn(captures.load(walk), tmp_path)
    assert pixels.shape == (round(SIZE_IN[1] * DPI), round(SIZE_IN[0] * DPI), 3)
    assert 0.02 < (pixels.min(axis=2) < 0.85).mean() < 0.5
    assert count(part(pixels, TRAJECTORY), ESTIMATE_COLOUR) > 100


def test_nothing_is_said_on_the_way(
    walk: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, recwarn: pytest.WarningsRecorder
) -> None:
    with caplog.at_level(logging.WARNING):
        drawn(captures.load(walk), tmp_path)
    assert not caplog.records
    assert not recwarn.list


def test_the_truth_is_drawn_where_there_is_one(walk: Path, tmp_path: Path) -> None:
    far = truth_of(walk)
    far.position_enu[:, 0] += 3.0
    without = drawn(with_truth(walk, tmp_path, None), tmp_path)
    beside = drawn(with_truth(walk, tmp_path, far), tmp_path)
    assert count(part(without, TRAJECTORY), TRUTH_COLOUR) == 0
    assert count(part(beside, TRAJECTORY), TRUTH_COLOUR) > 100


def test_survey_points_without_height_are_drawn(walk: Path, tmp_path: Path) -> None:
    dense = truth_of(walk)
    points = dense.position_enu[3000::250].copy()
    points[:, 2] = np.nan
    # Off the line to see them, but not so that the fit takes it away.
    points[1::2, 0] += 1.0
    sparse = Truth(dense.time_s[3000::250], points)
    pixels = drawn(with_truth(walk, tmp_path, sparse), tmp_path)
    assert count(part(pixels, TRAJECTORY), TRUTH_COLOUR) > 50


def test_a_local_truth_is_laid_onto_the_estimate(walk: Path, tmp_path: Path) -> None:
    truth = truth_of(walk)
    truth.position_enu = truth.position_enu[:, [1, 0, 2]] * np.array([-1.0, 1.0, 1.0]) + 500.0
    local, real = (
        drawn(with_truth(walk, tmp_path, replace(truth, frame=frame)), tmp_path)
        for frame in ("local", "enu")
    )
    # Left where it is, 700 m away, the truth shrinks the walk to a point.
    assert count(part(local, TRAJECTORY), ESTIMATE_COLOUR) > 200
    assert count(part(real, TRAJECTORY), ESTIMATE_COLOUR) < 100


def test_a_loop_without_positions_needs_no_truth(walk: Path, tmp_path: Path) -> None:
    nowhere = Truth(np.empty(0), np.empty((0, 3)), closed_loop=True)
    pixels = drawn(with_truth(walk, tmp_path, nowhere), tmp_path)
    assert count(part(pixels, TRAJECTORY), TRUTH_COLOUR) == 0


def test_poses_alone_are_enough(walk: Path, tmp_path: Path) -> None:
    capture = captures.load(walk)
    whole = drawn(capture, tmp_path)
    empty = np.empty(0, np.int64)
    capture.samples = Table(capture.samples.rows[:0], empty, empty)
    capture.aligns = Table(capture.aligns.rows[:0], empty, empty)
    capture.params = []
    pixels = drawn(capture, tmp_path)
    dark = [(part(p, RATE).max(axis=2) < 0.4).mean() for p in (whole, pixels)]
    assert dark[1] < dark[0] / 2  # a line of text in place of the curve
    assert count(part(pixels, TRAJECTORY), ESTIMATE_COLOUR) > 100


def test_a_single_pose_is_no_trouble(walk: Path, tmp_path: Path) -> None:
    capture = with_truth(walk, tmp_path, None)
    poses = capture.poses
    capture.poses = Table(poses.rows[:1], poses.tick[:1], poses.order[:1])
    assert drawn(capture, tmp_path).min() < 0.5


def test_a_standing_foot_is_no_trouble(tmp_path: Path) -> None:
    importing.to_capture(simulate("stand", duration_s=4.0), tmp_path / "raw.solcap")
    replaying.replay(
        captures.load(tmp_path / "raw.solcap"), tmp_path / "stand.solcap", engine="fast"
    )
    assert drawn(captures.load(tmp_path / "stand.solcap"), tmp_path).min() < 0.5


def test_the_title_can_be_chosen(walk: Path, tmp_path: Path) -> None:
    capture = captures.load(walk)
    short, long = (
        (part(drawn(capture, tmp_path, title), TITLE) < 0.5).sum()
        for title in ("I", "A walk for $5 around the $house")
    )
    assert long > 5 * short > 0


def test_a_capture_without_poses_is_refused(walk: Path, tmp_path: Path) -> None:
    with pytest.raises(SolenavError, match="no poses") as caught:
        plot(captures.load(walk.with_name("raw.solcap")), tmp_path / "walk.png")
    assert "replay" in caught.value.remedy
    assert not (tmp_path / "walk.png").exists()


def test_a_picture_that_cant_be_written_is_an_error(walk: Path, tmp_path: Path) -> None:
    with pytest.raises(SolenavError, match="can't write"):
        plot(captures.load(walk), tmp_path / "nowhere" / "walk.png")


def test_matplotlib_is_asked_for(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(SolenavError, match="matplotlib") as caught:
        plot(captures.load(walk), tmp_path / "walk.png")
    assert "solenav[plot]" in caught.value.remedy


def test_a_long_line_keeps_its_extremes() -> None:
    time = np.arange(700_000) / 200.0
    values = np.sin(time)
    values[123_456], values[654_321] = 40.0, -30.0
    values[200_000:300_000] = np.nan
    short_time, short = envelope(time, values)
    assert len(short) == len(short_time) < 5000
    assert np.nanmax(short) == 40.0
    assert np.nanmin(short) == -30.0
    assert short_time[np.nanargmax(short)] == pytest.approx(time[123_456], abs=2.0)
    assert np.isnan(short[(short_time > 1002) & (short_time < 1498)]).all()
