"""`solenav modes`: train, judge and ship the forest that tells motions apart."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from solenav import capture
from solenav.errors import SolenavError
from solenav.modes.labels import MODES
from solenav_tools.cli.output import (
    Json,
    check_output,
    progress,
    say,
    say_json,
    tell,
    write_text,
)

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
    training.save(output, words)
    about: dict[str, Any] = {
        "trained_on": [one.name for one in real],
        "simulated": simulated,
        "growth": {"trees": trees, "depth": depth, "leaf": leaf, "seed": seed},
        "words": len(words),
        "judgements": {name: one.as_dict() for name, one in found.items()},
    }
    write_text(output.with_suffix(".json"), json.dumps(about, indent=2) + "\n")
    _report(found, figure, {"forest": str(output), **about}, as_json)
    tell(f"{output}: {words[0]} trees, {len(words)} words; `solenav modes export` ships it")


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
    words = training.load(forest) if forest is not None else training.shipped()
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
    from solenav import forests
    from solenav.modes import training

    words = training.load(forest)
    check_output(output, ".py")
    write_text(output, forests.table(words, _about(forest)))
    say(f"{output}: {words[0]} trees, {len(words)} words")


def _about(forest: Path) -> str:
    """A line on what a forest was trained on, from the file beside it."""
    path = forest.with_suffix(".json")
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        growth, real, made = about["growth"], about["trained_on"], about["simulated"]
        grown = f"depth {growth['depth']}, leaf {growth['leaf']}, seed {growth['seed']}"
    except FileNotFoundError:
        return "What it was trained on isn't known."
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SolenavError(
            f"{path} doesn't say what the forest was trained on: {error}",
            "delete it, or train anew",
        ) from None
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
