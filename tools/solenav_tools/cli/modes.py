"""`solenav modes`: train, judge and ship the forest that tells motions apart."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from solenav import forests
from solenav.capture import Capture, load
from solenav.errors import SolenavError
from solenav.modes.labels import MODES
from solenav_tools.cli.arguments import Baud, PortOption, forest_from
from solenav_tools.cli.output import Json, check_output, progress, say, say_json, tell
from solenav_tools.forest_upload import send as put
from solenav_tools.ports import chosen_port

if TYPE_CHECKING:
    # It needs numba, which the other commands do without.
    from solenav.modes.training import Judgement

app = typer.Typer(help="The forest that tells motions apart.", no_args_is_help=True)
SUFFIX = ".forest"
Captures = Annotated[
    list[Path] | None,
    typer.Argument(help="Captures with labels (NAME.modes.csv) beside them.", metavar="CAPTURE..."),
]
Forest = Annotated[
    Path | None, typer.Option(help=f"A forest ({SUFFIX}); default: the shipped one.")
]
Figure = Annotated[Path | None, typer.Option(help="PNG of the confusion to draw.")]


@app.command()
def train(
    output: Annotated[Path, typer.Option("-o", "--output", help=f"Forest to write ({SUFFIX}).")],
    files: Captures = None,
    simulated: Annotated[
        int, typer.Option(min=0, help="People on each simulated course, to train on as well.")
    ] = 0,
    trees: Annotated[int, typer.Option(min=1, max=64, help="Trees.")] = 16,
    depth: Annotated[int, typer.Option(min=1, max=16, help="Splits from root to leaf.")] = 6,
    leaf: Annotated[int, typer.Option(min=1, help="The fewest windows in a leaf.")] = 3,
    seed: Annotated[int, typer.Option(help="Of the forest's randomness.")] = 1,
    figure: Figure = None,
    as_json: Json = False,
) -> None:
    """Grow a forest on labelled captures and simulated walks; say how it does on unseen ones.

    Cross validation over windows has each walk on both sides; leaving out recordings hasn't.
    """
    _need_numba()
    from solenav.modes import making
    from solenav.modes.training import Growth

    check_output(output, SUFFIX)
    if figure is not None:
        check_output(figure, ".png")
    trained = making.train(
        _captures(files),
        simulated=simulated,
        growth=Growth(trees, depth, leaf, seed),
        progress=progress,
    )
    trained.save(output)
    result = {"forest": str(output), **trained.as_dict()}
    _report(trained.judgements, figure, result, as_json)
    size = f"{trained.words[0]} trees, {len(trained.words)} words"
    tell(f"{output}: {size}; `solenav modes send` takes it to a board")


@app.command()
def evaluate(
    files: Captures = None,
    forest: Forest = None,
    figure: Figure = None,
    as_json: Json = False,
) -> None:
    """What a forest makes of labelled captures, window by window and as the core holds it.

    Exit code 1: less than 97 % of the windows are right.
    """
    _need_numba()
    from solenav.modes import making

    if figure is not None:
        check_output(figure, ".png")
    found = making.evaluate(_captures(files), forest_from(forest), progress=progress)
    shown = {name: one.as_dict() for name, one in found.items()}
    _report(found, figure, {"judgements": shown}, as_json)
    if found["each window"].right < GOAL:
        raise typer.Exit(1)


GOAL = 0.97
"""So many windows should be right on recordings that the forest hasn't seen."""


@app.command()
def export(
    forest: Annotated[Path, typer.Argument(help=f"A forest ({SUFFIX}).", metavar="FOREST")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The core's table to write (.py).")
    ],
) -> None:
    """Write a forest as the table that core and firmware ship (solenav_core/tables/forest.py)."""
    check_output(output, ".py")
    words = forests.export(forest, output)
    say(f"{output}: {words[0]} trees, {len(words)} words")


@app.command()
def send(
    forest: Annotated[
        Path | None,
        typer.Argument(help=f"A forest ({SUFFIX}).", metavar="FOREST", show_default=False),
    ] = None,
    port: PortOption = None,
    shipped: Annotated[
        bool, typer.Option("--shipped", help="Back to the forest in the board's firmware.")
    ] = False,
    restart: Annotated[
        bool, typer.Option("--restart", help="End the board's run, and begin a fresh one with it.")
    ] = False,
    baud: Baud = None,
    as_json: Json = False,
) -> None:
    """Send a forest to a board, which checks it, keeps it in flash and says that it has it.

    A board that samples takes none. Exit code 1: the board refuses, or something was lost.
    """
    if (forest is None) != shipped:
        raise SolenavError("which forest?", "name a file, or say --shipped")
    words = forest_from(forest)
    sent = put(chosen_port(port), words, restart=restart, baud=baud, progress=progress)
    if as_json:
        say_json(sent.as_dict())
        return
    own = "the shipped one" if sent.shipped else "its firmware's own"
    what = f"{words[0]} trees, {len(words)} words" if words else own
    say(f"{sent.port}: {sent.board}")
    say(f"forest before {sent.had:08x}, now {sent.has:08x} ({what}), as HELLO says")
    say("a fresh run has begun with it" if restart else "it holds from the board's next run on")


def _captures(files: list[Path] | None) -> list[Capture]:
    unique = {file.resolve(): file for file in files or []}.values()
    return [load(file) for file in unique]


def _report(
    found: dict[str, Judgement], figure: Path | None, result: dict[str, Any], as_json: bool
) -> None:
    if figure is not None:
        from solenav.modes.figures import draw_confusion

        draw_confusion(found, figure)
    if as_json:
        say_json(result)
        return
    say(f"{'':24} {'windows':>8} {'right':>8}  " + " ".join(f"{mode:>10}" for mode in MODES))
    for name, one in found.items():
        shares = (one.recall[mode] for mode in MODES)
        parts = " ".join(f"{'-':>10}" if r is None else f"{100 * r:8.1f} %" for r in shares)
        say(f"{name:24} {one.windows:8} {100 * one.right:6.2f} %  {parts}")


def _need_numba() -> None:
    if not find_spec("numba"):
        raise SolenavError("telling motions apart needs numba", "pip install 'solenav[fast]'")
