"""The config.json that a flash writes: what is there, a file's, single parameters; checked."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from solenav.errors import SolenavError
from solenav.parameters import checked
from solenav_core.params import NAMES
from solenav_core.tables.defaults import PARAMS

KEYS = (
    *("board", "params", "pose_every", "send_samples", "snapshot_s", "autostart", "sampling"),
    *("dlpf", "compass", "blackbox", "blackbox_samples", "watchdog", "checkpoint_s", "resume"),
)


def merged(
    there: dict[str, object], file: dict[str, object], single: Sequence[str], board: str
) -> dict[str, object]:
    """`there`, over it `file`, over it NAME=VALUE of `single`. SolenavError where any is wrong."""
    params = {**_object(there), **_object(file)}
    for text in single:
        name, equals, value = text.partition("=")
        if not equals or not value.lstrip("-").isdigit():
            raise SolenavError(f"--param {text} is no NAME=INTEGER", "for example M_A=1638")
        params[name] = int(value)
    out = {**there, **file, "board": f"boards.{board}"}
    if params:
        out["params"] = params
    for key in out:
        if key not in KEYS:
            raise SolenavError(f"config.json has no key {key}", f"choose from {', '.join(KEYS)}")
    values = array("i", PARAMS)
    for name, chosen in params.items():
        if name not in NAMES:
            raise SolenavError(f"there is no parameter {name}", "docs/protocol.md lists them")
        if type(chosen) is not int or abs(chosen) >= 2**31:
            raise SolenavError(f"parameter {name} can't be {chosen!r}", "it is an integer")
        values[NAMES.index(name)] = chosen
    checked(list(values))
    return out


def _object(config: dict[str, object]) -> dict[str, object]:
    found = config.get("params", {})
    return dict(found) if isinstance(found, dict) else {}
