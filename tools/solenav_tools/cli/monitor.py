"""`solenav monitor`: a board, live, in a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live as Screen

from solenav.capture import CaptureWriter
from solenav.errors import SolenavError
from solenav.link import Damage, Frame
from solenav_tools.cli.output import check_output, say
from solenav_tools.cli.record import Baud, Port, Seconds
from solenav_tools.live import Live
from solenav_tools.ports import BAUD, PortVanished, open_port
from solenav_tools.recorder import join_in, stream

_REFRESH_S = 0.1
_LINE_S = 1.0


def monitor(
    port: Port,
    duration: Seconds = None,
    baud: Baud = BAUD,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Record into this capture as well.")
    ] = None,
) -> None:
    """Show position, speed, heading, steps, stance, filter and drops. Ctrl-C ends it.

    In a pipe it prints a line a second instead.
    """
    if output is not None:
        check_output(output, ".solcap")
    opened = open_port(port, baud)
    view = Live()
    console = Console()
    recording: AbstractContextManager[CaptureWriter | None] = (
        CaptureWriter(output) if output is not None else nullcontext()
    )
    with opened, recording as writer:
        try:
            join_in(opened)
            if console.is_terminal:
                with Screen(view.render(port, 0.0), console=console, auto_refresh=False) as screen:
                    show = lambda now: screen.update(view.render(port, now), refresh=True)  # noqa: E731
                    _follow(stream(opened, writer, _over(duration)), view, show, _REFRESH_S)
            else:
                _follow(
                    stream(opened, writer, _over(duration)),
                    view,
                    lambda _now: say(view.line()),
                    _LINE_S,
                )
        except PortVanished:
            raise SolenavError(
                f"{port} vanished at tick {view.tick}", "plug the board in and start again", 1
            ) from None
        except KeyboardInterrupt:
            pass
    if not view.frames:
        raise SolenavError(
            f"no message came from {port}",
            "check that it is the solenav board's port, and the baud rate",
            1,
        )


def _over(duration: float | None) -> Callable[[], bool]:
    end = time.monotonic() + duration if duration is not None else float("inf")
    return lambda: time.monotonic() >= end


def _follow(
    items: Iterator[Frame | Damage | None],
    view: Live,
    show: Callable[[float], None],
    every: float,
) -> None:
    """Feed the view and show it every so often, and once more at the end."""
    shown = 0.0
    try:
        for item in items:
            now = time.monotonic()
            view.take(item, now)
            if view.foreign():
                raise SolenavError(
                    f"firmware and host differ (schema {view.hello['schema']:04x})",
                    "install the host version that goes with the firmware, or flash it anew",
                )
            if now - shown >= every:
                shown = now
                show(now)
    finally:
        show(time.monotonic())
