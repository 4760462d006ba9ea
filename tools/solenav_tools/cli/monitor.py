"""`solenav monitor`: boards, live, in a terminal, a window or a browser."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.live import Live as Screen

from solenav.errors import SolenavError
from solenav_tools import settings
from solenav_tools.cli.arguments import Baud, Seconds
from solenav_tools.cli.output import Json, check_output, say, tell, warn
from solenav_tools.monitor import terminal
from solenav_tools.monitor.watch import Watch, watching
from solenav_tools.monitor.wearers import Wearer, wearers
from solenav_tools.ports import chosen_port, known_names

_REFRESH_S = 0.1
_LINE_S = 1.0

Tick = Callable[[], None]


def monitor(
    ports: Annotated[
        list[str] | None,
        typer.Argument(
            help="Ports, one a wearer; NAME=PORT names it; default: the only one.",
            metavar="[PORT...]",
            autocompletion=lambda: known_names(),
            show_default=False,
        ),
    ] = None,
    duration: Seconds = None,
    baud: Baud = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Record as well: a capture; several wearers: a folder."
        ),
    ] = None,
    plot: Annotated[bool, typer.Option("--plot", help="A window with the track.")] = False,
    web: Annotated[bool, typer.Option("--web", help="A page for browsers.")] = False,
    host: Annotated[
        str, typer.Option(help="With --web: for whom; others than 127.0.0.1 need a token.")
    ] = "127.0.0.1",
    http_port: Annotated[int, typer.Option(help="With --web: 0 takes a free one.")] = 8765,
    as_json: Json = False,
) -> None:
    """Show position, speed, heading, steps, stance, filter and drops. Ctrl-C ends it.

    In a pipe it prints a line a second for each wearer. A port that vanishes is waited for.
    """
    found = wearers(ports or [chosen_port(None)], settings.load(), baud)
    place = _recordings(found, output)
    end = time.monotonic() + duration if duration is not None else float("inf")
    with watching(found, place) as watches:
        over = lambda: time.monotonic() >= end or all(watch.over for watch in watches)  # noqa: E731
        try:
            if web:
                from solenav_tools.monitor.web import serve

                serve(watches, host, http_port, over, tell)
            elif plot:
                from solenav_tools.monitor.window import show

                show(watches, over)
            else:
                _in_terminal(watches, over, as_json)
        except KeyboardInterrupt:
            pass
    _judge(watches)


def _recordings(found: Sequence[Wearer], output: Path | None) -> Callable[[Wearer], Path | None]:
    """Where each wearer is recorded. SolenavError before anything is opened."""
    if output is None:
        return lambda _wearer: None
    if len(found) == 1 and output.suffix == ".solcap":
        check_output(output, ".solcap")
        return lambda _wearer: output
    if not output.is_dir():
        raise SolenavError(
            f"there is no folder {output} for the captures of {len(found)} wearers",
            f"mkdir -p {output}",
        )
    stamp = time.strftime("%Y%m%d-%H%M%S")
    return lambda wearer: output / f"{stamp}-{_safe(wearer.name)}.solcap"


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)


def _in_terminal(watches: list[Watch], over: Callable[[], bool], as_json: bool) -> None:
    console = Console()
    if console.is_terminal and not as_json:
        with Screen(
            terminal.render(watches, time.monotonic()), console=console, auto_refresh=False
        ) as screen:
            _every(
                _REFRESH_S,
                over,
                lambda: screen.update(terminal.render(watches, time.monotonic()), refresh=True),
            )
    else:
        _every(_LINE_S, over, lambda: _lines(watches, as_json))


def _every(seconds: float, over: Callable[[], bool], show: Tick) -> None:
    """Show it every so often, and once more at the end."""
    try:
        while not over():
            show()
            time.sleep(seconds)
    finally:
        show()


def _lines(watches: list[Watch], as_json: bool) -> None:
    now = time.monotonic()
    for watch in watches:
        with watch.lock:
            live = watch.live
            stale = live.stale(now)
            if as_json:
                age = now - live.heard if live.frames else None
                facts: dict[str, Any] = {"name": watch.wearer.name, "port": watch.wearer.port}
                facts |= {"stale": stale, "age": age, "unplugged": watch.gone, **live.as_dict()}
                print(json.dumps(facts, ensure_ascii=False), flush=True)
                continue
            line = live.line()
        name = f"{watch.wearer.name}: " if len(watches) > 1 else ""
        note = "; UNPLUGGED: waiting" if watch.gone else "; STALE" if stale and live.frames else ""
        say(f"{name}{line}{note}")


def _judge(watches: list[Watch]) -> None:
    """What went wrong on the way, as an error with its exit code."""
    for watch in watches:
        if watch.losses:
            warn(f"{watch.wearer.port} vanished {watch.losses} times")
        if watch.trouble:
            warn(f"{watch.wearer.name}: {watch.trouble}")
    for watch in watches:
        port = watch.wearer.port
        if watch.error is not None:
            raise watch.error
        if watch.gone:
            raise SolenavError(
                f"{port} vanished at tick {watch.live.tick} and didn't come back",
                "plug the board in and start again",
                1,
            )
        if not watch.live.frames:
            raise SolenavError(
                f"no message came from {port}",
                "check that it is the solenav board's port, and the baud rate",
                1,
            )
    if any(watch.trouble for watch in watches):
        raise typer.Exit(1)
