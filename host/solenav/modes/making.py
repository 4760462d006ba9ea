"""A forest from labelled captures, and what it makes of others: `solenav modes`."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from solenav import forests
from solenav.capture.contents import Capture
from solenav.errors import SolenavError
from solenav.modes import training
from solenav.modes.training import Examples, Growth, Judgement
from solenav.progress import Progress, unseen
from solenav_core.layout import FEATURES


@dataclass(frozen=True)
class Trained:
    """A forest (`words`, as the core walks it), what it was trained on, and how well it does.

    `judgements` by the way in which windows were kept from the forest that judges them.
    """

    words: array[int]
    trained_on: tuple[str, ...]
    simulated: int
    growth: Growth
    judgements: dict[str, Judgement]

    def save(self, path: Path | str) -> None:
        """Into a file, and what is known of it into NAME.json beside. SolenavError: it can't be."""
        forests.save(Path(path), self.words, self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """All but the words, for JSON."""
        return {
            "trained_on": list(self.trained_on),
            "simulated": self.simulated,
            "growth": asdict(self.growth),
            "features": FEATURES,
            "words": len(self.words),
            "judgements": {name: one.as_dict() for name, one in self.judgements.items()},
        }


def train(
    captures: Sequence[Capture] = (),
    *,
    simulated: int = 0,
    growth: Growth | None = None,
    progress: Progress = unseen,
) -> Trained:
    """Grow a forest on captures with labels of motion and on simulated walks; judge it.

    `simulated`: people on each of the simulated courses. Cross validation over windows has each
    walk on both sides; leaving out recordings hasn't. SolenavError where a capture has no labels,
    where there are no two motions or too few windows of one, and where numba or scikit-learn is
    missing.
    """
    growth = growth or Growth()
    real = _examples(captures, None, progress)
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
    return Trained(words, tuple(one.name for one in real), simulated, growth, found)


def evaluate(
    captures: Sequence[Capture],
    forest: array[int] | None = None,
    *,
    progress: Progress = unseen,
) -> dict[str, Judgement]:
    """What a forest (None: the shipped one) makes of labelled captures.

    "each window" alone, and "motion held" by the core from one to the next. SolenavError without
    captures, where one has no labels, and where numba is missing.
    """
    words = training.shipped() if forest is None else forest
    data = _examples(captures, words, progress)
    if not data:
        raise SolenavError("nothing to judge by", "name captures with labels beside them")
    return {
        "each window": training.judge(words, data),
        "motion held": training.judge_held(data),
    }


def _examples(
    captures: Sequence[Capture], words: array[int] | None, progress: Progress
) -> list[Examples]:
    found = []
    with progress("reading", len(captures)) as done:
        for i, one in enumerate(captures, 1):
            found.append(training.from_capture(one, words))
            done(i)
    return found
