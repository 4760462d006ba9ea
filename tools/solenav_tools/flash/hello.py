"""Waiting for a board that was just flashed to say who it is."""

from __future__ import annotations

from typing import Any

import serial

from solenav.errors import SolenavError
from solenav_core import messages
from solenav_tools.conversation import Conversation

_PATIENCE_S = 20.0
_QUIET_S = 1.0


def awaited(port: serial.Serial, name: str, build: int, patience: float = 1.0) -> dict[str, Any]:
    """HELLO of the new firmware. SolenavError where none comes or it tells of a fault.

    `patience`: it is awaited so many times longer than a real board needs.
    """
    wait_s = _PATIENCE_S * patience
    other = None
    for hello in Conversation(port).hellos(wait_s, quiet_s=_QUIET_S):
        if hello["schema"] == messages.SCHEMA and hello["build"] == build:
            return _sound(hello)
        other = hello  # the old firmware's last words, perhaps
    if other is not None:
        raise SolenavError(
            f"the board runs build {other['build']:08x}, not {build:08x}", "flash again", 1
        )
    raise SolenavError(
        f"{name}: no HELLO within {wait_s:.0f} s",
        "check the adapter: its RX to the board's TX, common ground; the files are on the board",
        1,
    )


def _sound(fields: dict[str, Any]) -> dict[str, Any]:
    if fields["self_test"]:
        raise SolenavError(
            f"the core's self-test {fields['self_test']} fails on the board",
            "flash again; if it stays, report it with the board's name",
            1,
        )
    failed = fields["sensor_test"]
    if failed and failed != messages.NOT_TESTED:
        raise SolenavError(f"the sensor's self-test fails ({failed})", "check its wiring", 1)
    return fields
