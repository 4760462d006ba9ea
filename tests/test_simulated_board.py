"""The simulated board around the sensor: bus and pins, watchdog, resets, flash, recording."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from solenav.errors import SolenavError
from solenav.sim import feed_file
from solenav.sim.board import faults, flash, machine, simtime
from solenav.sim.board.feed import Feed
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav.sim.board.playback import Playback
from solenav_tools.board import Samples, SimulatedBoard

EIO, ENOENT, ENOSPC, ETIMEDOUT = 5, 2, 28, 110


@pytest.fixture(autouse=True)
def board() -> Iterator[Mpu9150]:
    """A sensor on a fresh bus, the clock at 0."""
    simtime.clear()
    sensor = Mpu9150()
    machine.wire(sensor, None)
    yield sensor
    machine.wire(None, None)
    machine.inject(None)
    simtime.clear()


def failure(error: pytest.ExceptionInfo[OSError]) -> int:
    return int(error.value.args[0])


# Time.


def test_events_come_in_order_each_at_its_own_time() -> None:
    seen: list[tuple[str, int]] = []
    simtime.at(200, lambda: seen.append(("b", simtime.now())))
    simtime.at(100, lambda: seen.append(("a", simtime.now())))
    simtime.at(200, lambda: seen.append(("c", simtime.now())))
    simtime.at(300, lambda: seen.append(("late", simtime.now())))
    simtime.advance(250)
    assert seen == [("a", 100), ("b", 200), ("c", 200)]
    assert simtime.now() == 250


def test_interrupts_that_are_held_off_come_once() -> None:
    calls: list[int] = []

    def handler(_pin: machine.Pin) -> None:
        calls.append(simtime.now())

    pin = machine.Pin(machine.READY_PIN, machine.Pin.IN)
    pin.irq(handler, machine.Pin.IRQ_RISING, hard=True)
    for at in (100, 200, 300):
        simtime.at(at, lambda: machine.rise(machine.READY_PIN))
    simtime.hold_off(250)
    assert calls == [250]
    simtime.advance(100)
    assert calls == [250, 300]
    state = machine.disable_irq()
    machine.rise(machine.READY_PIN)
    assert len(calls) == 2
    machine.enable_irq(state)
    assert len(calls) == 3
    pin.irq(None)
    machine.rise(machine.READY_PIN)
    assert len(calls) == 3


def test_tick_counts_start_again_with_the_processor() -> None:
    simtime.clear(now_us=(1 << 30) + 5)
    simtime.advance(2000)
    assert simtime.ticks_us() == 2000
    simtime.boot()
    assert (simtime.ticks_us(), simtime.ticks_ms()) == (0, 0)
    assert simtime.now() == (1 << 30) + 2008


# The bus.


def test_a_transfer_takes_the_time_of_its_bits() -> None:
    for frequency, us in ((400_000, 127), (100_000, 510)):
        bus = machine.I2C(freq=frequency)
        before = simtime.now()
        assert bus.readfrom_mem(0x68, 0x75, 2) == b"\x68\0"
        assert simtime.now() - before == (9 * 5 + 3) * 1_000_000 // frequency
        assert abs(simtime.now() - before - us) < us // 10


def test_every_way_to_read_and_write() -> None:
    bus = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400_000, timeout=10_000)
    bus.writeto_mem(0x68, 0x6B, b"\0")
    bus.writeto(0x68, b"\x19\x04\x01")
    into = bytearray(2)
    bus.readfrom_mem_into(0x68, 0x19, into)
    assert bytes(into) == bus.readfrom_mem(0x68, 0x19, 2) == b"\x04\x01"
    bus.writeto(0x68, b"\x75")
    assert bus.readfrom(0x68, 1) == b"\x68"
    bus.writeto(0x68, b"\x75")
    one = bytearray(1)
    bus.readfrom_into(0x68, one)
    assert one == b"\x68"
    assert bus.scan() == [0x68]
    bus.writeto_mem(0x68, 0x37, b"\x02")
    assert bus.scan() == [0x0C, 0x68]


def test_nobody_acknowledges() -> None:
    with pytest.raises(OSError) as error:
        machine.I2C().readfrom_mem(0x69, 0, 1)
    assert failure(error) == EIO


def test_pins_taken_by_hand_are_not_the_controllers() -> None:
    bus = machine.I2C(timeout=5000)
    machine.Pin(machine.SCL_PIN, machine.Pin.OPEN_DRAIN, value=1)
    before = simtime.now()
    with pytest.raises(OSError) as error:
        bus.readfrom_mem(0x68, 0x75, 1)
    assert failure(error) == ETIMEDOUT
    assert simtime.now() - before == 5000
    machine.I2C()
    assert bus.readfrom_mem(0x68, 0x75, 1) == b"\x68"


@pytest.mark.parametrize("clocks", range(1, 10))
def test_a_slave_holds_sda_until_it_was_clocked(clocks: int) -> None:
    bus = machine.I2C(timeout=5000)
    machine.bus.held = clocks
    with pytest.raises(OSError) as error:
        bus.readfrom_mem(0x68, 0x75, 1)
    assert failure(error) == ETIMEDOUT
    sda = machine.Pin(machine.SDA_PIN, machine.Pin.OPEN_DRAIN, machine.Pin.PULL_UP, value=1)
    scl = machine.Pin(machine.SCL_PIN, machine.Pin.OPEN_DRAIN, machine.Pin.PULL_UP, value=1)
    pulses = 0
    while not sda.value():
        scl.value(0)
        assert not scl.value()
        scl(1)
        pulses += 1
    assert pulses == clocks
    sda.off()
    assert sda() == 0
    sda.on()
    assert sda() == 1
    assert machine.I2C().readfrom_mem(0x68, 0x75, 1) == b"\x68"


def test_the_power_pin_switches_the_sensor(board: Mpu9150) -> None:
    bus = machine.I2C()
    bus.writeto_mem(0x68, 0x6B, b"\0")
    machine.bus.held = 9
    supply = machine.Pin(machine.POWER_PIN, machine.Pin.OUT, value=0)
    assert bus.scan() == []
    supply.value(1)
    simtime.advance(100_000)
    assert bus.readfrom_mem(0x68, 0x6B, 1) == b"\x40"


def test_the_interrupt_line_can_be_read(board: Mpu9150) -> None:
    bus = machine.I2C()
    for register, value in ((0x6B, 0), (0x37, 0x20), (0x38, 1)):
        bus.writeto_mem(0x68, register, bytes([value]))
    ready = machine.Pin(machine.READY_PIN, machine.Pin.IN, machine.Pin.PULL_DOWN)
    assert ready.value() == 0
    board.sample((0,) * 10)
    assert ready.value() == 1
    bus.readfrom_mem(0x68, 0x3A, 1)
    assert ready.value() == 0


# Watchdog and resets.


def test_a_watchdog_that_is_fed_stays_quiet() -> None:
    dog = machine.WDT(timeout=1000)
    for _ in range(10):
        simtime.advance(900_000)
        dog.feed()
    with pytest.raises(SystemExit) as ended:
        simtime.advance(1_000_001)
    assert machine.RESTARTS[int(str(ended.value.code))] == "watchdog"
    with pytest.raises(SystemExit):  # nothing works any more
        simtime.advance(1)


def test_a_watchdog_waits_no_longer_than_the_rp2s() -> None:
    with pytest.raises(ValueError, match="8388"):
        machine.WDT(timeout=8389)


def test_a_program_cannot_go_on_after_a_reset() -> None:
    with pytest.raises(SystemExit) as ended:
        machine.reset()
    assert machine.RESTARTS[int(str(ended.value.code))] == "reset"
    with pytest.raises(SystemExit):
        simtime.sleep_ms(1)
    with pytest.raises(SystemExit):
        flash.open("anything")


# The recording.


def records(n: int = 50) -> Samples:
    values = np.arange(n, dtype=np.int16)
    counts = np.repeat(10 * values[:, None], 6, axis=1)
    return Samples(5000 * np.arange(n, dtype=np.int64), counts, values, -counts[:, :3])


def playing(tmp_path: Path, samples: Samples) -> tuple[Mpu9150, Playback, list[int]]:
    """A sensor that plays samples, and the times of its pulses."""
    path = tmp_path / "feed.bin"
    feed_file.write_feed(path, *samples)
    sensor = Mpu9150()
    pulses: list[int] = []
    playback = Playback(sensor, Feed(str(path)), lambda: pulses.append(simtime.now()))
    machine.wire(sensor, playback)
    return sensor, playback, pulses


def begin(bus: machine.I2C) -> None:
    for register, value in ((0x6B, 0), (0x1B, 0x18), (0x1C, 0x18), (0x19, 4), (0x1A, 1)):
        bus.writeto_mem(0x68, register, bytes([value]))
    simtime.advance(60_000)
    bus.writeto_mem(0x68, 0x38, b"\1")


def test_a_feed_holds_the_field(tmp_path: Path) -> None:
    sensor, playback, pulses = playing(tmp_path, records())
    begin(machine.I2C())
    simtime.advance(20_001)
    assert [t - playback.start for t in pulses] == [0, 5000, 10_000, 15_000, 20_000]
    assert sensor.compass
    assert sensor.compass.field == (-40, -40, -40)
    simtime.advance(1_000_000)
    assert len(pulses) == 50
    assert playback.over


def test_without_a_field_the_compass_reads_a_quiet_one(tmp_path: Path) -> None:
    samples = records()._replace(mag=None)
    feed_file.write_feed(tmp_path / "feed.bin", *samples)
    feed = Feed(str(tmp_path / "feed.bin"))
    assert feed.next() == 0
    assert feed.values[7:] == (feed_file.NO_FIELD,) * 3


@pytest.mark.parametrize("wrong", [np.zeros((50, 2), np.int16), np.zeros((49, 3), np.int16)])
def test_fields_of_another_shape(tmp_path: Path, wrong: Any) -> None:
    with pytest.raises(ValueError, match="expected"):
        feed_file.write_feed(tmp_path / "feed.bin", *records()._replace(mag=wrong))


def test_an_awake_sensor_measures_before_the_recording_starts(tmp_path: Path) -> None:
    _sensor, playback, pulses = playing(tmp_path, records())
    bus = machine.I2C()
    bus.writeto_mem(0x68, 0x6B, b"\0")
    bus.writeto_mem(0x68, 0x19, b"\4\1\x18\x18")
    simtime.advance(100_000)
    seen = set()
    for _ in range(6):
        seen.add(bus.readfrom_mem(0x68, 0x3B, 6))
        simtime.advance(5000)
    assert len(seen) == 3
    assert playback.elapsed == -1
    assert not pulses
    bus.writeto_mem(0x68, 0x38, b"\1")
    assert playback.start == simtime.now()


def test_a_clock_that_is_off_measures_what_the_foot_does_then(tmp_path: Path) -> None:
    _sensor, playback, pulses = playing(tmp_path, records())
    bus = machine.I2C()
    begin(bus)
    playback.factor = 1.04
    simtime.advance(51_000)
    steps = np.diff(pulses)
    assert steps[2:].tolist() == [5200] * len(steps[2:])
    raw = bus.readfrom_mem(0x68, 0x3B, 2)
    true_time = pulses[-1] - playback.start
    assert int.from_bytes(raw, "big") == round(10 * true_time / 5000)
    playback.factor = 1.0
    simtime.advance(60_000)
    assert set(np.diff(pulses).tolist()) == {5000, 5200}  # no step when it is right again
    assert np.diff(pulses)[-5:].tolist() == [5000] * 5
    simtime.advance(1_000_000)
    assert playback.over


def test_a_recording_goes_on_after_a_restart(tmp_path: Path) -> None:
    _sensor, playback, pulses = playing(tmp_path, records())
    begin(machine.I2C())
    simtime.advance(22_000)
    left = playback.save()
    at = simtime.now()
    sensor, again, more = playing(tmp_path, records())
    simtime.clear(at)
    again.load(left)
    simtime.advance(30_000)
    assert more == [] and pulses  # this sensor sleeps
    assert again.elapsed == playback.elapsed
    assert sensor.compass
    assert sensor.compass.field[0] == -10 * (again.elapsed // 5000)


# The flash.


@pytest.fixture
def disk(tmp_path: Path) -> Path:
    flash.mount(f"{tmp_path}/", {"capacity": 64 * 4096})
    return tmp_path


def test_files_as_on_a_board(disk: Path) -> None:
    flash.mkdir("log")
    with flash.open("log/a", "wb") as file:
        assert file.write(b"one") == 3
        assert file.tell() == 3
    with flash.open("/log/a", "ab") as file:
        file.write(b"two")
        file.seek(1)
        file.write(b"!")  # appended all the same
    with flash.open("log/a", "rb") as file:
        assert file.read() == b"onetwo!"
    with flash.open("log/a", "r+b") as file:
        file.seek(3)
        file.write(b"TWO")
        file.seek(0)
        assert file.read() == b"oneTWO!"
    with flash.open("t.json", "w") as file:
        json.dump({"a": 1}, file)
    with flash.open("t.json") as file:
        assert json.load(file) == {"a": 1}
    assert flash.listdir() == flash.listdir("/") == ["log", "t.json"]
    assert [entry[:2] for entry in flash.ilistdir("")] == [("log", 0x4000), ("t.json", 0x8000)]
    assert flash.stat("log")[0] == 0x4000
    assert flash.stat("log/a")[6] == 7
    flash.rename("log/a", "t.json")
    assert flash.listdir("log") == []
    flash.rmdir("log")
    flash.remove("t.json")
    assert flash.listdir() == []
    with pytest.raises(OSError) as error:
        flash.open("t.json")
    assert failure(error) == ENOENT


def test_the_simulators_own_files_are_not_on_the_flash(disk: Path) -> None:
    (disk / "feed.bin").write_bytes(b"x")
    (disk / "main.py").write_bytes(b"x")
    assert flash.listdir() == ["main.py"]
    with pytest.raises(OSError):
        flash.open("feed.bin", "rb")


def test_space_is_counted_in_blocks(disk: Path) -> None:
    size, _size, total, free, *_rest = flash.statvfs("/")
    assert (size, total) == (4096, 64)
    with flash.open("small", "wb") as file:
        file.write(bytes(512))
    assert flash.statvfs("")[3] == free
    with flash.open("large", "wb") as file:
        file.write(bytes(4097))
    assert flash.statvfs("")[3] == free - 2
    flash.rename("large", "small")
    flash.mount(f"{disk}/", {"capacity": 64 * 4096})
    assert flash.statvfs("")[3] == free - 2
    flash.remove("small")
    assert flash.statvfs("")[3] == free


def test_a_full_flash_keeps_what_it_has(disk: Path) -> None:
    with flash.open("log", "wb") as file:
        with pytest.raises(OSError) as error:
            while True:
                file.write(bytes(1000))
        size = file.tell()
    assert failure(error) == ENOSPC
    assert flash.statvfs("")[3] == 0
    assert size > 55 * 4096
    assert (disk / "log").stat().st_size == size
    flash.remove("log")
    assert flash.statvfs("")[3] > 55


def test_what_is_not_flushed_is_not_there(disk: Path) -> None:
    kept = flash.open("log", "wb")
    kept.write(b"one")
    kept.flush()
    kept.write(b"two")
    assert (disk / "log").read_bytes() == b"one"
    emptied = flash.open("log", "wb")
    emptied.write(b"new")
    assert (disk / "log").read_bytes() == b"one"
    emptied.close()
    assert (disk / "log").read_bytes() == b"new"


def cost(disk: Path, *sizes: int) -> int:
    """µs of simulated time that writes take, with a flush after each."""
    file = flash.open(f"f{simtime.now()}", "wb")
    before = simtime.now()
    for size in sizes:
        file.write(bytes(size))
        file.flush()
    return simtime.now() - before


def test_what_writing_costs(disk: Path) -> None:
    assert cost(disk, 100) == flash.PROGRAM_US
    # An erased block, 16 pages, and the directory's page.
    assert cost(disk, 4096) == flash.ERASE_US + 17 * flash.PROGRAM_US
    # To go on in the middle of a block costs a new one, the old one's pages copied.
    more = cost(disk, 1024, 1024) - cost(disk, 1024)
    assert more == flash.ERASE_US + (4 + 4 + 1) * flash.PROGRAM_US
    # Directories are compacted now and then.
    assert cost(disk, *[1] * 32) == 2 * flash.ERASE_US + 32 * flash.PROGRAM_US


def test_interrupts_wait_while_the_flash_is_written(disk: Path) -> None:
    calls = []
    machine.Pin(machine.READY_PIN).irq(lambda pin: calls.append(simtime.now()))
    file = flash.open("log", "wb")
    began = simtime.now()
    for i in range(9):
        simtime.at(began + 1 + 5000 * i, lambda: machine.rise(machine.READY_PIN))
    file.write(bytes(1000))
    assert calls == [began + flash.ERASE_US]


@pytest.mark.parametrize("torn", [False, True])
def test_power_cut_at_every_operation(tmp_path: Path, torn: bool) -> None:
    """What was flushed is there, whatever came after; torn, with a part of what did."""
    whole = bytes(range(256)) * 5
    cuts = 0
    while True:
        folder = tmp_path / str(cuts)
        folder.mkdir()
        simtime.clear()
        flash.mount(f"{folder}/", {"torn": torn})
        flash.cut(cuts + 1, 0, lambda: simtime.end(machine.POWER_CUT))
        flushed = 0
        try:
            file = flash.open("log", "wb")
            for at in range(0, len(whole), 320):
                file.write(whole[at : at + 320])
                file.flush()
                flushed = at + 320
            file.close()
        except SystemExit:
            left = (folder / "log").read_bytes() if flushed else b""
            assert left == whole[: len(left)]
            assert len(left) == flushed or (torn and len(left) >= flushed)
            cuts += 1
            continue
        break
    assert cuts == flash.operations > 10


def test_power_cut_at_a_byte(disk: Path) -> None:
    for torn in (False, True):
        simtime.clear()
        flash.mount(f"{disk}/", {"torn": torn})
        flash.cut(0, 1500, lambda: simtime.end(machine.POWER_CUT))
        with pytest.raises(SystemExit):
            file = flash.open("log", "wb")
            for _ in range(20):
                file.write(b"x" * 100)
        assert (disk / "log").stat().st_size == (1499 if torn else 0)


PATHS = ("a", "b", "log/a")
steps = st.tuples(
    st.sampled_from(["write", "append", "patch", "flush", "close", "remove", "rename"]),
    st.sampled_from(PATHS),
    st.binary(max_size=900),
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plan=st.lists(steps, max_size=25), cut=st.integers(1, 120), torn=st.booleans())
def test_whatever_is_done_a_cut_leaves_what_was_flushed(
    tmp_path: Path, plan: list[tuple[str, str, bytes]], cut: int, torn: bool
) -> None:
    """Against a model that knows two contents of a file: on the flash, and as written so far."""
    folder = tmp_path / f"{simtime.now()}-{len(list(tmp_path.iterdir()))}"
    (folder / "log").mkdir(parents=True)
    simtime.clear()
    flash.mount(f"{folder}/", {"torn": torn})
    flash.cut(cut, 0, lambda: simtime.end(machine.POWER_CUT))
    durable: dict[str, bytes] = {}
    now: dict[str, bytes] = {}
    handles: dict[str, Any] = {}

    def settle(path: str) -> None:
        if path in handles:
            handles[path].flush()
            durable[path] = now[path]

    doing = ("", "", b"")
    try:
        for doing in plan:
            action, path, data = doing
            if action in ("write", "append", "patch"):
                mode = {"write": "wb", "append": "ab", "patch": "r+b"}[action]
                if path in handles:
                    settle(path)
                    handles.pop(path).close()
                if action == "patch" and path not in durable:
                    continue
                handles[path] = flash.open(path, mode)
                durable.setdefault(path, b"")
                before = b"" if action == "write" else durable[path]
                now[path] = data + before[len(data) :] if action == "patch" else before + data
                handles[path].write(data)
            elif action in ("flush", "close"):
                settle(path)
                if action == "close" and path in handles:
                    handles.pop(path).close()
            elif path in durable and path not in handles and "a" not in handles:
                if action == "remove":
                    flash.remove(path)
                    del durable[path]
                elif path != "a":
                    flash.rename(path, "a")
                    durable["a"] = durable.pop(path)
    except SystemExit:
        pass
    else:
        doing = ("", "", b"")
    found = {path: (folder / path).read_bytes() for path in PATHS if (folder / path).is_file()}
    for path in durable:
        # A file that was just being made may be missing; torn, more may be there than was flushed.
        if path == doing[1] and path not in found:
            assert durable[path] == b""
        elif not torn or path not in handles:
            assert found[path] == durable[path]
    assert set(found) <= set(durable) | {doing[1]}


# Whole lives of a board.

posix = pytest.mark.skipif(os.name != "posix", reason="no pseudo-terminals here")


class Programmed(SimulatedBoard):
    """A board that runs a program of ours in place of the firmware."""

    def __init__(self, program: str, **options: Any) -> None:
        super().__init__(records(2000), **options)
        self._program = program

    def _fill(self, folder: Path) -> None:
        super()._fill(folder)
        (folder / "main.py").write_text(PRELUDE + self._program)


PRELUDE = """
import machine, os, time
from solenav.sim.board import simtime, simulated
bus = simulated.open_bus()
uart = machine.UART(simulated.baud)

def say(*values):
    line = " ".join(map(str, values)) + "\\n"
    uart.write(line.encode(), 0, len(line))

def start():
    for register, value in ((0x6B, 0), (0x1B, 0x18), (0x1C, 0x18), (0x38, 1)):
        bus.writeto_mem(0x68, register, bytes([value]))

def lives():
    try:
        with open("lives") as file:
            n = int(file.read()) + 1
    except OSError:
        n = 1
    with open("lives", "w") as file:
        file.write(str(n))
    return n

life = lives()
"""


def said(program: str, **options: Any) -> tuple[list[str], Programmed]:
    """What a program sends, line by line, through all of its lives."""
    data = b""
    with Programmed(program, **options) as made:
        with serial.Serial(made.port, 460800, timeout=0.5) as port:
            deadline = time.monotonic() + 20
            while time.monotonic() < deadline:
                try:
                    data += port.read(max(1, min(port.in_waiting, 4096)))
                except (serial.SerialException, OSError):
                    break
        made.wait(5)
        assert made.stderr == ""
        made.check()
    return data.decode().split("\n")[:-1], made


@posix
def test_a_reset_starts_the_program_again_and_time_goes_on() -> None:
    lines, made = said(
        """
say(life, machine.reset_cause(), simtime.now() // 100000, time.ticks_ms())
if life == 1:
    start()
    time.sleep_ms(500)
    say(bus.readfrom_mem(0x68, 0x38, 1)[0])
    uart.flush()
    try:
        machine.reset()
    finally:
        say("never")
say(bus.readfrom_mem(0x68, 0x38, 1)[0])
"""
    )
    # As on the rp2 the cause is the watchdog. The sensor keeps its registers.
    assert lines == ["1 1 0 0", "1", "2 3 15 0", "1"]
    assert made.restarts == ["reset"]


@posix
def test_a_hanging_program_is_bitten() -> None:
    lines, made = said(
        """
say(life, machine.reset_cause(), simtime.now() // 1000000)
uart.flush()
if life < 3:
    dog = machine.WDT(timeout=2000)
    while True:
        time.sleep_ms(1)
"""
    )
    assert lines == ["1 1 0", "2 3 3", "3 3 6"]
    assert made.restarts == ["watchdog", "watchdog"]


@posix
def test_a_power_cut_takes_the_sensor_with_it() -> None:
    lines, made = said(
        """
say(life, machine.reset_cause(), simtime.now() // 100000)
if life == 1:
    with open("kept", "w") as file:
        file.write("kept")
    lost = open("lost", "w")
    lost.write("lost")
    start()
    while True:
        machine.idle()
say(open("kept").read(), repr(open("lost").read()), bus.readfrom_mem(0x68, 0x38, 1)[0])
start()
n = 0
while True:
    n += 1
    machine.idle()
    if n == 100:
        say(bus.readfrom_mem(0x68, 0x41, 2)[1])
""",
        faults=[{"kind": "power_cut", "at": 2_000_000, "for": 500_000}],
    )
    assert lines[:2] == ["1 1 0", "2 1 35"]
    assert lines[2] == "kept '' 0"
    # The recording went on: 3.5 s after its start, and 100 samples.
    assert int(lines[3]) == (700 + 100) & 255
    assert made.restarts == ["power"]


@posix
def test_the_power_goes_again_while_the_board_boots() -> None:
    lines, made = said(
        """
say(life, simtime.now() // 100000)
start()
while True:
    machine.idle()
""",
        faults=[
            {"kind": "power_cut", "at": 2_000_000, "for": 500_000},
            {"kind": "power_cut", "at": 3_000_000, "for": 200_000},
        ],
    )
    assert lines == ["1 0", "2 42"]
    assert made.restarts == ["power", "power"]


@posix
def test_a_cut_inside_a_read_leaves_the_slave_holding_sda() -> None:
    lines, _made = said(
        """
if life == 1:
    dog = machine.WDT(timeout=100)
    while True:
        bus.readfrom_mem(0x68, 0x3B, 200)
sda = machine.Pin(4, machine.Pin.OPEN_DRAIN, value=1)
say(sda.value())
"""
    )
    assert lines == ["0"]


@posix
def test_a_sensor_that_was_switched_off_is_on_after_a_reset() -> None:
    lines, _made = said(
        """
if life == 1:
    machine.Pin(7, machine.Pin.OUT, value=0)
    say(bus.scan())
    uart.flush()
    machine.reset()
say(bus.scan())
"""
    )
    assert lines == ["[]", "[104]"]


@posix
def test_what_the_uart_still_holds_is_lost_in_a_reset() -> None:
    lines, _made = said("say('x' * 100)\ntime.sleep_us(1000)\nif life == 1: machine.reset()\n")
    # At 460800 baud 46 bytes leave in 1 ms.
    assert lines == ["x" * 46 + "x" * 100]


@posix
def test_a_board_switched_off_between_two_lives_has_not_crashed() -> None:
    with Programmed("machine.reset()\n") as made:
        with serial.Serial(made.port, 460800, timeout=0.5):
            deadline = time.monotonic() + 20
            while not made.restarts and time.monotonic() < deadline:
                time.sleep(0.01)
            made.close()
        made.check()
        assert made.restarts


@posix
def test_rejected_writes_are_told_at_the_end() -> None:
    _lines, made = said("bus.writeto_mem(0x68, 0x75, b'\\1')\nsay('done')")
    ((at, *entry),) = made.rejected
    assert at > 0
    assert entry == [0x68, 0x75, 1, "no register that can be written"]
    assert made.report["flash"][0] > 0  # operations


@posix
def test_a_program_that_resets_for_ever_ends_with_the_recording() -> None:
    lines, made = said("start()\nsay(life)\nuart.flush()\nmachine.reset()\n")
    assert len(lines) == len(made.restarts) == 10  # 10 s of recording, a second each


SCRIPT: list[dict[str, Any]] = [
    {"kind": "clock", "at": 100_000, "for": 1_000_000, "factor": 1.04},
    {"kind": "register", "at": 200_000, "register": 0x19, "value": 9},
    {"kind": "temperature", "at": 0, "for": 5_000_000, "degrees": -15},
    {"kind": "magnet", "at": 300_000, "for": 400_000, "field": [5, 6, 7]},
    {"kind": "power_cut", "operation": 30},
]


@posix
@pytest.mark.parametrize("kind", faults.KINDS)
def test_every_fault_on_micropython(kind: str) -> None:
    """A program that only looks sees the recording to its end, the same each time."""
    script = [fault for fault in SCRIPT if fault["kind"] == kind] or [
        {"kind": kind, "at": 500_000, "for": 700_000}
    ]
    program = """
start()
mode = "wb" if life == 1 else "ab"
log = open("log", mode)
dog = machine.WDT(timeout=8000)
n = 0
while True:
    dog.feed()
    try:
        say(bus.readfrom_mem(0x68, 0x3A, 15))
    except OSError as error:
        say(error.args[0])
    n += 1
    if n % 20 == 0:
        try:
            log.write(bytes(100))
            log.flush()
        except OSError as error:
            say(error.args[0])
    if uart.any():
        uart.readinto(bytearray(8), 8)
    machine.idle()
"""
    lines, made = said(program, faults=script)
    assert made.restarts == (["power"] if kind == "power_cut" else [])
    if kind in ("power_cut", "bus_noise", "uart_noise"):
        assert said(program, faults=script)[0] == lines


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ({"kind": "gremlins", "at": 0}, "no kind 'gremlins'"),
        ({"kind": "gone"}, "gone needs one of at, after"),
        ({"kind": "gone", "at": 0, "after": 0}, "gone needs one of at, after"),
        ({"kind": "clock", "at": 0}, "clock needs factor"),
    ],
)
def test_scripts_that_cannot_be(fault: dict[str, Any], text: str) -> None:
    with pytest.raises(SolenavError, match=text):
        SimulatedBoard(records(), faults=[fault])


def test_a_flash_that_cannot_be() -> None:
    with pytest.raises(SolenavError, match="no setting 'size'"):
        SimulatedBoard(records(), flash={"size": 1})
