"""`solenav download`: a board's black box into captures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solenav.errors import SolenavError
from solenav_tools.cli.arguments import Baud, Port
from solenav_tools.cli.output import Json, progress, say, say_json, warn
from solenav_tools.download import Downloaded, Fetched
from solenav_tools.download import download as get
from solenav_tools.ports import chosen_port


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
    found = get(
        chosen_port(port),
        output,
        erase=erase,
        only_list=only_list,
        baud=baud,
        progress=progress,
    )
    if as_json:
        say_json(found.as_dict())
    elif only_list:
        _list(found)
    else:
        _tell(found)
    for file in found.files:
        if isinstance(file, Fetched) and file.damaged:
            warn(f"{file.capture}: {file.damaged} damaged frames, as they are on the board")


def _list(found: Downloaded) -> None:
    for file in found.files:
        say(f"{file.number:6d}  {file.size:8d} bytes")
    say(f"{len(found.files)} files, {found.bytes} bytes, {found.free} bytes free")


def _tell(found: Downloaded) -> None:
    for file in found.files:
        assert isinstance(file, Fetched)
        notes = [f"{file.frames} frames", f"{file.size} bytes verified"]
        if file.there_already:
            notes.append("was here already")
        elif file.resumed_from:
            notes.append(f"{file.resumed_from} of them from an earlier try")
        if file.erased:
            notes.append("erased on the board")
        say(f"{file.capture}: {', '.join(notes)}")
    count = len(found.files)
    say(f"{count} files in {found.seconds:.1f} s" if count else "the black box is empty")
