"""`solenav download`: a board's black box into captures."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from solenav.errors import SolenavError
from solenav_tools.cli.arguments import Baud, Port
from solenav_tools.cli.output import Json, progress, say, say_json, warn
from solenav_tools.download import BlackBox, Fetched, fetch
from solenav_tools.ports import PortVanished, chosen_port, open_port


def download(
    port: Port = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for the captures.", metavar="DIR")
    ] = Path(),
    erase: Annotated[
        bool, typer.Option(help="Erase each file on the board once its copy is verified.")
    ] = False,
    only_list: Annotated[bool, typer.Option("--list", help="Only say what is there.")] = False,
    baud: Baud = None,
    as_json: Json = False,
) -> None:
    """Fetch what the board recorded while nobody listened, a capture a file.

    After a break the same command goes on from where it was. Navigation goes on meanwhile.
    """
    if not output.is_dir():
        raise SolenavError(f"there is no folder {output}", f"mkdir -p {output}")
    port = chosen_port(port)
    began = time.monotonic()
    done: list[Fetched] = []
    here = total = 0
    with open_port(port, baud) as opened:
        try:
            box = BlackBox(opened)
            box.hello()
            files = box.files()
            total = sum(file.size for file in files)
            result: dict[str, Any] = {
                "port": port,
                "bytes": total,
                "free": box.free,
                "longest_access_us": box.longest,
            }
            if only_list:
                result["files"] = [file._asdict() for file in files]
            else:
                notes = {"port": port, "baud": opened.baudrate, "downloaded": time.time()}
                with progress("downloading", total) as show:
                    for file in files:

                        def count(bytes_here: int, before: int = here) -> None:
                            show(before + bytes_here)

                        done.append(fetch(box, file, output, notes, count, erase=erase))
                        here += file.size
                result["files"] = [file.as_dict() for file in done]
        except (PortVanished, KeyboardInterrupt) as error:
            what = f"{port} vanished" if isinstance(error, PortVanished) else "stopped"
            raise SolenavError(
                f"{what} after {len(done)} whole files; all that came is kept in {output}",
                "the same command goes on from there",
                1,
            ) from None
    result["seconds"] = round(time.monotonic() - began, 3)
    if as_json:
        say_json(result)
    elif only_list:
        _list(result)
    else:
        _tell(result, done)
    for fetched in done:
        if fetched.damaged:
            warn(f"{fetched.capture}: {fetched.damaged} damaged frames, as they are on the board")


def _list(result: dict[str, Any]) -> None:
    for file in result["files"]:
        say(f"{file['number']:6d}  {file['size']:8d} bytes")
    say(f"{len(result['files'])} files, {result['bytes']} bytes, {result['free']} bytes free")


def _tell(result: dict[str, Any], done: list[Fetched]) -> None:
    for file in done:
        notes = [f"{file.frames} frames", f"{file.size} bytes verified"]
        if file.there_already:
            notes.append("was here already")
        elif file.resumed_from:
            notes.append(f"{file.resumed_from} of them from an earlier try")
        if file.erased:
            notes.append("erased on the board")
        say(f"{file.capture}: {', '.join(notes)}")
    say(f"{len(done)} files in {result['seconds']:.1f} s" if done else "the black box is empty")
