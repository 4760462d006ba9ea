"""A calibration from a board that sends its samples: the guide's eyes and voice."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np

from solenav.calibration.guide import Guide
from solenav.calibration.still import from_rows
from solenav.capture import CaptureWriter
from solenav.capture.contents import dtype
from solenav.capture.sidecar import write_sidecar
from solenav.errors import SolenavError
from solenav.link import Frame, unpack
from solenav.link.schema import need_schema
from solenav.recording import Recording
from solenav_core import messages
from solenav_tools.ports import PortVanished, open_port
from solenav_tools.recorder import join_in, stream

_SILENT_S = 5.0


def guided(
    port: str,
    baud: int | None,
    guide: Guide,
    say: Callable[[str], None],
    record: Path | None = None,
) -> Recording:
    """Follow a board until the guide is done: the samples that it looked at last.

    All bytes go into the capture `record` as well. SolenavError where the board can't be read,
    sends no samples, vanishes, or the person gives up with Ctrl-C.
    """
    samples = _Samples(port)
    opened = open_port(port, baud)
    writing: AbstractContextManager[CaptureWriter | None] = (
        CaptureWriter(record) if record is not None else nullcontext()
    )
    with opened, writing as writer:
        if record is not None:
            write_sidecar(record, {"port": port, "baud": opened.baudrate, "started": time.time()})
        for line in guide.opening():
            say(line)
        try:
            join_in(opened)
            for item in stream(opened, writer):
                if isinstance(item, Frame):
                    samples.take(item)
                samples.check_alive()
                if samples.due(guide):
                    recording = samples.since(guide.first)
                    for line in guide.look(recording):
                        say(line)
                    if guide.done:
                        return recording
        except PortVanished:
            raise SolenavError(
                f"{port} vanished before all was there; {guide.lacks()}",
                "plug the board in and start again",
                1,
            ) from None
        except KeyboardInterrupt:
            raise SolenavError(
                f"given up before all was there; {guide.lacks()}", "start again", 1
            ) from None
    raise AssertionError("a stream without an end has ended")


class _Samples:
    """The SAMPLE rows that came, and when to look at them."""

    def __init__(self, port: str) -> None:
        self._port = port
        self._rows = bytearray()
        self._dtype = dtype(messages.SAMPLE)
        self._looked_us = 0
        self._heard = time.monotonic()

    def take(self, frame: Frame) -> None:
        if frame.kind == messages.HELLO:
            need_schema(unpack(frame), self._port)
        elif frame.kind == messages.SAMPLE:
            self._rows += frame.payload
            self._heard = time.monotonic()

    def check_alive(self) -> None:
        if time.monotonic() - self._heard > _SILENT_S:
            raise SolenavError(
                f"no samples came from {self._port} for {_SILENT_S:g} s",
                "check that it is the solenav board's port and the baud rate, and that "
                '"send_samples" in its config.json is true',
                1,
            )

    def due(self, guide: Guide) -> bool:
        """True when `every_s` of the board's time have gone since the last look."""
        size = self._dtype.itemsize
        if len(self._rows) - guide.first * size < 2 * size:
            return False
        newest = int(np.frombuffer(self._rows[-size:], self._dtype)["time"][0])
        if (newest - self._looked_us) % 2**32 < guide.every_s * 1e6:
            return False
        self._looked_us = newest
        return True

    def since(self, first: int) -> Recording:
        rows = bytes(self._rows[first * self._dtype.itemsize :])
        return from_rows(np.frombuffer(rows, self._dtype), self._port)
