"""Random forests as the core walks them: packed into words, and those words as its table.

The words' layout, and what the features are, stand in `solenav_core.forest` and `.features`; what
they were trained on is nothing to the core, which knows a forest by its CRC-32 (HELLO's `forest`).
"""

from __future__ import annotations

from array import array
from binascii import crc32
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import byteorder

import numpy as np
from numpy.typing import NDArray

from solenav.errors import SolenavError
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


def load(path: Path) -> array[int]:
    """A forest's words from a file. SolenavError where there is none in it."""
    try:
        return from_bytes(path.read_bytes())
    except OSError as error:
        raise SolenavError(f"can't read {path}: {error.strerror}", "check its name") from None
    except SolenavError as error:
        raise SolenavError(f"{path}: {error.message}", error.remedy) from None


def save(path: Path, words: array[int]) -> None:
    """A forest's words into a file, little-endian. SolenavError where it can't be written."""
    little = array("i", words)
    if byteorder == "big":
        little.byteswap()
    try:
        path.write_bytes(little.tobytes())
    except OSError as error:
        raise SolenavError(f"can't write {path}: {error.strerror}", "choose another file") from None


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
    for at in range(0, len(data), _PER_LINE):
        escaped = "".join(f"\\x{byte:02x}" for byte in data[at : at + _PER_LINE])
        lines.append(f'    b"{escaped}"')
    return "\n".join([*lines, ")", ""])
