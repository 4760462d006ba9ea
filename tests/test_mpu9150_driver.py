"""The sensor's driver on the register-level model: what it sets up, reads and finds out."""

from __future__ import annotations

import struct
from array import array
from typing import Any

import imu_bench
import pytest
from imu_bench import Bench, still

from solenav.sim.board import simtime
from solenav.sim.board.ak8975_registers import SENSITIVITY
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav_core import messages

SENSORS = messages.SENSORS


@pytest.fixture
def bench() -> Any:
    """A bench on which nothing was done that the hardware would ignore."""
    with imu_bench.on() as made:
        yield made
        assert made.model.rejected == []


def registers(bench: Bench, first: int, count: int = 1) -> list[int]:
    return list(bench.model.registers[first : first + count])


def test_every_value_of_a_word_is_decoded(bench: Bench) -> None:
    driver = bench.modules["mpu9150"]
    device = bench.sensor()
    sample = array("i", [0] * 6)
    last = device._last
    for word in range(65536):
        others = ((word * 7919 + i * 9973) & 0xFFFF for i in range(6))
        raw = struct.pack(">7H", word, *others)
        values = struct.unpack(">7h", raw)
        flags = driver.decode(raw, last, sample)
        assert tuple(sample) == values[:3] + values[4:]
        assert last == raw
        assert device.temperature() == values[3]
        clipped = [v in (-32768, 32767) for v in values]
        assert flags == messages.CLIPPED_ACC * any(clipped[:3]) + messages.CLIPPED_GYRO * any(
            clipped[4:]
        )
        assert driver.decode(raw, last, sample) == flags | driver.ALIKE


def test_every_value_of_a_field_is_decoded(bench: Bench) -> None:
    """Little-endian, within 13 bits, adjusted, and turned into the accelerometer's axes."""
    compass = bench.modules["ak8975"]
    adjust = bytes([0, 255, 128])
    for word in range(65536):
        sample = array("i", [-9] * 10)
        other = word * 7919 & 0x0FFF
        field = struct.unpack("<3h", struct.pack("<3H", word, other, 4095 - other))
        raw = bytes(14) + struct.pack("<B3hB", 1, *field, 0)
        flags = compass.decode(raw, bytearray(8), adjust, sample, 0)
        if not -4096 <= field[0] <= 4095:
            assert flags == messages.MAG_BAD
            assert sample.tolist() == [-9] * 10
            continue
        assert flags == messages.MAG_NEW
        x, y, z = (h * (asa + 128) / 256 for h, asa in zip(field, adjust, strict=True))
        assert sample[6] == pytest.approx(y, abs=0.5)
        assert sample[7] == pytest.approx(x, abs=0.5)
        assert sample[8] == pytest.approx(-z, abs=0.5)
        assert sample.tolist()[:6] + sample.tolist()[9:] == [-9] * 7


@pytest.mark.parametrize(
    ("st1", "st2", "flags"),
    [
        (1, 0, messages.MAG_NEW),
        (0, 0, 0),
        (0, 4, 0),
        (1, 4, messages.MAG_BAD),
        (1, 8, messages.MAG_BAD),
    ],
)
def test_what_the_status_of_a_reading_means(bench: Bench, st1: int, st2: int, flags: int) -> None:
    raw = bytes(14) + struct.pack("<B3hB", st1, 1, 2, 3, st2)
    sample = array("i", [77] * 10)
    decode = bench.modules["ak8975"].decode
    last = bytearray(8)
    neutral = bytes([128] * 3)
    assert decode(raw, last, neutral, sample, 0) == flags
    sound = flags == messages.MAG_NEW
    assert sample.tolist()[6:9] == ([2, 1, -3] if sound else [77] * 3)
    assert decode(raw, last, neutral, sample, 0) == 0  # the same once more
    assert decode(raw, last, neutral, sample, 1) == flags  # another one, but equal


def test_waking_takes_the_times_of_the_data_sheet(bench: Bench) -> None:
    device = bench.sensor()
    device.wake()
    assert device.kind == SENSORS.index("MPU-9150")
    assert not bench.model.sampling
    power = [(t, v) for t, address, r, v in bench.writes if (address, r) == (0x68, 0x6B)]
    assert [v for _t, v in power] == [0x80, 0x00, 0x01]
    assert power[1][0] - power[0][0] >= 100_000
    assert power[2][0] - power[1][0] >= 60_000
    assert registers(bench, 0x37) == [0]
    device.sample(200_000)
    device.sleep()
    assert not bench.model.sampling
    assert bench.model.registers[0x6B] & 0x40


@pytest.mark.parametrize("fifo", [False, True])
@pytest.mark.parametrize("dlpf", [1, 6])
def test_the_sensor_is_set_up(bench: Bench, fifo: bool, dlpf: int) -> None:
    device = bench.sensor()
    device.wake()
    assert device.sample(200_000, dlpf=dlpf, fifo=fifo) == 200_000
    assert registers(bench, 0x19, 4) == [4, dlpf, 0x18, 0x18]
    assert bench.model.period_us == 5000
    assert bench.model.sampling
    assert registers(bench, 0x6B) == [1]  # awake, on the gyro's PLL
    assert registers(bench, 0x37, 2) == [0, 1]  # pulses, bypass closed
    assert registers(bench, 0x23) == [0xF9 if fifo else 0]
    assert registers(bench, 0x6A) == [0x60 if fifo else 0x20]


@pytest.mark.parametrize(
    ("wanted", "divider", "rate"),
    [(200_000, 4, 200_000), (1_000_000, 0, 1_000_000), (112_500, 8, 111_111), (1000, 255, 3906)],
)
def test_the_nearest_rate(bench: Bench, wanted: int, divider: int, rate: int) -> None:
    device = bench.sensor()
    device.wake()
    assert device.sample(wanted) == rate
    assert registers(bench, 0x19) == [divider]
    # The AK8975 measures for 9 ms; never started again before, with a clock 5 % fast neither.
    pause = (registers(bench, 0x34)[0] + 1) * bench.model.period_us
    assert pause * 0.95 >= 9000
    assert pause < 9500 + bench.model.period_us


def test_an_mpu6050_runs_without_a_heading() -> None:
    with imu_bench.on(Mpu9150(compass=False)) as bench:
        sampler = bench.sampler()
        bench.run(sampler, 20)
        assert sampler._sensor.kind == SENSORS.index("MPU-6050")
        assert all(t.words[6:9] == [0, 0, 0] for t in bench.taken)
        assert not any(t.flags for t in bench.taken)
        assert bench.model.rejected == []


def test_what_is_no_mpu9150(bench: Bench) -> None:
    device = bench.sensor()
    bench.model.identity = 0x70
    with pytest.raises(bench.SensorError, match=r"WHO_AM_I 0x70 at 0x68 is an MPU-6500"):
        device.wake()
    assert device.kind == 0
    assert not bench.writes
    bench.model.identity = 0x55
    with pytest.raises(bench.SensorError, match="an unknown chip"):
        device.wake()
    bench.model.cut()
    with pytest.raises(bench.SensorError, match=r"no answer from 0x68.*check"):
        device.wake()


def test_a_bit_lost_in_the_identity_is_no_other_chip(bench: Bench) -> None:
    bench.flips[(0x75, 0)] = 0x08
    device = bench.sensor()
    device.wake()
    assert device.kind == SENSORS.index("MPU-9150")


def test_settings_are_read_back(bench: Bench) -> None:
    device = bench.sensor()
    device.wake()
    bench.flips[(0x1B, 0)] = 0x10
    device.sample(200_000)
    assert registers(bench, 0x1B) == [0x18]
    written = [v for _t, _a, r, v in bench.writes if r == 0x1B]
    assert written == [0x18, 0x18]


def test_settings_that_do_not_stick_are_an_error() -> None:
    with imu_bench.on() as bench:
        device = bench.sensor()
        device.wake()
        bench.model.registers[0x6B] |= 0x40  # it went to sleep again
        bench.model._configured()
        with pytest.raises(bench.SensorError, match="doesn't keep"):
            device.sample(200_000)


@pytest.mark.parametrize("fifo", [False, True])
@pytest.mark.parametrize(
    "register", [0x19, 0x1A, 0x1B, 0x1C, 0x23, 0x24, 0x27, 0x2A, 0x34, 0x37, 0x38, 0x64, 0x67, 0x6A]
)
def test_a_register_that_changed_by_itself_is_noticed(
    bench: Bench, fifo: bool, register: int
) -> None:
    device = bench.sensor()
    device.wake()
    device.sample(200_000, fifo=fifo)
    assert device.check()
    bench.flips[(0x19, 2)] = 0x08  # a bit lost on the way is none
    assert device.check()
    bench.model.registers[register] ^= 0x10
    assert not device.check()


def test_the_self_test_passes(bench: Bench) -> None:
    device = bench.sensor()
    assert device.test == messages.NOT_TESTED
    device.wake(test=True)
    assert device.test == 0
    device.wake()
    assert device.test == 0  # nothing new is known


@pytest.mark.parametrize(("axes", "result"), [({0}, 1), ({2}, 1), ({4}, 2), ({1, 5}, 3)])
def test_the_self_test_finds_a_dead_axis(bench: Bench, axes: set[int], result: int) -> None:
    bench.model.failing = axes
    device = bench.sensor()
    device.wake(test=True)
    assert device.test == result


def test_the_self_test_finds_a_dead_magnetometer(bench: Bench) -> None:
    assert bench.model.compass is not None
    bench.model.compass.failing = True
    device = bench.sensor()
    device.wake(test=True)
    assert device.test == 4


def test_a_moving_foot_fails_no_self_test(bench: Bench) -> None:

    def swing(_number: int) -> tuple[int, ...]:
        phase = simtime.now() // 1000 % 40
        return (phase * 30, 0, 2048, 7, phase * 400, 0, 0)

    bench.values = swing
    device = bench.sensor()
    device.wake(test=True)
    assert device.test == messages.NOT_TESTED
    ends = simtime.now() + 300_000
    bench.values = lambda i: swing(i) if simtime.now() < ends else still(i)
    device.wake(test=True)
    assert device.test == 0


def test_trims_of_the_factory(bench: Bench) -> None:
    trims = bench.modules["mpu9150"].trims
    assert trims(bytes(4)) == [0] * 6
    most = trims(bytes([0xFF, 0xFF, 0xFF, 0x3F]))
    assert most[:3] == pytest.approx([4096 * 0.92] * 3, abs=0.6)
    assert most[3] == pytest.approx(3275 * 1.046**30, abs=0.6)
    assert most[4] == -most[3]
    # Bits of each axis: 4:2 in a register of its own, 1:0 shared.
    for axis in range(3):
        codes = bytearray(4)
        codes[axis] = 0b101_00001
        codes[3] = 0b10 << (4 - 2 * axis)
        found = trims(codes)
        assert [bool(t) for t in found] == [i % 3 == axis for i in range(6)]
        assert found[axis] == pytest.approx(4096 * 0.34 * (0.92 / 0.34) ** (21 / 30), abs=0.6)
        assert abs(found[3 + axis]) == pytest.approx(3275)


def test_lines_are_freed_by_nine_clocks_and_a_stop(bench: Bench) -> None:
    recover = bench.modules["bus"].recover
    for clocks in range(10):
        bench.stuck = clocks
        bench.pins.clear()
        assert recover(imu_bench.SCL, imu_bench.SDA)
        rises = [level for number, level in bench.pins if number == imu_bench.SCL]
        assert rises == [1] + [0, 1] * 10
        assert bench.pins[-4:] == [
            (imu_bench.SCL, 0),
            (imu_bench.SDA, 0),
            (imu_bench.SCL, 1),
            (imu_bench.SDA, 1),
        ]
    bench.stuck = 100
    assert not recover(imu_bench.SCL, imu_bench.SDA)


def test_the_field_in_the_accelerometers_axes(bench: Bench) -> None:
    """What the model was given comes out, within the rounding of the AK8975's counts."""
    field = (321, -456, 123)
    bench.values = lambda i: (*still(i)[:7], *field)
    for fifo in (True, False):
        bench.taken.clear()
        bench.run(bench.sampler(fifo=fifo), 40)
        new = [t for t in bench.taken if t.flags & messages.MAG_NEW]
        assert len(new) >= 18
        for t in new[1:]:
            assert t.words[6:9] == pytest.approx(field, abs=2)
        bench.sensor().sleep()
    assert set(SENSITIVITY) != {128}
