"""Pictures of how well motions are told apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from solenav.modes.labels import MODES
from solenav.modes.training import Judgement
from solenav.plotting import INK, sheet


def draw_confusion(found: Mapping[str, Judgement], out: Path) -> None:
    """A panel for each judgement: shares of each label's windows, and their numbers."""
    with sheet(out, (5.4 * len(found), 4.6), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        panels = figure.subplots(1, len(found), squeeze=False)[0]
        for panel, (title, judgement) in zip(panels, found.items(), strict=True):
            counts = judgement.confusion
            totals = np.maximum(counts.sum(axis=1, keepdims=True), 1)
            panel.imshow(counts / totals, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
            answers = [*MODES, "unknown"]
            panel.set_xticks(range(len(answers)), answers, rotation=30, ha="right")
            panel.set_yticks(range(len(MODES)), MODES)
            panel.set_xlabel("taken for")
            panel.set_ylabel("label")
            panel.grid(False)
            panel.set_title(f"{title}: {100 * judgement.right:.1f} % of {judgement.windows}")
            for row, column in np.argwhere(counts).tolist():
                light = counts[row, column] > 0.6 * totals[row, 0]
                panel.text(
                    column,
                    row,
                    str(counts[row, column]),
                    ha="center",
                    va="center",
                    color="white" if light else INK,
                )
