"""The register model of the sensor and its compass, as their data sheets have them."""

from __future__ import annotations

import json
import struct

import pytest

from solenav.sim.board import simtime
from solenav.sim.board.ak8975_registers import SENSITIVITY
from solenav.sim.board.mpu9150_registers import Mpu9150

STILL = (0, 0, 2048, 100, 1, 2, 3)


@pytest.fixture(autouse=True)
def clock() -> None:
    """Nothing of the test before is still to come."""
    simtime.clear()


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


def words(raw: list[int] | bytearray) -> tuple[int, ...]:
    """Big-endian words, as the sensor sends them."""
    return struct.unpack(f">{len(raw) // 2}h", bytes(raw))


def awake() -> Mpu9150:
    """A sensor out of sleep, its start-up over."""
    sensor = Mpu9150()
    write(sensor, 0x6B, 0)
    simtime.advance(100_000)
    return sensor


def test_registers_after_power_up() -> None:
    sensor = Mpu9150()
    registers = [*read(sensor, 0, 0x74), 0, *read(sensor, 0x75, 11)]
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


def field(sensor: Mpu9150, values: tuple[int, int, int]) -> None:
    sensor.sample((*STILL, *values))


def reasons(sensor: Mpu9150) -> list[tuple[int, int, int, str]]:
    """What was rejected: address, register, value, why."""
    return [entry[1:] for entry in sensor.rejected]


@pytest.mark.parametrize("register", [0x00, 0x11, 0x35, 0x36, 0x3A, 0x3B, 0x60, 0x72, 0x75, 0x7F])
def test_writes_to_what_is_no_setting_are_rejected(register: int) -> None:
    sensor = awake()
    write(sensor, register, 0x5A)
    assert reasons(sensor) == [(0x68, register, 0x5A, "no register that can be written")]
    assert sensor.rejections == 1


def test_reserved_bits_are_not_kept() -> None:
    sensor = awake()
    write(sensor, 0x37, 0x01)
    write(sensor, 0x1B, 0x1F)
    assert (read(sensor, 0x37), read(sensor, 0x1B)) == ([0], [0x18])
    assert [entry[3] for entry in reasons(sensor)] == ["reserved bits set"] * 2


def test_measurement_settings_do_not_stick_in_sleep() -> None:
    sensor = Mpu9150()
    write(sensor, 0x19, 4, 1, 0x18, 0x18)
    assert read(sensor, 0x19, 4) == [0, 0, 0, 0]
    assert [entry[1] for entry in reasons(sensor)] == [0x19, 0x1A, 0x1B, 0x1C]
    write(sensor, 0x37, 0x02)  # pins and interrupts do
    assert read(sensor, 0x37) == [2]


def test_nothing_is_taken_within_100_ms_of_a_reset() -> None:
    sensor = awake()
    write(sensor, 0x19, 4)
    write(sensor, 0x6B, 0x80)
    simtime.advance(99_000)
    write(sensor, 0x6B, 0)
    assert (read(sensor, 0x6B), read(sensor, 0x19), read(sensor, 0x75)) == ([0xC0], [0], [0])
    simtime.advance(1000)
    assert (read(sensor, 0x6B), read(sensor, 0x19), read(sensor, 0x75)) == ([0x40], [0], [0x68])
    assert reasons(sensor) == [(0x68, 0x6B, 0, "within 100 ms of a device reset")]


def test_without_power_nothing_answers_and_all_is_forgotten() -> None:
    sensor = awake()
    write(sensor, 0x19, 7)
    sensor.cut()
    assert not sensor.connect(0x68, False)
    assert not sensor.sample(STILL)
    sensor.power_up()
    simtime.advance(99_000)
    assert not sensor.connect(0x68, False)
    simtime.advance(1000)
    assert (read(sensor, 0x6B), read(sensor, 0x19)) == ([0x40], [0])


@pytest.mark.parametrize(
    ("power", "standby", "runs"),
    [
        (0, 0, True),
        (0, 7, True),
        (1, 0, True),
        (1, 4, False),  # that axis's gyro is off
        (2, 4, True),
        (2, 2, False),
        (3, 0, True),
        (3, 1, False),
        (4, 0, False),  # an external clock, which isn't wired
        (7, 0, False),
        (0x20, 0, False),
        (0x40, 0, False),
    ],
)
def test_samples_need_a_clock(power: int, standby: int, runs: bool) -> None:
    sensor = awake()
    write(sensor, 0x38, 1)
    write(sensor, 0x6B, power, standby)
    assert sensor.running is runs
    assert sensor.sample(STILL) is runs


def test_an_axis_in_standby_stays_as_it_was() -> None:
    sensor = awake()
    write(sensor, 0x1B, 0x18, 0x18)
    sensor.sample((1, 2, 3, 4, 5, 6, 7))
    write(sensor, 0x6C, 0x20 | 0x01)
    write(sensor, 0x6B, 0x08)
    sensor.sample((11, 12, 13, 14, 15, 16, 17))
    assert words(read(sensor, 0x3B, 14)) == (1, 12, 13, 4, 15, 16, 7)


def test_gyro_and_accelerometer_settle_after_sleep() -> None:
    sensor = Mpu9150()
    write(sensor, 0x6B, 0)
    write(sensor, 0x1B, 0x18, 0x18)
    simtime.advance(10_000)
    sensor.sample((0, 0, 2048, 0, 0, 0, 0))
    ax, ay, az, _t, *gyro = words(read(sensor, 0x3B, 14))
    assert (ax, ay) == (0, 0)
    assert az < 1500
    assert all(rate > 100 for rate in gyro)
    simtime.advance(20_000)
    sensor.sample((0, 0, 2048, 0, 0, 0, 0))
    assert words(read(sensor, 0x3B, 6)) == (0, 0, 2048)
    simtime.advance(30_000)
    sensor.sample((0, 0, 2048, 0, 0, 0, 0))
    assert words(read(sensor, 0x3B, 14)) == (0, 0, 2048, 0, 0, 0, 0)


def test_signal_paths_are_cleared_one_by_one() -> None:
    sensor = awake()
    write(sensor, 0x1B, 0x18, 0x18)
    values = (1, 2, 3, 4, 5, 6, 7)
    for which, left in ((1, (1, 2, 3, 0, 5, 6, 7)), (2, (0, 0, 0, 4, 5, 6, 7))):
        sensor.sample(values)
        write(sensor, 0x68, which)
        assert words(read(sensor, 0x3B, 14)) == left
    sensor.sample(values)
    write(sensor, 0x6A, 0x01)
    assert words(read(sensor, 0x3B, 14)) == (0,) * 7
    assert read(sensor, 0x6A) == [0]


def test_a_pin_that_nothing_drives_or_that_idles_high() -> None:
    sensor = awake()
    write(sensor, 0x38, 1)
    write(sensor, 0x37, 0x40)  # open drain, and no pull-up on the board
    assert not sensor.sample(STILL)
    write(sensor, 0x37, 0xA0)  # active low, latched
    assert not sensor.sample(STILL)
    assert sensor.line == 0
    read(sensor, 0x3A)
    assert sensor.line == 1


def with_fifo(bits: int = 0x78) -> Mpu9150:
    sensor = awake()
    write(sensor, 0x1B, 0x18, 0x18)
    write(sensor, 0x23, bits)
    write(sensor, 0x6A, 0x40)
    return sensor


def fifo_count(sensor: Mpu9150) -> int:
    high, low = read(sensor, 0x72, 2)
    return high << 8 | low


@pytest.mark.parametrize(
    ("bits", "kept"),
    [
        (0x78, (1, 2, 3, 5, 6, 7)),
        (0xF8, (1, 2, 3, 4, 5, 6, 7)),
        (0x08, (1, 2, 3)),
        (0x28, (1, 2, 3, 6)),
    ],
)
def test_the_fifo_holds_what_is_enabled_in_the_order_of_registers(
    bits: int, kept: tuple[int, ...]
) -> None:
    sensor = with_fifo(bits)
    for i in range(3):
        sensor.sample((1, 2, 3, 4, 5, 6, 7 + i))
    size = 2 * len(kept)
    assert fifo_count(sensor) == 3 * size
    assert words(read(sensor, 0x74, size)) == kept
    assert fifo_count(sensor) == 2 * size
    assert sensor.waiting == 2 * size
    into = bytearray(2 * size)
    assert sensor.connect(0x68, False)
    sensor.write_byte(0x74)
    assert sensor.connect(0x68, True)
    sensor.read_into(into)
    assert words(into)[: len(kept) - 1] == kept[:-1]
    assert fifo_count(sensor) == 0


def test_the_count_is_that_of_when_its_high_byte_was_read() -> None:
    sensor = with_fifo()
    sensor.sample(STILL)
    assert fifo_count(sensor) == 12
    sensor.sample(STILL)
    assert read(sensor, 0x73) == [12]
    assert fifo_count(sensor) == 24


def test_an_empty_fifo_repeats_its_last_byte() -> None:
    sensor = with_fifo(0x08)
    sensor.sample((0, 0, 0x1234, 0, 0, 0, 0))
    assert read(sensor, 0x74, 8)[4:] == [0x12, 0x34, 0x34, 0x34]


def test_an_overflow_drops_the_oldest_bytes_and_says_so() -> None:
    sensor = with_fifo()
    write(sensor, 0x38, 0x10)
    edges = [sensor.sample((i, 0, 0, 0, 0, 0, 0)) for i in range(85)]
    assert (fifo_count(sensor), any(edges)) == (1020, False)
    assert read(sensor, 0x3A) == [1]
    assert sensor.sample((85, 0, 0, 0, 0, 0, 0))
    assert read(sensor, 0x3A) == [0x11]
    assert fifo_count(sensor) == 1024
    # 1024 is no multiple of 12: what is left begins in the middle of a packet.
    assert words(read(sensor, 0x74, 12)) == (0, 0, 1, 0, 0, 0)


def test_the_fifo_is_reset_only_while_it_is_off() -> None:
    sensor = with_fifo()
    sensor.sample(STILL)
    write(sensor, 0x6A, 0x44)
    assert fifo_count(sensor) == 12
    assert reasons(sensor)[0][3] == "FIFO reset while the FIFO is enabled"
    write(sensor, 0x6A, 0x04)
    write(sensor, 0x6A, 0x40)
    assert fifo_count(sensor) == 0
    assert read(sensor, 0x6A) == [0x40]


def test_a_disabled_fifo_keeps_its_state() -> None:
    sensor = with_fifo()
    sensor.sample(STILL)
    write(sensor, 0x6A, 0)
    sensor.sample(STILL)
    write(sensor, 0x6A, 0x40)
    assert fifo_count(sensor) == 12


def test_the_fifo_can_be_written() -> None:
    sensor = with_fifo(0)
    write(sensor, 0x74, 1, 2, 3)
    assert read(sensor, 0x74, 3) == [1, 2, 3]
    write(sensor, 0x6A, 0)
    write(sensor, 0x74, 9)
    assert reasons(sensor)[0][3] == "the FIFO is disabled"


def self_test_counts(sensor: Mpu9150, accel: int, gyro: int) -> tuple[int, ...]:
    write(sensor, 0x1B, gyro, accel)
    sensor.sample((3, -2, 250, 0, 5, -6, 7))
    values = words(read(sensor, 0x3B, 14))
    return values[:3] + values[4:]


def test_the_self_test_response_is_near_the_factory_trim() -> None:
    """Register map, registers 13 to 16: within 14 %."""
    sensor = awake()
    response = [
        on - off
        for on, off in zip(
            self_test_counts(sensor, 0xF0, 0xE0), self_test_counts(sensor, 0x10, 0), strict=True
        )
    ]
    x, y, z, mixed = read(sensor, 0x0D, 4)
    for i, byte in enumerate((x, y, z)):
        code = (byte >> 5) << 2 | (mixed >> (4 - 2 * i)) & 3
        trim = 4096 * 0.34 * (0.92 / 0.34) ** ((code - 1) / 30)
        assert abs(response[i] / trim - 1) < 0.14
        trim = (-1 if i == 1 else 1) * 25 * 131 * 1.046 ** ((byte & 31) - 1)
        assert abs(response[3 + i] / trim - 1) < 0.14


def test_an_axis_that_fails_its_self_test() -> None:
    sensor = awake()
    sensor.failing = {0, 4}
    plain = self_test_counts(sensor, 0x10, 0)
    tested = self_test_counts(sensor, 0xF0, 0xE0)
    assert [a == b for a, b in zip(plain, tested, strict=True)] == [
        True, False, False, False, True, False,
    ]  # fmt: skip


def test_sampling_is_what_the_host_hears_of() -> None:
    sensor = awake()
    assert not sensor.sampling
    write(sensor, 0x38, 1)
    assert sensor.sampling
    write(sensor, 0x1B, 0xE0)
    assert not sensor.sampling  # the self-test comes before the run
    other = with_fifo()
    assert other.sampling
    write(other, 0x6A, 0)
    assert not other.sampling


# The AK8975, through the bypass.


@pytest.fixture
def compass() -> Mpu9150:
    sensor = awake()
    write(sensor, 0x37, 0x02)
    return sensor


def set_mode(sensor: Mpu9150, mode: int) -> None:
    assert sensor.connect(0x0C, False)
    sensor.write_byte(0x0A)
    sensor.write_byte(mode)
    sensor.stop()


def set_self_test(sensor: Mpu9150, value: int) -> None:
    assert sensor.connect(0x0C, False)
    sensor.write_byte(0x0C)
    sensor.write_byte(value)


def adjusted(sensor: Mpu9150) -> tuple[int, ...]:
    """HX to HZ after the sensitivity adjustment."""
    raw = struct.unpack("<3h", bytes(read(sensor, 0x03, 6, 0x0C)))
    return tuple(h * (asa + 128) // 256 for h, asa in zip(raw, SENSITIVITY, strict=True))


def near(values: tuple[int, ...], expected: tuple[int, ...]) -> bool:
    return all(abs(a - b) <= 1 for a, b in zip(values, expected, strict=True))


def test_one_measurement_at_a_time(compass: Mpu9150) -> None:
    field(compass, (100, -50, 30))
    set_mode(compass, 1)
    assert read(compass, 0x0A, 1, 0x0C) == [1]
    simtime.advance(7200)
    assert read(compass, 0x02, 1, 0x0C) == [0]
    simtime.advance(100)
    assert read(compass, 0x02, 1, 0x0C) == [1]
    assert read(compass, 0x0A, 1, 0x0C) == [0]  # back in power-down by itself
    # Its x is the IMU's y, its y the IMU's x, its z the IMU's -z.
    assert near(adjusted(compass), (-50, 100, -30))
    assert read(compass, 0x02, 1, 0x0C) == [0]
    assert read(compass, 0x09, 1, 0x0C) == [0]
    assert not compass.rejected


def test_reading_st2_ends_data_ready(compass: Mpu9150) -> None:
    set_mode(compass, 1)
    simtime.advance(9000)
    assert read(compass, 0x09, 1, 0x0C) == [0]
    assert read(compass, 0x02, 1, 0x0C) == [0]


def test_a_measurement_takes_up_to_9_ms(compass: Mpu9150) -> None:
    taken = []
    for _ in range(8):
        set_mode(compass, 1)
        began = simtime.now()
        while read(compass, 0x02, 1, 0x0C) == [0]:
            simtime.advance(100)
        taken.append(simtime.now() - began)
        simtime.advance(100)
    assert (min(taken), max(taken)) == (7300, 9000)


def test_data_read_during_a_measurement_are_an_error(compass: Mpu9150) -> None:
    field(compass, (100, -50, 30))
    set_mode(compass, 1)
    simtime.advance(9000)
    sound = adjusted(compass)
    set_mode(compass, 1)
    assert adjusted(compass) != sound
    assert read(compass, 0x09, 1, 0x0C) == [0x04]
    assert read(compass, 0x09, 1, 0x0C) == [0]


def test_a_field_that_is_too_strong(compass: Mpu9150) -> None:
    """|X| + |Y| + |Z| from 2400 µT on: 8000 counts."""
    field(compass, (3000, 3000, 2100))
    set_mode(compass, 1)
    simtime.advance(9000)
    assert read(compass, 0x09, 1, 0x0C) == [0x08]
    field(compass, (10, 20, 30))
    set_mode(compass, 1)
    simtime.advance(9000)
    assert read(compass, 0x09, 1, 0x0C) == [0]


def test_modes_change_through_power_down_only(compass: Mpu9150) -> None:
    set_mode(compass, 1)
    set_mode(compass, 1)
    assert reasons(compass) == [(0x0C, 0x0A, 1, "mode 1 changed without power-down")]
    simtime.advance(7300)
    assert read(compass, 0x02, 1, 0x0C) == [1]  # the first one wasn't disturbed
    set_mode(compass, 15)
    assert "less than 100 us" in reasons(compass)[1][3]
    simtime.advance(100)
    set_mode(compass, 15)
    set_mode(compass, 1)
    assert reasons(compass)[2][3] == "mode 15 changed without power-down"
    set_mode(compass, 0)
    set_mode(compass, 2)
    assert reasons(compass)[3][3] == "no such mode"
    assert read(compass, 0x0A, 1, 0x0C) == [0]


def test_the_fuse_rom_is_read_in_its_own_mode_only(compass: Mpu9150) -> None:
    assert read(compass, 0x10, 3, 0x0C) == [0, 0, 0]
    set_mode(compass, 15)
    assert read(compass, 0x10, 3, 0x0C) == list(SENSITIVITY)
    set_mode(compass, 0)
    assert read(compass, 0x10, 3, 0x0C) == [0, 0, 0]


def test_the_compass_tests_itself(compass: Mpu9150) -> None:
    """The data sheet's limits: X and Y within ±100, Z from -1000 to -300, after adjustment."""

    def passed(self_field: int) -> bool:
        set_self_test(compass, self_field)
        set_mode(compass, 8)
        simtime.advance(9000)
        x, y, z = adjusted(compass)
        set_self_test(compass, 0)
        simtime.advance(100)
        return abs(x) < 100 and abs(y) < 100 and -1000 < z < -300

    assert passed(0x40)
    assert not passed(0)
    assert compass.compass
    compass.compass.failing = True
    assert not passed(0x40)


def test_a_burst_over_the_compass_wraps_where_the_data_sheet_says(compass: Mpu9150) -> None:
    set_mode(compass, 15)
    assert read(compass, 0x0C, 2, 0x0C) == [0, 0x48]
    assert read(compass, 0x12, 2, 0x0C) == [SENSITIVITY[2], SENSITIVITY[0]]


@pytest.mark.parametrize("register", [0x00, 0x02, 0x09, 0x0B, 0x0D, 0x10])
def test_the_compass_has_few_registers_to_write(compass: Mpu9150, register: int) -> None:
    assert compass.connect(0x0C, False)
    compass.write_byte(register)
    compass.write_byte(1)
    assert reasons(compass)[0][:3] == (0x0C, register, 1)


def test_a_device_reset_does_not_reach_the_compass(compass: Mpu9150) -> None:
    set_mode(compass, 15)
    write(compass, 0x6B, 0x80)
    simtime.advance(100_000)
    write(compass, 0x37, 0x02)
    assert read(compass, 0x0A, 1, 0x0C) == [15]
    compass.cut()
    compass.power_up()
    simtime.advance(100_000)
    write(compass, 0x37, 0x02)
    assert read(compass, 0x0A, 1, 0x0C) == [0]


# The auxiliary master.

SLAVES = {0: 0x25, 1: 0x28, 2: 0x2B, 3: 0x2E}


def with_master(*settings: tuple[int, int, int, int], wait: bool = True) -> Mpu9150:
    """Slaves: number, address with the read bit, register, control; then the master is enabled."""
    sensor = awake()
    write(sensor, 0x1B, 0x18, 0x18)
    for slave, address, register, control in settings:
        write(sensor, SLAVES[slave], address, register, control)
    write(sensor, 0x24, 0x4D if wait else 0x0D)
    write(sensor, 0x6A, 0x20)
    return sensor


def test_the_master_reads_at_each_sample() -> None:
    sensor = with_master((0, 0x8C, 0x00, 0x81))
    assert read(sensor, 0x49) == [0]
    sensor.sample(STILL)
    assert read(sensor, 0x49) == [0x48]
    assert read(sensor, 0x36) == [0]
    assert not sensor.connect(0x0C, False)


def test_slaves_fill_the_external_data_one_after_another() -> None:
    sensor = with_master((0, 0x8C, 0x02, 0x82), (1, 0x0C, 0x0A, 0x81), (2, 0x8C, 0x00, 0x81))
    sensor.sample(STILL)
    assert read(sensor, 0x4B) == [0x48]


def test_a_measurement_by_the_master() -> None:
    """Slave 0 reads ST1 to ST2, swapped into words; slave 1 starts the next measurement."""
    sensor = with_master((0, 0x8C, 0x02, 0xD8), (1, 0x0C, 0x0A, 0x81))
    write(sensor, 0x64, 1)
    write(sensor, 0x34, 1)  # every other sample
    write(sensor, 0x67, 0x03)
    for _ in range(6):
        simtime.advance(5000)
        field(sensor, (100, -50, 30))
    assert not sensor.rejected
    st1, *data, st2 = read(sensor, 0x49, 8)
    raw = struct.unpack(">3h", bytes(data))
    made = tuple(h * (asa + 128) // 256 for h, asa in zip(raw, SENSITIVITY, strict=True))
    assert (st1, st2) == (1, 0)
    assert near(made, (-50, 100, -30))


def test_a_master_that_asks_too_often_is_refused() -> None:
    sensor = with_master((0, 0x0C, 0x0A, 0x81))
    write(sensor, 0x63, 1)
    for _ in range(4):
        simtime.advance(5000)
        sensor.sample(STILL)
    assert [entry[3] for entry in reasons(sensor)] == ["mode 1 changed without power-down"] * 2


@pytest.mark.parametrize(
    ("register", "control", "order"),
    [
        (0x10, 0x82, [0, 1]),
        (0x10, 0xC2, [1, 0]),
        (0x10, 0xD2, [0, 1]),
        (0x10, 0xD3, [0, 2, 1]),
        (0x11, 0xD2, [2, 1]),
        (0x11, 0xC2, [1, 2]),
    ],
)
def test_byte_swap_and_its_groups(register: int, control: int, order: list[int]) -> None:
    sensor = with_master((0, 0x8C, register, control))
    assert sensor.compass
    sensor.compass.mode = 15
    sensor.sample(STILL)
    assert read(sensor, 0x49, len(order)) == [SENSITIVITY[i] for i in order]


def test_a_slave_without_a_register_goes_on_where_the_last_one_ended() -> None:
    sensor = with_master((0, 0x8C, 0x10, 0x81), (1, 0x8C, 0x00, 0xA1))
    assert sensor.compass
    sensor.compass.mode = 15
    sensor.sample(STILL)
    assert read(sensor, 0x49, 2) == list(SENSITIVITY[:2])


def test_without_waiting_external_data_are_those_of_the_sample_before() -> None:
    for wait, first in ((True, 0x48), (False, 0)):
        sensor = with_master((0, 0x8C, 0x00, 0x81), wait=wait)
        write(sensor, 0x23, 0x01)
        write(sensor, 0x6A, 0x60)
        sensor.sample(STILL)
        assert read(sensor, 0x74) == [first]


def test_slaves_in_the_fifo() -> None:
    sensor = with_master((0, 0x8C, 0x00, 0x81), (3, 0x8C, 0x10, 0x82))
    assert sensor.compass
    sensor.compass.mode = 15
    write(sensor, 0x23, 0x09)
    write(sensor, 0x24, 0x6D)  # the fourth slave's flag is here
    write(sensor, 0x6A, 0x60)
    sensor.sample((1, 2, 3, 4, 5, 6, 7))
    assert fifo_count(sensor) == 9
    assert read(sensor, 0x74, 9) == [0, 1, 0, 2, 0, 3, 0x48, *SENSITIVITY[:2]]


def test_who_does_not_acknowledge_the_master_is_told() -> None:
    sensor = with_master((1, 0x8D, 0x00, 0x81))
    write(sensor, 0x38, 0x08)
    assert sensor.sample(STILL)
    assert read(sensor, 0x3A) == [0x09]
    assert (read(sensor, 0x36), read(sensor, 0x36)) == ([0x02], [0])
    plain = Mpu9150(compass=False)
    write(plain, 0x6B, 0)
    write(plain, 0x25, 0x8C, 0x00, 0x81)
    write(plain, 0x6A, 0x20)
    plain.sample(STILL)
    assert read(plain, 0x36) == [0x01]


def test_the_fifth_slave_transfers_one_byte_once() -> None:
    sensor = with_master()
    write(sensor, 0x31, 0x8C, 0x00, 0, 0xC0)
    assert read(sensor, 0x35) == [0]
    sensor.sample(STILL)
    assert (read(sensor, 0x35), read(sensor, 0x34)) == ([0x48], [0x40])
    assert read(sensor, 0x3A) == [0x09]
    assert read(sensor, 0x36) == [0x40]
    write(sensor, 0x31, 0x0C, 0x0A, 15, 0x80)
    sensor.sample(STILL)
    assert sensor.compass and sensor.compass.mode == 15
    write(sensor, 0x31, 0x0D, 0x0A, 15, 0x80)
    sensor.sample(STILL)
    assert read(sensor, 0x36) == [0x50]


def test_the_master_is_reset_only_while_it_is_off() -> None:
    sensor = with_master((0, 0x8D, 0x00, 0x81))
    sensor.sample(STILL)
    write(sensor, 0x6A, 0x22)
    assert reasons(sensor)[0][3] == "master reset while the master is enabled"
    write(sensor, 0x6A, 0x02)
    assert read(sensor, 0x36) == [0]


def test_what_the_processor_leaves_behind_is_kept() -> None:
    """A restart of the processor is none of the sensor."""
    sensor = with_master((0, 0x8C, 0x02, 0xD8), (1, 0x0C, 0x0A, 0x81))
    write(sensor, 0x23, 0x79)
    write(sensor, 0x6A, 0x60)
    write(sensor, 0x00, 1)
    for i in range(3):
        field(sensor, (i, 0, 0))
    again = Mpu9150()
    again.load(json.loads(json.dumps(sensor.save())))
    assert again.rejected == sensor.rejected
    assert fifo_count(again) == 60
    assert read(again, 0x74, 60) == read(sensor, 0x74, 60)
    simtime.advance(9000)
    for device in (sensor, again):
        field(device, (5, 5, 5))
    assert read(again, 0x3B, 32) == read(sensor, 0x3B, 32)
