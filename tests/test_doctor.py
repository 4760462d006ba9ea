"""`solenav doctor` before boards that are well, and that aren't."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli import refused, solenav
from test_monitor import Cable

from solenav.link import encode
from solenav_core import messages
from solenav_tools import doctor
from solenav_tools.board import Samples, SimulatedBoard
from solenav_tools.doctor import FAIL, PASS, SKIP, WARN, Seen

SAMPLES = 60_000
RNG = np.random.default_rng(3)
STILL = Samples(
    np.arange(SAMPLES) * 5000,
    # With some noise: a sensor whose data never change counts as frozen.
    (np.array([0, 0, 2048, 0, 0, 0]) + RNG.integers(-3, 4, (SAMPLES, 6))).astype(np.int16),
    np.full(SAMPLES, -3400, np.int16),
)


@contextmanager
def board(config: dict[str, Any] | None = None, **options: Any) -> Iterator[str]:
    """A simulated board at a port, in real time."""
    with SimulatedBoard(STILL, config, realtime=True, **options) as made:
        yield made.port


def examined(port: str, *options: str) -> tuple[int, dict[str, dict[str, str]]]:
    """The exit code and the checks by name; each that isn't passed says what to do or why not."""
    done = solenav("doctor", port, "--seconds", "2.5", "--json", *options)
    assert "Traceback" not in done.stderr
    assert done.stdout, done.stderr
    return done.returncode, {c["name"]: c for c in json.loads(done.stdout)["checks"]}


def test_a_board_that_is_well_passes_every_check() -> None:
    with board() as port:
        code, checks = examined(port, "--bus")
    assert code == 0
    assert {c["verdict"] for c in checks.values()} == {PASS}, checks
    assert "0 errors in 500 reads" in checks["bus at 400 kHz"]["found"]
    assert "0 errors in 500 reads" in checks["bus at 100 kHz"]["found"]
    assert "as here" in checks["firmware"]["found"]


def test_a_walk_is_not_ended_unasked_and_goes_on_afterwards() -> None:
    with board() as port:
        _code, checks = examined(port)
        assert checks["bus"]["verdict"] == SKIP and "--bus" in checks["bus"]["remedy"]
        _code, again = examined(port)
    assert again["state"]["found"] == "navigating"


def test_a_bus_that_is_bad_at_the_fast_clock_is_told_from_a_good_one() -> None:
    bad = {"kind": "nack", "at": 0, "every": 3, "above": 100_000}
    with board(faults=[bad]) as port:
        code, checks = examined(port, "--bus")
    assert code == 1
    assert checks["bus at 400 kHz"]["verdict"] == FAIL
    assert "2 kΩ" in checks["bus at 400 kHz"]["remedy"]
    assert checks["bus at 100 kHz"]["verdict"] == PASS


def test_an_mpu_6050_navigates_without_heading() -> None:
    with board(sensor="MPU-6050") as port:
        code, checks = examined(port)
    assert code == 0
    assert checks["sensor"]["verdict"] == WARN
    assert "no magnetometer" in checks["sensor"]["found"]


def test_a_sensor_that_is_gone_fails() -> None:
    with board(faults=[{"kind": "gone", "at": 0}]) as port:
        code, checks = examined(port)
    assert code == 1
    assert checks["state"]["verdict"] == FAIL
    assert "no answer from 0x68" in checks["state"]["found"]


def test_parameters_of_ones_own_are_named() -> None:
    with board({"params": {"ACC_MAX": 1600}}) as port:
        _code, checks = examined(port)
    assert checks["parameters"]["verdict"] == PASS
    assert "ACC_MAX" in checks["parameters"]["found"]


def test_a_nearly_full_flash_is_told() -> None:
    with board(flash={"capacity": 580_000}) as port:
        _code, checks = examined(port)
    assert checks["flash"]["verdict"] == WARN
    assert "download" in checks["flash"]["remedy"]


def test_a_silent_port_has_nobody_to_examine(tmp_path: Path) -> None:
    cable = Cable(tmp_path / "port")
    cable.plug()
    refused(solenav("doctor", cable.name), 2, "nobody says HELLO", "REPL")
    cable.pull()
    refused(solenav("doctor", cable.name), 2, "there is no port")


def test_firmware_of_another_schema_is_told_with_the_remedy(tmp_path: Path) -> None:
    cable = Cable(tmp_path / "port")
    cable.plug()
    payload = (
        (messages.SCHEMA ^ 1).to_bytes(2, "little").ljust(messages.SIZES[messages.HELLO], b"\0")
    )
    hello = encode(messages.HELLO, 0, 0, payload + b"old board")
    sending = threading.Thread(target=cable.send, args=(hello,))
    sending.start()
    done = solenav("doctor", cable.name)
    sending.join()
    refused(done, 2, "firmware and host differ", "old board", "flash the firmware anew")
    cable.pull()


# Verdicts that no simulated board gives.


class _Nobody:
    """An examination of what was seen, without a port."""

    def __init__(self, **seen: Any) -> None:
        self.doctor = doctor.Doctor.__new__(doctor.Doctor)
        self.doctor.seen = Seen(**seen)


def test_a_core_that_computes_wrongly_fails_by_the_test_s_name() -> None:
    check = doctor._self_test(1)
    assert check.verdict == FAIL and "it won't navigate" in check.found and check.remedy


@pytest.mark.parametrize(
    ("bits", "verdict", "says"),
    [
        (0, PASS, "within"),
        (2, FAIL, "gyro failed"),
        (5, FAIL, "accelerometer, magnetometer"),
        (messages.NOT_TESTED, WARN, "it was moved"),
    ],
)
def test_the_sensor_s_own_tests_are_read(bits: int, verdict: str, says: str) -> None:
    check = doctor._sensor_test(bits)
    assert (check.verdict, says in check.found) == (verdict, True)


def test_a_noisy_link_fails_both_ways() -> None:
    seen = _Nobody(frames=100, damaged=4, lost=3).doctor
    assert seen._link().verdict == FAIL
    seen = _Nobody(frames=100, damaged=1).doctor
    assert seen._link().verdict == PASS, "the frame that was under way when we came is no fault"
    heard = [{"bad_commands": 1}, {"bad_commands": 4}]
    assert _Nobody(statuses=heard).doctor._commands().verdict == FAIL


def test_a_clock_that_is_far_off_fails() -> None:
    samples = [(i, {"time": 5300 * i, "lost": 0, "flags": 0}) for i in range(100)]
    status = [{"period": 5300 * 256}]
    made = _Nobody(samples=samples, statuses=status, hello={"rate": 200_000}).doctor
    check = made._jitter()
    assert check.verdict == FAIL and "+6.00%" in check.found


def test_other_firmware_of_the_same_schema_is_a_warning() -> None:
    check = _Nobody(hello={"build": 1}).doctor._build()
    assert check.verdict == WARN and "solenav flash" in check.remedy
