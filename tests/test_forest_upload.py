"""`solenav modes send`: another forest into a board, over the link."""

from __future__ import annotations

import json
import struct
import threading
from array import array
from binascii import crc32
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from cli import refused, solenav
from device import load
from test_doctor import STILL
from test_injection import answer, joined
from test_monitor import Cable

from solenav import forests, link
from solenav.errors import SolenavError
from solenav.forests import Leaf, Split
from solenav_core import messages
from solenav_core.tables.forest import FOREST
from solenav_tools.board import SimulatedBoard
from solenav_tools.forest_upload import send
from solenav_tools.ports import open_port

OTHER = forests.pack([Split(1, 40, Leaf((63, 0, 0, 0, 0)), Leaf((0, 63, 0, 0, 0)))] * 30)
SHIPPED = f"{crc32(FOREST):08x}"
SENT = f"{crc32(OTHER):08x}"


@pytest.fixture
def board() -> Iterator[SimulatedBoard]:
    with SimulatedBoard(STILL, {"autostart": False}, realtime=True) as made:
        yield made


@pytest.fixture
def other(tmp_path: Path) -> Path:
    path = tmp_path / "other.forest"
    forests.save(path, OTHER)
    return path


def hello_frame(schema: int = messages.SCHEMA) -> bytes:
    payload = schema.to_bytes(2, "little").ljust(messages.SIZES[messages.HELLO], b"\0")
    return link.encode(messages.HELLO, 0, 0, payload + b"a board")


@contextmanager
def that_says(cable: Cable, data: bytes) -> Iterator[None]:
    """Something at the cable's end that says so much and no more."""
    cable.plug()
    sending = threading.Thread(target=cable.send, args=(data,))
    sending.start()
    yield
    sending.join()


def test_a_forest_goes_into_a_board_and_out_again(board: SimulatedBoard, other: Path) -> None:
    done = solenav("modes", "send", other, "--port", board.port)
    assert done.returncode == 0, done.stderr
    assert f"before {SHIPPED}, now {SENT} (30 trees, {len(OTHER)} words)" in done.stdout
    assert "simulated" in done.stdout and "next run" in done.stdout
    done = solenav("modes", "send", "--shipped", "--port", board.port, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["had"], told["has"], told["shipped"]) == (SENT, SHIPPED, True)


def test_a_board_that_samples_takes_one_only_with_a_fresh_run(other: Path, tmp_path: Path) -> None:
    with SimulatedBoard(STILL, realtime=True) as board:
        done = solenav("modes", "send", other, "--port", board.port)
        refused(done, 1, "while it samples", "--restart")
        done = solenav("modes", "send", other, "--port", board.port, "--restart")
        assert done.returncode == 0, done.stderr
        assert "a fresh run has begun" in done.stdout
        run = tmp_path / "run.solcap"
        assert solenav("record", board.port, "-o", run, "--duration", "3").returncode == 0
    refused(solenav("verify", run), 2, SENT, "--forest")
    assert solenav("verify", run, "--forest", other).returncode == 0


def test_the_run_goes_on_afresh_where_the_board_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = array("i", OTHER)
    wrong[-1] = 5  # a split without sides: a walk would leave the list
    monkeypatch.setattr(forests, "check", lambda words: None)
    with SimulatedBoard(STILL, realtime=True) as board:
        with pytest.raises(SolenavError, match=r"refuses a forest: that is no forest: tree 30"):
            send(board.port, wrong, restart=True)
        with open_port(board.port) as port:
            client = joined(port)
            client.until(lambda m: m.name == "POSE")
            assert client.ask(messages.ASK_HELLO, 77) == messages.DONE
            assert f"{client.named('HELLO')[-1].fields['forest']:08x}" == SHIPPED


def words_of(split: int) -> bytes:
    """A forest of one tree of one split, with two equal leaves."""
    return array("i", [1, 2, split, -(2**30), -(2**30)]).tobytes()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "0 words"),
        (b"abc", "no whole words"),
        (words_of(1 | 4096 << 6 | 3 << 19), "isn't where its split says"),
        (words_of(56 | 4096 << 6 | 2 << 19), "asks for feature 56"),
    ],
    ids=["empty", "cut off", "a walk leaves it", "more features than this core has"],
)
def test_what_is_no_forest_is_not_sent(data: bytes, says: str, tmp_path: Path) -> None:
    bad = tmp_path / "bad.forest"
    bad.write_bytes(data)
    done = solenav("modes", "send", bad, "--port", "/dev/null")
    refused(done, 2, "bad.forest: no forest", says, "with this version")


def test_a_forest_for_fewer_features_is_told_by_the_file_beside_it(other: Path) -> None:
    other.with_suffix(".json").write_text('{"features": 48}')
    done = solenav("modes", "send", other, "--port", "/dev/null")
    refused(done, 2, "trained on 48 features", "this core has 56", "train it anew")


def test_which_forest_has_to_be_said(other: Path) -> None:
    refused(solenav("modes", "send"), 2, "which forest?", "--shipped")
    refused(solenav("modes", "send", other, "--shipped"), 2, "which forest?")
    refused(solenav("modes", "send", other.with_name("none.forest")), 2, "can't read")


def test_nobody_another_schema_and_a_port_that_is_none_are_told(
    other: Path, tmp_path: Path
) -> None:
    cable = Cable(tmp_path / "port")
    cable.plug()
    refused(solenav("modes", "send", other, "--port", cable.name), 2, "nobody says HELLO")
    cable.pull()
    refused(solenav("modes", "send", other, "--port", cable.name), 2, "there is no port")
    with that_says(cable, hello_frame(messages.SCHEMA ^ 1)):
        done = solenav("modes", "send", other, "--port", cable.name)
    refused(done, 2, "firmware and host differ", "a board", "flash the firmware anew")
    cable.pull()


def test_a_board_that_falls_silent_is_told(other: Path, tmp_path: Path) -> None:
    cable = Cable(tmp_path / "port")
    with that_says(cable, hello_frame()):
        done = solenav("modes", "send", other, "--port", cable.name)
    refused(done, 1, "no answer to a forest", "solenav doctor")
    cable.pull()


def test_a_cable_that_is_pulled_leaves_the_board_the_forest_it_had(
    board: SimulatedBoard, other: Path, tmp_path: Path
) -> None:
    cable = Cable(tmp_path / "port")
    with that_says(cable, hello_frame()):
        threading.Timer(4, cable.pull).start()
        done = solenav("modes", "send", other, "--port", cable.name)
    refused(done, 1, "vanished in the middle", "the forest that it had", "send it again")

    @contextmanager
    def pulled(what: str, total: int) -> Iterator[Callable[[int], None]]:
        def half(done: int) -> None:
            if done > total // 2:
                raise KeyboardInterrupt

        yield half

    with pytest.raises(KeyboardInterrupt):
        send(board.port, OTHER, progress=pulled)
    assert f"{send(board.port, None).had:08x}" == SHIPPED


def test_a_piece_that_comes_twice_has_the_same_answer(board: SimulatedBoard) -> None:
    with open_port(board.port) as port:
        client = joined(port)
        client.until(lambda m: m.name == "HELLO")
        seq = 0
        for at in range(0, len(OTHER), 12):
            piece = [*OTHER[at : at + 12], *[0] * 12][:12]
            for _twice in range(2):
                seq += 1
                told = answer(client, messages.ASK_FOREST, seq, at, len(OTHER), *piece)
                assert told == messages.DONE
        skipped = answer(client, messages.ASK_FOREST, seq + 1, 24, len(OTHER) + 1, *[0] * 12)
        assert skipped == messages.REFUSED


def test_a_full_flash_is_told(tmp_path: Path) -> None:
    large = tmp_path / "large.forest"  # littlefs finds room for a small file in its folder's block
    forests.save(large, forests.pack([forests.unpack(OTHER)[0]] * 64))
    full = [{"kind": "flash_full", "after": 0}]
    with SimulatedBoard(STILL, {"autostart": False}, realtime=True, faults=full) as board:
        done = solenav("modes", "send", large, "--port", board.port)
        refused(done, 1, "can't keep the forest in flash", "solenav doctor")
        assert f"{send(board.port, None).had:08x}" == SHIPPED


def test_the_file_in_flash_is_the_old_one_until_the_new_one_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (module,) = load("forest_file")
    kept = tmp_path / module.FILE
    planted: list[array[int] | None] = []
    logged: list[str] = []
    board_link = SimpleNamespace(command=b"", unlimited=0)
    made = module.Upload(
        board_link, lambda: True, planted.append, lambda level, text: logged.append(text)
    )

    def sent(words: array[int]) -> int:
        result = messages.DONE
        for at in range(0, len(words), 12):
            piece = [*words[at : at + 12], *[0] * 12][:12]
            form = messages.FORMATS[messages.ASK_FOREST]
            board_link.command = bytes(6) + struct.pack(form, at, len(words), *piece)
            result = made.commands[messages.ASK_FOREST]()
        return result

    assert sent(OTHER) == messages.DONE and kept.read_bytes() == OTHER.tobytes()

    def cut(old: str, new: str) -> None:
        raise OSError(28, "no room")

    another = forests.pack(forests.unpack(OTHER)[:3])
    with monkeypatch.context() as patched:
        patched.setattr(module.os, "rename", cut)
        assert sent(another) == messages.REFUSED
    assert "no room" in logged[-1] and planted == [OTHER]
    assert [path.name for path in tmp_path.iterdir()] == [module.FILE]
    assert kept.read_bytes() == OTHER.tobytes()
    assert sent(another) == messages.DONE and kept.read_bytes() == another.tobytes()
