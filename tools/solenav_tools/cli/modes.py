"""`solenav modes`: train, judge and ship the forest that tells motions apart."""

from __future__ import annotations

import json
from array import array
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from solenav import capture, forests
from solenav.errors import SolenavError
from solenav.modes.labels import MODES
from solenav_core.layout import FEATURES
from solenav_tools.cli.arguments import Baud
from solenav_tools.cli.output import (
    Json,
    check_output,
    progress,
    say,
    say_json,
    tell,
    write_text,
)
from solenav_tools.forest_upload import send as put
from solenav_tools.ports import chosen_port, known_names

if TYPE_CHECKING:
    # It needs numba, which the other commands do without.
    from solenav.modes.training import Examples, Judgement

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
    trees: Annotated[int, typer.Option(min=1, max=64, help="Trees.")] = 32,
    depth: Annotated[int, typer.Option(min=1, max=16, help="Splits from root to leaf.")] = 5,
    leaf: Annotated[int, typer.Option(min=1, help="The fewest windows in a leaf.")] = 3,
    seed: Annotated[int, typer.Option(help="Of the forest's randomness.")] = 1,
    figure: Figure = None,
    as_json: Json = False,
) -> None:
    """Grow a forest on labelled captures and simulated walks; say how it does on unseen ones.

    Cross validation over windows has each walk on both sides; leaving out recordings hasn't.
    """
    _need_numba()
    from solenav.modes import training

    check_output(output, SUFFIX)
    if figure is not None:
        check_output(figure, ".png")
    growth = training.Growth(trees, depth, leaf, seed)
    real = _examples(files or [])
    with progress("simulating", 1) as done:
        made = training.simulated(simulated)
        done(1)
    data = [*real, *made]
    words = training.train(data, growth)
    found = {"10 folds of windows": training.cross_validate(data, growth)}
    if len({one.group for one in data}) > 1:
        left_out = real or made
        with progress("leaving out recordings", len({one.group for one in left_out})) as done:
            always = made if real else []
            found["recordings left out"] = training.leave_out(left_out, growth, always, done)
    if real and made:
        alone = training.train(made, growth)
        found["simulated walks alone"] = training.judge(alone, real)
    forests.save(output, words)
    about: dict[str, Any] = {
        "trained_on": [one.name for one in real],
        "simulated": simulated,
        "growth": {"trees": trees, "depth": depth, "leaf": leaf, "seed": seed},
        "features": FEATURES,
        "words": len(words),
        "judgements": {name: one.as_dict() for name, one in found.items()},
    }
    write_text(output.with_suffix(".json"), json.dumps(about, indent=2) + "\n")
    _report(found, figure, {"forest": str(output), **about}, as_json)
    tell(
        f"{output}: {words[0]} trees, {len(words)} words; `solenav modes send` puts it into a board"
    )


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
    from solenav.modes import training

    if figure is not None:
        check_output(figure, ".png")
    words = training.shipped() if forest is None else _forest(forest)
    data = _examples(files or [], words)
    if not data:
        raise SolenavError("nothing to judge by", "name captures with labels beside them")
    found = {
        "each window": training.judge(words, data),
        "motion held": training.judge_held(data),
    }
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
    words = _forest(forest)
    check_output(output, ".py")
    write_text(output, forests.table(words, _trained_on(forest)))
    say(f"{output}: {words[0]} trees, {len(words)} words")


@app.command()
def send(
    forest: Annotated[
        Path | None,
        typer.Argument(help=f"A forest ({SUFFIX}).", metavar="[FOREST]", show_default=False),
    ] = None,
    port: Annotated[
        str | None,
        typer.Option(
            help="Serial port of the board, or its name in solenav.toml; default: the only one.",
            autocompletion=lambda: known_names(),
            show_default=False,
        ),
    ] = None,
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
    words = None if forest is None else _forest(forest)
    sent = put(chosen_port(port), words, restart=restart, baud=baud, progress=progress)
    if as_json:
        say_json(sent.as_dict())
        return
    own = "the shipped one" if sent.shipped else "its firmware's own"
    what = f"{words[0]} trees, {len(words)} words" if words else own
    say(f"{sent.port}: {sent.board}")
    say(f"forest before {sent.had:08x}, now {sent.has:08x} ({what}), as HELLO says")
    say("a fresh run has begun with it" if restart else "it holds from the board's next run on")


def _forest(path: Path) -> array[int]:
    """The words in a forest's file. SolenavError where it is none, or one for another core."""
    words = forests.load(path)
    about = _about(path)
    count = about.get("features", FEATURES) if isinstance(about, dict) else FEATURES
    if count != FEATURES:
        raise SolenavError(
            f"{path} was trained on {count} features, and this core has {FEATURES}",
            "train it anew with this version",
        )
    return words


def _about(forest: Path) -> Any:
    """What the file beside a forest says of it; None where there is none."""
    path = forest.with_suffix(".json")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise _unclear(path, error) from None


def _unclear(path: Path, error: Exception) -> SolenavError:
    text = f"{path} doesn't say what the forest was trained on: {error}"
    return SolenavError(text, "delete it, or train anew")


def _trained_on(forest: Path) -> str:
    """A line on what a forest was trained on, from the file beside it."""
    about = _about(forest)
    if about is None:
        return "What it was trained on isn't known."
    try:
        growth, real, made = about["growth"], about["trained_on"], about["simulated"]
        grown = f"depth {growth['depth']}, leaf {growth['leaf']}, seed {growth['seed']}"
    except (KeyError, TypeError) as error:
        raise _unclear(forest.with_suffix(".json"), error) from None
    parts = [f"{len(real)} recordings"] * bool(real)
    parts += [f"{made} people on each simulated course"] * bool(made)
    return f"Trained on {' and '.join(parts)}; {grown}."


def _examples(files: list[Path], words: Any = None) -> list[Examples]:
    from solenav.modes import training

    unique = list({file.resolve(): file for file in files}.values())
    found = []
    with progress("reading", len(unique)) as done:
        for i, file in enumerate(unique):
            found.append(training.from_capture(capture.load(file), words))
            done(i + 1)
    return found


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
