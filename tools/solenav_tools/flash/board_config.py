"""The config.json that a flash writes: what is there, a file's, single parameters; checked."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence

from solenav.errors import SolenavError
from solenav.parameters import Settings as Parameters
from solenav.parameters import checked, to_integers
from solenav_core.params import NAMES
from solenav_core.tables.defaults import PARAMS
from solenav_tools.settings import Settings

KEYS = (
    *("board", "params", "pose_every", "send_samples", "snapshot_s", "autostart", "sampling"),
    *("dlpf", "compass", "blackbox", "blackbox_samples", "watchdog", "checkpoint_s", "resume"),
)


def parsed(single: Sequence[str]) -> dict[str, int]:
    """Core parameters from texts NAME=INTEGER. SolenavError where one is none."""
    params = {}
    for text in single:
        name, equals, value = text.partition("=")
        if not equals or not value.lstrip("-").isdigit():
            raise SolenavError(f"--param {text} is no NAME=INTEGER", "for example M_A=1638")
        params[name] = int(value)
    return params


def in_words(own: Settings, *over: Mapping[str, object]) -> dict[str, int]:
    """The parameters of solenav.toml as the core's integers: those that differ from the defaults.

    At the sample rate that one of `over` sets, else the default's. SolenavError where the core
    can't hold one.
    """
    if not own.parameters:
        return {}
    rate = PARAMS[NAMES.index("RATE_MHZ")]
    for layer in over:
        found = {**layer, **_params(layer)}.get("RATE_MHZ")
        rate = found if isinstance(found, int) else rate
    usual = to_integers(Parameters(), rate / 1000)
    chosen = to_integers(own.apply(Parameters()), rate / 1000)
    return {n: v for n, v, u in zip(NAMES, chosen, usual, strict=True) if v != u}


def over(config: Mapping[str, object], params: Mapping[str, int]) -> dict[str, object]:
    """A configuration with parameters under its own."""
    both = {**params, **_params(config)}
    return {**config, "params": both} if both else dict(config)


def merged(
    there: Mapping[str, object], given: Mapping[str, object], single: Mapping[str, int], board: str
) -> dict[str, object]:
    """`there`, over it `given`, over it the parameters `single`.

    SolenavError where any is wrong.
    """
    params = {**_params(there), **_params(given), **single}
    out = {**there, **given, "board": f"boards.{board}"}
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


def _params(config: Mapping[str, object]) -> dict[str, object]:
    found = config.get("params", {})
    return dict(found) if isinstance(found, dict) else {}
