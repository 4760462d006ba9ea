"""How commands speak: results on stdout, the rest on stderr, progress only on a terminal."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from solenav.errors import SolenavError, unwritable

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
CaptureFile = Annotated[Path, typer.Argument(help="A capture (.solcap).", metavar="CAPTURE")]
WalkFile = Annotated[
    Path,
    typer.Argument(
        help="A capture (.solcap), or steps as solenav pdr writes them (.csv).", metavar="WALK"
    ),
]

_errors = Console(stderr=True, soft_wrap=True, highlight=False)
_quiet = False


def be_quiet() -> None:
    """From now on only errors, warnings and what was asked for with `--json`."""
    global _quiet
    _quiet = True


def is_quiet() -> bool:
    return _quiet


def fail(error: SolenavError) -> int:
    """Print what happened and what to do; the exit code."""
    _errors.print(f"[bold red]error:[/] {escape(error.message)}")
    if error.remedy:
        _errors.print(f"  try: {escape(error.remedy)}")
    return error.exit_code


def warn(text: str) -> None:
    _errors.print(f"[yellow]warning:[/] {escape(text)}")


def tell(text: str) -> None:
    """A line on the way to the result."""
    if not _quiet:
        _errors.print(escape(text))


def say(text: str) -> None:
    """A line of a result for people."""
    if not _quiet:
        typer.echo(text)


def say_json(result: dict[str, Any] | list[dict[str, Any]]) -> None:
    typer.echo(json.dumps(result, indent=2, ensure_ascii=False))


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A progress bar on a terminal, nothing in a pipe; yields a function that takes what's done."""
    if _quiet or not _errors.is_terminal:
        yield lambda done: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_errors, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def check_output(path: Path, suffix: str) -> Path:
    """An output path whose folder exists. SolenavError otherwise, before any long work."""
    if path.suffix != suffix:
        raise SolenavError(f"{path} should end in {suffix}", f"name it {path.with_suffix(suffix)}")
    if not path.parent.is_dir():
        raise SolenavError(f"there is no folder {path.parent}", f"mkdir -p {path.parent}")
    return path


def write_text(path: Path, text: str) -> None:
    """Write a small file. SolenavError where that fails."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable(path, error) from None
