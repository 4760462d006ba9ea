"""Heights: writes the chapter "Stairs" of docs/modes.md. `python tools/studies/stairs.py DATA`.

DATA is the folder that holds foot/. A minute on one core.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import labelled
import numpy as np
import pages
import recordings
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from solenav import mpu9150, tuning
from solenav.comparison.metrics import score
from solenav.filters.walk import Track, Walk, of_recording
from solenav.parameters import Settings
from solenav.recording import FloatArray, Recording

_HEADING = "## Stairs"
_WIDTH = 110
_HARD = 120.0
_GOAL_M = 0.3
_EVEN = Settings(velocity_noise_up=0.02, strike_noise=0.0)
"""Vertical noise without regard to the force, about as large as that along E and N."""
_SEEDS = (1, 2, 3, 4, 5)
_STANCE_S = 0.06
_STRIDE_S = (0.5, 2.0)
_FREEDOMS = (1.0, 1.5, 2.0, 3.0, 4.0)
_DRAWS = 40
_TILL = 5e-3  # s: the noise of a change of the force counts over so long, as in the core
_SETS = ("llio", "openshoe", "pyshoe", "xio", "gaitmap")


def study(data: Path) -> None:
    page = pages.DOCS / "modes.md"
    before, _heading, _old = page.read_text(encoding="utf-8").partition(_HEADING)
    page.write_text(before + chapter(data), encoding="utf-8")


def chapter(data: Path) -> str:
    """The chapter on heights, in Markdown."""
    climbs = dict(labelled.stairs(data))
    floors = {n: r for n, r in recordings.recordings(data) if "_35_" not in n}
    table, nets = _flights(climbs)
    lines = [
        _HEADING,
        _text(
            "gaitmap's recordings of one flight of 29 risers, up and down again, left and right",
            "foot. The risers are equal, so each stride over two should climb the same. Heights in",
            "m by the core; *stride* is mean and deviation over the strides of two risers; *hard*",
            "and *soft* are the velocity up, in m/s, that the INS has when the foot comes to",
            "stand, after strikes above and below 120 m/s²; *net* is the mean over five seeds of",
            "the particles and in brackets the largest. *Even*: noise of the velocity up of 0.02",
            "(m/s)²/s, whatever the force does.",
        ),
        *table,
        "",
        _text(
            "The right foot stamps: its strikes last a sample or two at 204.8 Hz and reach the",
            "sensor's 16 g. With even noise a velocity that is wrong when the foot comes to stand",
            "is taken for a drift of the whole swing, and the height is corrected for half a",
            "swing of it. It comes from the strike, at the swing's very end.",
        ),
        *_noise(floors),
        *_tried(climbs, floors),
        *(
            f"- {'reached' if max(map(abs, nets[foot])) <= _GOAL_M else 'not reached'}: net height "
            f"within {_GOAL_M} m on each of {len(_SEEDS)} seeds, {foot} foot: "
            f"{min(nets[foot]):+.2f} to {max(nets[foot]):+.2f} m"
            for foot in ("left", "right")
        ),
        "",
    ]
    return "\n".join(lines)


def _text(*parts: str) -> str:
    """A paragraph."""
    return pages.wrapped(" ".join(parts), _WIDTH) + "\n"


# --- what the core makes of the flight ---------------------------------------------------------


@dataclass(frozen=True)
class Climb:
    """What the core made of a flight: its `height` m; for each step `rises` m, the `peak` of |a|
    in the last half second, m/s², and the velocity up before the stance, m/s (`landing`)."""

    height: float
    rises: FloatArray
    peak: FloatArray
    landing: FloatArray


def _climb(walk: Walk, settings: Settings) -> Climb:
    run = tuning.run(walk, settings)
    steps = np.flatnonzero(np.diff(run.steps)) + 1
    size = np.linalg.norm(walk.accel, axis=1)
    half = round(0.5 * walk.rate_hz)
    touch = [step - int(np.argmin(run.stance[step::-1])) for step in steps.tolist()]
    return Climb(
        float(run.position[-1, 2]),
        np.diff(run.position[steps, 2], prepend=0.0),
        np.array([size[max(0, step - half) : step].max() for step in steps.tolist()]),
        run.velocity[touch, 2],
    )


def _ways(foot: str) -> tuple[str, str]:
    return (
        f"gaitmap imu_sample_healthy_stair_up_{foot}",
        f"gaitmap imu_sample_healthy_stair_down_{foot}",
    )


def _nets(
    climbs: Mapping[str, Recording], foot: str, settings: Settings, seeds: Sequence[int] = _SEEDS
) -> list[float]:
    """Up and down again, m, on each seed of the particles."""
    walks = [of_recording(climbs[name]) for name in _ways(foot)]
    return [
        sum(float(tuning.run(w, replace(settings, seed=seed)).position[-1, 2]) for w in walks)
        for seed in seeds
    ]


def _flights(climbs: Mapping[str, Recording]) -> tuple[list[str], dict[str, list[float]]]:
    """The table, and the nets by foot on the parameters that ship."""
    lines = [
        "| foot | noise | up | stride | hard | soft | down | stride | hard | soft | net |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    nets: dict[str, list[float]] = {}
    for foot in ("left", "right"):
        for text, settings in (("even", _EVEN), ("the core's", Settings())):
            cells = []
            for name in _ways(foot):
                climb = _climb(of_recording(climbs[name]), settings)
                two = climb.rises[np.abs(climb.rises) > 0.2]
                cells += [
                    f"{climb.height:+.2f}",
                    f"{two.mean():+.3f} ± {two.std():.3f}",
                    f"{climb.landing[climb.peak > _HARD].mean():+.2f}",
                    f"{climb.landing[climb.peak <= _HARD].mean():+.2f}",
                ]
            nets[foot] = _nets(climbs, foot, settings)
            net = f"{np.mean(nets[foot]):+.2f} ({max(nets[foot], key=abs):+.2f})"
            lines.append(f"| {foot} | {text} | " + " | ".join(cells) + f" | {net} |")
    return lines, nets


# --- what noise strides on floors have ---------------------------------------------------------


def _strides(walk: Walk) -> FloatArray:
    """Of each stride, from the stillest sample of a stance to the next stance's, (n, 6).

    The climb in m and the change of the velocity up in m/s by the INS alone; the duration in s;
    and what noise for each (m/s²)² of the force's change would add to the variance of velocity, to
    its covariance with the height, and to the variance of height.
    """
    run = tuning.run(walk, Settings())
    dt = walk.dt
    rate = walk.gyro - run.gyro_bias
    before = np.vstack([run.attitude[:1], run.attitude[:-1]])
    turned = walk.accel + np.cross(0.5 * dt * rate, walk.accel)
    twice = 2.0 * np.cross(before[:, 1:], turned)
    force = turned + before[:, :1] * twice + np.cross(before[:, 1:], twice)
    up = force[:, 2] - walk.start.gravity
    change = (np.diff(walk.accel, axis=0, prepend=walk.accel[:1]) ** 2).sum(axis=1)
    settings = Settings()
    size = np.linalg.norm(walk.accel, axis=1)
    moving = (rate**2).sum(axis=1) / math.radians(settings.unrest_rate_dps) ** 2
    moving += ((size - walk.start.gravity) / settings.unrest_accel) ** 2
    stance = walk.stance & (np.arange(len(size)) > walk.start.row)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stance, [0]]).astype(int)))
    still = [
        begin + int(np.argmin(moving[begin:end]))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
        if end - begin >= _STANCE_S * walk.rate_hz
    ]
    rows = []
    for begin, end in pairwise(still):
        duration = (end - begin) * dt
        if not _STRIDE_S[0] < duration < _STRIDE_S[1]:
            continue
        part = slice(begin + 1, end + 1)
        velocity = np.cumsum(up[part]) * dt
        left = (np.arange(end - begin, 0, -1) - 0.5) * dt
        added = change[part] * dt * _TILL
        moments = [float((added * left**k).sum()) for k in range(3)]
        rows.append([float(velocity.sum()) * dt, float(velocity[-1]), duration, *moments])
    return np.array(rows).reshape(-1, 6)


@dataclass(frozen=True)
class Fit:
    """The likeliest noise: `even` (m/s)²/s, `kappa` without unit; `cost` is -ln of likelihood."""

    even: float
    kappa: float
    cost: float


def _fit(strides: FloatArray, freedom: float, kappa: float | None = None) -> Fit:
    """The noise that makes climb and change of velocity likeliest: on a floor both should be 0.

    They are Student t of so many degrees of `freedom`, since some strides are no strides on a
    floor; the climb has errors of its own besides. `kappa` is found as well unless it is given.
    """
    climb, velocity, duration, first, second, third = strides.T

    def cost(x: FloatArray) -> float:
        even, own = math.exp(x[0]), math.exp(x[1])
        square = math.exp(x[2]) if kappa is None else kappa**2
        vv = even * duration + square * first + 1e-5
        pv = even * duration**2 / 2.0 + square * second
        pp = even * duration**3 / 3.0 + square * third + own
        det = vv * pp - pv**2
        z = (pp * velocity**2 - 2.0 * pv * velocity * climb + vv * climb**2) / det
        return float((0.5 * np.log(det) + (freedom + 2.0) / 2.0 * np.log1p(z / freedom)).sum())

    start = [math.log(3e-4), math.log(4e-4)] + ([] if kappa is not None else [math.log(0.01)])
    found = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 4000})
    likeliest = math.sqrt(math.exp(found.x[2])) if kappa is None else kappa
    return Fit(math.exp(found.x[0]), likeliest, float(found.fun))


def _noise(floors: Mapping[str, Recording]) -> list[str]:
    """Where the core's noise along Up comes from, and what it does to heights on floors."""
    walks = {name: of_recording(one, name=name) for name, one in floors.items()}
    strides = [_strides(walk) for walk in walks.values()]
    everyone = np.vstack(strides)
    fits = {freedom: _fit(everyone, freedom) for freedom in _FREEDOMS}
    freedom, best = min(fits.items(), key=lambda one: one[1].cost)
    none = _fit(everyone, freedom, 0.0)
    rng = np.random.default_rng(1)
    drawn = []
    for _ in range(_DRAWS):
        chosen = rng.integers(0, len(strides), len(strides))
        drawn.append(_fit(np.vstack([strides[i] for i in chosen]), freedom).kappa)
    low, high = np.percentile(drawn, [5, 95])
    shipped = Settings()
    lines = [
        _text(
            f"So the noise was asked of the {len(everyone)} strides of the {len(strides)} walks on",
            "floors. From a stillest sample to the next the INS alone should find neither a climb",
            "nor a change of its velocity up; what it does find has variances and a covariance,",
            "which say how much noise there is and when in the stride it comes. Noise of which a",
            "part goes with the square of the force's change from sample to sample (κ of the",
            "change for 5 ms, 1 sigma) is far likelier than even noise alone: by",
            f"{none.cost - best.cost:.0f} in the logarithm. Some strides aren't on a floor, so",
            "errors have the tails of a Student t, whose degrees of freedom are found as well:",
        ),
        "| degrees of freedom | κ | even noise, (m/s)²/s | less likely by, in the logarithm |",
        "|---|---|---|---|",
        *(
            f"| {one:g} | {fit.kappa:.3f} | {fit.even:.5f} | {fit.cost - best.cost:.1f} |"
            for one, fit in fits.items()
        ),
        "",
        _text(
            f"The core has {shipped.strike_noise:g} and {shipped.velocity_noise_up:g}. With the",
            f"recordings drawn anew with replacement κ is from {low:.3f} to {high:.3f} (5 to 95",
            "%). The stairs were in view meanwhile: of what the noise is made, the tails' form and",
            "after how long a stance it is that of the other axes was chosen among some sixty",
            "trials. Mean height for each step of the walks on floors, cm, and share of the",
            "distance, %, geometric mean over walks and seeds:",
        ),
        "| noise | " + " | ".join(_SETS) + " | all, RMS | share |",
        "|---|" + "---|" * (len(_SETS) + 2),
    ]
    for text, settings in (("even", _EVEN), ("the core's", shipped)):
        heights, share = _on_floors(list(walks.values()), settings, _SEEDS)
        cells = [
            f"{100 * np.mean([h for n, h in heights.items() if n.startswith(one)]):+.1f}"
            for one in _SETS
        ]
        lines.append(f"| {text} | " + " | ".join(cells) + f" | {_rms(heights)} | {share:.3f} |")
    return [*lines, ""]


def _rms(heights: Mapping[str, float]) -> str:
    return f"{100 * math.sqrt(np.mean(np.square(list(heights.values())))):.2f}"


def _on_floors(
    walks: Sequence[Walk], settings: Settings, seeds: Sequence[int]
) -> tuple[dict[str, float], float]:
    """Height for each step in m by walk, and the error's share of the distance in %."""
    heights: dict[str, float] = {}
    shares = []
    for walk in walks:
        found = []
        for seed in seeds:
            run = tuning.run(walk, replace(settings, seed=seed))
            found.append(float(run.position[-1, 2]) / int(run.steps[-1]))
            own = replace(walk, start=run.start, stance=run.stance, clean=run.stance)
            share = score(own, Track(run.position, run.velocity), with_evo=False).error_share
            assert share is not None
            shares.append(math.log(min(1.0, max(recordings.FLOOR_SHARE, share))))
        heights[walk.name] = float(np.mean(found))
    return heights, 100 * math.exp(float(np.mean(shares)))


# --- what else was tried -----------------------------------------------------------------------


def _at_rest(recording: Recording) -> FloatArray:
    """The mean force, (3,) m/s², in the half second before the static start is complete."""
    walk = of_recording(recording)
    end = walk.start.row + 1
    mean = recording.accel[max(0, end - round(0.5 * walk.rate_hz)) : end].mean(axis=0)
    return np.asarray(mean, dtype=np.float64)


def _biased(recording: Recording) -> Recording:
    rest = _at_rest(recording)
    size = float(np.linalg.norm(rest))
    off = (size - mpu9150.STANDARD_GRAVITY) / size * rest
    return replace(recording, accel=recording.accel - off)


def _scaled(recording: Recording) -> Recording:
    size = float(np.linalg.norm(_at_rest(recording)))
    return replace(recording, accel=recording.accel * mpu9150.STANDARD_GRAVITY / size)


def _advanced(recording: Recording, late_s: float) -> Recording:
    """The recording of a gyro that is late by so much, put right."""
    at = np.arange(len(recording.gyro), dtype=np.float64)
    there = np.clip(at + late_s * recording.rate_hz, 0.0, at[-1])
    return replace(recording, gyro=CubicSpline(at, recording.gyro, axis=0)(there))


def _pitched(recording: Recording, factor: float) -> Recording:
    """The recording with the gyro's axis that turns most times a factor."""
    gyro = recording.gyro.copy()
    gyro[:, int((gyro**2).mean(axis=0).argmax())] *= factor
    return replace(recording, gyro=gyro)


_TRIED: tuple[tuple[str, Callable[[Recording], Recording]], ...] = (
    ("as recorded", lambda one: one),
    ("force at rest made 9.807 m/s²: a bias along Up", _biased),
    ("the same, a scale", _scaled),
    ("gyro late by -2 ms", lambda one: _advanced(one, -0.002)),
    ("gyro late by 2 ms", lambda one: _advanced(one, 0.002)),
    ("gyro late by 4 ms", lambda one: _advanced(one, 0.004)),
    ("gyro's pitch axis 0.98", lambda one: _pitched(one, 0.98)),
    ("gyro's pitch axis 1.02", lambda one: _pitched(one, 1.02)),
)


def _tried(climbs: Mapping[str, Recording], floors: Mapping[str, Recording]) -> list[str]:
    """What errors of the sensors would explain of the rest."""
    rest = [float(np.linalg.norm(_at_rest(climbs[_ways(foot)[0]]))) for foot in ("left", "right")]
    lines = [
        _text(
            "What is left, about 0.01 m for each stride upwards on either foot, is no matter of",
            "noise. The sensors aren't calibrated: at rest they show",
            f"{rest[0]:.2f} (left) and {rest[1]:.2f} m/s² (right). Below, the same core on",
            "recordings whose sensors are corrected for one error, all alike: net height in m, and",
            "for the walks on floors RMS of the height for each step, cm, and share of the",
            "distance, %, as above, with one seed. No correction is made: no set says how late its",
            "gyro is or what its scale is, and one value for all isn't right for all.",
        ),
        "| | left | right | height | share |",
        "|---|---|---|---|---|",
    ]
    for text, corrected in _TRIED:
        found = {name: corrected(one) for name, one in climbs.items()}
        nets = [_nets(found, foot, Settings(), (1,))[0] for foot in ("left", "right")]
        walks = [of_recording(corrected(one), name=name) for name, one in floors.items()]
        heights, share = _on_floors(walks, Settings(), (1,))
        lines.append(
            f"| {text} | {nets[0]:+.2f} | {nets[1]:+.2f} | {_rms(heights)} | {share:.3f} |"
        )
    return [*lines, ""]


if __name__ == "__main__":
    pages.as_script(study)
