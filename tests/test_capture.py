"""Capture files keep what came, whatever happens to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solenav import capture, link
from solenav.capture import file as capture_file
from solenav.capture import sidecar
from solenav.capture.contents import unwrap
from solenav.capture.summary import summary
from solenav.errors import SolenavError
from solenav.recording import Truth
from solenav_core import messages


def sample(tick: int) -> bytes:
    rest = messages.SIZES[messages.SAMPLE] - 4
    payload = (tick * 5000 % 2**32).to_bytes(4, "little") + bytes(rest)
    return link.encode(messages.SAMPLE, tick, tick, payload)


def write(path: Path, *pieces: bytes) -> Path:
    with capture.CaptureWriter(path) as writer:
        for i, piece in enumerate(pieces):
            writer.write(float(i), piece)
    return path


@given(st.lists(st.tuples(st.floats(0, 1e9), st.binary(min_size=1, max_size=300)), max_size=20))
def test_records_come_back(tmp_path_factory: pytest.TempPathFactory, records: list) -> None:
    path = tmp_path_factory.mktemp("records") / "x.solcap"
    with capture.CaptureWriter(path) as writer:
        for arrival, data in records:
            writer.write(arrival, data)
    assert capture.read_records(path) == records


def test_a_capture_cut_at_any_byte_reads_to_its_last_whole_frame(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.solcap", *(sample(tick) for tick in range(1, 6)))
    data = whole.read_bytes()
    frame = 10 + len(sample(1))
    cut = tmp_path / "cut.solcap"
    for length in range(len(capture_file.MAGIC), len(data) + 1):
        cut.write_bytes(data[:length])
        got = capture.load(cut)
        frames = (length - len(capture_file.MAGIC)) // frame
        assert len(got.samples) in (frames, frames + 1)
        assert (got.cut_off_bytes > 0) == ((length - len(capture_file.MAGIC)) % frame > 0)


def test_a_frame_may_span_records(tmp_path: Path) -> None:
    data = sample(1) + sample(2)
    path = write(tmp_path / "x.solcap", data[:11], data[11:40], data[40:])
    assert capture.load(path).samples.tick.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "is empty"), (b"\x89PNG\r\n\x1a\n" + bytes(50), "no solenav capture")],
)
def test_what_is_no_capture_is_an_error_with_a_remedy(
    tmp_path: Path, content: bytes, says: str
) -> None:
    path = tmp_path / "x.solcap"
    path.write_bytes(content)
    with pytest.raises(SolenavError, match=says) as caught:
        capture.load(path)
    assert caught.value.remedy


def test_a_missing_capture_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SolenavError, match="No such file"):
        capture.load(tmp_path / "none.solcap")


def test_a_full_disk_is_said_and_loses_nothing_written(tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full here")
    with pytest.raises(SolenavError, match="No space left"):
        write(full, sample(1))


def test_damaged_frames_are_counted_and_the_rest_is_read(tmp_path: Path) -> None:
    bad = bytearray(sample(2))
    bad[8] ^= 0x40
    path = write(tmp_path / "x.solcap", sample(1), bytes(bad), sample(3), b"\x05noise\0")
    got = capture.load(path)
    assert got.samples.tick.tolist() == [1, 3]
    assert sum(got.damaged.values()) == 2
    facts = summary(got)
    assert facts["samples"]["gaps"] == 1
    assert facts["samples"]["missing"] == 1


def test_time_stamps_are_unwrapped() -> None:
    stamps = np.array([2**32 - 6000, 2**32 - 1000, 4000, 9000], np.uint32)
    assert np.allclose(np.diff(unwrap(stamps)), 0.005)


def test_time_of_a_tick_counts_from_the_first_sample(tmp_path: Path) -> None:
    # The first two samples are lost, and one in the middle.
    path = write(tmp_path / "x.solcap", *(sample(tick) for tick in (3, 4, 6, 7)))
    got = capture.load(path)
    assert np.allclose(got.time_of_tick(np.arange(1, 9)), np.arange(8) * 0.005)


def test_another_schema_is_named(tmp_path: Path) -> None:
    hello = bytearray(messages.SIZES[messages.HELLO])
    hello[:2] = (messages.SCHEMA ^ 1).to_bytes(2, "little")
    frame = link.encode(messages.HELLO, 0, 0, bytes(hello) + b"Pico; 9.9")
    got = capture.load(write(tmp_path / "x.solcap", frame))
    with pytest.raises(SolenavError, match=r"firmware and host differ.*Pico; 9\.9"):
        got.need_samples()


def test_truth_comes_back_with_what_it_does_not_know(tmp_path: Path) -> None:
    path = tmp_path / "x.solcap"
    truth = Truth(
        np.array([0.0, 1.0]),
        np.array([[1.0, 2.0, np.nan], [3.0, 4.0, np.nan]]),
        stance=np.array([True, False]),
        closed_loop=True,
    )
    sidecar.write_sidecar(path, {"truth": sidecar.truth_notes(truth)})
    sidecar.write_truth(path, truth)
    got = sidecar.read_truth(path)
    assert got is not None
    assert np.array_equal(got.position_enu, truth.position_enu, equal_nan=True)
    assert got.stance is not None and got.stance.tolist() == [True, False]
    assert got.velocity_enu is None and got.closed_loop and got.frame == "local"


def test_a_damaged_truth_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "x.solcap"
    sidecar.truth_path(path).write_text("time_s,east_m\n0,1\n")
    with pytest.raises(SolenavError, match="no truth table"):
        sidecar.read_truth(path)


def test_a_damaged_sidecar_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "x.solcap"
    sidecar.sidecar_path(path).write_text("{")
    with pytest.raises(SolenavError, match="can't be read"):
        sidecar.read_sidecar(path)
