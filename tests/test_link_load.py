"""Whatever comes in on the UART: good commands are obeyed once, nothing else has an effect."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import device
import numpy as np
import pytest
import serial
from board import Client
from hypothesis import given
from hypothesis import strategies as st

from solenav import capture, link
from solenav.sim.board import simtime
from solenav_core import messages
from solenav_core.framing import CRC, HEADER
from solenav_tools import firmware_run

(LINK,) = device.load("link")

COMMANDS = [kind for kind in link.NAMES if kind >= messages.ASK_HELLO]
commands = st.builds(
    lambda kind, seq, data: (kind, seq, data[: messages.SIZES[kind]]),
    st.sampled_from(COMMANDS),
    st.integers(0, 255),
    st.binary(min_size=64, max_size=64),
)


class Board:
    """A link, and what it made of what it received."""

    def __init__(self) -> None:
        self.uart = device.Uart()
        self.link: Any = LINK.Link(self.uart)
        self.link.pump()
        self.uart.frames()
        self.obeyed: list[tuple[int, int, bytes]] = []

    def receive(self, data: bytes, pause_ms: int = 0) -> None:
        """Let it arrive, and turn the loop until all is looked at."""
        self.uart.waiting += data
        while True:
            kind = self.link.receive(0)
            if kind:
                size = messages.SIZES.get(kind, 0)
                payload = bytes(self.link.command[HEADER : HEADER + size])
                self.obeyed.append((kind, self.link.command[1], payload))
                self.link.acknowledge(messages.DONE, 0)
            elif not self.uart.waiting:
                break
            self.link.pump()
        self.link.pump()
        simtime.advance(1000 * pause_ms)

    def acks(self) -> list[tuple[int, int, int]]:
        return [tuple(link.unpack(f).values()) for f in self.uart.frames()]


def wire(command: tuple[int, int, bytes]) -> bytes:
    kind, seq, payload = command
    return link.encode(kind, seq, 0, payload)


def without_repeats(sent: list[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
    """A command with the type and seq of the one before it is not obeyed again."""
    return [c for i, c in enumerate(sent) if i == 0 or c[:2] != sent[i - 1][:2]]


@given(
    st.lists(st.tuples(st.binary(max_size=150), commands), max_size=12),
    st.lists(st.integers(1, 90), max_size=20),
)
def test_delimited_commands_among_anything_are_obeyed_once_each_and_in_order(
    parts: list[tuple[bytes, tuple[int, int, bytes]]], cuts: list[int]
) -> None:
    board = Board()
    data = b"".join(noise + b"\0" + wire(command) for noise, command in parts)
    for cut in cuts:
        board.receive(data[:cut], pause_ms=50)
        data = data[cut:]
    board.receive(data)
    assert board.obeyed == without_repeats([command for _noise, command in parts])
    assert [ack[:2] for ack in board.acks()] == [command[:2] for _noise, command in parts]


@given(commands, commands, st.data())
def test_half_a_command_costs_nothing_but_itself(
    half: tuple[int, int, bytes], whole: tuple[int, int, bytes], data: st.DataObject
) -> None:
    board = Board()
    cut = data.draw(st.integers(1, len(wire(half)) - 2))
    board.receive(wire(half)[:cut], pause_ms=10_000)
    board.receive(b"\0" + wire(whole))
    assert board.obeyed == [whole]
    assert board.link.damaged == 1


@given(commands, st.data())
def test_a_damaged_command_is_counted_and_not_obeyed(
    command: tuple[int, int, bytes], data: st.DataObject
) -> None:
    board = Board()
    spoilt = bytearray(wire(command))
    at = data.draw(st.integers(0, len(spoilt) - 2))
    spoilt[at] ^= data.draw(st.integers(1, 255))
    board.receive(bytes(spoilt) + b"\0")
    assert not board.obeyed and not board.acks()
    assert board.link.damaged >= 1


@given(st.sampled_from([k for k in COMMANDS if messages.SIZES[k]]), st.data())
def test_a_command_whose_fields_are_cut_off_is_damaged(kind: int, data: st.DataObject) -> None:
    board = Board()
    board.receive(wire((kind, 1, bytes(data.draw(st.integers(0, messages.SIZES[kind] - 1))))))
    assert not board.obeyed
    assert board.link.damaged == 1


@given(st.lists(st.tuples(st.integers(0, 400), commands), min_size=1, max_size=150))
def test_no_more_than_a_burst_of_40_and_then_20_a_second(
    arrivals: list[tuple[int, tuple[int, int, bytes]]],
) -> None:
    board = Board()
    times: list[int] = []
    for i, (pause, (kind, _seq, payload)) in enumerate(arrivals):
        simtime.advance(1000 * pause)
        board.receive(wire((kind, i % 256, payload)))
        times += [simtime.now()] * (len(board.obeyed) - len(times))
    for i, first in enumerate(times):
        for j in range(i, len(times)):
            # One more for the clock's milliseconds.
            assert j - i + 1 <= 41 + (times[j] - first) / 50_000
    assert board.link.refused == len(arrivals) - len(board.obeyed)
    assert len(board.acks()) == len(board.obeyed)


def test_a_burst_is_obeyed_and_what_is_over_it_refused() -> None:
    board = Board()
    board.receive(b"".join(wire((messages.ASK_LISTEN, i, b"")) for i in range(100)))
    assert len(board.obeyed) == 40
    assert board.link.refused == 60
    simtime.advance(1_000_000)
    board.receive(b"".join(wire((messages.ASK_LISTEN, i, b"")) for i in range(100, 150)))
    assert len(board.obeyed) == 60


def test_an_endless_frame_is_one_damage_and_forgotten_at_the_next_delimiter() -> None:
    board = Board()
    for _ in range(100):
        board.receive(b"\xff" * 1000)
    board.receive(b"\0" + wire((messages.ASK_HELLO, 7, b"")))
    assert board.obeyed == [(messages.ASK_HELLO, 7, b"")]
    assert board.link.damaged == 1


def test_a_turn_of_the_loop_looks_at_64_bytes_at_most() -> None:
    board = Board()
    board.uart.waiting += bytes(range(256)) * 40
    before = len(board.uart.waiting)
    board.link.receive(0)
    assert 0 < before - len(board.uart.waiting) <= 64
    assert board.uart.longest_read <= 64


def test_when_the_line_is_slow_samples_go_first_then_poses_then_a_download_waits() -> None:
    board = Board()
    board.uart.takes = 0
    outbox = board.link.outbox
    order = []
    kinds = {messages.SAMPLE: 0, messages.POSE: 1, messages.STATUS: 2}
    while len(order) < 3:
        for kind, rank in kinds.items():
            before = outbox.dropped[rank]
            board.link.send(kind, 0, HEADER + messages.SIZES[kind])
            if outbox.dropped[rank] > before and kind not in order:
                order.append(kind)
                if kind == messages.POSE:
                    room = outbox.has_room(HEADER + messages.SIZES[messages.POSE] + CRC + 2)
                    assert room, "a download's pieces still find room"
    assert order == [messages.SAMPLE, messages.POSE, messages.STATUS]
    assert not outbox.has_room(1)
    board.uart.takes = 1 << 30
    board.link.pump()
    sent = [frame.seq for frame in board.uart.frames()]
    assert sent == [i % 256 for i in range(len(sent))], "what was dropped leaves no hole"


ASKED = (messages.ASK_LISTEN, messages.ASK_HELLO, messages.ASK_SNAPSHOT, messages.ASK_FILES)
FLOODS = {
    "random": b"",
    "endless": b"\xff",
    "delimiters": b"\0",
    "halves": b"".join(link.command(kind, 9, *([0] * (kind == ASKED[3])))[:8] for kind in ASKED),
    "commands": b"".join(
        link.command(kind, seq, *([0] * (kind == ASKED[3]))) for seq in range(256) for kind in ASKED
    ),
}


@pytest.fixture(scope="module")
def quiet(walk: Path) -> dict[int, int]:
    """Digests of the walk's poses by tick, on a line where nothing comes in."""
    return walked(walk)[0]


def walked(walk: Path, **options: Any) -> tuple[dict[int, int], dict[str, int]]:
    """The poses' digests by tick, and the last STATUS."""
    with (
        firmware_run.board_for(capture.load(walk), pose_every=4, **options) as board,
        serial.Serial(board.port, 460800, timeout=0.5) as port,
    ):
        client = Client(port)
        client.to_the_end()
        board.check()
    poses = {m.tick: m.fields["digest"] for m in client.named("POSE")}
    return poses, client.named("STATUS")[-1].fields


@pytest.mark.skipif(os.name != "posix", reason="no pseudo-terminals here")
@pytest.mark.parametrize("name", FLOODS)
def test_a_flood_during_a_walk_changes_no_pose(
    name: str, walk: Path, quiet: dict[int, int]
) -> None:
    script = {"kind": "uart_flood", "after": 0, "data": FLOODS[name].hex()}
    poses, status = walked(walk, faults=[script])
    assert len(poses) > 1000
    assert poses == quiet
    assert status["lost"] == status["overruns"] == 0
    # Snapshots that are asked for 20 times a second find no room in the end.
    assert (status["dropped_others"] > 0) == (name == "commands")
    assert (status["bad_commands"] > 10) == (name in ("random", "halves", "commands"))
    assert (status["refused_commands"] > 100) == (name == "commands")


def test_random_bytes_make_no_command() -> None:
    board = Board()
    board.receive(np.random.default_rng(1).integers(0, 256, 200_000).astype(np.uint8).tobytes())
    assert not board.obeyed
    assert board.link.damaged > 500
