"""The sampler on the register-level model: which samples, when, and what becomes of faults.

The bench numbers its samples, in their temperature; so what is lost is known.
"""

from __future__ import annotations

import shutil
import subprocess
from contextlib import suppress
from errno import ETIMEDOUT
from itertools import pairwise
from pathlib import Path
from typing import Any

import imu_bench
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from imu_bench import Bench, Taken, still

from solenav import datasets, mpu9150
from solenav.engines.source import core_path
from solenav.errors import SolenavError
from solenav.sim.board import simtime
from solenav_core import messages
from solenav_tools import micropython32
from solenav_tools.micropython import find_micropython
from solenav_tools.staging import firmware_path, stage

MODES = pytest.mark.parametrize("fifo", [True, False], ids=["fifo", "ready"])
CLIPS = messages.CLIPPED_ACC | messages.CLIPPED_GYRO
MAG = messages.MAG_NEW | messages.MAG_BAD


@pytest.fixture
def bench() -> Any:
    """A bench on which nothing was done that the hardware would ignore."""
    with imu_bench.on() as made:
        yield made
        assert made.model.rejected == []


def holes(bench: Bench, before: Taken, after: Taken, fifo: bool = True) -> None:
    """What is lost between two samples is told.

    To one where it was set up anew, which doesn't end in step, and without a FIFO where a stamp
    is late by a whole period.
    """
    unsure = bench.restarts if fifo else bench.restarts | bench.late
    restarted = any(before.number < n <= after.number for n in unsure)
    assert abs(after.number - before.number - after.lost - 1) <= restarted


def check(bench: Bench, sampler: Any, late_us: int = 120) -> None:
    """Every sample is what the sensor made, and every hole has its size."""
    for taken in bench.taken:
        assert taken.words[:6] == [*still(taken.number)[:3], *still(taken.number)[4:7]]
        assert bool(taken.lost) == bool(taken.flags & messages.GAP_BEFORE)
        assert taken.words[9] == taken.flags | min(taken.lost, messages.LOST_MAX) << 8
    for before, after in pairwise(bench.taken):
        holes(bench, before, after, sampler._sensor.fifo)
    offset = bench.taken[0].time - bench.made[bench.taken[0].number]
    for taken in bench.taken:
        assert abs(taken.time - bench.made[taken.number] - offset) <= late_us
    assert sampler.samples == len(bench.taken)
    assert sampler.lost_samples == sum(t.lost for t in bench.taken)
    assert sampler.gaps == sum(bool(t.lost) for t in bench.taken)


@MODES
def test_each_sample_once_and_at_its_time(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 300)
    check(bench, sampler)
    assert bench.numbers()[0] == min(bench.made)
    assert sampler.lost_samples == sampler.overruns == sampler.bus_errors == 0
    # Begun anew, what was before is no gap.
    sampler.stop()
    simtime.advance(1_000_000)
    sampler._sensor.wake()
    sampler.start()
    bench.run(sampler, 10)
    assert sampler.lost_samples == sampler.overruns == 0
    assert not any(t.flags & ~messages.MAG_NEW for t in bench.taken)


@MODES
@pytest.mark.parametrize("rate", [50_000, 100_000, 250_000, 500_000])
def test_other_rates(bench: Bench, fifo: bool, rate: int) -> None:
    sampler = bench.sampler(rate, fifo=fifo)
    bench.run(sampler, 200)
    check(bench, sampler)
    assert sampler.lost_samples == 0
    new = sum(bool(t.flags & messages.MAG_NEW) for t in bench.taken)
    assert new >= 200 // -(-9475 * rate // 10**9) - 2


@MODES
def test_a_reading_of_the_magnetometer_counts_once(bench: Bench, fifo: bool) -> None:
    """The bench's field changes with each sample, so two readings never look the same."""
    bench.values = lambda i: (*still(i)[:7], 100 + 8 * (i % 400), 5, -90)
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 400)
    told = [t.words[6] for t in bench.taken if t.flags & messages.MAG_NEW]
    assert len(told) in (199, 200)
    assert all(a != b for a, b in pairwise(told))
    between = [t.words[6] for t in bench.taken]
    assert all(a == b for a, b, t in zip(between, between[1:], bench.taken[1:], strict=False)
               if not t.flags & messages.MAG_NEW)  # fmt: skip


@MODES
def test_equal_readings_in_a_steady_field_are_new_ones_too(bench: Bench, fifo: bool) -> None:
    bench.values = lambda i: (*still(i)[:7], 100, 5, -90)
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 400)
    new = [i for i, t in enumerate(bench.taken) if t.flags & messages.MAG_NEW]
    assert len(new) in (199, 200)
    assert {b - a for a, b in pairwise(new)} == {2}
    assert sampler._sensor.way == bench.modules["mpu9150"].AUXILIARY


@MODES
def test_an_overflowing_magnetometer_is_told(bench: Bench, fifo: bool) -> None:
    bench.values = lambda i: (*still(i)[:7], 100 if i < 500 else 4000, 3900, -300)
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 600)
    bad = [t for t in bench.taken if t.flags & messages.MAG_BAD]
    assert len(bad) > 50
    assert all(t.words[6] < 200 and not t.flags & messages.MAG_NEW for t in bad)


@MODES
def test_a_magnetometer_that_the_auxiliary_master_cannot_reach(bench: Bench, fifo: bool) -> None:
    bench.model._transfer = lambda *_: False  # type: ignore[method-assign]
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 400)
    check(bench, sampler)
    assert sampler._sensor.way == bench.modules["mpu9150"].BYPASS
    later = bench.taken[200:]
    new = [t for t in later if t.flags & messages.MAG_NEW]
    assert len(new) >= 90
    assert sampler.lost_samples <= 5


@MODES
def test_a_magnetometer_that_is_gone_for_a_while(bench: Bench, fifo: bool) -> None:
    """Navigation goes on without it, and old readings don't pass for new ones."""
    compass = bench.model.compass
    assert compass is not None
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 100)
    compass.disabled = True
    bench.run(sampler, 800)
    assert sampler._sensor.way == bench.modules["mpu9150"].NO_WAY
    assert not any(t.flags & MAG for t in bench.taken[102:])
    compass.disabled = False
    bench.run(sampler, 1200)
    assert sampler._sensor.way == bench.modules["mpu9150"].AUXILIARY
    assert not sampler.slow
    assert sum(bool(t.flags & messages.MAG_NEW) for t in bench.taken[-200:]) == 100
    check(bench, sampler)
    assert sampler.lost_samples <= 12
    assert sampler.recoveries == 0


@MODES
def test_without_the_compass(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo, compass=False)
    bench.run(sampler, 300)
    check(bench, sampler)
    assert not any(t.flags for t in bench.taken)
    assert bench.model.registers[0x6A] == (0x40 if fifo else 0)


@MODES
def test_clipped_samples_are_counted(bench: Bench, fifo: bool) -> None:
    def values(i: int) -> tuple[int, ...]:
        return (*still(i)[:2], 32767, i, -32768 if i % 2 else 20000, *still(i)[5:])

    bench.values = values
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 50)
    both = [t.flags & CLIPS == CLIPS for t in bench.taken]
    assert both == [bool(t.number % 2) for t in bench.taken]
    assert all(t.flags & messages.CLIPPED_ACC for t in bench.taken)
    assert sampler.clipped == 50


def test_the_fifo_bridges_a_busy_processor(bench: Bench) -> None:
    sampler = bench.sampler()
    for stall in (7000, 40_000, 150_000, 220_000):
        bench.run(sampler, 50)
        simtime.advance(stall)
    bench.run(sampler, 100)
    check(bench, sampler)
    assert sampler.lost_samples == sampler.overruns == 0


def test_the_fifo_bridges_interrupts_held_up(bench: Bench) -> None:
    """As by erasing a Pico's flash: many pulses become one, and that one is late."""
    sampler = bench.sampler()
    for i in range(40):
        bench.run(sampler, 30 + i % 3)
        bench.hold_interrupts(1700 * i)
    bench.run(sampler, 100)
    check(bench, sampler, late_us=5000)
    assert sampler.lost_samples == 0
    assert sampler.period() == pytest.approx(5000 * 256, rel=1e-3)


def test_a_fifo_that_ran_over_is_a_gap_of_the_right_size(bench: Bench) -> None:
    sampler = bench.sampler()
    for stall in (231_000, 235_500, 300_000, 1_000_000, 3_000_000):
        bench.run(sampler, 30)
        simtime.advance(stall)
    bench.run(sampler, 30)
    check(bench, sampler)
    assert sampler.fifo_overflows == 5
    assert sampler.gaps == 5


def test_a_fifo_that_cannot_be_reset_is_set_up_anew(bench: Bench) -> None:
    sampler = bench.sampler()
    bench.run(sampler, 100)
    simtime.advance(300_000)
    refused: list[int] = []

    def refuses(_address: int, register: int) -> bool:
        if register == 0x6A and len(refused) < 3:
            refused.append(register)
            return True
        return False

    bench.refuses = refuses
    bench.run(sampler, 100)
    check(bench, sampler)
    assert (sampler.fifo_overflows, sampler.recoveries, sampler.gaps) == (1, 1, 1)


@pytest.mark.parametrize("enabled", [0x30, 0x08, 0xC8])
def test_a_fifo_that_holds_parts_of_samples_only_is_set_up_anew(bench: Bench, enabled: int) -> None:
    """FIFO_EN is lost: emptying the FIFO again and again would never end."""
    sampler = bench.sampler()
    bench.run(sampler, 100)
    bench.model.corrupt(0x23, enabled)
    bench.run(sampler, 100)
    check(bench, sampler)
    assert sampler.recoveries == 1


@pytest.mark.parametrize("work", [0, 137, 1000, 3000])
def test_overruns_of_the_registers_are_gaps_of_the_right_size(bench: Bench, work: int) -> None:
    sampler = bench.sampler(fifo=False)
    for stall in (9000, 23_000, 61_000, 400_000):
        bench.run(sampler, 20, work_us=work)
        simtime.advance(stall)
    bench.run(sampler, 20)
    check(bench, sampler)
    assert sampler.overruns == sampler.lost_samples > 90


@MODES
def test_single_failures_lose_nothing(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    for _ in range(5):
        bench.run(sampler, 80)
        bench.nacks = 1
    bench.run(sampler, 80)
    check(bench, sampler)
    assert (sampler.bus_errors, sampler.lost_samples, sampler.recoveries) == (5, 0, 0)


@pytest.mark.parametrize("size", [22, 14])
def test_a_fifo_burst_that_breaks_off_shifts_nothing(bench: Bench, size: int) -> None:
    sampler = bench.sampler(compass=size == 22)
    sensor = sampler._sensor
    taken = sensor.take
    plan: list[int] = []

    def take(sample: Any) -> int:
        if plan:
            bench.breaks_after = plan.pop()
        return int(taken(sample))

    sensor.take = take
    for byte in range(size):
        for stall in (0, 11_000):
            bench.run(sampler, 90)
            simtime.advance(stall)
            plan.append(byte)
    bench.run(sampler, 10)
    check(bench, sampler)
    assert sampler.bus_errors == 2 * size
    assert sampler.recoveries == 0
    assert sampler.lost_samples <= 5 * size


def test_a_short_disturbance_of_the_bus_loses_nothing_in_the_fifo(bench: Bench) -> None:
    sampler = bench.sampler()
    for ms in (2, 9, 17):
        bench.run(sampler, 100)
        until = simtime.now() + 1000 * ms
        bench.refuses = lambda *_, until=until: simtime.now() < until  # type: ignore[misc]
    bench.run(sampler, 100)
    check(bench, sampler)
    assert sampler.bus_errors >= 6
    assert sampler.lost_samples == sampler.recoveries == 0


@MODES
def test_a_sensor_that_was_away_for_a_moment_leaves_no_slow_bus(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 100)
    until = simtime.now() + 250_000
    bench.refuses = lambda *_: simtime.now() < until
    bench.run(sampler, 100)
    check(bench, sampler)
    assert sampler.recoveries == 1
    assert not sampler.slow


@MODES
def test_many_failures_in_a_row_set_the_sensor_up_anew(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 100)
    bench.nacks = 6 if fifo else 4
    bench.run(sampler, 100)
    check(bench, sampler)
    assert (sampler.recoveries, sampler.gaps) == (1, 1)
    assert 33 <= sampler.lost_samples <= 42
    assert bench.opened == [400_000, 400_000]


@MODES
@pytest.mark.parametrize("clocks", range(1, 10))
def test_a_stuck_line_is_clocked_free(bench: Bench, fifo: bool, clocks: int) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 50)
    bench.stuck = clocks
    bench.run(sampler, 50)
    check(bench, sampler)
    assert sampler.recoveries == 1


@MODES
def test_a_line_that_stays_low_is_not_waited_for(bench: Bench, fifo: bool) -> None:
    """The I2C times out then; other failures may pass, so they are worth another try."""
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 50)
    bench.stuck = 3
    bench.error = ETIMEDOUT
    bench.run(sampler, 50)
    check(bench, sampler)
    assert sampler.bus_errors == (1 if fifo else 2)
    assert sampler.recoveries == 1


@MODES
def test_a_bus_that_works_at_100_khz_only(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 50)
    bench.refuses = lambda *_: bench.opened[-1] == 400_000
    bench.run(sampler, 50)
    check(bench, sampler)
    assert sampler.slow
    assert sampler.recoveries == 1
    assert bench.opened[1:] == [400_000, 100_000, 400_000, 100_000]


@MODES
def test_a_bus_with_many_errors_is_slowed_down_for_a_while(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    for _ in range(11):
        bench.nacks = 1
        bench.run(sampler, 10)
    assert sampler.slow
    assert sampler.lost_samples == 0
    bench.run(sampler, 11_000, work_us=0, seconds=100)
    assert sampler.slow
    bench.run(sampler, 1100, work_us=0)
    assert not sampler.slow
    assert bench.opened == [400_000, 100_000, 400_000]
    assert sampler.recoveries == 0


@MODES
def test_a_sensor_that_is_gone_and_comes_back(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 60)
    bench.model.cut()
    with pytest.raises(bench.SensorError, match="no answer from 0x68"):
        bench.run(sampler, 1)
    for _ in range(3):
        simtime.advance(1_000_000)
        sampler.keep_time()
        with pytest.raises(bench.SensorError, match="no answer"):
            sampler.resume()
    bench.model.power_up()
    simtime.advance(150_000)
    sampler.resume()
    bench.run(sampler, 60)
    # Its clock stood still meanwhile on no account: the bench counts on.
    assert not sampler.slow
    (gap,) = [t for t in bench.taken if t.lost]
    assert gap.lost > 600
    check(bench, sampler)


def test_the_power_pin_is_the_last_resort(bench: Bench) -> None:
    bench.has_power_pin = True
    sampler = bench.sampler()
    bench.run(sampler, 60)
    bench.refuses = lambda *_: (imu_bench.POWER, 0) not in bench.pins
    bench.run(sampler, 60)
    check(bench, sampler)
    assert [level for number, level in bench.pins if number == imu_bench.POWER] == [0, 1]
    assert sampler.recoveries == 1


@MODES
def test_a_reset_in_mid_run(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    for _ in range(3):
        bench.run(sampler, 60)
        bench.model.reset()
    bench.run(sampler, 60)
    check(bench, sampler)
    assert (sampler.recoveries, sampler.gaps) == (3, 3)


@MODES
def test_silence_is_a_fault(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 60)
    handler = bench.handler
    assert handler

    def no_wire() -> None:
        bench.handler = None

    sensor_sample = sampler._sensor.sample

    def sample(*options: Any) -> int:
        rate = int(sensor_sample(*options))
        no_wire()
        return rate

    sampler._sensor.sample = sample
    no_wire()
    with pytest.raises(bench.SensorError, match="INT wire"):
        bench.run(sampler, 1)
    assert sampler.recoveries == 2


@MODES
def test_frozen_data_are_a_fault(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 100)
    bench.model.frozen = True
    before = len(bench.taken)
    with pytest.raises(bench.SensorError, match="frozen"):
        bench.run(sampler, 200)
    assert len(bench.taken) - before <= 25
    assert (sampler.frozen, sampler.recoveries) == (3, 2)
    bench.model.frozen = False
    sampler.resume()
    bench.run(sampler, 100)
    later = bench.taken[-100:]
    # The frozen ones before it was known have the same number, but times of their own. Of each
    # of three fresh starts the last, incomplete period isn't counted.
    periods = (later[0].time - bench.taken[-101].time) / 5000
    assert periods - 4 <= later[0].lost <= periods - 1
    assert all(b.number == a.number + 1 for a, b in pairwise(later))


@MODES
def test_data_frozen_for_a_moment_are_lost_samples(bench: Bench, fifo: bool) -> None:
    """All but the first three: the core bridges a hole better than a foot that turns on."""

    def values(i: int) -> tuple[int, ...]:
        bench.model.frozen = 100 <= i < 112
        return still(i)

    bench.values = values
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 150)
    (at,) = [i for i, taken in enumerate(bench.taken) if taken.lost]
    assert bench.taken[at].lost == 9
    assert [taken.number for taken in bench.taken[at - 5 : at + 2]] == [
        98,
        99,
        99,
        99,
        99,
        112,
        113,
    ]
    assert (sampler.lost_samples, sampler.recoveries) == (9, 0)


def spoil(bench: Bench, first: int, axis: int, by: int, count: int = 1) -> None:
    at = axis if axis < 3 else axis + 1

    def values(i: int) -> tuple[int, ...]:
        made = list(still(i))
        if first <= i < first + count:
            made[at] = max(-32768, min(32767, made[at] + by))
        return tuple(made)

    bench.values = values


@MODES
@pytest.mark.parametrize(("axis", "by"), [(0, 12000), (2, -16384), (4, 1500), (5, -30000)])
def test_a_spike_is_dropped(bench: Bench, fifo: bool, axis: int, by: int) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 50)
    spoil(bench, bench.number + 10, axis, by, count=2)
    bench.run(sampler, 50)
    check(bench, sampler)
    assert (sampler.spikes, sampler.gaps, sampler.lost_samples) == (2, 1, 2)


@MODES
def test_more_than_three_spikes_are_a_motion(bench: Bench, fifo: bool) -> None:
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 50)
    first = bench.number + 10
    spoil(bench, first, 4, 3000, count=1000)
    bench.run(sampler, 50)
    assert sampler.spikes == 3
    assert sampler.lost_samples == 3
    (gap,) = [t for t in bench.taken if t.lost]
    assert gap.number == first + 3
    # Or what came before was one that nobody noticed: the core is told that nothing is sure.
    assert gap.words[9] >> 8 == messages.LOST_MAX
    assert all(t.words[9] >> 8 == 0 for t in bench.taken if t.number > first + 3)


def test_a_bit_lost_on_the_way_is_read_again(bench: Bench) -> None:
    sampler = bench.sampler(fifo=False)
    for byte, bit in ((0, 0x80), (4, 0x40), (8, 0x10), (12, 0x80)):
        bench.run(sampler, 50)
        bench.flips[(0x3B, byte)] = bit
    bench.run(sampler, 50)
    check(bench, sampler)
    assert sampler.spikes == sampler.lost_samples == 0


@MODES
@pytest.mark.parametrize(("by", "around"), [(-19000, 1500), (17000, 5000), (9000, 560)])
def test_a_spike_that_only_its_end_gives_away_is_told(
    bench: Bench, fifo: bool, by: int, around: int
) -> None:
    """While the foot turns about other axes as well a single sample may pass for motion."""
    spike = 60

    def values(i: int) -> tuple[int, ...]:
        made = list(still(i))
        made[4] += around if i == spike else 0
        made[6] += by if i == spike else 0
        return tuple(made)

    bench.values = values
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 100)
    told = [t for t in bench.taken if t.words[9] >> 8]
    assert [(t.number, t.words[9] >> 8) for t in told] == [(spike + 1, messages.LOST_MAX)]
    assert (sampler.spikes, sampler.lost_samples) == (1, 0)


def test_no_step_of_the_recordings_is_a_spike(data: Path) -> None:
    """Over all foot recordings; the limits' comment has the largest jumps."""
    walks = []
    for format_ in datasets.FORMATS:
        folder = data / "foot" / {"pyshoe": "pyshoe_vicon"}.get(format_, format_)
        for path in sorted(folder.glob("*")):  # none of a format without feet
            with suppress(SolenavError):  # truth, licences
                walks.append((path.name, datasets.read(path, format_)))
    assert len(walks) >= 20
    with imu_bench.on() as bench:
        jumps, returned = bench.modules["sampler"].jumps, bench.modules["sampler"].returned
        for name, walk in walks:
            counts = mpu9150.to_counts(walk.accel, walk.gyro).counts.astype(np.int64)
            steps = np.abs(np.diff(counts, axis=0)).max(axis=1)
            # Only what could be one: the smallest limit is 1024.
            for i in np.flatnonzero(steps > 1000).tolist():
                new, old = counts[i + 1].tolist(), counts[i].tolist()
                assert not jumps(new, old), (name, i)
                assert not i or not returned(new, old, counts[i - 1].tolist()), (name, i)


@MODES
@pytest.mark.parametrize("clock", [0.96, 1.0235, 1.04])
def test_the_period_is_learned(bench: Bench, fifo: bool, clock: float) -> None:
    bench.clock = clock
    sampler = bench.sampler(fifo=fifo)
    bench.run(sampler, 20)
    assert sampler.period() == pytest.approx(5000 * clock * 256, rel=1e-3)
    simtime.advance(9000)  # gaps teach nothing
    for _ in range(5):
        bench.run(sampler, 300)
        bench.hold_interrupts(13_000)
    assert sampler.period() == pytest.approx(5000 * clock * 256, rel=2e-5)
    assert sampler.lost_samples == (0 if fifo else sampler.overruns)


def test_the_learned_period_is_a_running_mean(bench: Bench) -> None:
    sampler = bench.sampler(fifo=False)
    learn = bench.modules["sampler"].learn
    rng = np.random.default_rng(3)
    intervals = rng.integers(4900, 5150, 10_000)
    for interval in intervals.tolist():
        learn(sampler._times, interval)
    late = intervals[-4096:].mean()
    assert sampler.period() / 256 == pytest.approx(intervals.mean(), abs=abs(late - 5025) + 1.5)
    for _ in range(30_000):
        learn(sampler._times, 5003)
    # No rounding keeps it off.
    assert sampler.period() / 256 == pytest.approx(5003, abs=0.1)


def test_time_goes_on_past_the_wrap_of_the_ticks(bench: Bench) -> None:
    sampler = bench.sampler(fifo=False)
    bench.run(sampler, 3)
    start, told = simtime.now(), sampler.time
    sampler.stop()
    for _ in range(20):
        simtime.advance(1 << 28)
        sampler.keep_time()
    sampler.resume()
    bench.run(sampler, 1)
    assert sampler.time == pytest.approx((told + simtime.now() - start) % 2**32, abs=2000)


FAULTS = st.one_of(
    st.tuples(st.just("stall"), st.integers(0, 400_000)),
    st.tuples(st.just("held"), st.integers(0, 60_000)),
    st.tuples(st.just("nacks"), st.integers(1, 8)),
    st.tuples(st.just("breaks"), st.integers(0, 21)),
    st.tuples(st.just("stuck"), st.integers(1, 9)),
    st.tuples(st.just("reset"), st.just(0)),
)


@MODES
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    plan=st.lists(st.tuples(st.integers(1, 40), FAULTS), max_size=6), clock=st.floats(0.96, 1.04)
)
def test_every_hole_has_its_size_whatever_happens(
    fifo: bool, plan: list[tuple[int, tuple[str, int]]], clock: float
) -> None:
    """Times stand still where interrupts were held up; then one sample may be told late."""
    with imu_bench.on() as bench:
        bench.clock = clock
        sampler = bench.sampler(fifo=fifo)
        bench.run(sampler, 40)
        for samples, (kind, n) in plan:
            if kind == "stall":
                simtime.advance(n)
            elif kind == "held":
                bench.hold_interrupts(n)
            elif kind == "nacks":
                bench.nacks = n
            elif kind == "breaks":
                bench.breaks_after = n
            elif kind == "stuck":
                bench.stuck = n
            else:
                bench.model.reset()
            bench.run(sampler, samples)
        bench.nacks = 0
        bench.run(sampler, 60)
        numbers = bench.numbers()
        assert numbers == sorted(set(numbers))
        for taken in bench.taken:
            assert taken.words[:6] == [*still(taken.number)[:3], *still(taken.number)[4:7]]
        for before, after in pairwise(bench.taken):
            holes(bench, before, after, fifo)
        assert all(b.time > a.time for a, b in pairwise(bench.taken))
        assert bench.model.rejected == []


ALLOCATION = """
import gc
import sys

sys.path[:] = [""]


class Time:
    now = 1 << 29

    def ticks_us():
        return Time.now

    def ticks_add(ticks, delta):
        return (ticks + delta) & 0x3FFFFFFF

    def ticks_diff(end, start):
        return ((end - start + 0x20000000) & 0x3FFFFFFF) - 0x20000000

    def sleep_us(us):
        pass

    def sleep_ms(ms):
        Time.now = (Time.now + 1000 * ms) & 0x3FFFFFFF


class Pin:
    IN = OUT = OPEN_DRAIN = IRQ_RISING = 0

    def __init__(self, number, mode=0, value=1):
        pass

    def value(self, level=1):
        return 1

    def irq(self, handler=None, trigger=0, hard=False):
        self.handler = handler


class Machine:
    Pin = Pin


class Link:
    frame = bytearray(300)

    def send(self, kind, tick, end):
        pass


class I2C:
    registers = bytearray(128)
    count = 0

    def readfrom_mem_into(self, address, register, buffer):
        if address == 0x0C:
            buffer[0] = 0x48
        elif register == 0x72:
            buffer[0] = 0
            buffer[1] = 22
        elif register == 0x74 or register == 0x3B:
            self.count = (self.count + 1) & 63
            buffer[0] = self.count & 3
            buffer[5] = self.count
            buffer[14] = 1
            buffer[15] = self.count & 62
        elif register == 0x75:
            buffer[0] = 0x68
        else:
            for i in range(len(buffer)):
                buffer[i] = self.registers[register + i]

    def writeto_mem(self, address, register, data):
        if address == 0x68:
            self.registers[register] = data[0]


sys.modules["time"] = Time
sys.modules["machine"] = Machine()
from boards import Board
from bus import Bus
from mpu9150 import Mpu9150
from sampler import Sampler
import reports

pin = Pin(0)
link = Link()
sensor = Mpu9150(Bus(Board(lambda freq: I2C(), 0, 0, pin, None, "", 0, None)))
sensor.wake()
sampler = Sampler(sensor, pin, 200000, fifo=FIFO)
for _ in range(8):
    Time.now = (Time.now + 0x1FFE0000) & 0x3FFFFFFF
    sampler.keep_time()  # to where the time's upper half is about to wrap
sampler.start()
new = 0


def passes(n):
    global new, sound
    for i in range(n):
        Time.now = (Time.now + 4950 + i % 100) & 0x3FFFFFFF
        pin.handler(None)
        if sampler.ready() and sampler.read():
            reports.sample(link, 0, sampler, sampler.temperature())
            new += sampler.flags >> 3 & 1
        sound = sensor.check()


passes(400)
gc.collect()
gc.disable()
before = gc.mem_alloc()
passes(2000)
print(gc.mem_alloc() - before, sampler.samples, sampler.time_high < 0xFFF0, new > 1000, sound)
"""


@pytest.fixture(params=[64, 32])
def interpreter(request: pytest.FixtureRequest, tmp_path: Path) -> list[str]:
    """A MicroPython over staged firmware: bytecode on 64 bits, viper on the 32 of a board."""
    if request.param == 64:
        stage(tmp_path, {})
        return [str(find_micropython())]
    try:
        command = micropython32.command()
    except SolenavError as error:
        pytest.skip(f"{error.message}; {error.remedy}")
    firmware = firmware_path()
    for path in firmware.glob("*.py"):
        (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    shutil.copytree(firmware / "boards", tmp_path / "boards")
    shutil.copytree(core_path(), tmp_path / "solenav_core")
    return command


@MODES
def test_nothing_is_allocated_per_sample(
    interpreter: list[str], fifo: bool, tmp_path: Path
) -> None:
    """Neither where the board's time has more bits than a small int."""
    (tmp_path / "allocation.py").write_text(ALLOCATION.replace("FIFO", str(fifo)))
    ran = subprocess.run(
        [*interpreter, "allocation.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.stdout.split(), ran.stderr) == (["0", "2400", "True", "True", "True"], "")
