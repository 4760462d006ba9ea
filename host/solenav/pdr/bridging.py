"""A foot's steps where it has them, a waist's where the foot's navigation has a hole.

Beside a hole both are known, so the foot says how the waist's axes lie to its own and how long the
waist's steps really are (least squares turn and scale, Umeyama 1991); within, the waist's steps are
laid in. After a hole that it couldn't bridge the foot goes on with the heading from before, so what
it walks from then on is turned by what it missed: the waist's gyro knows.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from solenav.capture.contents import Capture, unwrap
from solenav.errors import SolenavError
from solenav.parameters import named
from solenav.pdr.length import SPREAD
from solenav.pdr.steps import TUNING
from solenav.pdr.track import JOINED, StepTrack
from solenav.recording import FloatArray

WINDOW_S = 20.0
"""How far beside a hole steps are compared: longer, and the waist's gyro drifts."""
LEAST_STEPS = 4


@dataclass(frozen=True)
class Hole:
    """Between two samples, s; `resumed` where the foot then went on anew, else it was bridged."""

    begin_s: float
    end_s: float
    resumed: bool


def holes(capture: Capture) -> list[Hole]:
    """Where a foot's board lost more samples than it makes up for (flags GAP and RESUMED).

    What only the link lost is none: the board went on. SolenavError without samples.
    """
    capture.need_samples()
    bridged = named(capture.params[0][1])["BRIDGE_TICKS"]
    rows, tick = capture.samples.rows, capture.samples.tick
    at = capture.time_of_tick(tick)
    missed = np.diff(unwrap(rows["time"])) * capture.rate_hz() - np.diff(tick)
    lost = np.maximum(np.rint(missed), rows["lost"][1:])
    return [
        Hole(float(at[k]), float(at[k + 1]), bool(lost[k] > 4 * bridged))
        for k in np.flatnonzero((lost > bridged) & (np.diff(tick) > 0))
    ]


def joined(foot: StepTrack, waist: StepTrack, missing: list[Hole]) -> StepTrack:
    """The foot's walk with the waist's steps in the holes, in the foot's axes.

    Times of both count from one moment. A foot's step that a hole falls into is left out and the
    time from the step before to its end filled; a hole after the last step goes on to the waist's
    last. The waist takes floors for level. SolenavError where fewer than 4 of the foot's steps
    before a hole have the waist's beside them, or the waist has no steps for a hole.
    """
    out = _Joined(foot, waist)
    for hole in sorted(missing, key=lambda one: one.begin_s):
        out.bridge(hole)
    return out.track()


class _Joined:
    """Rows of the foot's steps, some of them replaced; complex numbers are East + i North."""

    def __init__(self, foot: StepTrack, waist: StepTrack) -> None:
        self.foot, self.waist = foot, waist
        self.ends = foot.position_s
        self.kept = np.ones(len(foot), bool)
        self.turn = np.zeros(len(foot))
        self.filled: list[StepTrack] = []

    def bridge(self, hole: Hole) -> None:
        begins, ends = self.ends[:-1], self.ends[1:]
        within = (begins < hole.end_s) & (ends > hole.begin_s) & self.kept
        if within.any():
            begin, end = float(begins[within][0]), float(ends[within][-1])
        elif hole.begin_s >= ends[-1]:
            begin, end = float(ends[-1]), float(self.waist.time_s[-1])
        else:
            # It lies within what an earlier hole has had filled.
            return
        if not self.waist.start_s <= begin < end <= self.waist.time_s[-1]:
            raise SolenavError(
                f"{self.waist.name} has steps from {self.waist.start_s:.2f} s to "
                f"{self.waist.time_s[-1]:.2f} s, the foot's hole lasts from {begin:.2f} s to "
                f"{end:.2f} s",
                "record both for the whole walk, with one clock",
            )
        self.kept &= ~within
        fit = self._fit((ends <= begin) & (ends > begin - WINDOW_S))
        if fit is None:
            raise SolenavError(
                f"fewer than {LEAST_STEPS} steps of foot and waist before the hole at "
                f"{hole.begin_s:.2f} s: how the waist's axes lie is unknown",
                "walk some steps with both before",
            )
        self.filled.append(_laid(self.waist, begin, end, fit))
        later = begins >= end
        after = self._fit(later & (begins < end + WINDOW_S)) if hole.resumed else None
        if after is not None:
            self.turn[later] += cmath.phase(fit / after)

    def _fit(self, wanted: NDArray[np.bool_]) -> complex | None:
        """Turn and scale of the waist's steps to the foot's; None with too few."""
        begins, ends = self.ends[:-1], self.ends[1:]
        beside = (begins >= self.waist.start_s) & (ends <= self.waist.time_s[-1])
        wanted = wanted & self.kept & beside
        if wanted.sum() < LEAST_STEPS:
            return None
        moved = self.foot.displacement[wanted]
        own = (moved[:, 0] + 1j * moved[:, 1]) * np.exp(1j * self.turn[wanted])
        at = self.waist.position_s, self.waist.position
        other = _between(*at, ends[wanted]) - _between(*at, begins[wanted])
        seen = other[:, 0] + 1j * other[:, 1]
        size = float(np.sum(np.abs(seen) ** 2))
        product = complex(np.sum(np.conj(seen) * own))
        return product / size if size and product else None

    def track(self) -> StepTrack:
        foot = self.foot
        turn = _turns(self.turn)
        parts = [
            (
                foot.time_s[self.kept],
                np.einsum("nij,nj->ni", turn, foot.displacement)[self.kept],
                (foot.heading + self.turn)[self.kept],
                (turn @ foot.covariance @ turn.transpose(0, 2, 1))[self.kept],
            ),
            *((f.time_s, f.displacement, f.heading, f.covariance) for f in self.filled),
        ]
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        order = np.argsort(columns[0], kind="stable")
        time_s, displacement, heading, covariance = (column[order] for column in columns)
        source = JOINED if self.filled else foot.source
        return StepTrack(
            foot.name, time_s, displacement, heading, covariance, foot.start, foot.start_s, source
        )


def _laid(waist: StepTrack, begin: float, end: float, fit: complex) -> StepTrack:
    """The waist's steps from `begin` to `end`, turned and scaled.

    Those at the edges are cut there; a sliver shorter than any step goes to the step beside it.
    """
    least = TUNING.closest_s
    inner = waist.time_s[(waist.time_s > begin + least) & (waist.time_s < end - least)]
    edges = np.concatenate([[begin], inner, [end]])
    turn = _turns(np.full(len(edges) - 1, cmath.phase(fit)))
    moved = np.diff(_between(waist.position_s, waist.position, edges), axis=0)
    flat = np.array([abs(fit), abs(fit), 0.0])
    displacement = np.einsum("nij,nj->ni", turn, moved) * flat
    known = waist.position_covariance.reshape(-1, 9)
    covariance = np.diff(_between(waist.position_s, known, edges), axis=0).reshape(-1, 3, 3)
    covariance = abs(fit) ** 2 * (turn @ covariance @ turn.transpose(0, 2, 1))
    covariance[:, 2, 2] += (SPREAD**2) * (displacement**2).sum(axis=1)
    middle = [(a + b) / 2 for a, b in pairwise(edges.tolist())]
    step = np.minimum(np.searchsorted(waist.time_s, middle), len(waist) - 1)
    heading = waist.heading[step] + cmath.phase(fit)
    return StepTrack(
        waist.name, edges[1:], displacement, heading, covariance, np.zeros(3), begin, waist.source
    )


def _between(time_s: FloatArray, values: FloatArray, wanted_s: FloatArray) -> FloatArray:
    """`values` (n, k) at `time_s`, on straight lines between, at the wanted times."""
    return np.column_stack([np.interp(wanted_s, time_s, column) for column in values.T])


def _turns(angle: FloatArray) -> FloatArray:
    """Matrices (n, 3, 3) that turn by `angle` (n,) about Up."""
    out = np.zeros((len(angle), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(angle)
    out[:, 1, 0] = np.sin(angle)
    out[:, 0, 1] = -out[:, 1, 0]
    out[:, 2, 2] = 1.0
    return out
