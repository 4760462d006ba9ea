"""A person's own `solenav.toml`: names for ports, and parameters.

It is looked for as `--settings` or SOLENAV_SETTINGS says, else in the folder one works in, else in
the user's folder of settings (`solenav --version` names it). Everything in it is optional:

    default_port = "right"          # for commands that are given none

    [ports.right]
    device = "/dev/ttyUSB0"
    baud = 460800
    colour = "green"                # of the wearer in `monitor`

    [parameters]                    # fields of solenav.parameters.Settings, in SI units
    accel_max = 12.5
"""

from __future__ import annotations

import dataclasses
import difflib
import os
import sys
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer
from rich.color import Color, ColorParseError

from solenav.errors import SolenavError, unreadable
from solenav.parameters import Settings as Parameters

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

NAME = "solenav.toml"
VARIABLE = "SOLENAV_SETTINGS"
_BAUD_MAX = 4_000_000


@dataclass(frozen=True)
class PortSettings:
    """What is said of one port."""

    device: str
    baud: int | None = None
    colour: str | None = None


@dataclass(frozen=True)
class Settings:
    """The file's content; `path` is None where there is no file."""

    path: Path | None = None
    default_port: str | None = None
    ports: dict[str, PortSettings] = field(default_factory=dict)
    parameters: dict[str, Any] = field(default_factory=dict)

    def port(self, name: str) -> PortSettings:
        """The port of that name; a name that the file doesn't know is a device."""
        return self.ports.get(name) or PortSettings(name)

    def apply(self, parameters: Parameters) -> Parameters:
        """Parameters with the file's laid over them."""
        return dataclasses.replace(parameters, **self.parameters)


def user_path() -> Path:
    """The file in the user's folder of settings, there or not."""
    return Path(typer.get_app_dir("solenav")) / NAME


def load(chosen: Path | None = None) -> Settings:
    """The settings that hold. SolenavError names the file and the key that is wrong."""
    named = os.environ.get(VARIABLE)
    if chosen is None and named:
        chosen = Path(named)
    if chosen is None:
        chosen = next((path for path in (Path(NAME), user_path()) if path.is_file()), None)
    return Settings() if chosen is None else _read(chosen)


def _read(path: Path) -> Settings:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise unreadable(path, error) from None
    except ValueError as error:
        raise SolenavError(f"{path} is no TOML: {error}", "mend it or move it away") from None
    _known(path, "", content, ("default_port", "ports", "parameters"))
    ports = {
        name: _port(path, name, entry)
        for name, entry in _table(path, "ports", content.get("ports", {})).items()
    }
    default = content.get("default_port")
    if default is not None and not isinstance(default, str):
        raise _wrong(path, "default_port", default, "a name under [ports], or a device")
    chosen = _table(path, "parameters", content.get("parameters", {}))
    return Settings(path, default, ports, _parameters(path, chosen))


def _port(path: Path, name: str, entry: Any) -> PortSettings:
    where = f"ports.{name}"
    _known(path, where, _table(path, where, entry), ("device", "baud", "colour"))
    device, baud, colour = (entry.get(key) for key in ("device", "baud", "colour"))
    if not (isinstance(device, str) and device):
        raise _wrong(path, f"{where}.device", device, "the port, as in /dev/ttyUSB0")
    if baud is not None and not (type(baud) is int and 0 < baud <= _BAUD_MAX):
        raise _wrong(path, f"{where}.baud", baud, "a whole number, as in 460800")
    if colour is not None and not _is_colour(colour):
        raise _wrong(path, f"{where}.colour", colour, "a colour, as in green or #20a060")
    return PortSettings(device, baud, colour)


def _is_colour(value: Any) -> bool:
    try:
        return isinstance(value, str) and bool(Color.parse(value))
    except ColorParseError:
        return False


def _parameters(path: Path, chosen: dict[str, Any]) -> dict[str, Any]:
    defaults = {
        known.name: known.default
        for known in dataclasses.fields(Parameters)
        if isinstance(known.default, (bool, int, float))
    }
    _known(path, "parameters", chosen, defaults)
    for name, value in chosen.items():
        kind = type(defaults[name])
        # A whole number does for a float, nothing else for another kind.
        if type(value) is not kind and not (kind is float and type(value) is int):
            raise _wrong(
                path, f"parameters.{name}", value, f"a value as its default, {defaults[name]!r}"
            )
    return chosen


def _table(path: Path, where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _wrong(path, where, value, f"a table: [{where}]")
    return value


def _known(path: Path, where: str, content: dict[str, Any], names: Collection[str]) -> None:
    for key in content:
        if key not in names:
            near = difflib.get_close_matches(key, names, 1)
            raise SolenavError(
                f"{path}: there is no {where}{'.' if where else ''}{key}",
                f"{near[0]}?" if near else f"one of {', '.join(names)}",
            )


def _wrong(path: Path, where: str, value: Any, wanted: str) -> SolenavError:
    return SolenavError(f"{path}: {where} can't be {value!r}", f"give {wanted}")
