"""`solenav run-firmware`: the firmware itself over a capture's samples, without hardware."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solenav import capture
from solenav.errors import SolenavError
from solenav_tools import firmware_run
from solenav_tools.cli.output import CaptureFile, Json, check_output, progress, say, say_json, warn
from solenav_tools.outcome import need_alignment


def run_firmware(
    file: CaptureFile,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Capture to write.")] = None,
    pose_every: Annotated[
        int | None,
        typer.Option(min=1, help="A POSE on every n-th tick; default: 1, from 300 Hz on 2."),
    ] = None,
    serve: Annotated[
        bool, typer.Option(help="Don't record: print the port for `monitor` or `record`.")
    ] = False,
    realtime: Annotated[
        bool, typer.Option(help="With --serve: no faster than the samples were.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Run the firmware on MicroPython behind a pseudo-terminal, fed with a capture's samples."""
    source = capture.load(file)
    if serve:
        _serve(source, pose_every, realtime)
        return
    if output is None:
        raise SolenavError("no output", "name the capture to write with -o, or use --serve")
    check_output(output, ".solcap")
    with progress("running the firmware", len(source.samples)) as done:
        firmware_run.run(source, output, pose_every=pose_every, progress=done)
    made = capture.load(output)
    lost = len(source.samples) - len(made.samples)
    result = {"capture": str(output), "samples": len(made.samples), "lost": lost}
    result |= {"messages": dict(made.counts)}
    need_alignment(bool(len(made.aligns)), source, output)
    if as_json:
        say_json(result)
    else:
        counts = ", ".join(f"{count} {name}" for name, count in made.counts.items())
        say(f"{output}: {len(made.samples)} samples through the firmware")
        say(f"  {counts}")
    if lost:
        warn(f"{lost} samples were lost on the board: `solenav info {output}`")


def _serve(source: capture.Capture, pose_every: int | None, realtime: bool) -> None:
    """Keep a board at a port until a client has read all of it, or Ctrl-C."""
    with firmware_run.board_for(source, pose_every=pose_every, realtime=realtime) as board:
        say(board.port)
        try:
            board.wait_until_read()
        except KeyboardInterrupt:
            return
        board.check()
