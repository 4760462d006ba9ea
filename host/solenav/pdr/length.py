"""Step length from frequency and variance: L = a f + b v + c, first generic, then one's own.

Adaptation is linear least squares from stretches of known length, with the generic coefficients
as a prior of some steps' weight, so that the first stretch doesn't throw them over.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solenav.pdr.steps import Steps
from solenav.recording import FloatArray

SPREAD = 0.10
"""Deviation of a step's length, as a share."""
SHORTEST_M, LONGEST_M = 0.25, 1.2


@dataclass(frozen=True)
class LengthModel:
    """`coefficients` (3,): a m/Hz, b m/(m/s²)², c m; `information` (3, 3) what they rest on."""

    coefficients: FloatArray
    information: FloatArray = field(default_factory=lambda: np.diag([400.0, 2e4, 400.0]))

    def of(self, steps: Steps) -> FloatArray:
        """Lengths (n,) in m."""
        return np.clip(features(steps) @ self.coefficients, SHORTEST_M, LONGEST_M)

    def adapted(self, steps: Steps, length_m: float) -> LengthModel:
        """The model after `steps` turned out to be `length_m` in all (recursive least squares)."""
        if not len(steps) or not np.isfinite(length_m):
            return self
        row = features(steps).sum(axis=0)
        # Two ends, each passed within half a metre or so, and the steps' own spread.
        weight = 1.0 / (0.5 + len(steps) * (SPREAD * 0.7) ** 2)
        information = self.information + weight * np.outer(row, row)
        off = length_m - float(row @ self.coefficients)
        gain = np.linalg.solve(information, weight * row)
        return LengthModel(self.coefficients + gain * off, information)


def features(steps: Steps) -> FloatArray:
    """(n, 3): frequency, variance, 1."""
    return np.column_stack([steps.frequency_hz, steps.variance, np.ones(len(steps))])


GENERIC = LengthModel(np.array([0.25, 0.01, 0.15]))
"""Before anything is known of the user: 0.65 m at 1.8 steps a second."""
