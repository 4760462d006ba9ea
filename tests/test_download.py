"""The black box's way to the host: complete, equal to the byte, whatever breaks on the way."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import time
from binascii import crc32
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import serial
from board import Client
from cli import SOLENAV, refused, solenav
from hypothesis import given, settings
from hypothesis import strategies as st
from logging_board import Board
from test_device_cli import on_a_terminal, sender
from test_firmware import still

from solenav import capture, link
from solenav.capture.sidecar import read_sidecar
from solenav.errors import SolenavError
from solenav.sim.board import simtime
from solenav.verification import verify
from solenav_core import messages
from solenav_tools import conversation, download, firmware_run, recorder
from solenav_tools.board import SimulatedBoard
from solenav_tools.ports import PortVanished

pytestmark = pytest.mark.skipif(os.name != "posix", reason="no pseudo-terminals here")


class Line:
    """A serial port as pyserial's, with a board of this process at its end.

    `noise` may change what passes, in both directions. The port vanishes after `pulled` bytes.
    """

    name = "line"

    def __init__(
        self,
        board: Board,
        noise: Callable[[bytes], bytes] = bytes,
        pulled: int = 1 << 30,
    ) -> None:
        self.board = board
        self.noise = noise
        self.pulled = pulled

    @property
    def in_waiting(self) -> int:
        return len(self.board.uart.sent)

    def read(self, most: int) -> bytes:
        if not self.board.uart.sent:
            self.board.turn()
        data = bytes(self.board.uart.sent[:most])
        del self.board.uart.sent[:most]
        self.pulled -= len(data)
        if self.pulled < 0:
            raise serial.SerialException("pulled")
        return self.noise(data)

    def write(self, data: bytes) -> None:
        self.board.uart.waiting += self.noise(data)


@pytest.fixture(autouse=True, scope="module")
def simulated_time() -> Iterator[None]:
    """The host waits on the clock of the board at the other end of the line."""
    clock = SimpleNamespace(monotonic=lambda: simtime.now() * 1e-6)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(download, "time", clock)
        patch.setattr(recorder, "time", clock)
        patch.setattr(conversation, "time", clock)
        yield


def recorded(folder: Path, seconds: float = 40, **options: Any) -> tuple[Board, list[Path]]:
    """A board that has walked unheard, and the files in its flash."""
    board = Board(folder, line=True, **options)
    board.run(seconds)
    board.box.close()
    board.uart.sent.clear()
    return board, sorted(folder.glob("log/*.frames"))


def fetched(line: Line, folder: Path, **options: bool) -> list[download.Fetched]:
    box = download.BlackBox(line)  # type: ignore[arg-type]
    box.hello()
    return [download.fetch(box, file, folder, {}, **options) for file in box.files()]


def stream_of(path: Path) -> bytes:
    return b"".join(data for _t, data in capture.read_records(path))


@pytest.fixture
def here(tmp_path: Path) -> Path:
    folder = tmp_path / "here"
    folder.mkdir()
    return folder


def test_a_file_comes_as_a_capture_equal_to_the_byte(tmp_path: Path, here: Path) -> None:
    board, (file,) = recorded(tmp_path / "flash")
    (got,) = fetched(Line(board), here)
    assert stream_of(got.capture) == file.read_bytes()
    assert got.crc == crc32(file.read_bytes())
    assert (got.damaged, got.resumed_from, got.there_already, got.erased) == (0, 0, False, False)
    assert read_sidecar(got.capture)["blackbox"]["number"] == 1
    assert sorted(p.suffix for p in here.iterdir()) == [".json", ".solcap"]
    assert file.exists()
    arrivals = [t for t, _data in capture.read_records(got.capture)]
    assert arrivals == sorted(arrivals)


def test_what_is_here_already_is_not_fetched_again(tmp_path: Path, here: Path) -> None:
    board, _files = recorded(tmp_path / "flash")
    (first,) = fetched(Line(board), here)
    before = first.capture.stat().st_mtime_ns
    (second,) = fetched(Line(board, pulled=20_000), here)
    assert second.there_already
    assert first.capture.stat().st_mtime_ns == before


@given(st.lists(st.integers(0, 40_000), min_size=1, max_size=4), st.integers(0, 2))
@settings(max_examples=10)
def test_pulled_at_any_byte_it_goes_on_from_there(
    tmp_path_factory: pytest.TempPathFactory, pulls: list[int], torn: int
) -> None:
    folder = tmp_path_factory.mktemp("pulled")
    board, (file,) = recorded(folder / "flash")
    had = 0
    for pulled in pulls:
        try:
            fetched(Line(board, pulled=pulled), folder)
            break
        except PortVanished:
            (part,) = list(folder.glob("*.part")) or [None]
            if part is not None:
                assert part.read_bytes() == file.read_bytes()[: part.stat().st_size]
                if torn and part.stat().st_size > torn:
                    # The host's power went as well: the end of the file isn't on its disk.
                    os.truncate(part, part.stat().st_size - torn)
                had = part.stat().st_size
        board.uart.sent.clear()
    (got,) = fetched(Line(board), folder)
    assert stream_of(got.capture) == file.read_bytes()
    assert got.there_already or got.resumed_from == had
    assert not list(folder.glob("*.part"))


# One byte in 300 spoilt and a frame of 240 bytes comes through less than every second time: then
# ten tries in a row may fail, one download in forty, and the same command goes on from there.
@given(st.integers(0, 2**32), st.integers(800, 4000))
@settings(max_examples=10)
def test_a_noisy_line_costs_time_only(
    tmp_path_factory: pytest.TempPathFactory, seed: int, every: int
) -> None:
    """Bytes change and vanish, in both directions."""
    folder = tmp_path_factory.mktemp("noisy")
    board, (file,) = recorded(folder / "flash", 25)
    rng = random.Random(seed)

    def noise(data: bytes) -> bytes:
        spoilt = bytearray(data)
        for i in reversed(range(len(spoilt))):
            if rng.randrange(every) == 0:
                if rng.random() < 0.5:
                    spoilt[i] ^= rng.randrange(1, 256)
                else:
                    del spoilt[i]
        return bytes(spoilt)

    (got,) = fetched(Line(board, noise), folder)
    assert stream_of(got.capture) == file.read_bytes()


def test_a_part_that_went_bad_is_fetched_anew(tmp_path: Path, here: Path) -> None:
    board, (file,) = recorded(tmp_path / "flash")
    with pytest.raises(PortVanished):
        fetched(Line(board, pulled=30_000), here)
    board.uart.sent.clear()
    (part,) = here.glob("*.part")
    part.write_bytes(b"\x55" * part.stat().st_size)
    (got,) = fetched(Line(board), here)
    assert stream_of(got.capture) == file.read_bytes()
    assert got.resumed_from == 0


def test_a_file_is_erased_only_when_its_copy_is_verified(tmp_path: Path, here: Path) -> None:
    board, files = recorded(tmp_path / "flash", 12, everything=True)
    assert len(files) > 1
    with pytest.raises(PortVanished):
        fetched(Line(board, pulled=110_000), here, erase=True)
    board.uart.sent.clear()
    left = sorted((tmp_path / "flash").glob("log/*.frames"))
    assert files[-len(left) :] == left
    assert len(list(here.glob("*.solcap"))) >= len(files) - len(left)
    got = fetched(Line(board), here, erase=True)
    assert all(file.erased for file in got)
    assert not list((tmp_path / "flash").glob("log/*.frames"))
    assert board.box.numbers == []
    with_all = b"".join(stream_of(p) for p in sorted(here.glob("*.solcap")))
    assert len(with_all) == board.box.logged


def test_the_board_erases_nothing_that_it_has_not_just_checked(tmp_path: Path) -> None:
    board, (file,) = recorded(tmp_path / "flash")
    box: Any = download.BlackBox(Line(board))  # type: ignore[arg-type]
    (stored,) = box.files()
    with pytest.raises(SolenavError, match="refuses ASK_ERASE"):
        box.erase(download.Checked(1, stored.size, crc32(file.read_bytes())))
    checked = box.check(1)
    with pytest.raises(SolenavError, match="refuses ASK_ERASE"):
        box.erase(checked._replace(crc=checked.crc ^ 1))
    assert file.exists()
    box.erase(checked)
    assert not file.exists()
    box.erase(checked)  # as when the first answer was lost
    assert box.files() == []


def test_a_full_black_box_records_again_once_it_is_erased(tmp_path: Path, here: Path) -> None:
    board, files = recorded(tmp_path / "flash", 30, everything=True, capacity=250_000)
    assert "is full" in board.log[0]
    fetched(Line(board), here, erase=True)
    board.run(20)
    board.box.close()
    assert board.box.numbers[0] > len(files)
    assert board.kept()


def test_any_stretch_of_a_file_can_be_asked_for(tmp_path: Path) -> None:
    board, (file,) = recorded(tmp_path / "flash")
    data = file.read_bytes()
    box = download.BlackBox(Line(board))  # type: ignore[arg-type]
    for start, stop in ((0, 1), (1, 300), (len(data) - 1, len(data)), (5, 5), (0, len(data))):
        assert b"".join(box.pieces(1, start, stop)) == data[start:stop]
    with pytest.raises(SolenavError, match="refuses ASK_DATA"):
        list(box.pieces(7, 0, 1))


@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                [k for k in link.NAMES if messages.ASK_LISTEN <= k <= messages.ASK_ERASE]
            ),
            st.lists(
                st.sampled_from([0, 1, 2, 300, 65535, 2**31 - 1, 2**31, 2**32 - 1])
                | st.integers(0, 2**32 - 1),
                min_size=3,
                max_size=3,
            ),
        ),
        max_size=20,
    )
)
@settings(max_examples=30)
def test_whatever_is_asked_for_the_board_goes_on(
    tmp_path_factory: pytest.TempPathFactory, asked: list[tuple[int, list[int]]]
) -> None:
    board, (file,) = recorded(tmp_path_factory.mktemp("flash"), 12)
    line = Line(board)
    for seq, (kind, values) in enumerate(asked):
        fields = [v % 65536 if kind == messages.ASK_FILES else v for v in values]
        line.write(link.command(kind, seq, *fields[: len(link.FIELDS[kind])]))
        board.turn()
    box = download.BlackBox(line)  # type: ignore[arg-type]
    assert box.files()[0].size == file.stat().st_size


def test_what_the_disk_refuses_is_said(tmp_path: Path, here: Path) -> None:
    board, (file,) = recorded(tmp_path / "flash")
    (here / f"blackbox-000001-{crc32(file.read_bytes()):08x}.part").mkdir()
    with pytest.raises(SolenavError, match="Is a directory"):
        fetched(Line(board), here)


def test_a_file_that_is_still_written_is_finished_first(tmp_path: Path, here: Path) -> None:
    board = Board(tmp_path / "flash", line=True)
    board.run(30)
    (got,) = fetched(Line(board), here)
    heard = [t for k, t in board.sent if k == messages.STATUS and t < 30 * 200]
    statuses = capture.load(got.capture).statuses
    assert statuses.tick.tolist()[: len(heard)] == heard


def test_who_records_says_so_and_the_black_box_stays_empty(tmp_path: Path) -> None:
    board = Board(tmp_path, line=True)
    for item in recorder.stream(Line(board), None, lambda: simtime.now() > 60_000_000):  # type: ignore[arg-type]
        assert not isinstance(item, link.Damage)
    assert board.box.listening
    assert all(tick <= 10 for _kind, tick in board.kept()), "before it was heard"


def joined(port: serial.Serial) -> Client:
    """A client from the next frame on."""
    while port.read(1) != b"\0":
        pass
    return Client(port)


@contextmanager
def walked(
    walk: Path, seconds: float, *, stop: bool = True, baud: int = 460800, **config: Any
) -> Iterator[tuple[SimulatedBoard, Client]]:
    """A simulated board that has walked unheard for so long, then stands idle."""
    source = capture.load(walk)
    with firmware_run.board_for(source, pose_every=4, baud=baud, config=config) as board:
        with serial.Serial(board.port, 460800, timeout=0.5) as port:
            client = Client(port)
            client.until(lambda m: m.tick >= 200 * seconds, 60)
            if stop:
                client.ask(messages.ASK_STOP, 1)
        yield board, client


def test_a_download_verifies_bit_for_bit(walk: Path, tmp_path: Path) -> None:
    with walked(walk, 9, blackbox_samples=True) as (board, client):
        done = solenav("download", board.port, "-o", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert len(result["files"]) > 1
    assert result["longest_access_us"] < 200_000
    covered = 0
    poses: dict[int, int] = {}
    for file in result["files"]:
        assert file["damaged"] == 0
        got = capture.load(Path(file["capture"]))
        report = verify(got, "fast")
        assert report.verified
        covered += report.covered_ticks
        poses |= zip(got.poses.tick.tolist(), got.poses.rows["digest"].tolist(), strict=True)
        assert solenav("info", file["capture"]).returncode == 0
    assert covered > 0.9 * 200 * 9
    live = {m.tick: m.fields["digest"] for m in client.named("POSE")}
    assert poses.items() >= live.items()


def test_a_download_without_samples_evaluates_and_plots(walk: Path, tmp_path: Path) -> None:
    with walked(walk, 25) as (board, _client):
        done = solenav("download", board.port, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "verified" in done.stdout and "1 files in" in done.stdout
    (file,) = tmp_path.glob("*.solcap")
    got = capture.load(file)
    assert len(got.poses) >= 23 and len(got.steps) > 3
    assert not len(got.samples)
    assert solenav("evaluate", file).returncode == 0
    plotted = solenav("plot", file, "-o", tmp_path / "x.png")
    assert plotted.returncode == 0, plotted.stderr


def test_interrupted_it_says_how_to_go_on_and_does(walk: Path, tmp_path: Path) -> None:
    with walked(walk, 8, blackbox_samples=True) as (board, _client):
        command = [SOLENAV, "download", board.port, "-o", tmp_path]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 30
        while sum(p.stat().st_size for p in tmp_path.glob("*.part")) < 10_000:
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _out, said = process.communicate(timeout=20)
        assert process.returncode == 1
        assert "stopped" in said and "the same command goes on" in said
        kept = sum(p.stat().st_size for p in tmp_path.glob("*.part"))
        done = solenav("download", board.port, "-o", tmp_path, "--erase", "--json")
        assert done.returncode == 0, done.stderr
        files = json.loads(done.stdout)["files"]
        assert sum(f["resumed_from"] for f in files if not f["there_already"]) == kept > 0
        assert all(f["erased"] for f in files)
        again = solenav("download", board.port, "-o", tmp_path)
        assert again.stdout.strip() == "the black box is empty"


def test_navigation_goes_on_meanwhile(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(download, "time", time)
    monkeypatch.setattr(recorder, "time", time)

    class Tee:
        """A port that keeps what passes."""

        def __init__(self, port: serial.Serial) -> None:
            self.port = port
            self.name = port.name
            self.data = b""

        @property
        def in_waiting(self) -> int:
            return self.port.in_waiting

        def read(self, most: int) -> bytes:
            data = self.port.read(most)
            self.data += data
            return data

        def write(self, data: bytes) -> None:
            self.port.write(data)

    quiet = {}
    for during in (False, True):
        with (
            walked(walk, 12, stop=False, blackbox_samples=True) as (board, client),
            serial.Serial(board.port, 460800, timeout=0.5) as port,
        ):
            if during:
                tee = Tee(port)
                box = download.BlackBox(tee)  # type: ignore[arg-type]
                for file in box.files()[:1]:
                    assert download.fetch(box, file, tmp_path, {}).damaged == 0
                client.data += b"\0" + tee.data
            rest = joined(port)
            rest.to_the_end()
            board.check()
        frames = list(link.FrameReader().feed(client.data + b"\0" + rest.data))
        poses = {
            f.tick: link.unpack(f)["digest"]
            for f in frames
            if isinstance(f, link.Frame) and f.kind == messages.POSE
        }
        status = rest.named("STATUS")[-1].fields
        assert status["lost"] == status["overruns"] == 0
        if not during:
            quiet = poses
    common = poses.keys() & quiet.keys()
    assert len(common) > 1000
    assert {tick: poses[tick] for tick in common} == {tick: quiet[tick] for tick in common}


def test_on_a_slow_line_samples_make_room_for_a_download(walk: Path, tmp_path: Path) -> None:
    with walked(walk, 10, stop=False, baud=57600) as (board, client):
        before = client.named("STATUS")[-1].fields
        done = solenav("download", board.port, "-o", tmp_path, "--json")
        assert done.returncode == 0, done.stderr
        with serial.Serial(board.port, 460800, timeout=0.5) as port:
            rest = joined(port)
            rest.until(lambda m: m.name == "STATUS")
    (file,) = json.loads(done.stdout)["files"]
    assert file["damaged"] == 0 and file["size"] > 1000
    after = rest.named("STATUS")[-1].fields
    assert after["dropped_samples"] > before["dropped_samples"] > 0
    assert after["dropped_others"] == after["lost"] == 0


def test_the_list_is_shown_without_fetching(walk: Path, tmp_path: Path) -> None:
    with walked(walk, 8) as (board, _client):
        done = solenav("download", board.port, "-o", tmp_path, "--list")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("1 files, ")
    assert not list(tmp_path.iterdir())


def test_a_progress_bar_on_a_terminal(walk: Path, tmp_path: Path) -> None:
    with walked(walk, 8) as (board, _client):
        status, shown = on_a_terminal("download", board.port, "-o", str(tmp_path))
    assert status == 0
    assert "downloading" in shown and "━" in shown


def test_what_can_t_be_done_is_said(tmp_path: Path) -> None:
    refused(solenav("download", "/dev/ttyNOSUCH7"), 2, "there is no port")
    refused(solenav("download", "/dev/null", "-o", tmp_path / "nowhere"), 2, "there is no folder")
    with sender(b"", then_vanish=False) as port:
        refused(solenav("download", port, cwd=tmp_path), 2, "nobody says HELLO")
    foreign = link.encode(messages.HELLO, 0, 0, bytes(messages.SIZES[messages.HELLO]))
    with sender(foreign * 50, then_vanish=False) as port:
        refused(solenav("download", port, cwd=tmp_path), 2, "firmware and host differ")


def test_a_switched_off_black_box_is_empty(tmp_path: Path) -> None:
    with SimulatedBoard(still(100), {"blackbox": "off", "autostart": False}) as board:
        done = solenav("download", board.port, "-o", tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, "the black box is empty")
