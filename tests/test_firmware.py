"""The firmware as it is, on real MicroPython and a simulated board, over a pseudo-terminal."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
from binascii import crc32
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
import wire
from board import Client, on, run
from numpy.typing import NDArray
from wire import Message

from solenav import engines
from solenav.errors import SolenavError
from solenav_core import messages
from solenav_core.params import NAMES
from solenav_core.tables.defaults import PARAMS
from solenav_tools.board import Samples, SimulatedBoard
from solenav_tools.micropython import find_micropython
from solenav_tools.staging import build_hash, stage

pytestmark = pytest.mark.skipif(os.name != "posix", reason="no pseudo-terminals here")

N = 1000
PERIOD = 5000
ALIGN_TICKS = PARAMS[NAMES.index("ALIGN_TICKS")]
FIRST = 0  # µs from the start of sampling to the first sample


def still(n: int = N) -> Samples:
    rng = np.random.default_rng(7)
    counts = np.zeros((n, 6), np.int16)
    counts[:, 2] = 2048
    counts += rng.integers(-4, 5, (n, 6)).astype(np.int16)
    times = FIRST + PERIOD * np.arange(n, dtype=np.int64)
    return Samples(times, counts, np.arange(n, dtype=np.int16) - n // 2)


def of_sample(message: Message) -> tuple[int, ...]:
    return message.fields["acc"] + message.fields["gyro"]


def words(message: Message) -> tuple[int, ...]:
    """A sample as the core takes it."""
    fields = message.fields
    return (*of_sample(message), *fields["mag"], fields["flags"] | fields["lost"] << 8)


@pytest.fixture(scope="module")
def standing() -> Client:
    return run(still(), {"pose_every": 1, "snapshot_s": 2})


def test_what_a_run_begins_with(standing: Client) -> None:
    hello, *parameters = standing.messages[:3]
    assert hello.name == "HELLO"
    fields = hello.fields
    assert fields["schema"] == messages.SCHEMA
    assert fields["build"] == build_hash()
    assert fields["params"] == crc32(PARAMS)
    assert fields["rate"] == 200_000
    assert fields["pose_every"] == 1
    assert messages.SENSORS[fields["sensor"]] == "MPU-9150"
    assert fields["self_test"] == 0
    board, _version, micropython = fields["text"].decode().split("; ")
    assert board == "simulated"
    assert micropython.startswith("MicroPython 1.")
    assert fields["sensor_test"] == 0
    assert [m.name for m in parameters] == ["PARAMS"] * 2
    assert b"".join(m.fields["data"] for m in parameters) == PARAMS.tobytes()
    assert not standing.texts()


def test_every_sample_is_told(standing: Client) -> None:
    feed = still()
    samples = standing.named("SAMPLE")
    assert [m.tick for m in samples] == list(range(1, N + 1))
    assert [of_sample(m) for m in samples] == list(map(tuple, feed.counts.tolist()))
    assert [m.fields["temperature"] for m in samples] == feed.temperature.tolist()
    # The magnetometer takes two sample periods for a reading.
    assert [m.fields["flags"] for m in samples[2:]] == [0, messages.MAG_NEW] * (N // 2 - 1)
    times = [m.fields["time"] for m in samples]
    assert np.diff(times).tolist() == [PERIOD] * (N - 1)


def test_messages_in_order_and_complete(standing: Client) -> None:
    assert [m.seq for m in standing.messages] == [i & 255 for i in range(len(standing.messages))]
    (align,) = standing.named("ALIGN")
    assert align.tick == ALIGN_TICKS
    assert [m.tick for m in standing.named("POSE")] == list(range(align.tick, N + 1))
    assert [m.tick for m in standing.named("STATUS")] == list(range(200, N + 1, 200))
    snapshots = {m.tick for m in standing.named("SNAPSHOT")}
    assert snapshots == {400, 800}
    order = [m.name for m in standing.messages if m.tick == 400]
    assert order[:2] == ["SAMPLE", "POSE"]
    assert set(order[2:-1]) == {"SNAPSHOT"}
    assert order[-1] == "STATUS"
    last = standing.named("STATUS")[-1].fields
    assert (last["mode"], last["samples"]) == (messages.RUNNING, N)
    assert last["period"] == PERIOD * 256
    assert last["heap"] > 100_000
    counters = ("overruns", "gaps", "bus_errors", "recoveries", "clipped", "bad_commands")
    assert not any(last[name] for name in (*counters, "dropped_samples", "dropped_poses"))


def test_the_core_computes_what_the_host_computes(standing: Client) -> None:
    poses = {m.tick: m.fields for m in standing.named("POSE")}
    snapshots = {m.tick: b"" for m in standing.named("SNAPSHOT")}
    for m in standing.named("SNAPSHOT"):
        assert m.fields["offset"] == len(snapshots[m.tick])
        snapshots[m.tick] += m.fields["data"]
    engine = engines.create("pure", PARAMS)
    rows = np.array([words(m) for m in standing.named("SAMPLE")], np.int16)
    for tick in range(1, N + 1):
        engine.advance(rows, tick - 1, tick)
        if tick in poses:
            assert poses[tick]["digest"] == engine.digest(), tick
        if tick in snapshots:
            assert snapshots[tick] == engine.snapshot(), tick


def said(client: Client) -> list[tuple[str, int, dict[str, Any]]]:
    """Everything but STATUS' heap: garbage whose address is on the stack by chance stays."""
    return [
        (m.name, m.tick, {name: value for name, value in m.fields.items() if name != "heap"})
        for m in client.messages
    ]


def test_two_runs_say_the_same(standing: Client) -> None:
    assert said(run(still(), {"pose_every": 1, "snapshot_s": 2})) == said(standing)


def test_a_feed_file(tmp_path: Path) -> None:
    feed = still(300)
    path = tmp_path / "still.feed"
    records = [
        struct.pack("<I10h", t, *c[:3], temperature, *c[3:], *[-32768] * 3)
        for t, c, temperature in zip(
            feed.time_us.tolist(), feed.counts.tolist(), feed.temperature.tolist(), strict=True
        )
    ]
    path.write_bytes(b"".join(records))
    assert said(run(path)) == said(run(feed))
    path.write_bytes(b"".join(records)[:-1])
    with pytest.raises(SolenavError, match="no feed file"), SimulatedBoard(path):
        pass
    with (
        pytest.raises(SolenavError, match="No such file"),
        SimulatedBoard(tmp_path / "nowhere.feed"),
    ):
        pass


def test_settings_choose_what_is_sent() -> None:
    config = {"pose_every": 7, "send_samples": False, "params": {"ALIGN_TICKS": 100}}
    client = run(still(300), config)
    assert not client.named("SAMPLE")
    assert client.named("ALIGN")[0].tick == 100
    assert [m.tick for m in client.named("POSE")] == list(range(105, 301, 7))
    assert client.named("HELLO")[0].fields["params"] != crc32(PARAMS)


def test_wrong_settings_are_told() -> None:
    config = {
        "pose_evry": 1,
        "snapshot_s": "often",
        "dlpf": 7,
        "resume": "sometimes",
        "params": {"ALIGN_TICKS": 100, "SEEDS": 1, "SEED": 1.5, "RATE_MHZ": 0, "WINDOW": 32},
    }
    client = run(still(150), config)
    # MicroPython's dictionaries keep no order.
    assert sorted(client.texts()) == [
        ("error", "config.json: RATE_MHZ = 0 is not 1000 to 1000000"),
        ("error", "config.json: WINDOW = 32 is not 1 to 31"),
        ("error", "config.json: dlpf can't be 7"),
        ("error", "config.json: parameter SEED can't be 1.5"),
        ("error", "config.json: resume can't be 'sometimes'"),
        ("error", "config.json: snapshot_s can't be 'often'"),
        ("error", "config.json: there is no key pose_evry"),
        ("error", "config.json: there is no parameter SEEDS"),
    ]
    assert client.named("ALIGN")[0].tick == 100


def test_parameters_that_contradict_each_other_are_not_run_with() -> None:
    left_handed = {"MOUNT_R": 1, "MOUNT_F": 3, "MOUNT_U": 2, "ALIGN_TICKS": 100}
    client = run(still(150), {"params": left_handed})
    ((level, text),) = client.texts()
    assert level == "error" and "left-handed: default parameters used" in text
    assert client.named("HELLO")[0].fields["params"] == crc32(PARAMS)


def test_commands() -> None:
    with on(still(3000), {"pose_every": 1}) as (_board, client):
        client.until(lambda m: m.tick == 300)

        assert client.ask(messages.ASK_SNAPSHOT, 10) == messages.DONE
        snapshot = client.until(lambda m: m.name == "SNAPSHOT")
        total = snapshot.fields["total"]
        client.until(lambda m: m.name == "SAMPLE" and m.tick == snapshot.tick + 1)
        data = b"".join(m.fields["data"] for m in client.named("SNAPSHOT"))
        assert len(data) == total
        (pose,) = [m for m in client.named("POSE") if m.tick == snapshot.tick]
        assert crc32(data) == pose.fields["digest"]

        assert client.ask(messages.ASK_HELLO, 11) == messages.DONE
        assert len(client.named("HELLO")) == 2
        assert len(client.named("PARAMS")) == 4

        assert client.ask(messages.ASK_STOP, 12) == messages.DONE
        stopped = client.messages[-1].tick
        assert client.ask(messages.ASK_SNAPSHOT, 13) == messages.DONE
        status = client.until(lambda m: m.name == "STATUS" and m.fields["mode"] == messages.IDLE)
        assert status.tick == stopped
        assert len([m for m in client.named("SNAPSHOT") if m.tick == stopped]) > 1

        assert client.ask(messages.ASK_START, 14) == messages.DONE
        first = client.until(lambda m: m.name == "SAMPLE")
        assert first.tick == 1
        assert first.fields["flags"] == 0
        names = [m.name for m in client.messages if m.name in ("HELLO", "PARAMS")]
        assert names[-3:] == ["HELLO", "PARAMS", "PARAMS"]
        assert client.until(lambda m: m.name == "ALIGN").tick == ALIGN_TICKS


def test_a_command_is_carried_out_once() -> None:
    with on(still(), {"autostart": False}) as (_board, client):
        assert client.until(lambda m: m.name == "HELLO").fields["sensor"] == 2
        assert client.ask(messages.ASK_HELLO, 1) == messages.DONE
        assert client.ask(messages.ASK_HELLO, 1) == messages.REPEATED
        assert client.ask(messages.ASK_HELLO, 1) == messages.REPEATED
        assert len(client.named("HELLO")) == 2
        assert client.ask(messages.ASK_HELLO, 2) == messages.DONE
        assert len(client.named("HELLO")) == 3
        assert client.ask(messages.SAMPLE, 3) == messages.UNKNOWN
        assert not client.named("SAMPLE")


def test_damaged_commands_are_counted() -> None:
    with on(still(), {"autostart": False}) as (_board, client):
        client.until(lambda m: m.name == "HELLO")
        whole = wire.command(messages.ASK_START, 1)
        client.port.write(bytes([whole[0], whole[1] ^ 1]) + whole[2:])
        client.port.write(b"\xff\xff\xff\0" + b"\x01\0" + bytes(range(1, 200)) + b"\0")
        client.port.write(b"\0\0\0")
        assert client.ask(messages.ASK_SNAPSHOT, 2) == messages.DONE
        status = client.until(lambda m: m.name == "STATUS")
        assert status.fields["bad_commands"] == 4
        assert not client.named("SAMPLE")


def test_commands_sent_before_the_first_byte_are_heard() -> None:
    """A recorder that joins asks at once; two such runs are the same bytes as well."""
    runs = []
    for _ in range(2):
        with on(still(300)) as (_board, client):
            client.port.write(wire.command(messages.ASK_HELLO, 0))
            client.to_the_end()
        assert len(client.named("HELLO")) == 2
        runs.append(client.data)
    assert runs[0] == runs[1]


def test_a_slow_line_loses_samples_first() -> None:
    client = run(still(), {"pose_every": 4}, baud=38400)
    status = client.named("STATUS")[-1].fields
    assert status["dropped_samples"] > 0
    assert status["dropped_poses"] == status["dropped_others"] == 0
    seen = [m for m in client.named("SAMPLE") if m.tick <= N]
    assert len(seen) + status["dropped_samples"] == N
    assert len(client.named("POSE")) == len(range(200, N + 1, 4))
    assert [m.seq for m in client.messages] == [i & 255 for i in range(len(client.messages))]

    slower = run(still(), {"pose_every": 1}, baud=19200)
    status = slower.named("STATUS")[-1].fields
    assert status["dropped_poses"] > 0
    assert status["dropped_others"] == 0
    assert len(slower.named("STATUS")) == N // 200


def test_without_a_sensor() -> None:
    with on(still(10), sensor="none") as (_board, client):
        hello = client.until(lambda m: m.name == "HELLO")
        assert messages.SENSORS[hello.fields["sensor"]] == "none"
        client.until(lambda m: m.name == "STATUS" and m.fields["mode"] == messages.FAULT)
        client.until(lambda m: m.name == "STATUS" and m.fields["mode"] == messages.FAULT)
        ((level, text),) = client.texts()
        assert level == "error"
        assert "no answer from 0x68" in text
        assert "check" in text
        assert client.ask(messages.ASK_START, 1) == messages.REFUSED


def test_another_sensor_is_named() -> None:
    client = run(still(50), sensor="MPU-6050")
    assert messages.SENSORS[client.named("HELLO")[0].fields["sensor"]] == "MPU-6050"
    assert len(client.named("SAMPLE")) == 50


def silence(first: int, last: int, after_us: int = 1000) -> list[dict[str, Any]]:
    """Nothing acknowledges at the times of samples `first` to `last`, by index."""
    begin, end = FIRST + first * PERIOD - 100, FIRST + last * PERIOD + after_us
    return [{"kind": "nack", "at": begin, "for": end - begin}]


def lost(client: Client, feed: Samples) -> NDArray[np.int64]:
    """Indexes of the samples that were never told, by their temperatures, which all differ."""
    told = [m.fields["temperature"] for m in client.named("SAMPLE")]
    return np.flatnonzero(~np.isin(feed.temperature, told))


def test_a_short_bus_failure_costs_nothing() -> None:
    """The samples wait in the sensor's FIFO."""
    feed = still()
    client = run(feed, faults=silence(400, 403))
    status = client.named("STATUS")[-1].fields
    assert status["bus_errors"] > 0
    assert (status["gaps"], status["recoveries"], status["bus_khz"]) == (0, 0, 400)
    assert not lost(client, feed).size
    assert not client.texts()


def test_without_the_fifo_it_costs_its_samples() -> None:
    feed = still()
    # Nor is there time for flash then.
    client = run(feed, {"sampling": "ready", "blackbox": "off"}, faults=silence(400, 400))
    assert lost(client, feed).tolist() == [400]
    flagged = [m for m in client.named("SAMPLE") if m.fields["flags"] & messages.GAP_BEFORE]
    assert [(m.tick, m.fields["lost"]) for m in flagged] == [(401, 1)]
    assert client.messages[-1].tick == N - 1


def test_poses_are_left_out_before_a_sample_is_lost() -> None:
    """For 0.2 s the processor did something else: 40 samples wait in a FIFO that holds 46."""
    feed = still()
    hang = {"kind": "hang", "at": 500 * PERIOD, "for": 40 * PERIOD}
    client = run(feed, {"pose_every": 1}, faults=[hang])
    assert [of_sample(m) for m in client.named("SAMPLE")] == list(map(tuple, feed.counts.tolist()))
    ticks = [m.tick for m in client.named("POSE")]
    missing = sorted(set(range(ALIGN_TICKS, N + 1)) - set(ticks))
    assert 5 < len(missing) < 20 and missing == list(range(missing[0], missing[-1] + 1))
    status = client.named("STATUS")[-1].fields
    assert (status["lost"], status["dropped_poses"]) == (0, len(missing))


def test_a_bus_failure_that_lasts() -> None:
    feed = still()
    client = run(feed, faults=silence(400, 600))
    (level, text), mended = client.texts()
    assert level == "error"
    assert "no answer from 0x68" in text
    assert mended == ("info", "the sensor works again")
    status = client.named("STATUS")[-1].fields
    assert (status["gaps"], status["recoveries"]) == (1, 1)
    # One tick is left out, so that the hole shows.
    assert client.messages[-1].tick == N - len(lost(client, feed)) + 1


def test_a_crash_is_told() -> None:
    with SimulatedBoard(still()) as board:
        source = board.folder / "application.py"
        text = source.read_text(encoding="utf-8")
        broken = text.replace("events = _tick(", "events = 1 // 0 or _tick(")
        assert broken != text
        source.write_text(broken, encoding="utf-8")
        with serial.Serial(board.port, 460800, timeout=0.5) as port:
            client = Client(port)
            client.to_the_end()
        assert board.wait(5) == 1
        level, text = client.texts()[-1]
        assert level == "error"
        assert "Error" in text
        with pytest.raises(SolenavError, match="Traceback"):
            board.check()


def test_nothing_reads_nothing_is_lost() -> None:
    with on(still(), {"pose_every": 1}) as (board, client):
        with pytest.raises(TimeoutError):
            board.wait(0.5)
        client.to_the_end()
        assert len(client.named("SAMPLE")) == N
        assert board.wait(5) == 0


def test_real_time() -> None:
    fast = run(still(200))
    began = time.monotonic()
    slow = run(still(200), realtime=True)
    assert time.monotonic() - began > 1
    for message in (*fast.named("STATUS"), *slow.named("STATUS")):
        del message.fields["heap"]  # other settings take other memory
    assert slow.messages == fast.messages


def test_the_port_vanishes_when_all_is_read() -> None:
    with on(still(50)) as (board, client):
        assert board.wait(5) == 0
        client.to_the_end()
        board.wait_until_read()
        assert len(client.named("SAMPLE")) == 50


def test_closing_a_board_that_nobody_opened() -> None:
    with SimulatedBoard(still()) as board:
        pass
    board.check()


def test_which_micropython(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def chosen(script: str) -> None:
        program = tmp_path / "micropython"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        monkeypatch.setenv("SOLENAV_MICROPYTHON", str(program))

    assert find_micropython().name.startswith("micropython")
    chosen("echo micropython 1 19")
    with pytest.raises(SolenavError, match="too old"):
        find_micropython()
    chosen("echo cpython 3 11")
    with pytest.raises(SolenavError, match="no MicroPython"):
        find_micropython()
    monkeypatch.setenv("SOLENAV_MICROPYTHON", str(tmp_path / "nothing"))
    with pytest.raises(SolenavError, match="can't run"):
        find_micropython()
    monkeypatch.delenv("SOLENAV_MICROPYTHON")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    (tmp_path / "micropython").unlink()
    with pytest.raises(SolenavError, match="not installed") as caught:
        find_micropython()
    assert "solenav[board]" in caught.value.remedy


ALLOCATION = """
import gc
import sys

sys.path[:] = [""]
from solenav.sim.board import machine, simtime

sys.modules["machine"] = machine
sys.modules["time"] = simtime


class Sensor:
    # As much as the driver asks for, allocating nothing: a sample a pulse in the FIFO.

    def __init__(self):
        self.registers = bytearray(128)
        self.registers[0x75] = 0x68
        self.n = 0

    def readfrom_mem_into(self, address, register, buffer):
        if register == 0x74:
            self.n += 1
            for i in range(len(buffer)):
                buffer[i] = 0
            buffer[4] = 8
            buffer[5] = self.n & 3
            self.registers[0x73] = 0
            return
        for i in range(len(buffer)):
            buffer[i] = 0x48 if address == 0x0C else self.registers[register + i]

    def writeto_mem(self, address, register, data):
        if address == 0x68:
            kept = 0xFB if register == 0x6A else 0x7F if register == 0x6B else 0xFF
            self.registers[register] = data[0] & kept


class Uart:
    def write(self, buffer, offset, length):
        return length

    def any(self):
        return 0


class Ready:
    def irq(self, handler=None, trigger=0, hard=False):
        self.handler = handler


from application import Application
from boards import Board
from config import load

sensor = Sensor()
ready = Ready()
board = Board(lambda frequency: sensor, 5, 4, ready, Uart(), "", 0, None)
app = Application(board, *load())
app.wake(False)


def passes(n):
    for _ in range(n):
        simtime.advance(5000)
        sensor.registers[0x73] = len(app.sensor.raw)
        ready.handler(None)
        app.link.receive(0)
        app.take()
        app.link.pump()


before = 0  # here, as a new name may take room
passes(401)
gc.collect()
gc.disable()
before = gc.mem_alloc()
passes(198)
print(app.mode, app.sampler.samples, gc.mem_alloc() - before)
"""


def test_nothing_is_allocated_per_sample(tmp_path: Path) -> None:
    stage(tmp_path, {"pose_every": 1})
    (tmp_path / "allocation.py").write_text(ALLOCATION)
    ran = subprocess.run(
        [find_micropython(), "allocation.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.stdout.split(), ran.stderr) == (["2", "599", "0"], "")
