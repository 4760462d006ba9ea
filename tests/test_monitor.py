"""Watching boards live: several wearers, ports that go and come, recording, window, lines."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from cli import SOLENAV, refused, solenav

from solenav import capture
from solenav.link import Frame, FrameReader, encode
from solenav.link.units import POSE_FLAGS, complaints
from solenav_core import messages
from solenav_tools.monitor import live as lives
from solenav_tools.monitor.live import Live
from solenav_tools.monitor.watch import Watch
from solenav_tools.monitor.wearers import Wearer, wearers
from solenav_tools.settings import PortSettings, Settings


class Cable:
    """A port under a fixed name, at which bytes arrive; it can be pulled and plugged in again."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self._ends: tuple[int, int] | None = None

    def plug(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        self._ends = master, slave
        self.name.symlink_to(os.ttyname(slave))

    def send(self, data: bytes, piece: int = 512) -> None:
        assert self._ends is not None
        # What comes before the client has opened and discarded its input would be lost.
        os.read(self._ends[0], 1)
        for start in range(0, len(data), piece):
            os.write(self._ends[0], data[start : start + piece])

    def pull(self) -> None:
        assert self._ends is not None
        self.name.unlink()
        for end in reversed(self._ends):
            os.close(end)
        self._ends = None


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    made = Cable(tmp_path / "port")
    made.plug()
    yield made
    if made._ends:
        made.pull()


@pytest.fixture(scope="module")
def stream(replayed: Path) -> bytes:
    """A walk's messages from its start."""
    return b"".join(data for _t, data in capture.read_records(replayed))


def frames(data: bytes) -> list[Frame]:
    return [item for item in FrameReader().feed(data) if isinstance(item, Frame)]


def wait_for(what: object, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not what():  # type: ignore[operator]
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)


@contextmanager
def watched(cable: Cable, record_to: Path | None = None) -> Iterator[Watch]:
    watch = Watch(Wearer("ann", str(cable.name), 460800, "#112233"), record_to)
    watch.start()
    try:
        yield watch
    finally:
        watch.stop()


def test_no_frame_is_lost_while_nobody_looks(cable: Cable, stream: bytes, tmp_path: Path) -> None:
    data = stream[:150_000]
    with watched(cable, tmp_path / "r.solcap") as watch:
        sending = threading.Thread(target=cable.send, args=(data,))
        sending.start()
        # Drawing holds the lock for a moment, now and then, and does nothing about the data.
        for _ in range(20):
            with watch.lock:
                time.sleep(0.01)
        sending.join()
        wait_for(lambda: watch.live.frames >= len(frames(data)))
        assert (watch.live.frames, watch.live.lost) == (len(frames(data)), 0)
    kept = b"".join(part for _t, part in capture.read_records(tmp_path / "r.solcap"))
    assert kept == data


def test_a_port_that_is_plugged_in_again_is_watched_and_recorded_on(
    cable: Cable, stream: bytes, tmp_path: Path
) -> None:
    half = stream.index(b"\0", 60_000) + 1
    first, second = stream[:half], stream[half : half + 60_000]
    with watched(cable, tmp_path / "r.solcap") as watch:
        cable.send(first)
        wait_for(lambda: watch.live.frames >= len(frames(first)))
        cable.pull()
        wait_for(lambda: watch.gone)
        cable.plug()
        cable.send(second)
        wait_for(lambda: watch.live.frames >= len(frames(first)) + len(frames(second)))
        assert (watch.gone, watch.losses) == (False, 1)
    kept = b"".join(part for _t, part in capture.read_records(tmp_path / "r.solcap"))
    assert kept == first + second


def test_a_port_that_stays_away_is_waited_for_and_told(cable: Cable, stream: bytes) -> None:
    process = subprocess.Popen(
        [SOLENAV, "monitor", cable.name], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    cable.send(stream[:30_000])
    line = process.stdout.readline()
    while "position" not in line:
        line = process.stdout.readline()
    cable.pull()
    while "UNPLUGGED" not in line:
        line = process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _out, said = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "didn't come back" in said and "try:" in said


def test_data_are_stale_after_a_second_of_silence(stream: bytes) -> None:
    view = Live()
    for frame in frames(stream[:50_000]):
        view.take(frame, 10.0)
    assert not view.stale(10.9)
    assert view.stale(11.1)


def test_a_full_disk_ends_the_recording_and_not_the_watching(cable: Cable, stream: bytes) -> None:
    with watched(cable, cable.name.with_suffix(".solcap")) as watch:
        assert watch._writer is not None
        watch._writer.close()
        watch._writer._file = Path("/dev/full").open("wb", buffering=0)  # noqa: SIM115
        cable.send(stream[:50_000])
        wait_for(lambda: watch.live.frames >= len(frames(stream[:50_000])))
        assert "No space left" in watch.trouble
        assert not watch.recording


def pose(tick: int, **changes: int) -> Frame:
    """A POSE at a tick: fields by name, all else 0."""
    fields = next(f for kind, _n, _w, f in messages.MESSAGES if kind == messages.POSE)
    values: list[int] = []
    for name, _code, count, _form, _meaning in fields:
        values += [changes.get(name, 0)] * count
    payload = struct.pack(messages.FORMATS[messages.POSE], *values)
    frame = FrameReader().feed(encode(messages.POSE, tick & 255, tick, payload))
    found = next(iter(frame))
    assert isinstance(found, Frame)
    return found


def test_every_complaint_of_a_pose_is_told_in_words() -> None:
    for flag in POSE_FLAGS.keys() - {messages.IN_STANCE, messages.NAVIGATING}:
        (text,) = complaints(flag)
        view = Live()
        view.take(pose(1, flags=flag | messages.NAVIGATING), 0.0)
        assert text in view.values()["warning"]
        assert view.as_dict()["warnings"] == [text]
        assert view.way[-1].doubtful
    sound = Live()
    sound.take(pose(1, flags=messages.NAVIGATING | messages.IN_STANCE), 0.0)
    assert "warning" not in sound.values() and not sound.way[-1].doubtful


def test_the_way_keeps_its_ends_however_long_it_gets() -> None:
    view = Live()
    for tick in range(1, 50_001):
        view.take(pose(tick, position=tick << 10), 0.0)
    assert len(view.way) < lives.WAY and len(view.recent) == lives.RECENT
    times = [point.time_s for point in view.way]
    assert times[0] == 1 / 200 and times == sorted(times)
    assert times[-1] > 50_000 / 200 - 1.0
    assert max(np.diff(times)) <= 2 * 50_000 / 200 / (lives.WAY / 2)


def test_a_board_that_starts_afresh_begins_another_way() -> None:
    view = Live()
    for tick in (*range(1, 500), *range(1, 100)):
        view.take(pose(tick), 0.0)
    assert (view.starts, len(view.way)) == (1, 99)


def test_wearers_have_names_from_the_line_the_settings_or_the_port() -> None:
    chosen = Settings(ports={"left": PortSettings("/dev/ttyUSB3", 115200, "green")})
    found = wearers(["left", "bob=/dev/ttyACM0", "/dev/ttyUSB9"], chosen)
    assert [(w.name, w.port, w.baud) for w in found] == [
        ("left", "/dev/ttyUSB3", 115200),
        ("bob", "/dev/ttyACM0", 460800),
        ("ttyUSB9", "/dev/ttyUSB9", 460800),
    ]
    assert len({w.colour for w in found}) == 3
    assert all(w.colour.startswith("#") for w in found)


def test_two_wearers_cannot_share_a_port_or_a_name() -> None:
    refused(solenav("monitor", "a=/dev/null", "a=/dev/zero"), 2, "two wearers have the name a")
    refused(solenav("monitor", "a=/dev/null", "b=/dev/null"), 2, "two wearers have the port")


def test_several_wearers_in_a_pipe_each_have_their_line(stream: bytes, tmp_path: Path) -> None:
    cables = [Cable(tmp_path / name) for name in ("one", "two")]
    for cable in cables:
        cable.plug()
    (tmp_path / "out").mkdir()
    process = subprocess.Popen(
        [
            SOLENAV,
            "monitor",
            f"ann={cables[0].name}",
            cables[1].name,
            "--json",
            "-o",
            tmp_path / "out",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    for cable in cables:
        cable.send(stream[:80_000])
    seen: dict[str, dict[str, object]] = {}
    wanted = frames(stream[:80_000])[-1].tick
    deadline = time.monotonic() + 60
    while {facts["tick"] for facts in seen.values()} != {wanted} or len(seen) < 2:
        assert time.monotonic() < deadline
        facts = json.loads(process.stdout.readline())
        seen[facts["name"]] = facts
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert set(seen) == {"ann", "two"}
    assert isinstance(seen["ann"]["position"], list) and seen["ann"]["mode"] is not None
    files = sorted((tmp_path / "out").glob("*.solcap"))
    assert [path.stem.rsplit("-", 1)[1] for path in files] == ["ann", "two"]
    for path in files:
        assert b"".join(p for _t, p in capture.read_records(path)) == stream[:80_000]
    for cable in cables:
        cable.pull()


def test_a_folder_that_is_not_there_is_told_before_anything_is_opened(tmp_path: Path) -> None:
    done = solenav("monitor", "a=/dev/nope1", "b=/dev/nope2", "-o", tmp_path / "none")
    refused(done, 2, "there is no folder", "mkdir -p")


def test_a_window_without_a_screen_is_refused_with_what_to_do(cable: Cable) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [SOLENAV, "monitor", cable.name, "--plot"],
        capture_output=True,
        text=True,
        env={**environment, "MPLBACKEND": "agg"},
        timeout=120,
    )
    refused(done, 2, "no window can be opened", "--web")


def test_the_window_draws_the_track_and_blits_the_rest(
    cable: Cable, stream: bytes, tmp_path: Path
) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from solenav_tools.monitor.window import Window

    figure = Figure(figsize=(11, 7))
    canvas = FigureCanvasAgg(figure)
    canvas.blit = lambda *_area: None
    watch = Watch(Wearer("ann", str(cable.name), 460800, "#d95f02"))
    window = Window([watch], figure)
    empty = np.asarray(canvas.buffer_rgba()).copy()
    for i, frame in enumerate(frames(stream)):
        watch.live.take(frame, i / 200)
        if i % 200 == 0:
            window.update(i / 200)
    drawn = np.asarray(canvas.buffer_rgba())
    orange = (np.abs(drawn[:, :, :3].astype(int) - (0xD9, 0x5F, 0x02)).sum(axis=2) < 40).sum()
    assert orange > 500 and not (drawn == empty).all()
    updates = len(frames(stream)) // 200
    assert window.redraws < updates / 4, "the background is drawn anew only when an axis changes"
    assert watch._port is not None
    watch._port.close()
