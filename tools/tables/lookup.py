"""Write `solenav_core/tables/lookup.py`: the core's constant tables, or check that it is current.

EXP2 and ATAN are rounded values of the functions. GAUSS is 50 antithetic pairs of a scrambled
Halton sequence through the normal quantile, whitened (mean 0, covariance 1), in a fixed shuffle
so that neighbouring rows are not neighbours of the sequence.

    python tools/tables/lookup.py [--check]
"""

from __future__ import annotations

import sys
from array import array
from pathlib import Path

import numpy as np
from generated import keep
from scipy.special import ndtri
from scipy.stats import qmc

from solenav.forests import literal

TARGET = Path(__file__).resolve().parents[2] / "shared/solenav_core/tables/lookup.py"
SEED = 2020


def exp2() -> list[int]:
    """2**(-i/256) in Q15 for i = 0..256."""
    return [int(v) for v in np.rint(2.0 ** (15 - np.arange(257) / 256))]


def atan() -> list[int]:
    """atan(2**-i) for i = 0..15, 2**24 a turn."""
    return [int(v) for v in np.rint(np.arctan(2.0 ** -np.arange(16)) / (2 * np.pi) * 2**24)]


def gauss() -> list[int]:
    """100 three-vectors, Q11: the first components, the second, the third."""
    half = ndtri(qmc.Halton(3, scramble=True, rng=np.random.default_rng(SEED)).random(50))
    pairs = np.vstack([half, -half])
    whitener = np.linalg.inv(np.linalg.cholesky(np.cov(pairs.T, bias=True)))
    rows = np.rint((pairs @ whitener.T) * 2048).astype(int)
    return [int(v) for v in np.random.default_rng(SEED).permutation(rows).T.ravel()]


def render() -> str:
    lines = [
        '"""Constant tables of the core. Written by tools/tables/lookup.py: do not edit."""',
        "",
        "from array import array",
        "",
        "# EXP2 (257), ATAN (16), GAUSS (300), as `layout.TABLE_FIELDS` lists them.",
        "# Bytes, as a list of so many numbers takes a board three times the room.",
        "TABLES = array(",
        '    "i",',
    ]
    data = array("i", exp2() + atan() + gauss()).tobytes()
    return "\n".join([*lines, *literal(data), ")", ""])


if __name__ == "__main__":
    sys.exit(keep(TARGET, render()))
