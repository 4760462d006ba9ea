"""The emulated Pico around the firmware: its bus, pins, UART, file system, ports."""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cli
import numpy as np
import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from solenav import capture, importing
from solenav.errors import SolenavError
from solenav.sim.board import machine, simtime
from solenav.sim.feed_file import write_feed
from solenav.verification import verify

pytest.importorskip("rp2040py", reason="the emulator isn't installed")
pytest.importorskip("littlefs", reason="the emulator isn't installed")

from rp2040py.rp2040 import RP2040

from solenav_tools.emulator import bench as measuring
from solenav_tools.emulator import image, ports, run, uf2, workarounds
from solenav_tools.emulator.pico import EmulatedPico
from solenav_tools.emulator.sensor import Wiring
from solenav_tools.emulator.workarounds import PacedUart
from solenav_tools.staging import switch

MPU = 0x68
I2C, UART = 0x40044000, 0x40034000
TAR, DATA_CMD, RAW_INTR, ABORT_SOURCE, ENABLE, RXFLR, SCL_HIGH, SCL_LOW, CLR_ABORT = (
    0x04, 0x10, 0x34, 0x80, 0x6C, 0x78, 0x1C, 0x20, 0x54,
)  # fmt: skip
READ, STOP, RESTART = 0x100, 0x200, 0x400
TX_EMPTY, TX_ABORT, STOP_DET = 0x10, 0x40, 0x200
MICROSECOND = 1000


class Bench:
    """An RP2040 without a program: its registers are written by hand, its clock is ticked."""

    def __init__(self, feed: Path, faults: list[dict[str, object]]) -> None:
        self.rp = RP2040()
        self.rp.logger.warning = lambda *_: None  # type: ignore[method-assign]
        self.uart = PacedUart.install(self.rp, 0)
        self.stopped = 0
        self.wiring = Wiring(self.rp, self.uart, feed, "MPU-9150", faults, self.stop)
        self.clock(400_000)
        for pin in (4, 5):
            self.rp.gpio[pin].ctrl = 3

    def stop(self) -> None:
        self.stopped += 1

    def clock(self, hertz: int) -> None:
        period = 125_000_000 // hertz
        self.put(I2C + SCL_LOW, period * 3 // 5)
        self.put(I2C + SCL_HIGH, period - period * 3 // 5)

    def put(self, address: int, value: int) -> None:
        self.rp.write_uint32(address, value)

    def get(self, address: int) -> int:
        return self.rp.read_uint32(address)

    def pass_us(self, us: float) -> None:
        self.rp.clock.tick(us * MICROSECOND)

    def until(self, done: Callable[[], bool], us: int = 20_000) -> int:
        """µs that pass until it is done; time passes in a look as well (workarounds.pass_polls)."""
        began = self.rp.clock.nanos
        for _ in range(us):
            if done():
                return round((self.rp.clock.nanos - began) / 1000)
            self.pass_us(1)
        raise AssertionError(f"not done within {us} µs")

    def select(self, address: int) -> None:
        self.put(I2C + ENABLE, 0)
        self.put(I2C + TAR, address)
        self.put(I2C + ENABLE, 1)

    def write(self, register: int, value: int) -> None:
        self.select(MPU)
        self.put(I2C + DATA_CMD, register)
        self.put(I2C + DATA_CMD, value | STOP)
        self.until(lambda: not self.get(I2C + 0x70) & 0x20)

    def read(self, register: int, count: int) -> tuple[bytes, int]:
        """A burst, and how many µs it took."""
        self.select(MPU)
        self.put(I2C + DATA_CMD, register)
        for i in range(count):
            last = STOP if i == count - 1 else 0
            self.put(I2C + DATA_CMD, READ | last | (RESTART if i == 0 else 0))
        took = self.until(lambda: self.get(I2C + RXFLR) >= count)
        return bytes(self.get(I2C + DATA_CMD) & 255 for _ in range(count)), took

    def wake(self, interrupts: int = 1) -> None:
        """The sensor measuring at 200 Hz, ±16 g and ±2000 °/s, announcing its samples."""
        for register, value in (
            (0x6B, 1), (0x19, 4), (0x1A, 1), (0x1B, 0x18), (0x1C, 0x18), (0x38, interrupts),
        ):  # fmt: skip
            self.write(register, value)


@pytest.fixture
def feed(tmp_path: Path) -> Path:
    """200 Hz; sample n has n in every accelerometer axis."""
    n = 400
    counts = np.zeros((n, 6), np.int16)
    counts[:, :3] = np.arange(n)[:, None]
    times = np.arange(n, dtype=np.int64) * 5000 + 100
    write_feed(tmp_path / "feed.bin", times, counts, np.zeros(n, np.int16))
    return tmp_path / "feed.bin"


@pytest.fixture
def bench(feed: Path) -> Iterator[Bench]:
    yield Bench(feed, [])
    machine.wire(None, None)
    simtime.clear()


# The sensor on the emulated controller.


def test_a_register_is_read_in_the_time_that_its_bits_take(bench: Bench) -> None:
    data, took = bench.read(0x75, 1)
    assert data == b"\x68"
    # START, address, register, repeated START, address, a byte: 38 bits of 2.5 µs.
    assert 90 <= took <= 100
    bench.clock(100_000)
    assert 4 * 90 <= bench.read(0x75, 1)[1] <= 4 * 100


def test_an_address_that_nobody_has_is_aborted_and_lets_the_sdk_look(bench: Bench) -> None:
    bench.select(0x51)
    bench.put(I2C + DATA_CMD, 0 | STOP)
    bench.until(lambda: bool(bench.get(I2C + RAW_INTR) & STOP_DET))
    assert bench.get(I2C + RAW_INTR) & TX_ABORT
    assert bench.get(I2C + RAW_INTR) & TX_EMPTY
    assert bench.get(I2C + ABORT_SOURCE) & 1
    bench.get(I2C + CLR_ABORT)
    assert bench.read(0x75, 1)[0] == b"\x68"


def test_int_rises_with_each_sample_at_its_time(bench: Bench) -> None:
    bench.wake()
    playback = bench.wiring.playback
    assert playback and playback.start > 0
    risen = []
    level = False
    for _ in range(15_000):
        bench.pass_us(1)
        now = bench.rp.gpio[6]._raw_input_value
        if now and not level:
            risen.append(round(bench.rp.clock.nanos / 1000) - playback.start)
        level = bool(now)
    assert all(abs((at - 100) % 5000) <= 1 for at in risen) and len(risen) == 3


def test_a_burst_is_of_one_sample_also_where_the_next_comes_in_its_middle(bench: Bench) -> None:
    bench.wake()
    playback = bench.wiring.playback
    assert playback
    bench.pass_us(70_000)  # settled
    before = playback._time + playback.start - round(bench.rp.clock.nanos / 1000)
    bench.pass_us(before - 200)
    number = struct.unpack(">h", bench.read(0x3B, 2)[0])[0]
    data, took = bench.read(0x3B, 6)
    assert took > 150
    assert struct.unpack(">3h", data) == (number, number, number)
    assert struct.unpack(">3h", bench.read(0x3B, 6)[0]) == (number + 1,) * 3


def test_a_bus_that_is_held_starts_nothing_until_it_is_clocked_free(feed: Path) -> None:
    bench = Bench(feed, [{"kind": "stuck_sda", "after": 0, "clocks": 4}])
    bench.select(MPU)
    bench.put(I2C + DATA_CMD, 0x75 | STOP)
    bench.pass_us(5000)
    assert not bench.get(I2C + RAW_INTR) & STOP_DET
    sda, scl = bench.rp.gpio[4], bench.rp.gpio[5]
    bench.put(0x4000C000, 0x8)  # RESETS: the controller is reset, as MicroPython does when opening
    bench.put(0x4000C000, 0)
    # By hand, open drain: driven low, released.
    for pin in (sda, scl):
        pin.ctrl = 5
        pin.check_for_updates()
    assert not sda.input_value or not sda._raw_input_value
    for _ in range(4):
        bench.rp.sio.write_uint32(0x24, 1 << 5)  # GPIO_OE_SET: low
        bench.pass_us(5)
        bench.rp.sio.write_uint32(0x28, 1 << 5)  # GPIO_OE_CLR: released
        bench.pass_us(5)
    assert sda._raw_input_value
    for pin in (sda, scl):
        pin.ctrl = 3
        pin.check_for_updates()
    assert bench.read(0x75, 1)[0] == b"\x68"


def test_faults_of_the_simulated_board_are_the_same_here(feed: Path) -> None:
    script = [
        {"kind": "nack", "after": 0, "for": 10_000},
        {"kind": "bit_flip", "after": 20_000, "byte": 0, "bit": 1},
        {"kind": "wrong_id", "after": 30_000, "value": 0x70},
    ]
    bench = Bench(feed, script)
    bench.select(MPU)
    bench.put(I2C + DATA_CMD, 0x75)
    bench.until(lambda: bool(bench.get(I2C + RAW_INTR) & TX_ABORT))
    bench.get(I2C + CLR_ABORT)
    bench.pass_us(15_000)
    assert bench.read(0x75, 1)[0] == b"\x68"
    bench.pass_us(10_000)
    assert bench.read(0x75, 1)[0] == b"\x6a"
    assert bench.read(0x75, 1)[0] == b"\x68"
    bench.pass_us(10_000)
    assert bench.read(0x75, 1)[0] == b"\x70"


def test_a_fault_that_stops_the_processor_asks_for_it(feed: Path) -> None:
    bench = Bench(feed, [{"kind": "hang", "after": 1000, "for": 250_000}])
    bench.pass_us(1001)
    assert bench.stopped
    assert bench.wiring.behind_ns == pytest.approx(250e6, abs=2000)
    bench.rp.clock.tick(bench.wiring.behind_ns)
    bench.wiring.follow()
    assert bench.wiring.behind_ns < 1000


# The UART.

DR, FR, IBRD, FBRD, LCR, CR, IMSC, RIS, ICR = 0, 0x18, 0x24, 0x28, 0x2C, 0x30, 0x38, 0x3C, 0x44
TX, RX, TIMEOUT = 0x20, 0x10, 0x40


def opened(bench: Bench) -> list[tuple[int, float]]:
    """The UART at 460800 baud; bytes with the µs at which they have left go into the list."""
    for register, value in ((IBRD, 16), (FBRD, 61), (LCR, 0x70), (CR, 0x301), (IMSC, TX | RX)):
        bench.put(UART + register, value)
    sent: list[tuple[int, float]] = []
    bench.uart.on_byte = lambda byte: sent.append((byte, bench.rp.clock.nanos / 1000))
    return sent


def test_bytes_leave_one_after_the_other_at_the_baud_rate(bench: Bench) -> None:
    sent = opened(bench)
    for byte in b"abc":
        bench.put(UART + DR, byte)
    assert sent == []
    bench.pass_us(100)
    assert bytes(byte for byte, _at in sent) == b"abc"
    gaps = np.diff([at for _byte, at in sent])
    assert gaps == pytest.approx(1e7 / 460_800, rel=2e-3)
    assert bench.get(UART + FR) & 0x88 == 0x80  # empty and not busy


def test_the_tx_interrupt_comes_when_the_fifo_empties_and_can_be_cleared(bench: Bench) -> None:
    opened(bench)
    assert not bench.get(UART + RIS) & TX
    for byte in range(32):
        bench.put(UART + DR, byte)
    assert not bench.get(UART + FR) & 0x20  # one is in the shifter
    bench.put(UART + DR, 32)
    assert bench.get(UART + FR) & 0x20
    bench.put(UART + DR, 99)  # no room: lost, as on the chip
    bench.until(lambda: bool(bench.get(UART + RIS) & TX))
    bench.put(UART + ICR, TX)
    assert not bench.get(UART + RIS) & TX
    bench.pass_us(2000)
    assert not bench.get(UART + RIS) & TX


def test_received_bytes_interrupt_at_the_level_and_after_a_silence(bench: Bench) -> None:
    opened(bench)
    bench.put(UART + 0x34, 0)  # UARTIFLS: four bytes
    bench.uart.receive(b"hallo")
    bench.pass_us(3.5 * 21.7)
    assert not bench.get(UART + RIS) & RX
    bench.pass_us(21.7)
    assert bench.get(UART + RIS) & RX
    bench.pass_us(21.7 + 75)
    assert bench.get(UART + RIS) & TIMEOUT
    assert bytes(bench.get(UART + DR) for _ in range(5)) == b"hallo"
    assert not bench.get(UART + RIS) & (RX | TIMEOUT)


def test_what_nobody_reads_in_time_is_lost_and_counted(bench: Bench) -> None:
    opened(bench)
    bench.uart.receive(bytes(40))
    bench.pass_us(40 * 22)
    assert bench.uart.overruns == 8


# The file system, and which MicroPython.


@settings(max_examples=10, deadline=None)
@given(
    st.dictionaries(
        st.from_regex(r"[a-z]{1,8}(/[a-z]{1,8}){0,2}\.(py|mpy)", fullmatch=True),
        st.binary(max_size=6000),
        max_size=6,
    )
)
def test_an_image_gives_back_the_files_that_it_was_made_of(files: dict[str, bytes]) -> None:
    made = image.build(files)
    assert len(made) == image.BLOCK * image.BLOCKS
    assert image.files(made) == files


def test_what_is_staged_is_compiled_and_fits_a_pico() -> None:
    files = image.files(run.file_system({"pose_every": 2}))
    sources = [name for name in files if name.endswith(".py")]
    assert sources == ["main.py"]
    assert files["main.py"] == switch() and files["active"] == b"a"
    tree = {"main.mpy", "application.mpy", "boards/rp2_pico.mpy", "solenav_core/particles.mpy"}
    assert {f"a/{name}" for name in tree} <= set(files)
    assert b"pose_every" in files["config.json"]
    # Notes for people stay at home.
    assert b"meaning" not in b"".join(files.values())


def test_another_version_of_the_emulator_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workarounds.metadata, "version", lambda _name: "0.4.0")
    with pytest.raises(SolenavError, match=r"rp2040py is 0\.4\.0") as error:
        workarounds.check_version()
    assert workarounds.VERSION in error.value.remedy


def test_a_missing_or_wrong_uf2_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOLENAV_UF2", raising=False)
    cli.refused(cli.solenav("emulate"), 2, "no MicroPython", "SOLENAV_UF2")
    (tmp_path / "no.uf2").write_bytes(b"not one")
    for path in ("no.uf2", "nowhere.uf2"):
        with pytest.raises(SolenavError, match=path):
            uf2.find(str(tmp_path / path))
    block = struct.pack("<8I", 0x0A324655, 0x9E5D5157, 0x2000, 0, 256, 0, 1, 0xE48BFF59)
    (tmp_path / "pico2.uf2").write_bytes(block.ljust(512, b"\0"))
    with pytest.raises(SolenavError, match="another processor"):
        uf2.find(str(tmp_path / "pico2.uf2"))


# Ports.


def exchanged(port: ports.Port, data: bytes = b"", seconds: float = 20) -> bytes:
    deadline = time.monotonic() + seconds
    came = port.exchange(data)
    while not came and time.monotonic() < deadline:
        came = port.exchange(b"")
        time.sleep(0.01)
    return came


def test_a_pseudo_terminal_carries_bytes_both_ways() -> None:
    port = ports.PseudoTerminal()
    try:
        with serial.Serial(port.name, timeout=20) as client:
            client.write(b"in\x03\x00\r")
            assert exchanged(port, b"out\r\n\x04") == b"in\x03\x00\r"
            assert client.read(6) == b"out\r\n\x04"
    finally:
        port.close()


def test_a_tcp_port_takes_one_client_after_the_other() -> None:
    port = ports.TcpPort(0)
    try:
        for _ in range(2):
            address = port.name.removeprefix("socket://").split(":")
            with socket.create_connection((address[0], int(address[1])), timeout=20) as client:
                client.sendall(b"hello")
                assert exchanged(port) == b"hello"
                port.exchange(b"back")
                assert client.recv(4) == b"back"
            deadline = time.monotonic() + 20
            while port._client and time.monotonic() < deadline:
                port.exchange(b"")
    finally:
        port.close()


# A board that runs a program of one instruction.


@pytest.fixture
def looping(tmp_path: Path) -> Iterator[EmulatedPico]:
    """``b .`` at the start of flash."""
    head = struct.pack("<8I", 0x0A324655, 0x9E5D5157, 0x2000, 0x1000_0000, 256, 0, 1, 0xE48BFF56)
    block = (head + b"\xfe\xe7").ljust(508, b"\0") + struct.pack("<I", 0x0AB16F30)
    (tmp_path / "loop.uf2").write_bytes(block)
    with EmulatedPico(tmp_path / "loop.uf2") as pico:
        yield pico


def test_the_board_is_looked_at_by_its_own_clock(looping: EmulatedPico) -> None:
    asked: list[int] = []
    looping.run(lambda: asked.append(looping.ns) or len(asked) == 8)  # type: ignore[func-returns-value]
    assert asked == [n * 1_000_000 for n in range(8)]


def test_a_watchdog_s_trigger_restarts_the_board(looping: EmulatedPico) -> None:
    looping.step()
    looping.mcu.write_uint32(0x4005_8000, 1 << 31)
    assert looping.restarts == ["reset"]
    before = looping.ns
    looping.step()
    looping.step()
    assert looping.ns - before >= 1_000_000
    assert looping.mcu.core.pc & ~2 == 0x1000_0000


# The bench.


def test_each_sample_that_came_is_found_among_those_measured() -> None:
    sent = np.arange(60, dtype=np.int16).reshape(10, 6)
    assert list(measuring._rows(sent, sent[[0, 1, 4, 9]])) == [0, 1, 4, 9]
    with pytest.raises(SolenavError, match="sample 1"):
        measuring._rows(sent, sent[[3, 2]])


def test_a_stance_costs_the_thumb_engine_what_particles_cost(tmp_path: Path) -> None:
    importing.to_capture(run.walk_of("loop", 3), tmp_path / "walk.solcap")
    source = capture.load(tmp_path / "walk.solcap")
    kinds = measuring.on_thumb(source.sample_counts[:460], source.params[0][1])
    assert sum(kind["ticks"] for kind in kinds.values()) == 460
    for kind in kinds.values():
        assert sum(kind["stages"].values()) == pytest.approx(kind["mean"], abs=20)
    assert kinds["stance"]["mean"] > 5 * kinds["swing"]["mean"]
    assert kinds["stance"]["stages"]["particles"] > kinds["stance"]["mean"] / 2
    assert "particles" not in kinds["swing"]["stages"]


# With MicroPython.


@pytest.fixture(scope="module")
def micropython() -> Path:
    if not os.environ.get("SOLENAV_UF2"):
        pytest.skip("no MicroPython for the Pico: SOLENAV_UF2 names none")
    return uf2.find(None)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walk") / "walk.solcap"
    importing.to_capture(run.walk_of("loop", 4), path)
    return path


def test_a_walk_on_the_emulated_pico_is_proven_tick_by_tick_and_the_same_twice(
    micropython: Path, walk: Path, tmp_path: Path
) -> None:
    outputs = [tmp_path / "a.solcap", tmp_path / "b.solcap"]
    for output in outputs:
        done = cli.solenav(
            "emulate",
            "--uf2",
            str(micropython),
            "--walk",
            str(walk),
            "-o",
            str(output),
            timeout=1800,
        )
        assert done.returncode == 0, done.stderr
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    made = capture.load(outputs[0])
    assert len(made.samples) == len(capture.load(walk).samples)
    report = verify(made)
    assert report.verified and report.covered_ticks == len(made.samples)


def test_a_program_is_typed_in_over_the_console(micropython: Path) -> None:
    said = bytearray()
    with EmulatedPico(micropython) as pico:
        pico.console.on_data = said.extend
        pico.run(lambda: pico.console.connected)
        pico.console.write(b"\r\x03\x03\x01")
        pico.run(lambda: b"raw REPL" in said)
        pico.console.write(
            b"import machine\n"
            b"i = machine.I2C(0, sda=machine.Pin(4), scl=machine.Pin(5), freq=400000)\n"
            b"try:\n i.readfrom(0x51, 1)\n"
            b"except OSError as e:\n print('errno', e.errno)\n\x04"
        )
        pico.run(lambda: said.count(b"\x04") >= 2)
    assert b"errno 5" in said
