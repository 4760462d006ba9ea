"""Whether firmware and host go together: the same messages, the same forest of motions."""

from __future__ import annotations

from array import array
from typing import Any

from solenav.errors import SolenavError
from solenav_core import messages, navigator


def need_schema(hello: dict[str, Any], where: str) -> None:
    """SolenavError where a HELLO's firmware speaks another schema; `where`: its port or file."""
    if hello["schema"] != messages.SCHEMA:
        text = hello["text"].decode("utf-8", "replace")
        raise SolenavError(
            f"{where}: firmware and host differ: the firmware ({text}) speaks message schema "
            f"{hello['schema']:04x}, this host {messages.SCHEMA:04x}",
            "install the host version that goes with the firmware, or flash the firmware anew",
        )


def need_forest(hello: dict[str, Any], forest: array[int] | None, where: str) -> None:
    """SolenavError where a HELLO's firmware has another forest than these words; None: the shipped.

    Without it the core comes to other motions, and so to other states. `where`: its port or file.
    """
    held = navigator.forest_hash(navigator.new_tables(forest))
    if hello["forest"] != held:
        raise SolenavError(
            f"{where} ran with the forest {hello['forest']:08x}, this is {held:08x}",
            "give the file that was sent to the board as --forest",
        )
