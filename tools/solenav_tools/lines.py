"""Messages as dictionaries, one after the other: from a board as they come, or from a capture."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from solenav.capture import read_records
from solenav.capture.file import MAGIC
from solenav.errors import SolenavError
from solenav.link import NAMES, Damage, Frame, FrameReader, unpack
from solenav.link.units import in_units
from solenav_tools.ports import PortVanished, open_port
from solenav_tools.recorder import join_in, stream


def cat(
    source: str | Path,
    only: Collection[str] | None = None,
    *,
    raw: bool = False,
    damaged: bool = False,
    baud: int | None = None,
) -> Iterator[dict[str, Any]]:
    """Each message of a capture, or of the board at a port for as long as it is asked for.

    "message", "tick", "seq" and the fields, in SI units, with `raw` as on the wire. `only`: names
    of messages. `damaged`: what is no message as well, with the reason. SolenavError for a name or
    a file that isn't there, and where the port vanishes.
    """
    wanted = _wanted(only)
    for item in _of_capture(Path(source)) if _is_capture(source) else _of_port(str(source), baud):
        if isinstance(item, Damage):
            if damaged:
                yield {"damaged": item.reason, "bytes": item.data.hex()}
        elif NAMES[item.kind] in wanted:
            yield {
                "message": NAMES[item.kind],
                "tick": item.tick,
                "seq": item.seq,
                **(_raw(item) if raw else in_units(item)),
            }


def _wanted(only: Collection[str] | None) -> set[str]:
    names = set(NAMES.values())
    if only is None:
        return names
    chosen = {name.strip().upper() for name in only}
    if not chosen <= names:
        raise SolenavError(
            f"there is no message {', '.join(sorted(chosen - names))}",
            f"choose from {', '.join(sorted(names))}",
        )
    return chosen


def _raw(frame: Frame) -> dict[str, Any]:
    return {k: v.hex() if isinstance(v, bytes) else v for k, v in unpack(frame).items()}


def _is_capture(source: str | Path) -> bool:
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
            for item in stream(port, None):
                if item is not None:
                    yield item
        except PortVanished:
            raise SolenavError(f"{name} vanished", "plug the board in and start again", 1) from None
