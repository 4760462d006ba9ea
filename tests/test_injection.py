"""Recorded samples through a live board: `verify --device`."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from board import Client
from cli import refused, solenav
from test_doctor import STILL
from test_monitor import Cable

from solenav import capture, engines, importing, parameters
from solenav.link import command
from solenav.sim.scenario import simulate
from solenav_core import messages
from solenav_core.params import NAMES
from solenav_tools import injection
from solenav_tools.board import SimulatedBoard
from solenav_tools.matrix import Difference
from solenav_tools.ports import open_port

TICKS = 420


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some seconds of a walk at 100 Hz, so with parameters that no board has by default."""
    path = tmp_path_factory.mktemp("walk") / "walk.solcap"
    recording = simulate("line35", seed=3, rate_hz=100.0).first(TICKS / 100)
    importing.to_capture(recording, path, parameters.Settings(align_s=0.5))
    return path


@pytest.fixture
def board() -> Iterator[SimulatedBoard]:
    with SimulatedBoard(STILL, realtime=True) as made:
        yield made


def joined(port: serial.Serial) -> Client:
    """A client of a board that is speaking already: from the next whole frame on."""
    while not port.read_until(b"\0").endswith(b"\0"):
        pass
    return Client(port)


def test_every_tick_of_a_live_board_is_compared(walk: Path, board: SimulatedBoard) -> None:
    done = solenav("verify", walk, "--device", board.port)
    assert done.returncode == 0, done.stderr
    assert f"{len(capture.load(walk).samples)} ticks, each equal" in done.stdout
    assert "times real time" in done.stdout


def test_the_board_goes_on_with_its_own_run_and_parameters(
    walk: Path, board: SimulatedBoard
) -> None:
    with open_port(board.port) as port:
        client = joined(port)
        client.until(lambda m: m.name == "POSE" and m.tick > 300)
        before = client.named("HELLO")[-1].fields["params"]
        tick = client.messages[-1].tick
        report = injection.inject(port, capture.load(walk), "fast")
        assert report.verified
        client = joined(port)
        client.until(lambda m: m.name == "POSE" and m.tick > tick)
        after = client.until(lambda m: m.name == "POSE")
        assert after.fields["flags"] & messages.RESUMED
        assert client.ask(messages.ASK_HELLO, 77) == messages.DONE
        assert client.named("HELLO")[-1].fields["params"] == before


def test_a_difference_is_named_by_tick_and_field(
    walk: Path, board: SimulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = capture.load(walk)
    told = injection.Session.put

    def spoilt(session: injection.Session, before: int, sample: list[int]) -> None:
        # What reaches the board isn't what the host computes with, from tick 301 on.
        told(session, before, [sample[0] + 1, *sample[1:]] if before == 300 else sample)

    monkeypatch.setattr(injection.Session, "put", spoilt)
    with open_port(board.port) as port:
        report = injection.inject(port, source, "fast")
    assert not report.verified and report.ticks == 300
    assert isinstance(report.difference, Difference)
    assert report.difference.tick >= 301
    assert report.difference.value != report.difference.reference
    assert report.difference.field


def test_lost_and_repeated_samples_on_the_way_cost_time_only(
    walk: Path, board: SimulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = injection.Session.put
    count = 0

    def lossy(session: injection.Session, before: int, sample: list[int]) -> None:
        nonlocal count
        count += 1
        if count % 100 == 50:
            return
        told(session, before, sample)
        if count % 70 == 35:
            told(session, before, sample)

    monkeypatch.setattr(injection.Session, "put", lossy)
    monkeypatch.setattr(injection, "PATIENCE_S", 0.3)
    with open_port(board.port) as port:
        report = injection.inject(port, capture.load(walk), "fast")
    assert report.verified and report.resent > 0


def test_an_engine_that_compiles_first_does_not_lose_the_board(
    walk: Path, board: SimulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    create = engines.create
    began: list[str] = []

    def compiling(name: str, params: Any, forest: Any = None) -> Any:
        if not began:
            began.append(name)
            time.sleep(6)  # the board waits for 5 s
        return create(name, params, forest)

    monkeypatch.setattr(engines, "create", compiling)
    with open_port(board.port) as port:
        assert injection.inject(port, capture.load(walk), "fast").verified
    assert began == ["fast"]


def answer(client: Client, kind: int, seq: int, *values: int) -> int:
    """Send a command with fields; its result."""
    client.port.write(command(kind, seq, *values))
    return client.until(
        lambda m: m.name == "ACK" and (m.fields["command"], m.fields["command_seq"]) == (kind, seq)
    ).fields["result"]


def test_nothing_is_injected_unasked_or_beyond_the_limits(board: SimulatedBoard) -> None:
    with open_port(board.port) as port:
        client = joined(port)
        client.until(lambda m: m.name == "SAMPLE")
        assert answer(client, messages.INJECT, 1, 0, *[0] * 10) == messages.REFUSED
        assert answer(client, messages.ASK_PARAM, 2, 0, 1) == messages.REFUSED
        assert answer(client, messages.ASK_INJECT, 3, 1) == messages.DONE
        assert (
            answer(client, messages.ASK_PARAM, 4, NAMES.index("WINDOW"), 10**6) == messages.REFUSED
        )
        assert answer(client, messages.ASK_PARAM, 5, len(NAMES), 0) == messages.REFUSED
        assert answer(client, messages.ASK_PARAM, 6, NAMES.index("SEED"), 5) == messages.DONE
        # Its own run can't be started or stopped meanwhile, which would lose it.
        assert client.ask(messages.ASK_START, 7) == messages.REFUSED
        assert client.ask(messages.ASK_STOP, 8) == messages.REFUSED
        assert answer(client, messages.ASK_INJECT, 9, 0) == messages.DONE
        client.until(lambda m: m.name == "SAMPLE")


def test_a_host_that_falls_silent_leaves_a_board_that_goes_on(board: SimulatedBoard) -> None:
    with open_port(board.port) as port:
        client = joined(port)
        client.until(lambda m: m.name == "POSE" and m.tick > 300)
        assert answer(client, messages.ASK_INJECT, 1, 1) == messages.DONE
        client.port.write(command(messages.INJECT, 2, 0, *[0] * 10))
        client.until(lambda m: m.name == "INJECTED")
        told = client.until(lambda m: m.name == "LOG", 30)
        assert b"fell silent" in told.fields["text"]
        client.until(lambda m: m.name == "SAMPLE" and m.tick > 300)


def test_what_cannot_be_injected_is_refused(walk: Path, tmp_path: Path) -> None:
    cable = Cable(tmp_path / "port")
    cable.plug()
    done = solenav("verify", walk, "--device", cable.name)
    refused(done, 2, "nobody says HELLO")
    cable.pull()
    refused(solenav("verify", walk, "--device", cable.name), 2, "there is no port")


def test_the_result_is_json_as_well(walk: Path, board: SimulatedBoard) -> None:
    done = solenav("verify", walk, "--device", board.port, "--json")
    found = json.loads(done.stdout)
    assert found["verified"] and found["ticks"] == found["samples"] > 0
