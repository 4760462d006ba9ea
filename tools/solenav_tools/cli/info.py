"""`solenav info`: what is in a capture."""

from __future__ import annotations

from typing import Any

from solenav import capture
from solenav.capture.summary import summary
from solenav_tools.cli.output import CaptureFile, Json, say, say_json, warn


def info(file: CaptureFile, as_json: Json = False) -> None:
    """Duration, messages, gaps, rates, clipping, faults, firmware and parameter hashes."""
    contents = capture.load(file)
    facts = summary(contents)
    if as_json:
        say_json(facts)
    else:
        _tell(facts)
    if facts["cut_off_bytes"]:
        warn("the file ends inside a record; everything before that was read")
    if facts["damaged"]:
        warn(f"{sum(facts['damaged'].values())} damaged frames: see `damaged`")
    contents.need_schema()


def _tell(facts: dict[str, Any], indent: str = "") -> None:
    for key, value in facts.items():
        label = key.replace("_", " ")
        if isinstance(value, dict):
            if value:
                say(f"{indent}{label}:")
                _tell(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], str):
            say(f"{indent}{label}:")
            for line in value:
                say(f"{indent}  {line}")
        elif value not in ([], None):
            say(f"{indent}{label}: {value}")
