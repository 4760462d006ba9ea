"""The register model of the sensor, and the firmware's driver and sampler on it, on CPython."""

from __future__ import annotations

import importlib
import struct
import sys
from array import array
from collections.abc import Iterator
from itertools import pairwise
from types import ModuleType
from typing import Any

import pytest

from solenav.sim.board import machine, simtime
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav_core import messages
from solenav_tools.staging import firmware_path

READY_PIN = 6
STILL = (0, 0, 2048, 100, 1, 2, 3)


@pytest.fixture
def firmware(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, ModuleType]]:
    """The firmware's modules, imported as on a board."""
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(firmware_path()))
        patch.setitem(sys.modules, "time", simtime)
        patch.setitem(sys.modules, "machine", machine)
        modules = {name: importlib.import_module(name) for name in ("mpu9150", "sampler")}
    yield modules
    for name in modules:
        del sys.modules[name]


@pytest.fixture
def model() -> Iterator[Mpu9150]:
    """A sensor on the simulated bus."""
    sensor = Mpu9150()
    machine.wire(sensor, None)
    yield sensor
    machine.wire(None, None)


class Bus(machine.I2C):
    """Notes what is written, and when; fails where it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.writes: list[tuple[int, int, int]] = []
        self.failures = 0

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        self.writes.append((simtime.now(), register, data[0]))
        super().writeto_mem(address, register, data)

    def readfrom_mem_into(self, address: int, register: int, buffer: bytearray) -> None:
        if self.failures:
            self.failures -= 1
            raise OSError(5)
        super().readfrom_mem_into(address, register, buffer)


def pulse(model: Mpu9150, values: tuple[int, ...] = STILL, after_us: int = 5000) -> None:
    simtime.advance(after_us)
    if model.sample(values):
        machine.rise(READY_PIN)


def write(model: Mpu9150, register: int, *values: int) -> None:
    assert model.connect(0x68, False)
    for byte in (register, *values):
        model.write_byte(byte)
    model.stop()


def read(model: Mpu9150, register: int, count: int = 1, address: int = 0x68) -> list[int]:
    assert model.connect(address, False)
    model.write_byte(register)
    assert model.connect(address, True)
    values = [model.read_byte() for _ in range(count)]
    model.stop()
    return values


def awake() -> Mpu9150:
    """A sensor out of sleep, its start-up over."""
    sensor = Mpu9150()
    write(sensor, 0x6B, 0)
    simtime.advance(100_000)
    return sensor


def test_registers_after_power_up() -> None:
    sensor = Mpu9150()
    registers = read(sensor, 0, 0x74) + [0] + read(sensor, 0x75, 11)
    found = {i: v for i, v in enumerate(registers) if v and not 0x0D <= i <= 0x10}
    assert found == {0x6B: 0x40, 0x75: 0x68}
    assert not sensor.sampling


def test_only_its_own_address_is_acknowledged() -> None:
    sensor = Mpu9150(address=0x69)
    assert sensor.connect(0x69, False)
    assert not any(sensor.connect(a, False) for a in range(128) if a != 0x69)


def test_the_compass_is_seen_through_the_bypass_only() -> None:
    sensor = Mpu9150()
    assert not sensor.connect(0x0C, False)
    write(sensor, 0x37, 0x02)
    assert read(sensor, 0, 1, 0x0C) == [0x48]
    write(sensor, 0x6A, 0x20)  # the auxiliary master owns that bus
    assert not sensor.connect(0x0C, False)
    plain = Mpu9150(compass=False)
    write(plain, 0x37, 0x02)
    assert not plain.connect(0x0C, False)


def test_a_burst_runs_over_the_registers() -> None:
    sensor = awake()
    write(sensor, 0x19, 4, 1, 0x18, 0x18)
    assert read(sensor, 0x19, 4) == [4, 1, 0x18, 0x18]
    sensor.sample((1, -1, 2048, -521, 32767, -32768, 0))
    raw = bytes(read(sensor, 0x3B, 14))
    assert struct.unpack(">7h", raw) == (1, -1, 2048, -521, 32767, -32768, 0)


def test_read_only_registers_stay() -> None:
    sensor = Mpu9150()
    for register in (0x3A, 0x3B, 0x48, 0x75):
        before = read(sensor, register)
        write(sensor, register, 0x5A)
        assert read(sensor, register) == before
    write(sensor, 0x6A, 0x47)
    assert read(sensor, 0x6A) == [0x40]


def test_reset_puts_it_back_to_sleep() -> None:
    sensor = Mpu9150()
    write(sensor, 0x6B, 1)
    write(sensor, 0x38, 1)
    assert sensor.sampling
    write(sensor, 0x6B, 0x80)
    assert not sensor.sampling
    assert read(sensor, 0x6B) == [0xC0]
    write(sensor, 0x38, 1)  # too early
    simtime.advance(100_000)
    assert read(sensor, 0x38) == [0]
    assert read(sensor, 0x6B) == [0x40]


def test_asleep_it_measures_nothing() -> None:
    sensor = Mpu9150()
    write(sensor, 0x38, 1)
    assert not sensor.sample(STILL)
    assert read(sensor, 0x3B, 14) == [0] * 14


def test_full_scale_decides_what_a_count_is() -> None:
    sensor = awake()
    sensor.sample((100, -100, 5000, 7, 100, -5000, 0))
    raw = bytes(read(sensor, 0x3B, 14))
    assert struct.unpack(">7h", raw) == (800, -800, 32767, 7, 800, -32768, 0)


@pytest.mark.parametrize(
    ("pin_config", "edges"), [(0x00, [True, True]), (0x20, [True, False]), (0x30, [True, False])]
)
def test_the_interrupt_line(pin_config: int, edges: list[bool]) -> None:
    sensor = Mpu9150()
    write(sensor, 0x6B, 0)
    write(sensor, 0x37, pin_config)
    write(sensor, 0x38, 1)
    assert [sensor.sample(STILL), sensor.sample(STILL)] == edges
    read(sensor, 0x3B)
    assert sensor.sample(STILL) is (pin_config != 0x20)
    assert read(sensor, 0x3A) == [1]
    assert read(sensor, 0x3A) == [0]
    assert not sensor.line


def test_period() -> None:
    sensor = awake()
    write(sensor, 0x19, 4, 1)
    assert sensor.period_us == 5000
    write(sensor, 0x1A, 0)
    assert sensor.period_us == 625


def test_every_value_of_a_word_is_decoded(firmware: dict[str, Any]) -> None:
    driver = firmware["mpu9150"]
    device = driver.Mpu9150(None)
    sample = array("i", [0] * 6)
    for word in range(65536):
        others = ((word * 7919 + i * 9973) & 0xFFFF for i in range(6))
        raw = struct.pack(">7H", word, *others)
        values = struct.unpack(">7h", raw)
        device.raw[:] = raw
        flags = driver.decode(raw, sample)
        assert tuple(sample) == values[:3] + values[4:]
        assert device.temperature() == values[3]
        clipped = [v in (-32768, 32767) for v in values]
        assert flags == messages.CLIPPED_ACC * any(clipped[:3]) + messages.CLIPPED_GYRO * any(
            clipped[4:]
        )


def test_the_driver_sets_the_sensor_up(firmware: dict[str, Any], model: Mpu9150) -> None:
    bus = Bus()
    device = firmware["mpu9150"].Mpu9150(bus)
    device.wake()
    assert device.kind == messages.SENSORS.index("MPU-9150")
    assert not model.sampling
    assert device.sample(200_000) == 200_000
    assert read(model, 0x19, 4) == [4, 1, 0x18, 0x18]
    assert model.period_us == 5000
    assert model.sampling
    assert model.registers[0x6B] == 1  # awake, on the gyro's PLL
    assert model.registers[0x37] == 0  # pulses, bypass closed
    power = [(t, value) for t, register, value in bus.writes if register == 0x6B]
    assert [value for _t, value in power] == [0x80, 0x00, 0x01]
    assert power[1][0] - power[0][0] >= 100_000
    assert power[2][0] - power[1][0] >= 60_000
    device.sleep()
    assert not model.sampling
    assert model.registers[0x6B] & 0x40


@pytest.mark.parametrize(
    ("wanted", "divider", "rate"),
    [(200_000, 4, 200_000), (1_000_000, 0, 1_000_000), (112_500, 8, 111_111), (1000, 255, 3906)],
)
def test_the_nearest_rate(
    firmware: dict[str, Any], model: Mpu9150, wanted: int, divider: int, rate: int
) -> None:
    device = firmware["mpu9150"].Mpu9150(Bus())
    device.wake()
    assert device.sample(wanted) == rate
    assert read(model, 0x19) == [divider]


def test_what_is_no_mpu9150(firmware: dict[str, Any], model: Mpu9150) -> None:
    driver = firmware["mpu9150"]
    bus = Bus()
    machine.wire(Mpu9150(compass=False), None)
    device = driver.Mpu9150(bus)
    device.wake()
    assert device.kind == messages.SENSORS.index("MPU-6050")

    machine.wire(model, None)
    model.identity = 0x70
    bus.writes.clear()
    with pytest.raises(driver.SensorError, match=r"WHO_AM_I 0x70 at 0x68"):
        device.wake()
    assert device.kind == 0
    assert not bus.writes

    machine.wire(None, None)
    with pytest.raises(driver.SensorError, match=r"no answer from 0x68.*check"):
        device.wake()


@pytest.fixture
def sampler(firmware: dict[str, Any], model: Mpu9150) -> tuple[Any, Bus]:
    """A sampler that has just started, at 200 Hz, and its bus."""
    bus = Bus()
    device = firmware["mpu9150"].Mpu9150(bus)
    device.wake()
    made = firmware["sampler"].Sampler(device, machine.Pin(READY_PIN), 200_000)
    made.start()
    return made, bus


def test_a_sample_for_each_pulse(sampler: tuple[Any, Bus], model: Mpu9150) -> None:
    made, _bus = sampler
    times = []
    for i in range(5):
        assert not made.ready()
        pulse(model, (i, 0, 2048, 100, 1, -2, 3))
        assert made.ready()
        assert made.read()
        assert made.sample.tolist()[:6] == [i, 0, 2048, 1, -2, 3]
        assert made.flags == 0
        times.append(made.time)
    assert made.samples == 5
    assert all(abs(b - a - 5400) < 50 for a, b in pairwise(times))
    pulse(model, (32767, 0, 0, 0, 0, 0, -32768))
    assert made.read()
    assert made.flags == messages.CLIPPED_ACC | messages.CLIPPED_GYRO
    assert made.clipped == 1


def test_overruns_are_gaps(sampler: tuple[Any, Bus], model: Mpu9150) -> None:
    made, _bus = sampler
    for _ in range(3):
        pulse(model)
    assert made.read()
    assert (made.samples, made.overruns, made.gaps) == (1, 2, 1)
    assert made.flags == messages.GAP_BEFORE
    pulse(model)
    assert made.read()
    assert made.flags == 0


def test_failed_transfers(sampler: tuple[Any, Bus], model: Mpu9150) -> None:
    made, bus = sampler
    bus.failures = 1
    pulse(model)
    assert made.read()
    assert (made.bus_errors, made.gaps, made.flags) == (1, 0, 0)
    bus.failures = 2
    pulse(model)
    assert not made.read()
    pulse(model)
    assert made.read()
    assert (made.bus_errors, made.gaps, made.flags) == (3, 1, messages.GAP_BEFORE)
    bus.failures = 3
    pulse(model)
    assert not made.read()
    pulse(model)
    assert not made.read()  # the third in a row: set up anew
    assert (made.bus_errors, made.recoveries) == (6, 1)
    pulse(model)
    assert made.read()
    assert (made.gaps, made.flags) == (2, messages.GAP_BEFORE)


def test_a_sensor_that_stays_away(
    firmware: dict[str, Any], sampler: tuple[Any, Bus], model: Mpu9150
) -> None:
    made, _bus = sampler
    pulse(model)
    assert made.read()
    machine.wire(None, None)
    machine.rise(READY_PIN)
    assert not made.read()
    machine.rise(READY_PIN)
    with pytest.raises(firmware["mpu9150"].SensorError):
        made.read()
    assert (made.bus_errors, made.recoveries) == (3, 0)


def test_silence_is_a_fault(
    firmware: dict[str, Any], sampler: tuple[Any, Bus], model: Mpu9150
) -> None:
    made, _bus = sampler
    simtime.advance(49_000)
    assert not made.ready()
    simtime.advance(2000)
    with pytest.raises(firmware["mpu9150"].SensorError, match="INT wire"):
        made.ready()


def test_the_period_is_learned(sampler: tuple[Any, Bus], model: Mpu9150) -> None:
    made, _bus = sampler
    last = simtime.now()
    for i in range(600):
        # 5117.5 µs between samples, however long the reading takes.
        due = last + 5117 + i % 2
        pulse(model, after_us=due - simtime.now())
        last = due
        assert made.read()
        simtime.advance(17 * i % 300)
    assert made.period() == pytest.approx(5117.5 * 256, abs=1e-5 * 5117.5 * 256)


def test_time_goes_on_past_the_wrap_of_the_ticks(sampler: tuple[Any, Bus], model: Mpu9150) -> None:
    made, _bus = sampler
    start, told = simtime.now(), made.time
    for _ in range(12):
        simtime.advance(1 << 28)
        made.keep_time()
    pulse(model)
    assert made.read()
    assert made.time == pytest.approx((told + simtime.now() - start) % 2**32, abs=1000)
