"""Commands against a board: real MicroPython, real firmware, a real pseudo-terminal."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import subprocess
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli import SOLENAV, refused, solenav

from solenav import capture, link, replaying
from solenav.verification import verify


@pytest.fixture(scope="module")
def ten(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The walk's seconds 10 to 20: standing, then strides."""
    path = tmp_path_factory.mktemp("ten") / "ten.solcap"
    source = capture.load(walk)
    samples = replaying.samples_of(source)
    cut = replaying.Samples(*(getattr(samples, n)[2000:4000] for n in samples.__dataclass_fields__))
    cut.time_us = cut.time_us - cut.time_us[0]
    replaying.write_samples(path, cut, source.params[0][1], text="test", notes={}, truth=None)
    return path


@contextlib.contextmanager
def served(file: Path, *options: str) -> Iterator[str]:
    """A simulated board at a port, by the command that people use for it."""
    command = [SOLENAV, "run-firmware", file, "--serve", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        # As Ctrl-C does: a command that is killed leaves its board running.
        process.send_signal(signal.SIGINT)
        process.wait()


@contextlib.contextmanager
def sender(data: bytes, *, then_vanish: bool) -> Iterator[str]:
    """A port at which `data` arrives; afterwards it is silent, or gone."""
    master, slave = os.openpty()
    tty.setraw(slave)
    port = os.ttyname(slave)
    done = threading.Event()

    def send() -> None:
        # What comes before the client has opened and discarded its input would be lost.
        os.read(master, 1)
        for start in range(0, len(data), 512):
            os.write(master, data[start : start + 512])
        if then_vanish:
            time.sleep(0.5)
            os.close(slave)
            os.close(master)
        done.wait(60)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        yield port
    finally:
        done.set()
        thread.join()
        if not then_vanish:
            os.close(slave)
            os.close(master)


def on_a_terminal(*arguments: str) -> tuple[int, str]:
    """Run the command on a terminal of its own: exit code, and all that it showed."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ |= {"TERM": "xterm", "COLUMNS": "110", "LINES": "30"}
        os.execv(SOLENAV, ["solenav", *arguments])
    shown = b""
    with contextlib.suppress(OSError):
        while data := os.read(terminal, 4096):
            shown += data
    _pid, status = os.waitpid(pid, 0)
    os.close(terminal)
    return os.waitstatus_to_exitcode(status), shown.decode()


def messages_in(path: Path) -> list[link.Frame]:
    reader = link.FrameReader()
    items = [item for _t, data in capture.read_records(path) for item in reader.feed(data)]
    return [item for item in items if isinstance(item, link.Frame)]


def test_the_firmware_is_proven_bit_for_bit(ten: Path, tmp_path: Path) -> None:
    done = solenav("run-firmware", ten, "-o", tmp_path / "run.solcap", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["lost"] == 0
    for engine in ("fast", "pure"):
        done = solenav("verify", tmp_path / "run.solcap", "--engine", engine, "--json")
        assert done.returncode == 0, done.stdout
        report = json.loads(done.stdout)
        assert report["covered_ticks"] == report["samples"] == 2000
        assert report["compared_ticks"] > 1700


def test_two_runs_of_the_firmware_write_the_same_file(ten: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert solenav("run-firmware", ten, "-o", tmp_path / f"{name}.solcap").returncode == 0
    assert (tmp_path / "a.solcap").read_bytes() == (tmp_path / "b.solcap").read_bytes()


def test_firmware_and_replay_say_the_same(ten: Path, tmp_path: Path) -> None:
    assert solenav("run-firmware", ten, "-o", tmp_path / "board.solcap").returncode == 0
    # The board's own samples: its compass is read at other moments than an import has it.
    board_run = tmp_path / "board.solcap"
    assert solenav("replay", board_run, "-o", tmp_path / "host.solcap").returncode == 0
    kinds = ("ALIGN", "POSE", "STEP")
    board, host = (
        [
            (f.kind, f.tick, f.payload)
            for f in messages_in(tmp_path / name)
            if link.NAMES[f.kind] in kinds
        ]
        for name in ("board.solcap", "host.solcap")
    )
    assert len(board) > 1700 and board == host


def test_record_keeps_all_until_the_board_goes_and_says_so(ten: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.solcap"
    with served(ten) as port:
        done = solenav("record", port, "-o", out)
    refused(done, 1, "vanished after", "all that came is in")
    recorded = capture.load(out)
    assert len(recorded.samples) == 2000
    assert not recorded.damaged
    report = verify(recorded, "fast")
    assert report.verified and report.covered_ticks == 2000
    assert capture.contents.read_sidecar(out)["port"] == port


def test_record_joins_a_running_board_and_can_be_verified(ten: Path, tmp_path: Path) -> None:
    """The recorder asks for a snapshot, so that the proof begins where it joined."""
    with served(ten, "--realtime") as port:
        first = solenav("record", port, "-o", tmp_path / "1.solcap", "--duration", "3")
        again = solenav("record", port, "-o", tmp_path / "2.solcap", "--duration", "3")
    assert first.returncode == 0, first.stderr
    assert again.returncode == 0, again.stderr
    joined = capture.load(tmp_path / "2.solcap")
    assert joined.samples.tick[0] > 100
    report = verify(joined, "fast")
    assert report.verified
    assert report.covered_ticks > 300


def test_monitor_in_a_pipe_prints_a_line_a_second(ten: Path) -> None:
    with served(ten, "--realtime") as port:
        done = solenav("monitor", port, "--duration", "4")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) >= 3
    for part in ("position E", "speed", "heading", "steps", "distance", "stance", "N_eff", "M 0."):
        assert part in lines[-1], lines[-1]


def test_monitor_on_a_terminal_shows_a_view(ten: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.solcap"
    with served(ten, "--realtime") as port:
        status, shown = on_a_terminal("monitor", port, "--duration", "4", "-o", str(out))
    assert status == 0, shown
    for part in ("navigating", "position", "heading", "N_eff", "drops", "\x1b["):
        assert part in shown
    assert len(capture.load(out).samples) > 400


@pytest.mark.parametrize("command", ["record", "monitor"])
def test_a_port_that_does_not_exist_is_refused(command: str, tmp_path: Path) -> None:
    done = solenav(command, "/dev/ttyNOSUCH7", cwd=tmp_path)
    refused(done, 2, "there is no port /dev/ttyNOSUCH7", "ports here:")
    assert not list(tmp_path.iterdir())


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("not a port")
    refused(solenav("record", tmp_path / "notes.txt", cwd=tmp_path), 2, "is no serial port")


def test_a_silent_port_is_told(tmp_path: Path) -> None:
    with sender(b"", then_vanish=False) as port:
        done = solenav("record", port, "-o", "x.solcap", "--duration", "1", cwd=tmp_path)
    refused(done, 1, "no message came")


def test_another_device_is_told_and_its_bytes_are_kept(tmp_path: Path) -> None:
    chatter = b"$GPGGA,123519,4807.038,N*47\r\n" * 40
    with sender(chatter, then_vanish=False) as port:
        done = solenav("record", port, "-o", "x.solcap", "--duration", "2", cwd=tmp_path)
    refused(done, 1, "no message came", f"{len(chatter)} bytes of something else")
    kept = b"".join(data for _t, data in capture.read_records(tmp_path / "x.solcap"))
    assert kept == chatter


def test_a_damaged_byte_on_the_wire_costs_one_frame(replayed: Path, tmp_path: Path) -> None:
    stream = bytearray(b"".join(data for _t, data in capture.read_records(replayed))[:100_000])
    whole = list(link.FrameReader().feed(bytes(stream)))
    # Within a frame: two that lost the delimiter between them are told apart.
    stream[stream.index(0, 50_000) + 8] ^= 0x21
    with sender(bytes(stream), then_vanish=True) as port:
        done = solenav("record", port, "-o", "x.solcap", cwd=tmp_path)
    refused(done, 1, "vanished", "1 damaged frames")
    got = capture.load(tmp_path / "x.solcap")
    assert sum(got.counts.values()) == len(whole) - 1
    kept = b"".join(data for _t, data in capture.read_records(tmp_path / "x.solcap"))
    assert kept == stream


def test_a_missing_micropython_is_told_with_the_remedy(ten: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "SOLENAV_MICROPYTHON": str(tmp_path / "none")}
    done = subprocess.run(
        [SOLENAV, "run-firmware", ten, "-o", tmp_path / "x.solcap"],
        capture_output=True,
        text=True,
        env=environment,
    )
    refused(done, 2, "can't run", "solenav[board]")


def test_long_work_shows_a_progress_bar_on_a_terminal(ten: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "x.solcap")
    status, shown = on_a_terminal("replay", str(ten), "--engine", "pure", "-o", out)
    assert status == 0
    assert "replaying on pure" in shown and "━" in shown


def test_record_rotates_and_each_file_is_proven_by_itself(ten: Path, tmp_path: Path) -> None:
    with served(ten) as port:
        done = solenav("record", port, "-o", tmp_path / "run.solcap", "--rotate", "90kB", "--json")
    files = [Path(name) for name in json.loads(done.stdout)["files"]]
    assert len(files) >= 3
    assert [path.name for path in files[:2]] == ["run-001.solcap", "run-002.solcap"]
    ticks: list[int] = []
    for path in files:
        part = capture.load(path)
        ticks += part.samples.tick.tolist()
        report = verify(part, "fast")
        assert report.verified, report
        # Whoever joins a running board waits for its first snapshot; at a seam nothing waits.
        assert report.unchecked_samples == 0 or path == files[0]
        assert not part.damaged
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks))), "lost or twice at a seam"


@pytest.mark.parametrize("wish", ["10", "10 parsecs", "0.1s", "-5m"])
def test_a_rotation_that_makes_no_sense_is_refused(wish: str, tmp_path: Path) -> None:
    done = solenav("record", "/dev/null", "-o", tmp_path / "x.solcap", f"--rotate={wish}")
    refused(done, 2)


def test_record_waits_for_a_port_that_comes_back(replayed: Path, tmp_path: Path) -> None:
    data = b"".join(part for _t, part in capture.read_records(replayed))[:40_000]
    link_to = tmp_path / "port"
    with sender(data, then_vanish=True) as first:
        link_to.symlink_to(first)
        process = subprocess.Popen(
            [SOLENAV, "record", link_to, "-o", tmp_path / "run.solcap", "--reconnect", "--json"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stderr is not None and process.stdout is not None
        assert "vanished" in process.stderr.readline()
        link_to.unlink()
        with sender(data, then_vanish=False) as second:
            link_to.symlink_to(second)
            assert "is back" in process.stderr.readline()
            again = tmp_path / "run-002.solcap"
            deadline = time.monotonic() + 60
            while not (again.exists() and again.stat().st_size >= len(data)):
                assert time.monotonic() < deadline
                time.sleep(0.1)
            process.send_signal(signal.SIGINT)
            out, _err = process.communicate(timeout=60)
    assert process.returncode == 0
    files = [Path(name) for name in json.loads(out)["files"]]
    assert [path.name for path in files] == ["run-001.solcap", "run-002.solcap"]
    for path in files:
        assert b"".join(part for _t, part in capture.read_records(path)) == data
