"""A whole flash: who is there, what differs, over it goes, and whether the new one speaks."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from solenav.errors import SolenavError
from solenav.progress import Progress, unseen
from solenav_tools.flash import board_config, boards, hello, tree
from solenav_tools.flash.repl import SerialRepl
from solenav_tools.ports import PortVanished, open_port
from solenav_tools.staging import board_tree, build_hash, switch


@dataclass
class Flashed:
    """What a flash came to. `sent`: bytes by path; `kept_main`: where a foreign main.py went."""

    port: str
    machine: str
    micropython: str
    architecture: str
    board: str
    build: str
    tree: str
    sent: dict[str, int]
    copied: int
    kept: int
    config: bool
    bytes: int
    nothing: bool
    dry_run: bool
    kept_main: str | None = None
    hello: dict[str, Any] | None = None
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        out = asdict(self)
        if self.hello is not None:
            out["hello"] = {**self.hello, "text": self.hello["text"].decode("utf-8", "replace")}
        return out


def flash(
    port: str,
    *,
    board: str | None = None,
    config: Mapping[str, object] | None = None,
    params: Mapping[str, int] | None = None,
    link: str | None = None,
    baud: int | None = None,
    dry_run: bool = False,
    patience: float = 1.0,
    tell: Callable[[str], None] = lambda text: None,
    progress: Progress = unseen,
) -> Flashed:
    """Put the firmware onto the board at a USB port: only what changed, whole or not at all.

    `board`: its module in firmware/boards, default by its own name. `config` and `params` (core's
    integers by name) go over its config.json. `link`: where HELLO of the new firmware is awaited.
    `patience`: all waits are so many times longer, for a board that is slower than a real one.
    SolenavError for a board that can't run it, settings past their limits, a port that vanishes,
    a HELLO that doesn't come or tells of a fault; the board then boots the old or the new.
    """
    began = time.monotonic()
    over = {**(config or {})}
    # Before the board is disturbed.
    board_config.merged({}, over, params or {}, board or next(iter(boards.BOARDS)))
    switched = False
    repl = SerialRepl(port, patience)
    try:
        try:
            found = boards.identify(repl)
            tell(f"{port}: {found.machine}, MicroPython {found.version}, {found.architecture}")
            tree.prepare(repl)
            present = tree.look(repl)
            there = boards.parse_config(present.config or "{}", "the board's config.json")
            name = boards.choose(found, board, there)
            wanted = board_config.merged(there, over, params or {}, name)
            files = board_tree(found.architecture)
            todo = tree.plan(present, files, switch(), wanted)
            kept_main = None
            if not dry_run:
                with progress("flashing", todo.bytes) as show:
                    kept_main = tree.apply(repl, todo, show)
                switched = True
                tree.clean(repl, todo, files)
        except SolenavError:
            repl.reset()
            raise
        result = Flashed(
            port=port,
            machine=found.machine,
            micropython=found.version,
            architecture=found.architecture,
            board=name,
            build=f"{build_hash():08x}",
            tree=todo.target,
            sent={path: len(data) for path, data in todo.send.items()},
            copied=len(todo.copy),
            kept=todo.kept,
            config=todo.config is not None,
            bytes=todo.bytes,
            nothing=todo.nothing,
            dry_run=dry_run,
            kept_main=kept_main,
        )
        if link is None or dry_run:
            repl.reset()
        else:
            result.hello = _spoken(repl, port, link, baud, patience)
    except (PortVanished, KeyboardInterrupt) as error:
        what = f"{port} vanished ({error})" if isinstance(error, PortVanished) else "stopped"
        state = "the new firmware is in place" if switched else "the board boots what is whole"
        raise SolenavError(
            f"{what}: {state}, it restarts by itself within 9 s, or when switched off and on",
            "the same command goes on from there; what has arrived is not sent again",
            1,
        ) from None
    finally:
        repl.close()
    result.seconds = round(time.monotonic() - began, 3)
    return result


def _spoken(
    repl: SerialRepl, port: str, link: str, baud: int | None, patience: float
) -> dict[str, Any]:
    """Restart the board and hear its HELLO."""
    if link == port:
        repl.reset()
        repl.close()
    with open_port(link, baud) as opened:
        if link != port:
            repl.reset()
        return hello.awaited(opened, link, build_hash(), patience)
