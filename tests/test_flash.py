"""`solenav flash`: a board gets the firmware whole or keeps what it had, whatever is cut off."""

from __future__ import annotations

import ast
import builtins
import contextlib
import io
import json
import os
import shutil
import struct
import subprocess
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from cli import refused, solenav
from serial.tools import list_ports
from test_doctor import STILL
from typer.testing import CliRunner

from solenav import link
from solenav.errors import SolenavError
from solenav_core import messages
from solenav_tools.board import SimulatedBoard
from solenav_tools.cli import flash as flash_command
from solenav_tools.cli.app import app
from solenav_tools.flash import board_config, boards, hello, tree
from solenav_tools.micropython import find_micropython
from solenav_tools.ports import PortVanished, open_port
from solenav_tools.staging import build_hash, firmware_path, switch

OLD = {"main.mpy": b"old main", "same.mpy": b"s" * 900, "boards/x.mpy": b"x", "gone.mpy": b"g"}
NEW = {"main.mpy": b"new main" * 200, "same.mpy": b"s" * 900, "boards/x.mpy": b"x2"}
CONFIG: dict[str, object] = {"board": "boards.rp2_pico"}
NEW_CONFIG: dict[str, object] = {"board": "boards.rp2_pico2"}


class Flash:
    """A board's flash as a folder, its REPL as this Python; power fails at operation `cut`.

    `fat`: as FAT, it renames onto a file in two steps.
    """

    def __init__(
        self, folder: Path, cut: int = -1, flip: int = -1, free: int = 10**6, fat: bool = False
    ) -> None:
        self.folder, self.cut, self.flip, self.free, self.fat = folder, cut, flip, free, fat
        self.count = 0
        self.puts = 0
        system = SimpleNamespace(
            listdir=lambda path="": [p.name for p in self.at(path).iterdir()],
            stat=lambda path: self.at(path).stat(),
            mkdir=lambda path: (self.step(), self.at(path).mkdir()),
            rmdir=lambda path: (self.step(), self.at(path).rmdir()),
            remove=lambda path: (self.step(), self.at(path).unlink()),
            rename=self.rename,
            getcwd=lambda: "",
            statvfs=lambda path: (4096, 0, 0, self.free // 4096),
        )

        def find(name: str, *rest: Any) -> Any:
            if name == "machine":
                raise ImportError(name)
            return system if name == "os" else __import__(name, *rest)

        own = {**vars(builtins), "open": self.open, "__import__": find}
        self.names: dict[str, Any] = {"__builtins__": own, "__name__": "__main__"}

    def at(self, path: str) -> Path:
        return self.folder / path

    def step(self) -> None:
        if self.count == self.cut:
            raise PortVanished("power")
        self.count += 1

    def rename(self, old: str, new: str) -> None:
        if self.fat and self.at(new).exists():
            self.step()
            self.at(new).unlink()
        self.step()
        self.at(old).replace(self.at(new))

    def open(self, path: str, mode: str = "r") -> Any:
        if "r" in mode:
            return self.at(path).open(mode)
        self.step()
        return _Torn(self, self.at(path), mode)

    def run(self, code: str) -> str:
        self.step()
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            try:
                exec(code, self.names)
            except OSError as error:
                raise SolenavError(str(error), "", 1) from None
        return out.getvalue()


class _Torn:
    """A file whose write may be torn halfway, or arrive with a flipped bit."""

    def __init__(self, flash: Flash, path: Path, mode: str) -> None:
        self.flash, self.file = flash, path.open(mode)

    def __enter__(self) -> _Torn:
        return self

    def __exit__(self, *_error: object) -> None:
        self.file.close()

    def write(self, data: bytes) -> None:
        if self.flash.puts == self.flash.flip and data:
            data = bytes([data[0] ^ 1]) + data[1:]
        self.flash.puts += bool(data)
        try:
            self.flash.step()
        except PortVanished:
            self.file.write(data[: len(data) // 2])
            raise
        self.file.write(data)


def flashed(flash: Flash, files: dict[str, bytes], config: dict[str, object]) -> tree.Plan:
    tree.prepare(flash)
    todo = tree.plan(tree.look(flash), files, switch(), config)
    tree.apply(flash, todo, lambda done: None)
    tree.clean(flash, todo, files)
    return todo


def booted(folder: Path) -> tuple[dict[str, bytes], object]:
    """What the board runs after power-up, and its configuration; boot.py and the switch run."""
    root: Path = folder
    if (folder / "boot.py").exists():
        exec((folder / "boot.py").read_bytes(), Flash(folder).names)
    if (folder / "main.py").read_bytes() == switch():
        flash = Flash(folder)
        names = {**flash.names, "__name__": "switch"}
        exec(switch(), names)
        chosen = names["active"]()
        names["adopt"](chosen)
        root = folder / chosen
    found = {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in root.rglob("*")
        if path.is_file() and (root != folder or path.parts[len(folder.parts)] not in ("a", "b"))
    }
    ours = ("config.json", "config.json.new", "active", "active.new")
    for name in ("main.py", "main.py.new", "boot.py", "boot.py.new", *ours):
        found.pop(name, None)
    return found, json.loads((folder / "config.json").read_text())


def by_hand(folder: Path) -> None:
    """The files copied to the root, as before `solenav flash`."""
    for name, data in {**OLD, "solenav_core/x.mpy": b"core", "main.py": b"print()"}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    (folder / "config.json").write_text(json.dumps(CONFIG))
    (folder / "boot.py").write_text("import os\n")


def by_flash(folder: Path) -> None:
    folder.mkdir(parents=True)
    flashed(Flash(folder), OLD, CONFIG)


@pytest.mark.parametrize("fat", [False, True], ids=["littlefs", "fat"])
@pytest.mark.parametrize("before", [by_hand, by_flash])
def test_power_cut_at_any_write_leaves_the_old_or_the_new_and_the_next_flash_completes(
    tmp_path: Path, before: Any, fat: bool
) -> None:
    seen = set()
    template = tmp_path / "before"
    before(template)
    for cut in range(2000):
        folder = tmp_path / str(cut)
        shutil.copytree(template, folder)
        was = booted(folder)
        boot = (folder / "boot.py").read_bytes() if before is by_hand else None
        (folder / "log").mkdir()
        (folder / "log" / "000001.frames").write_bytes(b"kept")
        finished = False
        try:
            flashed(Flash(folder, cut, fat=fat), NEW, NEW_CONFIG)
            finished = True
        except PortVanished:
            pass
        now, config = booted(folder)
        is_new = (folder / "main.py").read_bytes() == switch() and now == NEW
        if is_new:
            assert config == NEW_CONFIG, cut
        else:
            # At the root leftovers of the new main may lie; what ran before must all be there.
            assert {k: now.get(k) for k in was[0]} == was[0] and config == was[1], cut
        seen.add(is_new)
        flashed(Flash(folder, fat=fat), NEW, NEW_CONFIG)
        assert booted(folder) == (NEW, NEW_CONFIG), cut
        assert boot is None or (folder / "boot.py").read_bytes() == boot, cut
        assert (folder / "log" / "000001.frames").read_bytes() == b"kept"
        if finished:
            break
    assert finished and seen == {False, True}


def test_what_has_not_changed_is_not_sent_again(tmp_path: Path) -> None:
    by_flash(tmp_path / "x")
    booted(tmp_path / "x")
    todo = flashed(Flash(tmp_path / "x"), NEW, CONFIG)
    assert set(todo.send) == {"b/main.mpy", "b/boards/x.mpy"} and len(todo.copy) == 1
    again = flashed(Flash(tmp_path / "x"), NEW, CONFIG)
    assert again.nothing and again.bytes == 0


def test_a_file_corrupted_on_the_wire_is_sent_again(tmp_path: Path) -> None:
    by_flash(tmp_path / "x")
    flashed(Flash(tmp_path / "x", flip=2), NEW, NEW_CONFIG)
    assert booted(tmp_path / "x") == (NEW, NEW_CONFIG)


def test_a_flash_without_room_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    by_flash(tmp_path / "x")
    with pytest.raises(SolenavError, match="bytes free"):
        flashed(Flash(tmp_path / "x", free=1000), NEW, CONFIG)
    assert booted(tmp_path / "x") == (OLD, CONFIG)


class Answer:
    """A board that answers the first question with a fixed text."""

    def __init__(self, *answer: object) -> None:
        self.answer = repr(answer)

    def run(self, code: str) -> str:
        return self.answer


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (("circuitpython", [9, 0, 0], 517, "Raspberry Pi Pico"), "circuitpython"),
        (("micropython", [1, 22, 2], 4870, "Raspberry Pi Pico with RP2040"), "too old"),
        (("micropython", [1, 30, 0], 4102, "Raspberry Pi Pico with RP2040"), r"\.mpy version"),
    ],
)
def test_a_board_that_can_not_run_the_firmware_is_refused_with_the_download(
    answer: tuple[object, ...], says: str
) -> None:
    with pytest.raises(SolenavError, match=says) as caught:
        boards.identify(Answer(*answer))
    assert boards.DOWNLOADS in caught.value.remedy


def test_a_pico_s_own_answer_makes_it_a_pico() -> None:
    pico = Answer("micropython", [1, 28, 0], 4870, "Raspberry Pi Pico with RP2040")
    found = boards.identify(pico)
    assert found.architecture == "armv6m" and boards.choose(found, None, {}) == "rp2_pico"


@pytest.mark.parametrize("bad", ["M_A=99999", "NO_SUCH=1", "M_A", "M_A=x"])
def test_parameters_past_the_core_s_limits_are_refused(bad: str) -> None:
    with pytest.raises(SolenavError):
        board_config.merged({}, {}, board_config.parsed([bad]), "rp2_pico")


@pytest.mark.parametrize("fat", [False, True], ids=["littlefs", "fat"])
def test_somebody_else_s_main_is_kept_under_another_name_each_one_once(
    tmp_path: Path, fat: bool
) -> None:
    for text in (b"blink()", b"beep()"):
        for name in ("active", "a", "b"):
            path = tmp_path / name
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        (tmp_path / "main.py").write_bytes(text)
        flashed(Flash(tmp_path, fat=fat), NEW, CONFIG)
        flashed(Flash(tmp_path, fat=fat), OLD, CONFIG)
    kept = {path.name: path.read_bytes() for path in tmp_path.glob("main.py.*")}
    assert kept == {"main.py.old1": b"blink()", "main.py.old2": b"beep()"}
    assert not (tmp_path / "boot.py").exists()


@pytest.fixture
def board(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """MicroPython's own REPL on a pseudo-terminal, its flash a folder."""
    folder = tmp_path / "flash"
    folder.mkdir()
    master, slave = os.openpty()
    tty.setraw(slave)
    inner, outer = os.openpty()
    tty.setraw(outer)
    process = subprocess.Popen(
        [find_micropython()], cwd=folder, stdin=outer, stdout=outer, stderr=outer
    )

    def carry(source: int, target: int) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(source, 4096):
                os.write(target, data)

    for ends in ((master, inner), (inner, master)):
        threading.Thread(target=carry, args=ends, daemon=True).start()
    yield os.ttyname(slave), folder
    process.kill()
    process.wait()


def test_the_command_flashes_a_real_micropython_and_then_has_nothing_to_do(
    board: tuple[str, Path],
) -> None:
    port, folder = board
    dry = solenav("flash", port, "--board", "rp2_pico", "--dry-run")
    assert dry.returncode == 0, dry.stderr
    assert not list(folder.iterdir())
    done = solenav("flash", port, "--board", "rp2_pico", "--param", "M_A=1638", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["bytes"] > 100_000
    script = (
        "import sys; sys.path.insert(0, ''); import switch_main as s; t = s.active(); s.adopt(t);"
        "sys.path.insert(0, t); import config; print(config.build()[0], config.load()[0], t)"
    )
    (folder / "switch_main.py").write_bytes((folder / "main.py").read_bytes())
    ran = subprocess.run(
        [find_micropython(), "-c", script], cwd=folder, capture_output=True, text=True
    )
    assert ran.stdout.startswith(str(build_hash())), ran.stderr + ran.stdout
    assert "'M_A': 1638" in ran.stdout
    again = solenav("flash", port, "--board", "rp2_pico")
    assert again.returncode == 0 and "nothing to do" in again.stdout, again.stderr


def test_a_cable_pulled_in_the_middle_is_told_and_nothing_half_boots(
    board: tuple[str, Path],
) -> None:
    port, folder = board
    master, slave = os.openpty()
    tty.setraw(slave)
    inner = os.open(port, os.O_RDWR | os.O_NOCTTY)

    def carry(source: int, target: int, most: int) -> None:
        with contextlib.suppress(OSError):
            while most > 0 and (data := os.read(source, 256)):
                os.write(target, data)
                most -= len(data)
            os.close(slave)
            os.close(master)

    for source, target, most in ((master, inner, 60_000), (inner, master, 10**9)):
        threading.Thread(target=carry, args=(source, target, most), daemon=True).start()
    pulled = solenav("flash", os.ttyname(slave), "--board", "rp2_pico", timeout=120)
    refused(pulled, 1, "vanished", "boots what is whole")
    arrived = [path for path in folder.rglob("*") if path.is_file()]
    assert arrived and not (folder / "active").exists() and not (folder / "main.py").exists()


def test_a_port_without_a_repl_is_refused() -> None:
    _master, slave = os.openpty()
    tty.setraw(slave)
    refused(solenav("flash", os.ttyname(slave)), 2, "no MicroPython REPL answers")


def test_boards_are_listed() -> None:
    listed = solenav("flash", "--list-boards")
    assert listed.returncode == 0
    for name in ("rp2_pico", "rp2_pico2", "pyboard", "esp32_s3"):
        assert name in listed.stdout


def test_the_keys_that_flash_takes_are_those_that_the_firmware_knows() -> None:
    text = (firmware_path() / "config.py").read_text(encoding="utf-8")
    (defaults,) = (
        node.value
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_DEFAULTS"
    )
    assert set(board_config.KEYS) == set(ast.literal_eval(defaults))


def test_the_new_firmware_is_awaited_on_the_uart_and_its_hello_checked(
    board: tuple[str, Path],
) -> None:
    port, _folder = board
    with SimulatedBoard(STILL, realtime=True) as wearable:
        done = solenav("flash", port, "--board", "rp2_pico", "--link", wearable.port, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["hello"]["build"] == build_hash() and found["hello"]["self_test"] == 0
    assert "simulated" in found["hello"]["text"]


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("build", 7, "runs build 00000007"),
        ("self_test", 3, "self-test 3 fails"),
        ("sensor_test", 1, "sensor's self-test fails"),
    ],
)
def test_a_hello_of_another_build_or_with_a_fault_is_no_success(
    field: str, value: int, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hello, "_PATIENCE_S", 1.5)
    fields = {"schema": messages.SCHEMA, "build": build_hash(), field: value}
    values = [fields.get(name, 0) for name, code, *_rest in link.FIELDS[messages.HELLO][:-1]]
    payload = struct.pack(messages.FORMATS[messages.HELLO], *values) + b"board"
    master, slave = os.openpty()
    tty.setraw(slave)
    with open_port(os.ttyname(slave)) as port, pytest.raises(SolenavError, match=says):
        os.write(master, link.encode(messages.HELLO, 0, 0, payload))
        hello.awaited(port, "uart", build_hash())


def test_of_several_boards_a_person_picks_one_and_a_script_is_told_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = [
        SimpleNamespace(device="/dev/ttyS0", description="on board", vid=None),
        SimpleNamespace(device="/dev/ttyACM0", description="Pico", vid=0x2E8A),
        SimpleNamespace(device="/dev/ttyACM1", description="Pico", vid=0x2E8A),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: here)
    flashed_at = []

    def put(port: str, **_rest: Any) -> Any:
        flashed_at.append(port)
        raise SolenavError("enough", "")

    monkeypatch.setattr(flash_command, "put", put)
    alone = CliRunner().invoke(app, ["flash"]).exception
    assert isinstance(alone, SolenavError) and alone.message.startswith("several boards")
    monkeypatch.setattr(flash_command, "_asks", lambda: True)
    for answer, picked in (("2", ["/dev/ttyACM1"]), ("3", []), ("x", [])):
        flashed_at.clear()
        CliRunner().invoke(app, ["flash"], input=answer + "\n")
        assert flashed_at == picked
    del here[1]
    CliRunner().invoke(app, ["flash"])
    assert flashed_at == ["/dev/ttyACM1"]


def test_parameters_of_solenav_toml_go_onto_the_board_under_those_of_the_command_line(
    board: tuple[str, Path], tmp_path: Path
) -> None:
    port, folder = board
    (tmp_path / "solenav.toml").write_text(
        "[parameters]\naccel_max = 12.5\nthreshold_min = 0.2\nfreeze_s = 10.0\n"
    )
    done = solenav("flash", port, "--board", "rp2_pico", "--param", "M_A=1700", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "ACC_MAX, M_A" in done.stderr
    tree_there = (folder / "active").read_text()
    config = json.loads((folder / tree_there / "config.json").read_text())
    # 12.5 m/s² in Q7, what the command line says, and nothing that is as by default.
    assert config["params"] == {"ACC_MAX": 1600, "M_A": 1700}
