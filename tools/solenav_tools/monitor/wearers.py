"""Who is watched: a name, a port and a colour for each wearer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.color import Color

from solenav.errors import SolenavError
from solenav_tools.ports import BAUD
from solenav_tools.settings import Settings

COLOURS = ("#1f9e89", "#d95f02", "#7570b3", "#e7298a", "#66a61e", "#a6761d", "#3b7dd8", "#c0392b")
"""Of wearers that have none of their own: told apart on white and on black."""


@dataclass(frozen=True)
class Wearer:
    """`port` is the device; `colour` is #rrggbb."""

    name: str
    port: str
    baud: int
    colour: str


def wearers(texts: Sequence[str], settings: Settings, baud: int | None = None) -> list[Wearer]:
    """Wearers from what was typed: a port, a name of solenav.toml, or NAME=PORT.

    SolenavError where two have one name or one port.
    """
    out: list[Wearer] = []
    for text in texts:
        name, _, place = text.rpartition("=")
        known = settings.port(place)
        name = name or (place if place in settings.ports else Path(known.device).name)
        colour = known.colour or COLOURS[len(out) % len(COLOURS)]
        out.append(Wearer(name, known.device, baud or known.baud or BAUD, _hex(colour)))
    for what, values in (("name", [w.name for w in out]), ("port", [w.port for w in out])):
        twice = {value for value in values if values.count(value) > 1}
        if twice:
            raise SolenavError(
                f"two wearers have the {what} {twice.pop()}", "give each one its own: NAME=PORT"
            )
    return out


def _hex(colour: str) -> str:
    """A colour as browsers, matplotlib and rich know it."""
    return Color.parse(colour).get_truecolor().hex
