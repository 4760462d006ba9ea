"""What no host hears is in flash, whole and in order, whatever happens to power and space."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
import serial
import wire
from board import Client
from hypothesis import given
from hypothesis import strategies as st
from logging_board import SECOND, Board, wanted

from solenav import capture, link
from solenav.sim.board import flash
from solenav_core import messages
from solenav_tools import firmware_run
from solenav_tools.micropython import find_micropython
from solenav_tools.staging import stage


def is_subsequence(part: list[tuple[int, int]], whole: list[tuple[int, int]]) -> bool:
    rest = iter(whole)
    return all(item in rest for item in part)


def test_what_nobody_hears_is_kept_whole_and_in_order(tmp_path: Path) -> None:
    board = Board(tmp_path)
    board.run(60)
    board.box.close()
    assert board.kept() == wanted(board.sent)
    assert board.box.lost == 0
    assert board.box.logged == sum(p.stat().st_size for p in tmp_path.glob("log/*"))


def test_with_samples_everything_is_kept(tmp_path: Path) -> None:
    board = Board(tmp_path, everything=True)
    board.run(30)
    board.box.close()
    assert board.kept() == board.sent
    assert len(board.files()) > 3
    assert board.box.lost == 0


def test_switched_off_it_does_nothing(tmp_path: Path) -> None:
    board = Board(tmp_path, "off")
    board.run(20)
    board.box.close()
    assert not list(tmp_path.iterdir())
    assert (board.box.logged, board.box.lost) == (0, 0)


def test_each_file_says_what_it_is_the_record_of(tmp_path: Path) -> None:
    board = Board(tmp_path, everything=True)
    board.run(40)
    files = board.files()
    assert len(files) > 4
    for file in files:
        kinds = [item.kind for item in file[:150] if isinstance(item, link.Frame)]
        assert messages.HELLO in kinds and messages.PARAMS in kinds
    assert max(p.stat().st_size for p in tmp_path.glob("log/*")) <= 65536


def test_while_a_host_listens_nothing_is_written(tmp_path: Path) -> None:
    board = Board(tmp_path)
    board.run(30, listening=True)
    board.box.close()
    assert board.kept() == []
    assert board.box.lost == 0


def test_what_was_sent_before_the_first_host_came_is_kept(tmp_path: Path) -> None:
    board = Board(tmp_path)
    board.run(3)
    before = wanted(board.sent)
    board.run(20, listening=True)
    assert board.kept()[: len(before)] == before
    assert len(board.kept()) < len(before) + 5, "then a host listened"
    assert not board.box.busy()


def test_what_was_sent_after_a_host_s_last_word_is_kept(tmp_path: Path) -> None:
    """It may have left right after it, 5 s before the board can know."""
    board = Board(tmp_path)
    board.run(30, listening=True)
    board.box.listen()
    at = len(board.sent)
    board.run(20)
    board.box.close()
    missed = [f for f in wanted(board.sent[at:]) if f[0] != messages.POSE]
    assert is_subsequence(missed, board.kept())
    poses = [tick for kind, tick in board.kept() if kind == messages.POSE]
    assert poses[0] <= board.sent[at][1] + SECOND
    assert poses[-1] >= board.tick - SECOND


def test_hosts_come_and_go(tmp_path: Path) -> None:
    board = Board(tmp_path)
    for _ in range(4):
        board.run(12)
        board.run(9, listening=True)
    assert len(board.files()) == 4
    board.run(12)
    board.box.close()
    assert board.box.lost == 0
    assert is_subsequence(board.kept(), board.sent)


def test_when_flash_is_full_the_oldest_stays_and_it_is_said(tmp_path: Path) -> None:
    board = Board(tmp_path, everything=True, capacity=350_000)
    board.run(60)
    board.box.close()
    kept = board.kept()
    assert len(kept) > 2000
    assert kept == board.sent[: len(kept)]
    assert board.box.lost == len(board.sent) - len(kept)
    assert board.box.free() >= -8192, "the reserve is there, but for the file system's own blocks"
    assert len(board.log) == 1 and "is full" in board.log[0]


def test_overwriting_the_newest_stays(tmp_path: Path) -> None:
    board = Board(tmp_path, "overwrite", True, capacity=350_000)
    board.run(60)
    board.box.close()
    kept = board.kept()
    assert len(kept) > 2000
    assert kept == board.sent[-len(kept) :]
    assert board.box.lost == 0
    assert board.box.free() >= -8192
    assert not board.log
    numbers = [int(p.stem) for p in sorted(tmp_path.glob("log/*"))]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert numbers == board.box.numbers


@pytest.mark.parametrize("policy", ["stop", "overwrite"])
def test_space_that_others_take_costs_nothing_that_was_flushed(policy: str, tmp_path: Path) -> None:
    board = Board(tmp_path, policy)
    board.run(60)
    safe = board.box.logged
    flash.full = True
    board.run(60)
    assert sum(p.stat().st_size for p in tmp_path.glob("log/*")) >= safe
    kept = board.kept()
    assert kept == wanted(board.sent)[: len(kept)]
    assert board.box.lost > 0
    assert "is full" in board.log[0]


def test_flash_that_fails_is_given_up_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = Board(tmp_path)
    board.run(20)
    kept = board.kept()

    def fail(*_arguments: object) -> None:
        raise OSError(5, "EIO")

    monkeypatch.setattr(flash._File, "flush", fail)
    board.run(60)
    assert board.kept() == kept
    assert board.box.lost > 0
    assert len(board.log) == 1 and "can't write to flash" in board.log[0]


def test_a_folder_that_can_t_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "log").write_text("a file")
    board = Board(tmp_path)
    board.run(20)
    assert board.log
    assert (tmp_path / "log").read_text() == "a file"


def test_after_a_restart_a_new_file_follows_the_old_ones(tmp_path: Path) -> None:
    first = Board(tmp_path)
    first.run(20)
    kept = first.kept()
    (tmp_path / "log" / "000009.frames").touch()  # opened, then the power went
    (tmp_path / "log" / "notes.txt").write_text("mine")
    second = Board(tmp_path)
    second.run(20)
    second.box.close()
    assert second.box.numbers == [1, 2]
    assert second.kept() == kept + wanted(second.sent)
    assert (tmp_path / "log" / "notes.txt").read_text() == "mine"


def cut_off(folder: Path, cut: tuple[int, int], torn: bool, everything: bool) -> bool:
    """Cut the power at an operation or byte of the flash; False: it never came to that.

    AssertionError where anything acknowledged is gone, anything but a torn end is damaged, or
    the next start doesn't go on.
    """
    options = {"capacity": 200_000, "torn": torn}
    board = Board.__new__(Board)
    board.sent = []
    try:
        board.__init__(folder, "overwrite", everything, cut=cut, **options)  # type: ignore[misc]
        board.run(12 if everything else 20)
        board.box.close()
        return False
    except SystemExit:
        pass
    safe = board.box.logged if board.sent else 0
    files = board.files()
    damages = [item for file in files for item in file if isinstance(item, link.Damage)]
    assert len(damages) <= (1 if torn else 0)
    kept = [item[:3:2] for file in files for item in file if isinstance(item, link.Frame)]
    sent = board.sent if everything else wanted(board.sent)
    # Old files may have gone to make room; what is there is a stretch without a hole.
    start = sent.index(kept[0]) if kept else 0
    assert kept == sent[start : start + len(kept)]
    assert kept or not safe
    if start == 0:
        assert sum(p.stat().st_size for p in folder.glob("log/*")) >= safe
    again = Board(folder, "overwrite", everything, **options)
    again.run(8)
    again.box.close()
    assert again.box.lost == 0 and not again.log
    assert again.files()[-1][-1][:3:2] == again.sent[-1]
    return True


@pytest.mark.parametrize("torn", [False, True])
@pytest.mark.parametrize("everything", [False, True])
def test_the_power_goes_at_any_access_to_flash(
    torn: bool, everything: bool, tmp_path: Path
) -> None:
    cuts = 0
    while cut_off(tmp_path / str(cuts), (cuts + 1, 0), torn, everything):
        cuts += 23 if everything else 1
    assert cuts > 20


@given(st.integers(1, 3500), st.booleans())
def test_the_power_goes_at_any_byte(
    tmp_path_factory: pytest.TempPathFactory, byte: int, torn: bool
) -> None:
    cut_off(tmp_path_factory.mktemp("flash"), (0, byte), torn, False)


def test_an_access_is_short_enough_for_the_sensor_s_fifo(tmp_path: Path) -> None:
    """Simulated flash takes 45 ms to erase a block; the FIFO bridges 0.2 s."""
    board = Board(tmp_path, everything=True)
    board.run(60)
    assert 45_000 < board.box.longest < 200_000


def test_an_hour_fits_in_a_pico(tmp_path: Path) -> None:
    board = Board(tmp_path)
    board.run(600)
    board.box.close()
    assert board.box.logged * 6 < 1_000_000


@pytest.mark.skipif(os.name != "posix", reason="no pseudo-terminals here")
@pytest.mark.parametrize("operation", [4, 12, 30])
def test_a_board_whose_power_goes_keeps_what_it_has_acknowledged(
    operation: int, walk: Path
) -> None:
    """The firmware as it is: STATUS says how much is safe."""
    cut = {"kind": "power_cut", "operation": operation, "for": 1_000_000}
    source = capture.load(walk)
    config = {"checkpoint_s": 600}
    with (
        firmware_run.board_for(source, pose_every=4, faults=[cut], config=config) as board,
        serial.Serial(board.port, 460800, timeout=0.5) as port,
    ):
        client = Client(port)
        client.to_the_end()
        folder = board.folder / "log"
        files = {int(p.stem): p.read_bytes() for p in folder.glob("*.frames")}
    assert board.restarts == ["power"]
    hellos = [i for i, m in enumerate(client.messages) if m.name == "HELLO"]
    lives = client.messages[: hellos[1]], client.messages[hellos[1] :]
    acknowledged = [
        [m.fields["logged"] for m in life if m.name == "STATUS"][-1:] or [0] for life in lives
    ]
    assert acknowledged[1][0] > 0
    assert sum(map(len, files.values())) >= acknowledged[0][0] + acknowledged[1][0]
    assert len(files) == (2 if acknowledged[0][0] else 1)
    for data in files.values():
        assert wire.decode(data)


ALLOCATION = """
import gc
import sys

sys.path[:] = [""]
from solenav.sim.board import machine, simtime

sys.modules["machine"] = machine
sys.modules["time"] = simtime
from blackbox import BlackBox
from download import Download
from link import Link

from solenav_core.framing import HEADER
from solenav_core.messages import POSE, SAMPLE, SIZES, STATUS


class Uart:
    def write(self, buffer, offset, length):
        return length

    def any(self):
        return 0


link = Link(Uart())
box = BlackBox(link, "stop", EVERYTHING, 200, lambda: None)
download = Download(link, box)
KINDS = (SAMPLE, POSE, STATUS)


def passes(n):
    for tick in range(n):
        link.receive(tick)
        for kind in KINDS:
            link.send(kind, tick, HEADER + SIZES[kind])
        download.step(tick) or box.step(tick)
        link.pump()


def allocated(n):
    gc.collect()
    gc.disable()
    before = gc.mem_alloc()
    passes(n)
    spent = gc.mem_alloc() - before
    gc.enable()
    return spent


passes(3)
print(allocated(5), box.ring.used > 0)
box.listen()
passes(200)
print(allocated(300), box.ring.used > 1000)
"""


@pytest.mark.parametrize("everything", [False, True])
def test_nothing_is_allocated_per_frame(everything: bool, tmp_path: Path) -> None:
    """Neither while frames wait to be written nor while old ones make room for new ones."""
    stage(tmp_path, {})
    (tmp_path / "allocation.py").write_text(ALLOCATION.replace("EVERYTHING", str(everything)))
    command = [find_micropython(), "allocation.py"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (ran.stdout.split(), ran.stderr) == (["0", "True", "0", "True"], "")
