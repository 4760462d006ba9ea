"""Random forests as the core walks them: packed into words, and those words as its table.

The words' layout, and what the features are, stand in `solenav_core.forest` and `.features`; what
they were trained on is nothing to the core, which knows a forest by its CRC-32 (HELLO's `forest`).
"""

from __future__ import annotations

import json
from array import array
from binascii import crc32
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import byteorder
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.errors import SolenavError, unreadable, unwritable
from solenav_core import forest
from solenav_core.layout import CLASSES, FEATURES

_PER_LINE = 16


@dataclass(frozen=True)
class Leaf:
    """Weights, 0 to 63, of the motions but unknown, as in `forest.MOTIONS`; best they sum to 63."""

    weights: tuple[int, ...]


@dataclass(frozen=True)
class Split:
    """`left` where the feature is at most `threshold`, else `right`."""

    feature: int
    threshold: int
    left: Tree
    right: Tree


Tree = Split | Leaf


def pack(trees: Sequence[Tree]) -> array[int]:
    """The forest as words. SolenavError where it is too large or a number of it won't fit."""
    bodies = [list(_words(tree)) for tree in trees]
    words = [len(bodies)]
    at = 1 + len(bodies)
    for body in bodies:
        words.append(at)
        at += len(body)
    found = array("i", words + [word for body in bodies for word in body])
    wrong = forest.objection(found)
    if wrong:
        raise SolenavError(f"the forest doesn't fit the core: {wrong}", _SMALLER)
    return found


_SMALLER = "train fewer or less deep trees"
_ANEW = "train it anew with this version: another one's core may have other features"


def _words(tree: Tree) -> Iterator[int]:
    """The tree's nodes in preorder."""
    if isinstance(tree, Leaf):
        if len(tree.weights) != CLASSES or not all(0 <= w <= 63 for w in tree.weights):
            raise SolenavError(
                f"a leaf's weights {tree.weights} are not {CLASSES} numbers of 0 to 63",
                "scale them before packing",
            )
        yield sum(w << (6 * i) for i, w in enumerate(tree.weights)) - 2**30
        return
    left = list(_words(tree.left))
    if not 0 <= tree.feature < FEATURES or not -4096 <= tree.threshold <= 4095:
        raise SolenavError(
            f"a split of feature {tree.feature} at {tree.threshold}: there are {FEATURES}, of "
            "-4096 to 4095",
            "train on the features that the core gives",
        )
    if len(left) + 1 > 2047:
        raise SolenavError(f"a split's left side has {len(left)} nodes, over 2046", _SMALLER)
    yield tree.feature | (tree.threshold + 4096) << 6 | (len(left) + 1) << 19
    yield from left
    yield from _words(tree.right)


def check(words: Sequence[int]) -> None:
    """SolenavError where words are no forest that the core can walk."""
    wrong = forest.objection(words)
    if wrong:
        raise SolenavError(f"no forest: {wrong}", _ANEW)


def unpack(words: Sequence[int]) -> list[Tree]:
    """The trees of a forest's words. SolenavError where they are none."""
    check(words)
    return [_tree(words, words[1 + i])[0] for i in range(words[0])]


def _tree(words: Sequence[int], at: int) -> tuple[Tree, int]:
    """The tree whose first node is at `at`, and the place after its last."""
    node = words[at]
    if node < 0:
        return Leaf(tuple((node >> (6 * i)) & 63 for i in range(CLASSES))), at + 1
    left, at = _tree(words, at + 1)
    right, at = _tree(words, at)
    return Split(node & 63, (node >> 6 & 8191) - 4096, left, right), at


def scores(words: array[int], features: NDArray[np.int64]) -> NDArray[np.int64]:
    """What the core's walk of a sound forest gives for features (k, 56): weights (k, 5)."""
    nodes = np.array(words, np.int64)
    rows = np.arange(len(features))
    total = np.zeros((len(features), CLASSES), np.int64)
    for first in words[1 : 1 + words[0]]:
        at = np.full(len(features), first)
        while True:
            node = nodes[at]
            split = node >= 0
            if not split.any():
                break
            left = features[rows, np.where(split, node & 63, 0)] <= (node >> 6 & 8191) - 4096
            at = np.where(split, at + np.where(left, 1, node >> 19), at)
        total += np.stack([(node >> (6 * i)) & 63 for i in range(CLASSES)], axis=1)
    return total


def from_bytes(data: bytes) -> array[int]:
    """A forest's words from a file of them, little-endian. SolenavError where they are none."""
    if len(data) % 4:
        raise SolenavError(f"no forest: {len(data)} bytes are no whole words", _ANEW)
    words = array("i", data)
    if byteorder == "big":
        words.byteswap()
    check(words)
    return words


def load(path: Path | str) -> array[int]:
    """A forest's words from a file. SolenavError where there is none in it, or another core's.

    Of which core it is only the file beside it tells, if there is one.
    """
    path = Path(path)
    try:
        words = from_bytes(path.read_bytes())
    except OSError as error:
        raise unreadable(path, error) from None
    except SolenavError as error:
        raise SolenavError(f"{path}: {error.message}", error.remedy) from None
    features = _about(path).get("features", FEATURES)
    if features != FEATURES:
        raise SolenavError(
            f"{path} was trained on {features} features, and this core has {FEATURES}", _ANEW
        )
    return words


def save(path: Path, words: array[int], about: dict[str, Any] | None = None) -> None:
    """A forest's words into a file, little-endian, and `about` it into NAME.json beside.

    SolenavError where they can't be written.
    """
    little = array("i", words)
    if byteorder == "big":
        little.byteswap()
    try:
        path.write_bytes(little.tobytes())
        if about is not None:
            text = json.dumps(about, indent=2) + "\n"
            path.with_suffix(".json").write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable(path, error) from None


def export(path: Path | str, output: Path | str) -> array[int]:
    """Write a forest's file as the table that core and firmware ship; its words.

    SolenavError where it holds no forest of this core, or the file beside it isn't what
    `solenav modes train` writes, and where the table can't be written.
    """
    path, output = Path(path), Path(output)
    words = load(path)
    text = table(words, _trained_on(path))
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable(output, error) from None
    return words


def _about(forest: Path) -> dict[str, Any]:
    """What the file beside a forest says of it; {} where there is none."""
    path = forest.with_suffix(".json")
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise _unclear(path, error) from None
    if not isinstance(about, dict):
        raise _unclear(path, "no object")
    return about


def _trained_on(forest: Path) -> str:
    """A line on what a forest was trained on, from the file beside it."""
    about = _about(forest)
    if not about:
        return "What it was trained on isn't known."
    try:
        growth, real, made = about["growth"], about["trained_on"], about["simulated"]
        grown = f"depth {growth['depth']}, leaf {growth['leaf']}, seed {growth['seed']}"
    except (KeyError, TypeError) as error:
        raise _unclear(forest.with_suffix(".json"), error) from None
    parts = [f"{len(real)} recordings"] * bool(real)
    parts += [f"{made} people on each simulated course"] * bool(made)
    return f"Trained on {' and '.join(parts)}; {grown}."


def _unclear(path: Path, why: object) -> SolenavError:
    return SolenavError(
        f"{path} doesn't say what the forest was trained on: {why}", "delete it, or train anew"
    )


def table(words: array[int], about: str) -> str:
    """The text of `solenav_core/tables/forest.py`; `about`: a line on what it was trained on."""
    data = words.tobytes()
    lines = [
        '"""The forest that tells motions apart, as words (forest.py).',
        "",
        about,
        f"{words[0]} trees, {len(words)} words, CRC-32 0x{crc32(data):08x}. Written by",
        "`solenav modes export`: do not edit.",
        '"""',
        "",
        "FOREST = (",
    ]
    return "\n".join([*lines, *literal(data), ")", ""])


def literal(data: bytes) -> list[str]:
    """The lines of a bytes literal, indented once: what a board loads in the least room."""
    return [
        '    b"' + "".join(f"\\x{byte:02x}" for byte in data[at : at + _PER_LINE]) + '"'
        for at in range(0, len(data), _PER_LINE)
    ]
