"""The firmware's own modules on CPython, on simulated time, with fakes for what they reach."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any
from unittest import mock

from solenav.link import FrameReader
from solenav.sim.board import simtime
from solenav_tools.staging import firmware_path


def load(*names: str, **fakes: Any) -> list[ModuleType]:
    """Import firmware modules afresh; `fakes` stand in for modules that they import."""
    path = [str(firmware_path()), *sys.path]
    modules = {"time": simtime, **fakes}
    with mock.patch.object(sys, "path", path), mock.patch.dict(sys.modules, modules):
        return [importlib.import_module(name) for name in names]


class Uart:
    """A line: bytes that wait to be received, bytes that were sent."""

    def __init__(self) -> None:
        self.waiting = bytearray()
        self.sent = bytearray()
        self.longest_read = 0
        self.takes = 1 << 30  # bytes at once; 0: the line is stuck

    def any(self) -> int:
        return len(self.waiting)

    def readinto(self, buffer: bytearray, length: int) -> int | None:
        self.longest_read = max(self.longest_read, length)
        part = self.waiting[:length]
        buffer[: len(part)] = part
        del self.waiting[:length]
        return len(part) or None

    def write(self, buffer: bytearray, offset: int, length: int) -> int | None:
        length = min(length, self.takes)
        self.sent += buffer[offset : offset + length]
        return length or None

    def frames(self) -> list[Any]:
        """What was sent since the last call, decoded."""
        data, self.sent = bytes(self.sent), bytearray()
        return list(FrameReader().feed(data))
