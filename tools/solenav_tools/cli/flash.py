"""`solenav flash`: firmware onto a board."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from serial.tools import list_ports

from solenav.errors import SolenavError, unreadable
from solenav_tools import settings
from solenav_tools.cli.arguments import Baud
from solenav_tools.cli.output import Json, progress, say, say_json, tell, warn
from solenav_tools.flash import board_config, boards
from solenav_tools.flash.flashing import Flashed
from solenav_tools.flash.flashing import flash as put


def flash(
    port: Annotated[
        str | None, typer.Argument(help="USB port of the board; default: the only one.")
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="Module with the pins; default: by the board's own name.")
    ] = None,
    list_boards: Annotated[bool, typer.Option("--list-boards", help="Name the boards.")] = False,
    param: Annotated[
        list[str] | None, typer.Option("--param", help="A core parameter.", metavar="NAME=VALUE")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Settings to put over the board's config.json.")
    ] = None,
    link: Annotated[
        str | None, typer.Option(help="Port of the UART adapter, where HELLO is awaited.")
    ] = None,
    baud: Baud = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Write nothing, say what would be; the board restarts."),
    ] = False,
    patience: Annotated[
        float, typer.Option(min=1.0, help="Wait so many times longer: for an emulated board.")
    ] = 1.0,
    as_json: Json = False,
) -> None:
    """Put the firmware onto a board: only what changed, and whole or not at all.

    Whatever is cut off on the way, the board boots the old firmware or the new one.
    """
    if list_boards:
        _list(as_json)
        return
    if board is not None and board not in boards.BOARDS:
        raise SolenavError(f"there is no board {board}", f"choose {', '.join(boards.BOARDS)}")
    given = _given(config)
    single = board_config.parsed(param or [])
    own = settings.load()
    words = board_config.in_words(own, given, single)
    if words:
        tell(f"{own.path}: parameters {', '.join(words)}")
    result = put(
        port or _only_port(),
        board=board,
        config=board_config.over(given, words),
        params=single,
        link=link,
        baud=baud,
        dry_run=dry_run,
        patience=patience,
        tell=tell,
        progress=progress,
    )
    if result.kept_main:
        warn(f"the main.py that was on the board is kept there as {result.kept_main}")
    if as_json:
        say_json(result.as_dict())
    else:
        _say(result)


def _say(result: Flashed) -> None:
    would = "would be " if result.dry_run else ""
    for path, size in result.sent.items() if result.dry_run else ():
        say(f"{size:7d}  {path}")
    if result.nothing:
        say(f"nothing to do: {result.kept} files are as they should be")
    else:
        say(
            f"{len(result.sent)} files {would}sent, {result.copied} copied on the board, "
            f"{result.kept} kept; {result.bytes} bytes"
            + (f"; config.json {would}written" if result.config else "")
        )
    say(f"build {result.build}, board {result.board}")
    if result.hello is not None:
        text = result.hello["text"].decode("utf-8", "replace")
        say(f"HELLO: {text}; self-test passed")
    elif not result.dry_run:
        say("HELLO was not awaited: solenav monitor PORT on the UART adapter, or --link PORT here")


def _list(as_json: bool) -> None:
    if as_json:
        say_json({name: people for name, (people, _marks, _page) in boards.BOARDS.items()})
        return
    for name, (people, _marks, page) in boards.BOARDS.items():
        say(f"{name:10s} {people:20s} {boards.DOWNLOADS}{page}")


def _given(config: Path | None) -> dict[str, object]:
    if config is None:
        return {}
    try:
        return boards.parse_config(config.read_text(encoding="utf-8"), str(config))
    except OSError as error:
        raise unreadable(config, error) from None


def _asks() -> bool:
    """Whether somebody is there to answer."""
    return sys.stdin.isatty()


def _only_port() -> str:
    """The one USB serial port, or the one that a person picks."""
    ports = [p for p in list_ports.comports() if p.vid is not None]
    if not ports:
        raise SolenavError("no board is plugged in", "plug it in, or name its port")
    if len(ports) == 1:
        return str(ports[0].device)
    names = [str(p.device) for p in ports]
    if not _asks():
        raise SolenavError(f"several boards: {', '.join(names)}", "name one of them")
    for number, found in enumerate(ports, 1):
        tell(f"{number}  {found.device}  {found.description}")
    picked = str(typer.prompt("which", err=True))
    if not picked.isdigit() or not 1 <= int(picked) <= len(names):
        raise SolenavError(f"there is no board {picked} in the list", f"1 to {len(names)}")
    return names[int(picked) - 1]
