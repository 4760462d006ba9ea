"""`solenav info`: what is in captures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from solenav import capture
from solenav.capture.contents import Capture
from solenav.capture.summary import summary
from solenav_tools.cli.output import Json, say, say_json, warn

Files = Annotated[list[Path], typer.Argument(help="Captures (.solcap).", metavar="CAPTURE...")]


def info(files: Files, as_json: Json = False) -> None:
    """Duration, messages, gaps, rates, clipping, faults, firmware and parameter hashes."""
    found = [capture.load(file) for file in files]
    facts = [summary(contents) for contents in found]
    if as_json:
        # One capture is an object, several are a list of them.
        say_json(facts[0] if len(facts) == 1 else facts)
    for contents, fact in zip(found, facts, strict=True):
        if not as_json:
            _tell(fact)
        _warn(contents, fact)
    for contents in found:
        contents.need_schema()


def _warn(contents: Capture, facts: dict[str, Any]) -> None:
    if facts["cut_off_bytes"]:
        warn(f"{contents.path} ends inside a record; everything before that was read")
    if facts["damaged"]:
        warn(f"{contents.path}: {sum(facts['damaged'].values())} damaged frames: see `damaged`")


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
