"""Training of the forest that tells motions apart, and how well it does on what it hasn't seen.

The features are the core's own, from its kernels, and so are the windows; scikit-learn's random
forest (Breiman 2001) grows the trees, which are turned into the core's integer words. What is
judged is always those words, as the core walks them: `Windows.scores`, compared in a test.

Windows of one walk are much alike, so that cross validation over windows shows little: the same
walk, person and sensor are on both sides. Leaving out whole recordings shows more.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import forests, importing
from solenav.capture.contents import Capture
from solenav.engines.windows import Windows, windows
from solenav.errors import SolenavError
from solenav.evaluation import last_run
from solenav.forests import Leaf, Split, Tree
from solenav.modes.labels import MODES, Label, labels_path
from solenav.recording import FloatArray, Recording
from solenav.sim.scenario import simulate
from solenav_core import params as core
from solenav_core.layout import CLASSES, FEATURES
from solenav_core.tables.forest import FOREST

IntArray = NDArray[np.int64]
COURSES = ("run", "stairs", "modes")
"""Simulated scenarios with every motion in them."""
_WEIGHT = 63
_THRESHOLDS = (-4096, 4095)
_STRIDE = core.NAMES.index("MOTION_STRIDE")
_SAMPLES = 128  # of a window


@dataclass(frozen=True)
class Examples:
    """A recording's windows whose motion is certain.

    `name` the recording's; `features` (k, 56) as the core has them; `mode` (k,) index into
    `MODES`; `held` (k,) the motion that the core held from then on, index into `forest.MOTIONS`.
    `group` is what is left out together: the two feet of one walk have the same.
    """

    name: str
    group: str
    features: IntArray
    mode: IntArray
    held: IntArray

    def __len__(self) -> int:
        return len(self.mode)


@dataclass(frozen=True)
class Growth:
    """How a forest is grown. Every mode counts the same, however many windows it has."""

    trees: int = 16
    depth: int = 6
    leaf: int = 3
    """The fewest windows in a leaf."""
    seed: int = 1


@dataclass(frozen=True)
class Judgement:
    """What became of windows: `confusion` (5, 6), rows the labels, columns the answers.

    Both in the order of `MODES`; the last column is unknown.
    """

    confusion: IntArray

    @property
    def windows(self) -> int:
        return int(self.confusion.sum())

    @property
    def right(self) -> float:
        """Share of the windows whose motion is right; NaN without any."""
        return float(np.trace(self.confusion)) / self.windows if self.windows else float("nan")

    @property
    def recall(self) -> dict[str, float | None]:
        """Of each mode's windows the share that is right; None where it has none."""
        totals = self.confusion.sum(axis=1).tolist()
        rights = np.diag(self.confusion).tolist()
        return {
            mode: right / total if total else None
            for mode, right, total in zip(MODES, rights, totals, strict=True)
        }

    def as_dict(self) -> dict[str, Any]:
        return {
            "windows": self.windows,
            "right": self.right,
            "recall": self.recall,
            "confusion": self.confusion.tolist(),
        }


def from_capture(capture: Capture, forest: array[int] | None = None) -> Examples:
    """The labelled windows of a capture's last run; `forest` replaces the shipped one.

    SolenavError without samples, without labels, and where no window lies within a label.
    """
    capture.need_samples()
    if not capture.modes:
        raise SolenavError(
            f"{capture.path} has no labels of motion",
            f"put a table {labels_path(capture.path).name} beside it: start_s,end_s,mode",
        )
    run, _restarts = last_run(capture)
    params = run.params[-1][1]
    return examples(run.sample_counts, params, capture.modes, capture.path.stem, forest=forest)


def from_recording(recording: Recording, forest: array[int] | None = None) -> Examples:
    """The labelled windows of a recording in SI units. SolenavError as `from_capture`."""
    samples, _counted = importing.samples_of(recording)
    params = importing.parameters_of(recording)
    return examples(samples.words, params, recording.modes, recording.name, forest=forest)


def simulated(count: int, *, first_seed: int = 1) -> list[Examples]:
    """`count` of each of the simulated courses; every seed is another person."""
    return [
        from_recording(simulate(course, seed=seed))
        for course in COURSES
        for seed in range(first_seed, first_seed + count)
    ]


def examples(
    counts: NDArray[np.int16],
    params: array[int],
    labels: Sequence[Label],
    name: str,
    *,
    forest: array[int] | None = None,
) -> Examples:
    """The windows of `counts` (n, 6 or 10) that lie within one label each.

    SolenavError where there is none.
    """
    found = windows(counts, params, forest=forest)
    mode = _mode_of(found, labels, params)
    certain = mode >= 0
    if not certain.any():
        raise SolenavError(
            f"{name}: no window of motion lies within a label",
            f"a window is {_SAMPLES * params[_STRIDE] / (params[0] / 1000):.2f} s long, and there "
            "are none before the static start: label longer stretches",
        )
    return Examples(
        name,
        _group(name),
        found.features[certain].astype(np.int64),
        mode[certain],
        found.motion[certain].astype(np.int64),
    )


def _group(name: str) -> str:
    """A recording's name without its foot."""
    for foot in ("left", "right"):
        name = name.removesuffix(f"_{foot}").removesuffix(f"-{foot}")
    return name


def _mode_of(found: Windows, labels: Sequence[Label], params: array[int]) -> IntArray:
    """(k,) index into MODES of the label that a window lies within, else -1."""
    rate_hz = params[0] / 1000
    end = found.last / rate_hz
    start = (found.last + 1 - _SAMPLES * params[_STRIDE]) / rate_hz
    mode = np.full(len(end), -1, np.int64)
    for label in labels:
        mode[(start >= label.start_s) & (end <= label.end_s)] = MODES.index(label.mode)
    return mode


def train(data: Sequence[Examples], growth: Growth | None = None) -> array[int]:
    """A forest on all windows of `data`, as the core's words.

    SolenavError without windows of two modes, where the forest doesn't fit the core, and where
    scikit-learn is missing.
    """
    growth = growth or Growth()
    features, mode = _together(data)
    if len(np.unique(mode)) < 2:
        raise SolenavError(
            "there are no two motions to tell apart",
            "give recordings with labels of several, or --simulated",
        )
    grown = _sklearn("ensemble").RandomForestClassifier(
        growth.trees,
        # By Gini's measure as many trees do worse on simulated people they haven't met.
        criterion="entropy",
        max_depth=growth.depth,
        min_samples_leaf=growth.leaf,
        class_weight="balanced",
        random_state=growth.seed,
    )
    grown.fit(features, mode)
    classes = grown.classes_.tolist()
    return forests.pack([_tree(one.tree_, classes) for one in grown.estimators_])


def judge(words: array[int], data: Iterable[Examples]) -> Judgement:
    """What the forest makes of each window alone, by the largest score, the first of equals."""
    confusion = _nothing()
    for one in data:
        found = forests.scores(words, one.features).argmax(axis=1)
        np.add.at(confusion, (one.mode, found), 1)
    return Judgement(confusion)


def judge_held(data: Iterable[Examples]) -> Judgement:
    """The same of the motion that the core held after each window: vote and hysteresis count."""
    confusion = _nothing()
    for one in data:
        # Unknown, 0, is the last column.
        np.add.at(confusion, (one.mode, one.held - 1), 1)
    return Judgement(confusion)


def cross_validate(data: Sequence[Examples], growth: Growth, folds: int = 10) -> Judgement:
    """Every window judged by a forest grown on the other folds, each mode spread evenly over all.

    SolenavError as `train`, and where a mode has fewer windows than there are folds.
    """
    features, mode = _together(data)
    counts = np.bincount(mode, minlength=CLASSES)
    few = [MODES[i] for i in range(CLASSES) if 0 < counts[i] < folds]
    if few:
        raise SolenavError(
            f"{few[0]} has {counts[MODES.index(few[0])]} windows, too few for {folds} folds",
            "add recordings of it, or --simulated",
        )
    splitter = _sklearn("model_selection").StratifiedKFold(folds, shuffle=True, random_state=1)
    confusion = _nothing()
    for known, left in splitter.split(features, mode):
        words = train([_part(features[known], mode[known])], growth)
        confusion += judge(words, [_part(features[left], mode[left])]).confusion
    return Judgement(confusion)


def leave_out(
    data: Sequence[Examples],
    growth: Growth,
    always: Sequence[Examples] = (),
    progress: Callable[[int], None] = lambda done: None,
) -> Judgement:
    """Every group of `data` judged by a forest grown on the others and on `always`.

    `progress` gets the groups done. SolenavError as `train`.
    """
    confusion = _nothing()
    for done, group in enumerate(dict.fromkeys(one.group for one in data), 1):
        words = train([*always, *(one for one in data if one.group != group)], growth)
        confusion += judge(words, [one for one in data if one.group == group]).confusion
        progress(done)
    return Judgement(confusion)


def shipped() -> array[int]:
    """The forest that ships with the core."""
    return forests.from_bytes(FOREST)


def _nothing() -> IntArray:
    return np.zeros((CLASSES, CLASSES + 1), np.int64)


def _part(features: IntArray, mode: IntArray) -> Examples:
    return Examples("", "", features, mode, np.zeros_like(mode))


def _together(data: Sequence[Examples]) -> tuple[IntArray, IntArray]:
    """The windows of all examples: features (n, 56), mode (n,)."""
    if not data:
        return np.zeros((0, FEATURES), np.int64), np.zeros(0, np.int64)
    return (
        np.concatenate([one.features for one in data]),
        np.concatenate([one.mode for one in data]),
    )


def _tree(grown: Any, classes: Sequence[int], node: int = 0) -> Tree:
    """scikit-learn's tree from `node` on, in the core's numbers.

    Features are whole numbers, so a threshold between two of them says the same rounded down.
    """
    if grown.children_left[node] < 0:
        return Leaf(_weights(grown.value[node, 0], classes))
    low, high = _THRESHOLDS
    left = _tree(grown, classes, grown.children_left[node])
    right = _tree(grown, classes, grown.children_right[node])
    if left == right:
        return left
    threshold = min(max(math.floor(grown.threshold[node]), low), high)
    return Split(int(grown.feature[node]), threshold, left, right)


def _weights(shares: FloatArray, classes: Sequence[int]) -> tuple[int, ...]:
    """A leaf's shares of the modes as whole numbers that sum to 63: by the largest remainders."""
    exact = np.zeros(CLASSES)
    exact[list(classes)] = shares / shares.sum() * _WEIGHT
    whole = np.floor(exact)
    missing = _WEIGHT - int(whole.sum())
    for i in np.argsort(whole - exact, kind="stable")[:missing]:
        whole[i] += 1
    return tuple(int(weight) for weight in whole)


def _sklearn(module: str) -> Any:
    try:
        return import_module(f"sklearn.{module}")
    except ImportError:
        raise SolenavError("training needs scikit-learn", "pip install 'solenav[modes]'") from None
