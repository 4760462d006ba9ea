"""`solenav compare`: filters side by side over recordings."""

from __future__ import annotations

import inspect
import shutil
import sys
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from solenav import capture
from solenav.errors import SolenavError
from solenav.evaluation import last_run
from solenav_tools.cli.output import Json, check_output, progress, say, say_json, warn, write_text

if TYPE_CHECKING:
    # They need numba, which the other commands do without.
    from solenav.comparison.runs import Run
    from solenav.filters import Filter, Walk

_PIPE_COLUMNS = 160


def compare(
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(help="Captures (.solcap), or folders of them.", metavar="INPUT..."),
    ] = None,
    filters: Annotated[
        list[str] | None,
        typer.Option(
            "--filter",
            "--filters",
            metavar="NAME",
            help="A filter, with aids after plus signs (ekf+still+gate), or all; may be given "
            "again. See --list.",
        ),
    ] = None,
    list_filters: Annotated[
        bool, typer.Option("--list", help="List the filters, their aids and sources.")
    ] = False,
    false_share: Annotated[
        float, typer.Option(min=0, max=0.5, help="Share of swing samples called stance.")
    ] = 0.0,
    missed_share: Annotated[
        float, typer.Option(min=0, max=0.5, help="Share of the stances missed.")
    ] = 0.0,
    strict: Annotated[
        bool,
        typer.Option(
            help="All on the decisions of a strict detector: fairer to filters that take each "
            "decision at its word."
        ),
    ] = False,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each, with seeds from 1 up.")] = 1,
    csv: Annotated[Path | None, typer.Option(help="CSV to write, a line a run.")] = None,
    markdown: Annotated[Path | None, typer.Option(help="Markdown (.md) to write.")] = None,
    figures: Annotated[Path | None, typer.Option(help="Folder for pictures.")] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: up to a core each.")
    ] = None,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler, tcp://HOST:PORT.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Run every filter on the same samples and stance decisions; errors, closure, time, pictures.

    Exit code 1: a recording had to be left out.
    """
    if not find_spec("numba"):
        raise SolenavError("comparing filters needs numba", "pip install 'solenav[fast]'")
    if list_filters:
        _list(as_json)
        return
    from solenav.comparison import runs as comparing
    from solenav.filters import named

    names = list(dict.fromkeys(filters or comparing.DEFAULT))
    if "all" in names:
        names = comparing.every()
    for name in names:
        named(name)
    _check_outputs(csv, markdown, figures)
    walks, skipped = _load(inputs or [])
    if strict:
        from solenav.comparison.strict import strictly

        walks = list(map(strictly, walks))
    condition = comparing.Condition(false_share, missed_share)
    with progress("comparing filters", comparing.amount(len(walks), 1, seeds)) as done:
        runs = comparing.compare(
            walks,
            names,
            (condition,),
            range(1, seeds + 1),
            jobs=jobs,
            dask=dask,
            progress=done,
        )
    _write(runs, csv, markdown)
    if figures is not None:
        _draw(runs, walks, names, condition, figures)
    _tell(runs, skipped, as_json)
    if skipped:
        raise typer.Exit(1)


def _check_outputs(csv: Path | None, markdown: Path | None, figures: Path | None) -> None:
    """SolenavError for what couldn't be written, before any long work."""
    if csv is not None:
        check_output(csv, ".csv")
    if markdown is not None:
        check_output(markdown, ".md")
    if figures is not None:
        if not find_spec("matplotlib"):
            raise SolenavError("pictures need matplotlib", "pip install 'solenav[plot]'")
        try:
            figures.mkdir(exist_ok=True)
        except OSError as error:
            raise SolenavError(
                f"can't make the folder {figures}: {error.strerror}", "choose another for --figures"
            ) from None


def _load(inputs: list[Path]) -> tuple[list[Walk], list[str]]:
    """The walks of all captures, under names of their own, and what had to be left out.

    SolenavError where no walk is left.
    """
    from solenav.comparison import metrics
    from solenav.filters import walk as walking

    files = _files(inputs)
    walks, skipped = [], []
    for file, name in zip(files, _names(files), strict=True):
        try:
            run, _restarts = last_run(capture.load(file))
            walk = replace(walking.load(run), name=name)
            metrics.check(walk)
        except SolenavError as error:
            if len(files) == 1:
                raise
            warn(f"left out: {error.message}")
            skipped.append(str(file))
        else:
            walks.append(walk)
    if not walks:
        raise SolenavError("no recording can be compared", "see the warnings above")
    return walks, skipped


def _files(inputs: list[Path]) -> list[Path]:
    """The captures, each once. SolenavError where an input has none."""
    if not inputs:
        raise SolenavError("no recording to compare on", "name captures, or folders of captures")
    found = []
    for path in inputs:
        here = sorted(path.glob("*.solcap")) if path.is_dir() else [path]
        if not here:
            raise SolenavError(
                f"no captures (.solcap) in {path}", "make some: `solenav import` or `simulate`"
            )
        found += here
    return list({file.resolve(): file for file in found}.values())


def _names(files: list[Path]) -> list[str]:
    """A name each: the file's, with its folder's before it where two are alike."""
    stems = [file.stem for file in files]
    return [
        stem if stems.count(stem) == 1 else str(file.with_suffix(""))
        for stem, file in zip(stems, files, strict=True)
    ]


def _write(runs: list[Run], csv: Path | None, markdown: Path | None) -> None:
    from solenav.comparison import table

    for path, text in ((csv, table.to_csv), (markdown, _markdown)):
        if path is not None:
            write_text(path, text(runs))


def _markdown(runs: list[Run]) -> str:
    from solenav.comparison import table

    return table.markdown(table.sheets(runs))


def _draw(
    runs: list[Run], walks: list[Walk], names: list[str], condition: Any, folder: Path
) -> None:
    """Lines of each recording's first seed, and boxes over all runs."""
    from solenav.comparison import figures
    from solenav.comparison.faults import spoil

    with progress("drawing", len(walks)) as done:
        for i, walk in enumerate(walks):
            spoilt = spoil(walk, 1, condition.false_share, condition.missed_share)
            figures.draw(spoilt, names, folder)
            done(i + 1)
    if any(run.score.error_share is not None for run in runs):
        figures.draw_boxes(runs, folder / "errors.png")


def _tell(runs: list[Run], skipped: list[str], as_json: bool) -> None:
    from solenav.comparison import table

    if as_json:
        say_json({"runs": table.records(runs), "summary": table.summary(runs), "left_out": skipped})
        return
    terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns if terminal else _PIPE_COLUMNS
    console = Console(width=width)
    for sheet in table.sheets(runs):
        for part in table.to_rich(sheet, width):
            console.print(part)
    unknown = {run.recording for run in runs if run.score.kind is None}
    if unknown:
        say(f"neither truth nor a closed loop, so no error, in {', '.join(sorted(unknown))}")


def _list(as_json: bool) -> None:
    """The registry: what there is, which aids it takes, and where it is from."""
    from solenav.filters import FILTERS

    if as_json:
        say_json(
            {
                "filters": [
                    {"name": f.name, "about": f.about, "aids": f.aids, "source": _source(f)}
                    for f in FILTERS.values()
                ]
            }
        )
        return
    for one in FILTERS.values():
        aids = f"  (+{', +'.join(one.aids)})" if one.aids else ""
        say(f"{one.name:12} {one.about}{aids}")
    sources: dict[str, list[str]] = {}
    for one in FILTERS.values():
        sources.setdefault(_source(one), []).append(one.name)
    for source, filters in sources.items():
        say(f"\n{', '.join(filters)}:\n{source}")


def _source(one: Filter) -> str:
    """The docstring of the module that a filter is written in: what it is and who had it first."""
    function = one.run.func if isinstance(one.run, partial) else one.run
    module = inspect.getmodule(function)
    return inspect.getdoc(module) or "" if module else ""
