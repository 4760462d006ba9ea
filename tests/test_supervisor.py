"""What a wearer gets when things go wrong: the run goes on, says so, or stops with a clear state.

The firmware on the simulated board, a walk on its sensor, faults by script, a client at the port.
"""

from __future__ import annotations

import os
import struct
from array import array
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import device
import numpy as np
import pytest
from board import Client, on, run
from numpy.typing import NDArray
from wire import Message

from solenav import capture, engines, importing, parameters
from solenav.sim.board import simtime
from solenav.sim.scenario import simulate
from solenav.verification import Report, verify
from solenav_core import layout, messages
from solenav_core.messages import ALIGNING, FAULT, IDLE, RESUMING, RUNNING
from solenav_core.params import NAMES
from solenav_tools.board import Samples

pytestmark = pytest.mark.skipif(os.name != "posix", reason="no pseudo-terminals here")

S = 1_000_000  # µs
RATE = 200
Fault = dict[str, Any]
AT = layout.offsets(layout.STATE_FIELDS)

WALK = simulate("loop", seed=3).first(50.0)
PARAMS = importing.parameters_of(WALK)
# In stance after some strides, and in the swing after that.
STANCE = 23.1
SWING = 23.75


def feed(pause_s: float = 0.0, walk_s: float = 30.0) -> Samples:
    """The walk's first seconds; with a pause in which the wearer stands, from STANCE on."""
    samples, _ = importing.samples_of(WALK)
    row = round(STANCE * RATE)
    still = np.full(round(pause_s * RATE), row)
    # Any sample of the stance, each at its own moment: a sensor at rest still has its noise.
    still = still + np.random.default_rng(3).integers(-6, 7, len(still))
    rows = np.concatenate([np.arange(row), still, np.arange(row, round(walk_s * RATE))])
    times = np.arange(len(rows), dtype=np.int64) * (S // RATE)
    return Samples(times, samples.counts[rows], samples.temperature[rows])


def walk(faults: Sequence[Fault] = (), samples: Samples | None = None, **config: Any) -> Client:
    """A whole run of the walk."""
    config = {"params": parameters.named(PARAMS), **config}
    return run(feed() if samples is None else samples, config, faults=list(faults))


def position(pose: Message) -> NDArray[np.float64]:
    return np.array(pose.fields["position"]) / 2**18


def end(client: Client) -> NDArray[np.float64]:
    return position(client.named("POSE")[-1])


def flags(client: Client) -> list[int]:
    return [m.fields["flags"] for m in client.named("POSE")]


def proof(client: Client, folder: Path) -> Report:
    path = folder / "run.solcap"
    with capture.CaptureWriter(path) as writer:
        writer.write(0.0, client.data)
    report = verify(capture.load(path))
    assert report.verified, report.difference
    assert not report.unchecked_samples
    return report


def walked_alike(client: Client, whole: Client, since: int) -> bool:
    """Whether what was walked after tick `since` is as long, as the crow flies, as it really was.

    The heading is that before the hole, and of a walk that may have turned in it.
    """
    poses = [m for m in client.named("POSE") if m.tick > since]
    # The same moments of the recording, counted from its end.
    reference = whole.named("POSE")[-len(poses) :]
    found = np.linalg.norm(position(poses[-1]) - position(poses[0]))
    true = np.linalg.norm(position(reference[-1]) - position(reference[0]))
    assert true > 4
    return bool(abs(found - true) < 0.03 * true)


def modes(client: Client) -> list[int]:
    """The modes that STATUS told, each once in a row."""
    told = [m.fields["mode"] for m in client.named("STATUS")]
    return [mode for i, mode in enumerate(told) if not i or mode != told[i - 1]]


@pytest.fixture(scope="module")
def whole() -> Client:
    """The walk without a fault."""
    return walk()


# The clock


@pytest.mark.parametrize("factor", [0.96, 1.04])
def test_a_clock_four_per_cent_off_costs_centimetres(
    whole: Client, factor: float, tmp_path: Path
) -> None:
    client = walk([{"kind": "clock", "at": 0, "factor": factor}])
    assert np.linalg.norm(end(client) - end(whole)) < 0.1
    proof(client, tmp_path)
    status = client.named("STATUS")[-1].fields
    assert status["period"] == pytest.approx(5000 * 256 * factor, rel=1e-4)
    # Without parameters of its own it would be more than half a metre, on a walk of 12 m.
    rows = np.array(
        [(*m.fields["acc"], *m.fields["gyro"], 0, 0, 0, 0) for m in client.named("SAMPLE")],
        np.int16,
    )
    engine = engines.create("fast", PARAMS)
    engine.advance(rows)
    naive = np.array(engine.state[AT["POS"] : AT["POS"] + 3]) / 2**18
    assert np.linalg.norm(naive - end(whole)) > 0.5


def test_new_parameters_come_whole_and_between_two_samples(whole: Client) -> None:
    client = walk([{"kind": "clock", "at": 0, "factor": 0.97}])
    names = [m.name for m in client.messages if m.name in ("HELLO", "PARAMS", "SAMPLE")]
    changes = [i for i, name in enumerate(names) if name == "PARAMS" and i > 5]
    assert len(changes) == 2 and changes[1] == changes[0] + 1
    told = client.named("PARAMS")[-2:]
    new = array("i", b"".join(m.fields["data"] for m in told))
    assert new[NAMES.index("DT")] == pytest.approx(0.97 * PARAMS[NAMES.index("DT")], rel=1e-4)
    assert len(whole.named("PARAMS")) == 2


CLOCK: Any = device.load(
    "supervisor", machine=SimpleNamespace(reset_cause=lambda: 1, WDT_RESET=3, WDT=None)
)[0]


def sampled(samples: int, period: float, intervals: int = 4096) -> Any:
    return SimpleNamespace(samples=samples, intervals=intervals, period=lambda: round(period * 256))


def test_the_clock_is_looked_at_after_256_1024_and_then_every_2048_samples() -> None:
    clock = CLOCK.Clock(PARAMS)
    looks = []
    for n in range(1, 10_000):
        # A clock that is always another one.
        if clock.follow(sampled(n, 5000 + 50 * (len(looks) % 2 + 1))):
            looks.append(n)
    assert looks == [256, 1024, 3072, 5120, 7168, 9216]


@pytest.mark.parametrize(
    ("period", "intervals", "taken"),
    [(5004, 4096, False), (5006, 4096, True), (5200, 100, False), (6000, 4096, False)],
)
def test_what_is_no_clock_changes_nothing(period: float, intervals: int, taken: bool) -> None:
    """Less than one in a thousand; hardly known yet; so far off that it's something else."""
    clock = CLOCK.Clock(PARAMS)
    assert clock.follow(sampled(256, period, intervals)) is taken
    assert (clock.params != PARAMS) is taken


# The sensor


def test_a_sensor_that_is_gone_for_a_while(whole: Client, tmp_path: Path) -> None:
    """It stops with a clear state, and comes back by itself."""
    client = walk([{"kind": "nack", "at": round(SWING * S), "for": 2 * S}])
    assert modes(client) == [RUNNING, FAULT, RESUMING, RUNNING]
    (level, text), (_, mended) = client.texts()
    assert (level, mended) == ("error", "the sensor works again")
    assert "no answer from 0x68" in text and "check the sensor's power, SDA, SCL" in text
    # No pose comes from before the gap until the core has levelled itself again.
    (resumed,) = [m for m in client.named("ALIGN") if m.tick > 1000]
    fault = next(m for m in client.named("STATUS") if m.fields["mode"] == FAULT)
    assert not [m for m in client.named("POSE") if fault.tick < m.tick < resumed.tick]
    for pose in client.named("POSE"):
        late = pose.tick >= resumed.tick
        assert bool(pose.fields["flags"] & messages.RESUMED) == late
    report = proof(client, tmp_path)
    assert report.gaps == 1
    assert walked_alike(client, whole, resumed.tick)


def test_commands_work_while_the_sensor_is_gone() -> None:
    faults = [{"kind": "nack", "at": 15 * S, "for": 60 * S}]
    config = {"params": parameters.named(PARAMS)}
    with on(feed(walk_s=40), config, faults=faults) as (_board, client):
        client.until(lambda m: m.name == "STATUS" and m.fields["mode"] == FAULT)
        assert client.ask(messages.ASK_HELLO, 1) == messages.DONE
        assert client.ask(messages.ASK_SNAPSHOT, 2) == messages.DONE
        assert client.named("SNAPSHOT")[-1].tick == client.messages[-1].tick
        assert client.ask(messages.ASK_START, 3) == messages.REFUSED
        client.until(lambda m: m.name == "STATUS" and m.fields["mode"] == FAULT)
        assert client.ask(messages.ASK_STOP, 4) == messages.DONE
        client.until(lambda m: m.name == "STATUS" and m.fields["mode"] == IDLE)


@pytest.mark.parametrize("register", [0x1A, 0x1B, 0x1C])
def test_a_sensor_that_lost_its_settings_is_noticed(
    whole: Client, register: int, tmp_path: Path
) -> None:
    """Samples go on, at another scale: none of them may move the pose."""
    at = round((STANCE + 0.1) * S)
    client = walk([{"kind": "register", "at": at, "register": register, "value": 0}])
    assert ("warning", "the sensor had lost its settings: set up anew; check its supply") in (
        client.texts()
    )
    (resumed,) = [m for m in client.named("ALIGN") if m.tick > 1000]
    # Within a quarter of a second, and half a second to set it up and stand.
    assert resumed.tick < at * RATE / S + 200
    after = [m for m in client.named("POSE") if m.tick >= resumed.tick]
    assert after and all(m.fields["flags"] & messages.RESUMED for m in after)
    proof(client, tmp_path)
    assert np.linalg.norm(end(client) - end(whole)) < 2.5


def test_a_sensor_whose_power_dipped_is_set_up_anew(tmp_path: Path) -> None:
    client = walk([{"kind": "brown_out", "at": round(STANCE * S)}])
    status = client.named("STATUS")[-1].fields
    assert (status["mode"], status["recoveries"]) == (RUNNING, 1)
    assert flags(client)[-1] & (messages.GAP | messages.RESUMED)
    proof(client, tmp_path)


def test_frozen_data_end_in_a_fault() -> None:
    client = walk([{"kind": "frozen", "at": 25 * S}])
    assert ("error", "the sensor's data are frozen: check its power") in client.texts()
    assert FAULT in modes(client)
    last = client.named("POSE")[-1].tick
    assert last < 25.5 * RATE


def test_a_sensor_that_comes_late_starts_late() -> None:
    client = walk([{"kind": "nack", "after": 0, "for": 3 * S}])
    assert messages.SENSORS[client.named("HELLO")[0].fields["sensor"]] == "none"
    assert messages.SENSORS[client.named("HELLO")[-1].fields["sensor"]] == "MPU-9150"
    assert modes(client) == [FAULT, ALIGNING, RUNNING]
    assert [level for level, _ in client.texts()] == ["error", "info"]
    assert not flags(client)[-1] & (messages.GAP | messages.RESUMED)


# Restarts

HANG = round((STANCE + 12) * S)  # in the pause, a checkpoint after its beginning
PAUSE = 30.0


@pytest.fixture(scope="module")
def paused() -> Client:
    return walk(samples=feed(PAUSE))


def restarts(client: Client) -> list[Message]:
    return client.named("HELLO")[1:]


@pytest.mark.parametrize(("kind", "reason"), [("watchdog", 3), ("power_cut", 1)])
def test_a_restart_while_the_wearer_stands_costs_nothing_but_the_time(
    paused: Client, kind: str, reason: int, tmp_path: Path
) -> None:
    client = walk([{"kind": kind, "at": HANG}], feed(PAUSE))
    (hello,) = restarts(client)
    assert hello.fields["boot_reason"] == reason
    ((level, text),) = client.texts()
    assert level == "warning" and text.startswith("going on after a restart, from step ")
    assert np.linalg.norm(end(client) - end(paused)) < 0.1
    proof(client, tmp_path)
    for pose in client.named("POSE"):
        assert bool(pose.fields["flags"] & messages.RESUMED) == (pose.tick > hello.tick)
    # Steps and distance go on as well.
    last, reference = client.named("STEP")[-1].fields, paused.named("STEP")[-1].fields
    assert last["steps"] == reference["steps"]
    assert last["distance"] == pytest.approx(reference["distance"], rel=0.05)
    # Standing, it navigates within 2 s of the boot, sensor and stillness included.
    first = next(m for m in client.named("POSE") if m.tick > hello.tick)
    assert first.tick - hello.tick < 2 * RATE


def test_checkpoints_cost_no_samples(paused: Client) -> None:
    """There were five, on flash that stands still while it erases."""
    status = paused.named("STATUS")[-1].fields
    assert status["samples"] == len(paused.named("SAMPLE")) == round((PAUSE + 30) * RATE)
    assert status["lost"] == status["gaps"] == 0


def test_after_a_bite_in_mid_walk_what_follows_is_right(tmp_path: Path) -> None:
    samples = feed(walk_s=50)
    whole = walk(samples=samples)
    client = walk([{"kind": "watchdog", "at": 25 * S}], samples)
    (hello,) = restarts(client)
    proof(client, tmp_path)
    assert walked_alike(client, whole, hello.tick)


def test_what_has_hung_may_hang_again_soon(tmp_path: Path) -> None:
    faults = [{"kind": "watchdog", "at": HANG}, {"kind": "watchdog", "at": HANG + 14 * S}]
    client = walk(faults, feed(PAUSE))
    assert len(restarts(client)) == 2
    proof(client, tmp_path)


@pytest.mark.parametrize(
    ("kind", "resume", "goes_on"),
    [
        ("watchdog", "watchdog", True),
        ("power_cut", "watchdog", False),
        ("watchdog", "never", False),
    ],
)
def test_which_runs_are_gone_on_with_is_a_setting(kind: str, resume: str, goes_on: bool) -> None:
    client = walk([{"kind": kind, "at": HANG}], feed(PAUSE), resume=resume)
    (hello,) = restarts(client)
    assert (hello.tick > 0) is goes_on
    assert bool(flags(client)[-1] & messages.RESUMED) is goes_on
    told = ("info", f"not going on with the run before: config.json has resume: {resume}")
    assert (told in client.texts()) is not goes_on


def test_a_run_with_another_forest_is_gone_on_with() -> None:
    forest = [1, 2, 1 << 20, -(2**30), -(2**30)]
    config = {"params": parameters.named(PARAMS), "autostart": False}
    faults = [{"kind": "watchdog", "at": HANG}]
    with on(feed(PAUSE), config, faults=faults) as (_board, client):
        piece = struct.pack("<HH12i", 0, len(forest), *forest, *[0] * (12 - len(forest)))
        assert client.ask(messages.ASK_FOREST, 1, piece) == messages.DONE
        assert client.ask(messages.ASK_START, 2) == messages.DONE
        client.to_the_end()
    assert any("going on after a restart" in text for _, text in client.texts())
    before, after = (m.fields["forest"] for m in client.named("HELLO")[-2:])
    assert before == after


def test_a_run_that_was_stopped_is_over() -> None:
    faults = [{"kind": "power_cut", "at": HANG}]
    config = {"params": parameters.named(PARAMS)}
    with on(feed(PAUSE), config, faults=faults) as (_board, client):
        client.until(lambda m: m.tick > 21 * RATE, 60)
        assert client.ask(messages.ASK_STOP, 1) == messages.DONE
        client.to_the_end()
    (hello,) = restarts(client)
    assert hello.tick == 0
    assert not any("going on" in text for _, text in client.texts())
    assert client.named("SAMPLE")[-1].tick < 40 * RATE


def test_without_a_checkpoint_every_boot_is_a_fresh_start() -> None:
    client = walk([{"kind": "watchdog", "at": HANG}], feed(PAUSE), checkpoint_s=0)
    (hello,) = restarts(client)
    assert hello.tick == 0
    assert not flags(client)[-1] & messages.RESUMED


def test_without_the_watchdog_a_hang_is_only_a_gap(tmp_path: Path) -> None:
    client = walk([{"kind": "hang", "at": HANG, "for": 12 * S}], feed(PAUSE), watchdog=False)
    assert not restarts(client)
    assert flags(client)[-1] & messages.RESUMED
    proof(client, tmp_path)


def test_nothing_bites_while_the_sensor_is_gone_or_nobody_wants_samples() -> None:
    faults = [{"kind": "nack", "at": 12 * S, "for": 15 * S}]
    config = {"params": parameters.named(PARAMS)}
    with on(feed(PAUSE), config, faults=faults) as (board, client):
        client.until(lambda m: m.name == "LOG" and b"works again" in m.fields["text"], 60)
        assert client.ask(messages.ASK_STOP, 1) == messages.DONE
        client.to_the_end()
        assert board.wait(5) == 0
    assert not restarts(client)


def test_the_watchdog_leaves_a_boot_window_and_is_fed_by_progress_alone() -> None:
    fed: list[int] = []
    armed: list[int] = []

    class Wdt:
        def __init__(self, timeout: int) -> None:
            armed.append(simtime.now())
            assert timeout <= 8388  # what an RP2040 can wait

        def feed(self) -> None:
            fed.append(simtime.now())

    def dog(cause: int, wanted: bool = True) -> Any:
        machine = SimpleNamespace(reset_cause=lambda: cause, WDT_RESET=3, WDT=Wdt)
        return device.load("supervisor", machine=machine)[0].Watchdog(wanted)

    for cause, wanted, window in ((1, True, 8), (3, True, 2), (1, False, 0)):
        fed.clear()
        armed.clear()
        began = simtime.now()
        watchdog = dog(cause, wanted)
        for _ in range(100):
            simtime.advance(S // 10)
            watchdog.feed()
        if wanted:
            ((at),) = armed
            assert window * S <= at - began < (window + 0.2) * S
            assert len(fed) == 100 - 10 * window
        else:
            assert not armed and not fed
