"""A capture's samples through a live board: `solenav verify CAPTURE --device PORT`.

Each sample is a command; the board runs its core on it and answers with the digest of its whole
state, which is compared with the host's. A few are under way at a time, as many as the board's
receive buffer holds.
"""

from __future__ import annotations

import dataclasses
import time
from array import array
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import serial
from numpy.typing import NDArray

from solenav import engines, replaying
from solenav.capture import Capture
from solenav.capture.contents import Fragments
from solenav.errors import SolenavError
from solenav.link import command, unpack
from solenav.link.schema import need_forest
from solenav_core import messages
from solenav_tools.conversation import PATIENCE_S, TRIES, Conversation, unheard
from solenav_tools.matrix import Difference, state_difference
from solenav_tools.ports import send

_WINDOW = 4  # commands of 36 bytes: the board's receive buffer has 256
_SAMPLES = "injected samples"


@dataclasses.dataclass
class DeviceReport:
    """What the board made of the samples."""

    board: str
    engine: str
    samples: int
    ticks: int = 0  # compared, one by one
    seconds: float = 0.0
    resent: int = 0  # samples sent again because something was lost on the way
    difference: Difference | None = None

    @property
    def verified(self) -> bool:
        return self.difference is None and self.ticks == self.samples > 0

    def as_dict(self) -> dict[str, Any]:
        return {"verified": self.verified, **dataclasses.asdict(self)}


def inject(
    port: serial.Serial,
    capture: Capture,
    engine: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
    forest: array[int] | None = None,
) -> DeviceReport:
    """All of a capture's samples, as one run from a fresh start, on a board and on the host.

    SolenavError without samples, for a board of another schema, one that doesn't answer or
    refuses or has another forest than `forest` (words; None: the shipped one); PortVanished. The
    board goes on with its own run in any case: by itself after 5 s.
    """
    capture.need_samples()
    session = Session(port)
    hello = session.hello()
    need_forest(hello, forest, f"the board at {port.port}")
    held = session.params()
    if held is None:
        raise unheard(session.where, "ASK_HELLO in full: its parameters are missing")
    name = engine or engines.default_name()
    report = DeviceReport(
        hello["text"].decode("utf-8", "replace"), name, samples=len(capture.samples)
    )
    words = replaying.samples_of(capture).words
    # An engine may compile at its first tick, for longer than the board's patience.
    engines.create(name, capture.params[0][1]).advance(words, 0, 1)
    session.asked(messages.ASK_INJECT, 1, what=_SAMPLES)
    began = time.monotonic()
    try:
        _run(session, capture, words, report, progress, forest, held)
    except SolenavError:
        # It may have been restarted, or hear nothing: then its own patience ends it.
        session.leave()
        raise
    report.seconds = round(time.monotonic() - began, 3)
    session.asked(messages.ASK_INJECT, 0, what=_SAMPLES)
    return report


def _run(
    session: Session,
    capture: Capture,
    words: NDArray[np.int16],
    report: DeviceReport,
    progress: Callable[[int], None],
    forest: array[int] | None,
    held: array[int],
) -> None:
    params = capture.params[0][1][:]
    changes = replaying.parameter_changes(capture)
    core = engines.create(report.engine, params, forest)
    stops = sorted({0, *changes, len(words)})
    for start, stop in pairwise(stops):
        if start in changes:
            params[:] = changes[start]
        for index, (there, wanted) in enumerate(zip(held, params, strict=True)):
            if there != wanted:
                name = f"parameter {messages.NAMES[index]} = {wanted}"
                session.asked(messages.ASK_PARAM, index, wanted, what=name)
        held = params[:]
        sent = start
        due = time.monotonic() + PATIENCE_S
        tries = 0
        while report.ticks < stop:
            while sent < min(stop, report.ticks + _WINDOW):
                session.put(sent, words[sent].tolist())
                sent += 1
            answer = session.next()
            if answer is None:
                if time.monotonic() >= due:
                    # Something was lost on the way: again from the last one that was answered.
                    tries += 1
                    if tries > TRIES:
                        raise SolenavError(
                            f"the board stopped answering after {report.ticks} samples",
                            "look at the link with `solenav doctor`, and start again",
                            1,
                        )
                    report.resent += sent - report.ticks
                    sent = report.ticks
                    due = time.monotonic() + PATIENCE_S
                continue
            tick, digest = answer
            if tick <= report.ticks:
                continue
            if tick > sent:
                raise SolenavError(
                    f"the board is at tick {tick}, and {sent} samples were sent",
                    "somebody else injects: use one host at a time",
                )
            core.advance(words, report.ticks, tick)
            if core.digest() != digest:
                report.difference = session.difference(tick, core.state) or Difference(
                    "", tick, "state", "digest", digest, core.digest()
                )
                return
            report.ticks = tick
            tries, due = 0, time.monotonic() + PATIENCE_S
            progress(tick)


class Session(Conversation):
    """With a board that runs a host's samples."""

    def __init__(self, port: serial.Serial) -> None:
        super().__init__(port)
        self._samples_seq = 0

    def leave(self) -> None:
        """Ask for the end, without waiting for it."""
        self.ask(messages.ASK_INJECT, 0)

    def put(self, before: int, sample: list[int]) -> None:
        """One sample on its way."""
        self._samples_seq = (self._samples_seq + 1) & 255
        send(self._port, command(messages.INJECT, self._samples_seq, before, *sample))

    def next(self) -> tuple[int, int] | None:
        """Tick and digest of the next INJECTED; None where none is there yet."""
        for frame in self.frames():
            if frame.kind not in (messages.INJECTED, messages.ACK):
                continue
            fields = unpack(frame)
            if frame.kind == messages.INJECTED:
                return frame.tick, fields["digest"]
            if fields["command"] == messages.INJECT and fields["result"] == messages.REFUSED:
                raise SolenavError(
                    "the board refuses samples: its parameters are at odds, or it was restarted",
                    "look at `solenav info` for the capture's parameters, and start again",
                    1,
                )
        return None

    def difference(self, tick: int, state: Any) -> Difference | None:
        """The first word in which the board's state differs from the host's.

        None where the board doesn't show its state, or has gone on since.
        """
        fragments = Fragments()
        self.ask(messages.ASK_SNAPSHOT)
        end = time.monotonic() + 3 * PATIENCE_S
        while time.monotonic() < end:
            for frame in self.frames():
                if frame.kind != messages.SNAPSHOT:
                    continue
                whole = fragments.add(frame)
                if whole is not None and frame.tick == tick:
                    return state_difference("", tick, array("i", whole), state)
        return None
