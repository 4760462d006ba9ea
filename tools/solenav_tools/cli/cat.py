"""`solenav cat`: frames as JSON lines."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from solenav.capture import read_records
from solenav.capture.file import MAGIC
from solenav.errors import SolenavError
from solenav.link import NAMES, Damage, Frame, FrameReader, unpack
from solenav.link.units import in_units
from solenav_tools.cli.arguments import Baud
from solenav_tools.ports import PortVanished, open_port
from solenav_tools.recorder import join_in, stream


def cat(
    source: Annotated[str, typer.Argument(help="Port or capture.", metavar="PORT|CAPTURE")],
    only: Annotated[
        str | None, typer.Option(help="Message types, with commas between: pose,step.")
    ] = None,
    raw: Annotated[bool, typer.Option("--raw", help="The wire's integers, not units.")] = False,
    damaged: Annotated[bool, typer.Option(help="Damaged frames as well.")] = False,
    baud: Baud = None,
) -> None:
    """Print each message as a line of JSON as it comes, in SI units. Ctrl-C ends it."""
    wanted = _wanted(only)
    try:
        for item in _of_capture(Path(source)) if _is_capture(source) else _of_port(source, baud):
            line = _line(item, wanted, raw, damaged)
            if line is not None:
                # A pipe's reader wants it now, not with the next 8 kB.
                print(json.dumps(line, ensure_ascii=False), flush=True)
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:
        # Whoever read has had enough: as with any filter, no error.
        sys.stderr.close()
        raise typer.Exit(0) from None


def _wanted(only: str | None) -> set[str]:
    names = set(NAMES.values())
    if only is None:
        return names
    chosen = {name.strip().upper() for name in only.split(",")}
    if not chosen <= names:
        raise SolenavError(
            f"there is no message {', '.join(sorted(chosen - names))}",
            f"choose from {', '.join(sorted(names))}",
        )
    return chosen


def _is_capture(source: str) -> bool:
    path = Path(source)
    if path.suffix == ".solcap":
        return True
    try:
        return path.is_file() and path.open("rb").read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def _of_capture(path: Path) -> Iterator[Frame | Damage]:
    reader = FrameReader()
    for _arrival, data in read_records(path):
        yield from reader.feed(data)
    yield from reader.close()


def _of_port(name: str, baud: int | None) -> Iterator[Frame | Damage]:
    with open_port(name, baud) as port:
        try:
            join_in(port)
            for item in stream(port, None, lambda: False):
                if item is not None:
                    yield item
        except PortVanished:
            raise SolenavError(f"{name} vanished", "plug the board in and start again", 1) from None


def _line(
    item: Frame | Damage, wanted: set[str], raw: bool, damaged: bool
) -> dict[str, Any] | None:
    if isinstance(item, Damage):
        return {"damaged": item.reason, "bytes": item.data.hex()} if damaged else None
    name = NAMES[item.kind]
    if name not in wanted:
        return None
    if raw:
        fields = {k: v.hex() if isinstance(v, bytes) else v for k, v in unpack(item).items()}
    else:
        fields = in_units(item)
    return {"message": name, "tick": item.tick, "seq": item.seq, **fields}
