"""Whether firmware and host speak the same messages."""

from __future__ import annotations

from typing import Any

from solenav.errors import SolenavError
from solenav_core import messages


def need_schema(hello: dict[str, Any], where: str) -> None:
    """SolenavError where a HELLO's firmware speaks another schema; `where`: its port or file."""
    if hello["schema"] != messages.SCHEMA:
        text = hello["text"].decode("utf-8", "replace")
        raise SolenavError(
            f"{where}: firmware and host differ: the firmware ({text}) speaks message schema "
            f"{hello['schema']:04x}, this host {messages.SCHEMA:04x}",
            "install the host version that goes with the firmware, or flash the firmware anew",
        )
