"""`solenav flash`: firmware onto a board."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from serial.tools import list_ports

from solenav.errors import SolenavError
from solenav_tools.cli.arguments import Baud
from solenav_tools.cli.output import Json, progress, say, say_json, tell
from solenav_tools.flash import board_config, boards, hello, tree
from solenav_tools.flash.repl import SerialRepl
from solenav_tools.ports import PortVanished, open_port
from solenav_tools.staging import board_tree, build_hash, switch


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
    board_config.merged(
        {}, given, param or [], board or "rp2_pico"
    )  # before the board is disturbed
    chosen = port or _only_port()
    began = time.monotonic()
    switched = False
    repl = SerialRepl(chosen)
    try:
        try:
            found = boards.identify(repl)
            tell(f"{chosen}: {found.machine}, MicroPython {found.version}, {found.architecture}")
            tree.prepare(repl)
            present = tree.look(repl)
            there = boards.parse_config(present.config or "{}", "the board's config.json")
            name = boards.choose(found, board, there)
            wanted = board_config.merged(there, given, param or [], name)
            files = board_tree(found.architecture)
            todo = tree.plan(present, files, switch(), wanted)
            if not dry_run:
                with progress("flashing", todo.bytes) as show:
                    tree.apply(repl, todo, show)
                switched = True
                tree.clean(repl, todo, files)
        except SolenavError:
            repl.reset()
            raise
        result: dict[str, Any] = {
            "port": chosen,
            "machine": found.machine,
            "micropython": found.version,
            "architecture": found.architecture,
            "board": name,
            "build": f"{build_hash():08x}",
            "tree": todo.target,
            "sent": {path: len(data) for path, data in todo.send.items()},
            "copied": len(todo.copy),
            "kept": todo.kept,
            "config": todo.config is not None,
            "bytes": todo.bytes,
            "dry_run": dry_run,
        }
        if link is not None and not dry_run:
            if link == chosen:
                repl.reset()
                repl.close()
            with open_port(link, baud) as opened:
                if link != chosen:
                    repl.reset()
                result["hello"] = hello.awaited(opened, link, build_hash())
        else:
            repl.reset()
    except (PortVanished, KeyboardInterrupt) as error:
        what = f"{chosen} vanished" if isinstance(error, PortVanished) else "stopped"
        state = "the new firmware is in place" if switched else "the board boots what is whole"
        raise SolenavError(
            f"{what}: {state}, it restarts by itself within 9 s, or when switched off and on",
            "the same command goes on from there; what has arrived is not sent again",
            1,
        ) from None
    finally:
        repl.close()
    result["seconds"] = round(time.monotonic() - began, 3)
    if as_json:
        say_json(result)
    else:
        _say(result, todo.nothing)


def _say(result: dict[str, Any], nothing: bool) -> None:
    would = "would be " if result["dry_run"] else ""
    for path, size in result["sent"].items() if result["dry_run"] else ():
        say(f"{size:7d}  {path}")
    if nothing:
        say(f"nothing to do: {result['kept']} files are as they should be")
    else:
        say(
            f"{len(result['sent'])} files {would}sent, {result['copied']} copied on the board, "
            f"{result['kept']} kept; {result['bytes']} bytes"
            + (f"; config.json {would}written" if result["config"] else "")
        )
    say(f"build {result['build']}, board {result['board']}")
    if "hello" in result:
        say(f"HELLO: {result['hello']['text']}; self-test passed")
    elif not result["dry_run"]:
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
        raise SolenavError(f"can't read {config}: {error.strerror}", "check its name") from None


def _only_port() -> str:
    """The one USB serial port, or the one that a person picks."""
    ports = [p for p in list_ports.comports() if p.vid is not None]
    if not ports:
        raise SolenavError("no board is plugged in", "plug it in, or name its port")
    if len(ports) == 1:
        return str(ports[0].device)
    names = [str(p.device) for p in ports]
    if not sys.stdin.isatty():
        raise SolenavError(f"several boards: {', '.join(names)}", "name one of them")
    for number, found in enumerate(ports, 1):
        tell(f"{number}  {found.device}  {found.description}")
    picked = str(typer.prompt("which", err=True))
    if not picked.isdigit() or not 1 <= int(picked) <= len(names):
        raise SolenavError(f"there is no board {picked} in the list", f"1 to {len(names)}")
    return names[int(picked) - 1]
