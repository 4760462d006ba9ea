"""Scripted faults of the simulated board, each as a program on the board sees it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solenav.sim import feed_file
from solenav.sim.board import faults, flash, machine, simtime
from solenav.sim.board.ak8975_registers import SENSITIVITY
from solenav.sim.board.feed import Feed
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav.sim.board.playback import Playback

EIO, ENOSPC, ETIMEDOUT = 5, 28, 110
N = 400
PERIOD = 5000


class Board:
    """A sensor that samples since time 0 of the recording, and a script that acts on it."""

    def __init__(self, folder: Path, script: list[dict[str, Any]]) -> None:
        for fault in script:
            assert not faults.problem(fault)
        counts = np.zeros((N, 6), np.int16)
        counts[:, 0] = np.arange(N)
        times = PERIOD * np.arange(N, dtype=np.int64)
        mag = np.tile(np.array([10, 20, -30], np.int16), (N, 1))
        feed_file.write_feed(folder / "feed.bin", times, counts, np.zeros(N, np.int16), mag)
        flash.mount(f"{folder}/", {})
        simtime.clear()
        self.sensor = Mpu9150()
        self.pulses: list[int] = []
        self.playback = Playback(
            self.sensor,
            Feed(str(folder / "feed.bin")),
            lambda: self.pulses.append(self.time()),
            lambda: self.world.start(),
        )
        machine.wire(self.sensor, self.playback)
        self.world = faults.World(script, self.sensor, self.playback)
        self.world.switch_on()
        self.bus = machine.I2C(timeout=1000)
        self.set_up()

    def set_up(self) -> None:
        for register, value in ((0x6B, 0), (0x1B, 0x18), (0x1C, 0x18)):
            self.write(register, value)
        if self.playback.start < 0:
            simtime.advance(100_000)
        self.write(0x38, 1)

    def time(self) -> int:
        return self.playback.elapsed

    def until(self, us: int) -> None:
        simtime.advance(us - self.time())

    def write(self, register: int, value: int) -> None:
        self.bus.writeto_mem(0x68, register, bytes([value]))

    def read(self, register: int, length: int = 1) -> bytes:
        return self.bus.readfrom_mem(0x68, register, length)

    def words(self) -> list[int]:
        raw = self.read(0x3B, 14)
        return [int.from_bytes(raw[i : i + 2], "big", signed=True) for i in range(0, 14, 2)]

    def error(self) -> int:
        """Of a read; 0 for none."""
        try:
            self.read(0x75)
        except OSError as error:
            return int(error.args[0])
        return 0


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Callable[..., Board]]:
    yield lambda *script: Board(tmp_path, list(script))
    machine.wire(None, None)
    machine.inject(None)
    machine.scripted = False
    simtime.clear()


def test_every_kind_is_described() -> None:
    assert faults.__doc__
    described = [
        line.split()[0]
        for line in faults.__doc__.splitlines()
        if line[:4] == "    " and line[4] != " "
    ]
    assert described == list(faults.KINDS)


def test_nack(board: Callable[..., Board]) -> None:
    made = board({"kind": "nack", "at": 10_000, "for": 5000})
    made.until(9500)
    assert made.error() == 0
    made.until(10_001)
    assert made.error() == EIO
    made.until(15_001)
    assert made.error() == 0


def test_nack_of_some_transfers_at_full_speed_only(board: Callable[..., Board]) -> None:
    made = board({"kind": "nack", "at": 0, "every": 3, "above": 100_000})
    made.until(1000)
    assert [made.error() for _ in range(6)].count(EIO) == 2
    made.bus = machine.I2C(freq=100_000)
    assert [made.error() for _ in range(6)] == [0] * 6


def test_faults_of_a_kind_overlap(board: Callable[..., Board]) -> None:
    made = board(
        {"kind": "nack", "at": 10_000, "for": 10_000}, {"kind": "nack", "at": 5000, "for": 10_000}
    )
    seen = []
    for at in (4000, 6000, 12_000, 16_000, 21_000):
        made.until(at)
        seen.append(made.error())
    assert seen == [0, EIO, EIO, EIO, 0]


def test_stuck_sda(board: Callable[..., Board]) -> None:
    made = board({"kind": "stuck_sda", "at": 10_000, "clocks": 4})
    made.until(10_001)
    assert made.error() == ETIMEDOUT
    sda = machine.Pin(machine.SDA_PIN, machine.Pin.OPEN_DRAIN, value=1)
    scl = machine.Pin(machine.SCL_PIN, machine.Pin.OPEN_DRAIN, value=1)
    levels = []
    for _ in range(5):
        levels.append(sda.value())
        scl.value(0)
        scl.value(1)
    assert levels == [0, 0, 0, 0, 1]
    machine.I2C()
    assert made.error() == 0
    assert len(made.pulses) > 2  # the sensor samples all the while


def test_stuck_sda_that_goes_away(board: Callable[..., Board]) -> None:
    made = board({"kind": "stuck_sda", "at": 10_000, "clocks": 99, "for": 10_000})
    made.until(15_000)
    assert made.error() == ETIMEDOUT
    made.until(20_001)
    assert made.error() == 0


def test_wrong_id(board: Callable[..., Board]) -> None:
    made = board({"kind": "wrong_id", "at": 10_000, "for": 10_000, "value": 0x71})
    made.until(10_001)
    assert made.read(0x75) == b"\x71"
    made.until(20_001)
    assert made.read(0x75) == b"\x68"


def test_frozen(board: Callable[..., Board]) -> None:
    made = board({"kind": "frozen", "at": 11_000, "for": 20_000})
    made.until(30_500)
    assert made.words()[0] == 2
    assert len(made.pulses) == 7
    made.until(35_500)
    assert made.words()[0] == 7


def test_frozen_until_a_reset(board: Callable[..., Board]) -> None:
    made = board({"kind": "frozen", "at": 11_000, "mends": True})
    made.until(30_500)
    assert made.words()[0] == 2
    made.write(0x6B, 0x80)
    simtime.advance(100_000)
    made.set_up()
    made.until(300_500)
    assert made.words()[0] == 60


def test_the_fifo_overflows_while_the_processor_stands_still(board: Callable[..., Board]) -> None:
    made = board({"kind": "fifo_overflow", "at": 100_000})
    made.write(0x23, 0x78)
    made.write(0x6A, 0x40)
    calls: list[int] = []
    machine.Pin(machine.READY_PIN).irq(lambda pin: calls.append(made.time()))
    made.playback._rise = lambda: machine.rise(machine.READY_PIN)
    made.until(99_000)
    before = len(calls)
    simtime.advance(1001)
    assert made.time() == 1_100_000
    assert made.read(0x3A)[0] & 0x10
    assert made.read(0x72, 2) == b"\x04\x00"
    assert len(calls) == before + 1  # two hundred pulses came as one


@pytest.mark.parametrize(("kind", "length"), [("hang", 1_000_000), ("watchdog", 20_000_000)])
def test_the_processor_hangs(board: Callable[..., Board], kind: str, length: int) -> None:
    made = board({"kind": kind, "at": 50_000})
    made.until(50_000)
    assert made.time() == 50_000 + length
    assert len(made.pulses) == min(N, (50_000 + length) // PERIOD + 1)


def test_a_hang_is_bitten(board: Callable[..., Board]) -> None:
    made = board({"kind": "watchdog", "at": 50_000})
    machine.WDT(timeout=3000)
    with pytest.raises(SystemExit):
        made.until(60_000)
    assert abs(made.time() - 3_000_000) < 1000


def test_clock(board: Callable[..., Board]) -> None:
    made = board({"kind": "clock", "at": 100_000, "for": 500_000, "factor": 0.96})
    made.until(500_000)
    steps = np.diff(made.pulses)
    assert set(steps[:20]) == {5000}
    assert set(steps[22:]) == {4800}
    assert made.words()[0] == pytest.approx(made.pulses[-1] / PERIOD, abs=0.51)
    made.until(1_000_000)
    assert np.diff(made.pulses)[-50:].tolist() == [5000] * 50


def test_spike(board: Callable[..., Board]) -> None:
    made = board({"kind": "spike", "at": 9000, "axis": "gy", "value": -30_000})
    seen = []
    for at in (6000, 11_000, 16_000):
        made.until(at)
        seen.append(made.words()[5])
    assert seen == [0, -30_000, 0]


def test_a_spike_that_lasts(board: Callable[..., Board]) -> None:
    made = board({"kind": "spike", "at": 9000, "for": 10_000, "axis": "temperature"})
    seen = []
    for at in (6000, 11_000, 16_000, 21_000):
        made.until(at)
        seen.append(made.words()[3])
    assert seen == [0, 32767, 32767, 0]


def test_bit_flip(board: Callable[..., Board]) -> None:
    made = board({"kind": "bit_flip", "at": 1000, "byte": 2, "bit": 7, "count": 2})
    made.until(1001)
    assert made.read(0x75) == b"\x68"  # too short to be hit
    assert [made.words()[1] for _ in range(3)] == [-32768, -32768, 0]


def test_bus_noise(board: Callable[..., Board]) -> None:
    made = board({"kind": "bus_noise", "at": 1000, "for": 100_000, "every": 10, "seed": 3})
    made.until(1001)
    read = [made.read(0x0D, 4) for _ in range(40)]
    sound = bytes(made.sensor.registers[0x0D:0x11])
    wrong = [values for values in read if values != sound]
    assert len(wrong) == 4
    for values in wrong:
        flipped = int.from_bytes(values, "big") ^ int.from_bytes(sound, "big")
        assert flipped & (flipped - 1) == 0
    for _ in range(9):
        made.write(0x19, 4)
    assert made.sensor.registers[0x19] == 4
    made.write(0x19, 4)
    assert made.sensor.registers[0x19] != 4
    made.until(101_001)
    assert all(made.read(0x0D, 4) == sound for _ in range(40))


def test_int_wire(board: Callable[..., Board]) -> None:
    made = board({"kind": "int_wire", "at": 10_000, "for": 10_000})
    calls: list[int] = []
    machine.Pin(machine.READY_PIN).irq(lambda pin: calls.append(made.time()))
    made.playback._rise = lambda: machine.rise(machine.READY_PIN)
    made.until(30_000)
    assert 15_000 not in calls and calls[-1] == 30_000
    assert made.words()[0] == 6


def test_register(board: Callable[..., Board]) -> None:
    made = board({"kind": "register", "at": 1000, "register": 0x1C, "value": 0})
    made.until(6000)
    assert made.words()[0] == 1 << 3
    assert made.read(0x1C) == b"\0"


def test_reset(board: Callable[..., Board]) -> None:
    made = board({"kind": "reset", "at": 10_000})
    made.until(11_000)
    assert made.read(0x6B) == b"\xc0"
    made.until(200_000)
    assert len(made.pulses) == 2
    made.set_up()
    made.until(300_000)
    assert len(made.pulses) == 22
    assert made.words()[0] == 60


@pytest.mark.parametrize(("kind", "length"), [("brown_out", 50_000), ("gone", 2_000_000)])
def test_a_sensor_without_power(board: Callable[..., Board], kind: str, length: int) -> None:
    made = board({"kind": kind, "at": 10_000})
    made.until(11_000)
    assert made.error() == EIO
    made.until(10_000 + length + 99_000)
    assert made.error() == EIO  # it starts up
    made.until(10_000 + length + 101_000)
    assert made.read(0x6B) == b"\x40"
    assert len(made.pulses) == 2


def test_a_sensor_unplugged_stays_away_whatever_its_supply(board: Callable[..., Board]) -> None:
    made = board({"kind": "gone", "at": 10_000, "for": 500_000})
    supply = machine.Pin(machine.POWER_PIN, machine.Pin.OUT, value=1)
    made.until(20_000)
    supply.off()
    supply.on()
    made.until(400_000)
    assert made.error() == EIO
    supply.off()
    made.until(700_000)
    assert made.error() == EIO  # plugged in again, but switched off
    supply.on()
    made.until(801_000)
    assert made.read(0x6B) == b"\x40"


def test_gone_from_power_up_on(board: Callable[..., Board]) -> None:
    with pytest.raises(OSError):
        board({"kind": "gone", "after": 0})


def test_temperature(board: Callable[..., Board]) -> None:
    made = board(
        {"kind": "temperature", "at": 0, "for": 1_000_000, "degrees": 10, "gyro": [4, -2, 0]}
    )
    made.until(500_500)
    assert made.words()[3:] == [1700, 20, -10, 0]
    made.until(1_500_500)
    assert made.words()[3:] == [3400, 40, -20, 0]


def test_self_test(board: Callable[..., Board]) -> None:
    made = board({"kind": "self_test", "at": 0, "axes": ["ax", "gz", "mag"]})
    made.write(0x1B, 0xE0)
    made.write(0x1C, 0xF0)
    made.until(6000)
    ax, ay, az, _t, gx, gy, gz = made.words()
    assert (ax, gz) == (2, 0)
    assert all(abs(value) > 1000 for value in (ay, az, gx, gy))
    assert made.sensor.compass
    assert made.sensor.compass.failing


def field(made: Board) -> list[int]:
    """What the compass measures, through the bypass, in the IMU's axes."""
    made.bus.writeto_mem(0x0C, 0x0A, b"\1")
    simtime.advance(9100)
    raw = made.bus.readfrom_mem(0x0C, 0x03, 6)
    x, y, z = (
        (int.from_bytes(raw[2 * i : 2 * i + 2], "little", signed=True) * (asa + 128) + 128) // 256
        for i, asa in enumerate(SENSITIVITY)
    )
    return [y, x, -z]


def test_magnet(board: Callable[..., Board]) -> None:
    made = board({"kind": "magnet", "at": 50_000, "for": 50_000, "field": [100, 0, -50]})
    made.write(0x37, 2)
    assert field(made) == pytest.approx([10, 20, -30], abs=1)
    made.until(60_000)
    assert field(made) == pytest.approx([110, 20, -80], abs=1)
    made.until(120_000)
    assert field(made) == pytest.approx([10, 20, -30], abs=1)


def test_compass(board: Callable[..., Board]) -> None:
    made = board({"kind": "compass", "at": 50_000, "for": 50_000})
    made.write(0x37, 2)
    assert made.bus.scan() == [0x0C, 0x68]
    made.until(60_000)
    assert made.bus.scan() == [0x68]
    made.write(0x37, 0)
    for register, value in ((0x25, 0x8C), (0x26, 0), (0x27, 0x81), (0x6A, 0x20)):
        made.write(register, value)
    made.until(70_000)
    assert made.read(0x36) == b"\1"
    made.until(120_000)
    made.read(0x36)
    made.until(130_000)
    assert (made.read(0x36), made.read(0x49)) == (b"\0", b"\x48")


@pytest.fixture
def uart(monkeypatch: pytest.MonkeyPatch) -> machine.UART:
    made = machine.UART.__new__(machine.UART)
    made._rxbuf = 256
    made._injected = bytearray()
    monkeypatch.setattr(made, "wait", lambda ms: False, raising=False)
    return made


def test_noise_and_floods_on_rx(board: Callable[..., Board], uart: machine.UART) -> None:
    made = board(
        {"kind": "uart_noise", "at": 0, "for": 100_000, "rate": 1000},
        {"kind": "uart_flood", "at": 200_000, "for": 100_000, "data": "0102ff"},
    )
    into = bytearray(64)
    made.until(50_000)
    assert uart.any() == 50
    assert uart.readinto(into, 64) == 50
    assert len(set(into[:50])) > 20
    made.until(100_001)
    assert uart.any() == 0  # what nobody fetched is over with the noise
    made.until(201_000)
    assert uart.any() == 46
    assert uart.readinto(into, 6) == 6
    assert bytes(into[:6]) == b"\1\2\xff\1\2\xff"
    made.until(290_000)
    assert uart.any() == 256  # the buffer is full, the rest is lost
    made.until(301_000)
    assert uart.any() == 256


def test_noise_is_the_same_each_time() -> None:
    simtime.clear()
    lines = [machine.Line(1000, 10**6, seed=seed) for seed in (1, 1, 2)]
    simtime.advance(100_000)
    first, again, other = (bytes(line.arrived(256)) for line in lines)
    assert first == again != other
    simtime.clear()


def test_power_cut(board: Callable[..., Board]) -> None:
    made = board({"kind": "power_cut", "at": 50_000, "for": 300_000})
    with pytest.raises(SystemExit) as ended:
        made.until(60_000)
    assert ended.value.code == machine.POWER_CUT
    assert machine.off_us == 300_000


@pytest.mark.parametrize("when", [{"operation": 3}, {"byte": 700}])
def test_power_cut_at_a_flash_write(board: Callable[..., Board], when: dict[str, int]) -> None:
    board({"kind": "power_cut", **when})
    with pytest.raises(SystemExit) as ended, flash.open("log", "wb") as file:
        for _ in range(50):
            file.write(bytes(100))
    assert ended.value.code == machine.POWER_CUT


def test_flash_full(board: Callable[..., Board]) -> None:
    made = board({"kind": "flash_full", "at": 50_000, "for": 200_000})
    with flash.open("log", "wb") as file:
        file.write(bytes(600))
        made.until(60_000)
        file.write(bytes(3000))  # into the block that it has
        with pytest.raises(OSError) as error:
            file.write(bytes(1000))
        assert error.value.args[0] == ENOSPC
        assert flash.statvfs("/")[3] == 0
        made.until(260_000)
        file.write(bytes(1000))


def test_what_began_before_a_restart_is_past_or_goes_on(tmp_path: Path) -> None:
    script: list[dict[str, Any]] = [
        {"kind": "reset", "at": 10_000},
        {"kind": "spike", "at": 10_000},
        {"kind": "nack", "at": 10_000, "for": 10_000},
        {"kind": "power_cut", "at": 60_000},
        {"kind": "wrong_id", "at": 10_000, "for": 100_000},
        {"kind": "temperature", "at": 0, "for": 20_000, "degrees": 10},
        {"kind": "frozen", "at": 80_000, "for": 10_000},
    ]
    made = Board(tmp_path, script)
    with pytest.raises(SystemExit):
        made.until(70_000)
    saved, at = made.playback.save(), simtime.now()
    simtime.clear(at)
    sensor = Mpu9150()
    playback = Playback(sensor, Feed(str(tmp_path / "feed.bin")), lambda: None)
    machine.wire(sensor, playback)
    world = faults.World(script, sensor, playback)
    world.switch_on(again=True)
    playback.load(saved)
    world.start()
    simtime.advance(1)
    assert sensor.identity == 0x70
    assert len(playback.changes) == 1  # the temperature's
    assert not machine.bus.nack
    simtime.advance(25_000)
    assert sensor.frozen
    simtime.advance(50_000)
    assert (sensor.frozen, sensor.identity) == (False, 0x68)
    machine.wire(None, None)
    machine.scripted = False
    simtime.clear()
