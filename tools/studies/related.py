"""Measures dead reckoning and magnetic maps on the phone traces; writes docs/pdr.md, magmap.md.

python tools/studies/related.py DATA
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pages import DOCS, as_script, wrapped

from solenav import magmap, pdr
from solenav.datasets import indoor, kaist
from solenav.errors import SolenavError
from solenav.magmap import figures
from solenav.magmap.positioning import TUNING, Tuning
from solenav.pdr import steps
from solenav.plotting import sheet
from solenav.recording import FloatArray, Recording, Truth

SEEDS = range(1, 31)
FEW = range(1, 11)
COVERED = 0.8
GIVEN_UT = 4.0
FILTERS = ("plain", "firefly", "centroid")
SWAYS = (1.0, 1.5, 2.0)
FIGURES = DOCS / "figures"


@dataclass(frozen=True)
class Case:
    """A walk and the map that it is tested on, which it had no part in; `seen` of it is covered.

    `paces` is the walk from its first way point on.
    """

    set: str
    walk: Recording
    floor: magmap.MagneticMap
    seen: float
    paces: magmap.Paces


@dataclass(frozen=True)
class Result:
    """Errors (seeds, way points) m, seconds a step (seeds,), and the first seed's way."""

    errors: FloatArray
    seconds: FloatArray
    way: FloatArray


def way_points(walk: Recording) -> Truth:
    if walk.truth is None:
        raise SolenavError(f"{walk.name} has no way points", "")
    return walk.truth


def kaist_walks(data: Path) -> list[Recording]:
    folder = data / "phone/kaist"
    return [
        kaist.read(run, way_points=folder / f"est-result/ki-gt-s{k}.json")
        for k, run in enumerate(sorted((folder / "rawdata/test-KI-1F-S9").iterdir()), 1)
    ]


def indoor_walks(data: Path) -> list[Recording]:
    files = sorted((data / "phone/indoor_competition/site2/F8/path_data_files").glob("*.txt"))
    return [indoor.read(file) for file in files]


# --- dead reckoning ------------------------------------------------------------------------------


def stretches(mask: NDArray[np.bool_], least: float) -> list[tuple[int, int]]:
    """Begin and end of each run of True of at least so many samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a >= least]


def steady(walk: Recording, found: pdr.Steps, sway: float) -> tuple[float, float]:
    """Steps in steady walking: as detected, and as cycles of the gyro's main axis by its phase.

    Steady are 4 s and more in which the acceleration sways by `sway` m/s² between 1.2 and 2.8 Hz.
    Within them no limit decides what the gyro counts. A step partly within counts in part.
    """
    signal = steps.need("scipy.signal")
    band = signal.butter(2, (1.2, 2.8), "bandpass", fs=walk.rate_hz, output="sos")
    size = np.linalg.norm(walk.accel, axis=1)
    swaying = np.abs(signal.hilbert(signal.sosfiltfilt(band, size - size.mean()))) > sway
    turning = signal.sosfiltfilt(band, walk.gyro - walk.gyro.mean(axis=0), axis=0)
    detected = counted = 0.0
    for a, b in stretches(swaying, 4 * walk.rate_hz):
        begin, end = walk.time_s[a], walk.time_s[b - 1]
        within = np.minimum(found.time_s, end) - np.maximum(found.begin_s, begin)
        detected += float((within.clip(0) / (found.time_s - found.begin_s)).sum())
        axis = np.linalg.svd(turning[a:b], full_matrices=False)[2][0]
        phase = np.unwrap(np.angle(signal.hilbert(turning[a:b] @ axis)))
        counted += float(phase[-1] - phase[0]) / (2 * np.pi)
    return detected, counted


def stood(walk: Recording, found: pdr.Steps) -> tuple[int, float, int]:
    """Times stood for half a second and more, seconds in all, and steps counted within."""
    size = np.linalg.norm(walk.accel, axis=1)
    rests = [
        (walk.time_s[a], walk.time_s[b - 1])
        for a, b in stretches(np.abs(size - np.median(size)) < 1.0, 0.5 * walk.rate_hz)
    ]
    within = sum(int(((found.begin_s >= a) & (found.time_s <= b)).sum()) for a, b in rests)
    return len(rests), sum(b - a for a, b in rests), within


def pdr_page(walks: Sequence[Recording]) -> str:
    rows, counted = [], 0
    by_sway, rests = np.zeros((len(SWAYS), 2)), np.zeros(3)
    legs_of: list[FloatArray] = []
    for walk in walks:
        truth = way_points(walk)
        seen = pdr.level(walk)
        found = pdr.detect(seen.time_s, seen.vertical)
        inside = np.array([steady(walk, found, sway) for sway in SWAYS])
        by_sway += inside
        rests += np.array(stood(walk, found))
        _, legs = pdr.adapted(walk, truth)
        legs_of.append(legs)
        counted += len(found)
        metres = float(np.hypot(*np.diff(truth.position_enu[:, :2], axis=0).T).sum())
        total = legs.sum(axis=0)
        rows.append(
            f"| {walk.name[-8:]} | {metres:.1f} | {len(found)} | "
            f"{inside[1, 0]:.1f} | {inside[1, 1]:.1f} | "
            f"{metres / len(found):.2f} | {100 * (total[1] / total[0] - 1):+.1f} | "
            f"{100 * (total[2] / total[0] - 1):+.1f} |"
        )
    whole = np.array([legs.sum(axis=0) for legs in legs_of])
    legs = np.vstack(legs_of)
    before, after = (np.abs(whole[:, k] / whole[:, 0] - 1).mean() * 100 for k in (1, 2))
    leg_before, leg_after = (np.abs(legs[:, k] - legs[:, 0]).mean() for k in (1, 2))
    parts = [
        "# Dead reckoning with a phone",
        wrapped(
            "Written by `python tools/studies/related.py DATA`. Steps, their length and their "
            "direction from a phone carried in the hand and pointing ahead (`solenav.pdr`, "
            "`solenav pdr TRACE`). Method: a Chinese patent application, *An IMU indoor "
            "positioning method* (no publication number in our copy)."
        ),
        "",
        "## How",
        wrapped(
            "- **Level**: a quaternion turned by the gyro, its vertical pulled to "
            "gravity within 5 s."
        ),
        wrapped(
            "- **Steps**: vertical acceleration through an FIR at 3 Hz; a peak at least 1.0 m/s² "
            "above its valleys; 0.3 to 2.0 s between steps; and the step must be like the one "
            "before the last by dynamic time warping (dtaidistance, kept up and small; tslearn "
            "would bring scikit-learn and numba). A bout's first two steps count where the step "
            "after next is like them, so a lone jolt is none, nor are two."
        ),
        wrapped(
            "- **Length**: a f + b v + c with f the step frequency and v the variance of vertical "
            "acceleration; generic 0.25, 0.01, 0.15; then recursive least squares from stretches "
            "whose length is known (here: between way points), the generic coefficients as prior."
        ),
        wrapped(
            "- **Heading**: the gyro's, or pulled to the magnetometer's within 20 s. Which way the "
            "phone points is taken for the way one walks."
        ),
        wrapped(
            "- **Out**: a `StepTrack`, displacement and covariance a step; a foot's STEP messages "
            "make the same (`pdr.of_capture`). `solenav pdr -o steps.csv` writes it, `solenav "
            "evaluate` and `solenav plot` take it."
        ),
        wrapped(
            "- **Foot and waist together**: `solenav pdr TRACE --foot run.solcap --later S` (S: "
            "seconds that the trace began after the capture) lays the phone's steps into the holes "
            "of a foot's navigation (GAP, RESUMED): turned and scaled to the foot's steps of the "
            "20 s before; what the foot walks after a hole is turned by what the phone's gyro saw "
            "and the foot missed. In Python `pdr.joined(pdr.of_capture(run), waist, "
            "pdr.holes(run))`. No recording has both sensors; `tests/test_bridging.py` unplugs "
            "the simulated board's sensor for 8 s round a corner: with the phone the walk ends "
            "within 2 m, alone more than 5 m off."
        ),
        "",
        "## Measured",
        wrapped(
            f"**Steps.** Over all {len(walks)} traces {counted} steps. Way points say nothing of "
            "steps and nobody counted them, so they are counted a second time by another sensor: "
            "cycles of the gyro's main axis by their phase, in stretches of at least 4 s of steady "
            "walking. There the detector has no part in the reference, and no limit decides what "
            "the gyro counts; where a stretch begins hangs on how strongly the acceleration must "
            "sway (`related.steady`):"
        ),
        "",
        "| sway, m/s² | steps, of all | by the gyro | difference |",
        "|---|---|---|---|",
        *(
            f"| {sway} | {ours:.1f}, {100 * ours / counted:.0f} % | {gyro:.1f} | "
            f"{100 * (ours / gyro - 1):+.1f} % |"
            for sway, (ours, gyro) in zip(SWAYS, by_sway.tolist(), strict=True)
        ),
        "",
        wrapped(
            "So the goal of 2 % is met in steady walking. The other steps are beginnings, ends and "
            "small steps of people who turn on the spot at a way point; there no second count is "
            "to be had: the gyro's phase runs on while somebody stands, and one of the "
            "acceleration's size, with a limit below which it doesn't count, says what the limit "
            "makes it say."
        ),
        "",
        wrapped(
            f"**Standing.** The people of these traces stood {rests[0]:.0f} times for half a "
            f"second and more, {rests[1]:.1f} s in all (size of the acceleration within 1 m/s² of "
            f"its median); {rests[2]:.0f} steps lie within. None in 60 s of a sensor at rest, nor "
            "in simulated rest with 0.3 m/s² of noise. The limits (1.0 m/s², likeness 0.25) were "
            "chosen on these traces. After a low-pass at 3 Hz DTW is lenient: white noise of "
            "3 m/s² passes for steps nearly throughout."
        ),
        "",
        wrapped(
            f"**Length** of whole traces, mean absolute error: {before:.1f} % generic, "
            f"{after:.1f} % adapted; of a leg between way points: {leg_before:.2f} m and "
            f"{leg_after:.2f} m. "
            "Adapted is what the model said of a leg that had learned from those before it only."
        ),
        "",
        wrapped(f"Steady and by the gyro: at a sway of {SWAYS[1]} m/s²."),
        "",
        "| trace | way points, m | steps | steady | by the gyro | m a step | "
        "length generic, % | adapted, % |",
        "|---|---|---|---|---|---|---|---|",
        *rows,
        "",
    ]
    return "\n".join(parts)


# --- magnetic maps -------------------------------------------------------------------------------


def begun(walk: Recording) -> float:
    """When the first way point was passed, s."""
    return max(0.0, float(way_points(walk).time_s[0]))


def walked_off(walk: Recording) -> float:
    """Where the phone points at the start, from the direction of the first leg."""
    truth = way_points(walk)
    seen = pdr.level(walk)
    a, b = truth.time_s[:2]
    middle = (seen.time_s > a + 0.3 * (b - a)) & (seen.time_s < b - 0.3 * (b - a))
    soon = (seen.time_s >= a) & (seen.time_s <= a + 1.0)
    east, north = (truth.position_enu[1] - truth.position_enu[0])[:2]
    turned = float(np.median(seen.yaw[middle]) - seen.yaw[soon].mean())
    return math.atan2(north, east) - turned


def left_out(surveys: Sequence[magmap.Survey], walk: Recording) -> Case:
    """The walk with the map of all others."""
    others = [s for s in surveys if s.name != walk.name]
    own = next(s for s in surveys if s.name == walk.name)
    floor, _ = magmap.build(others, site="", floor="F8")
    seen = np.isfinite(floor.at(own.points)[0][:, 0]).mean()
    paces = magmap.paces(walk, begin_s=begun(walk))
    return Case("mall", walk, floor, float(seen), paces)


def tried(
    case: Case, filter: str, known: bool, tuning: Tuning = TUNING, seeds: Sequence[int] = SEEDS
) -> Result:
    truth = way_points(case.walk)
    points = truth.position_enu[:, :2]
    heading = walked_off(case.walk) if known else None
    errors, seconds, way = [], [], np.empty((0, 2))
    for seed in seeds:
        found = magmap.locate(
            case.paces,
            case.floor,
            (float(points[0, 0]), float(points[0, 1])),
            filter=filter,
            start_heading=heading,
            seed=seed,
            tuning=tuning,
        )
        # The first way point is given.
        errors.append(np.hypot(*(found.at(truth.time_s) - points).T)[1:])
        seconds.append(found.seconds_per_step)
        way = way if len(way) else found.track.position[:, :2]
    return Result(np.array(errors), np.array(seconds), way)


def reckoned(case: Case) -> Result:
    """Dead reckoning alone from the same start and direction."""
    truth = way_points(case.walk)
    points = truth.position_enu[:, :2]
    track = case.paces.reckoned
    turn = walked_off(case.walk) - case.paces.first_yaw
    c, s = math.cos(turn), math.sin(turn)
    way = points[0] + track.position[:, :2] @ np.array([[c, s], [-s, c]])
    at = np.column_stack([np.interp(truth.time_s, track.position_s, way[:, k]) for k in (0, 1)])
    return Result(np.hypot(*(at - points).T)[np.newaxis, 1:], np.array([math.nan]), way)


def table(results: dict[str, list[Result]]) -> list[str]:
    """A line a filter: mean and 75 % error over way points and seeds, spread of seeds, time."""
    plain = np.mean([r.seconds.min() for r in results["plain"]])
    lines = [
        "| filter | mean, m | 75 %, m | mean by seed, m | µs a step | of plain's |",
        "|---|---|---|---|---|---|",
    ]
    for name, of in results.items():
        pooled = np.concatenate([r.errors.ravel() for r in of])
        seeds = np.concatenate([r.errors for r in of], axis=1).mean(axis=1)
        # The quickest seed: what else the computer did then is in the others.
        taken = float(np.mean([r.seconds.min() for r in of]))
        lines.append(
            f"| {name} | {pooled.mean():.2f} | {np.percentile(pooled, 75):.2f} | "
            f"{seeds.min():.2f} to {seeds.max():.2f} | "
            + ("- | -" if math.isnan(taken) else f"{1e6 * taken:.0f} | {taken / plain:.2f}")
            + " |"
        )
    return [*lines, ""]


def each(cases: Sequence[Case], results: dict[str, list[Result]]) -> list[str]:
    lines = [f"| walk | {' | '.join(results)} |", "|---" * (1 + len(results)) + "|"]
    for k, case in enumerate(cases):
        means = " | ".join(f"{of[k].errors.mean():.2f}" for of in results.values())
        lines.append(f"| {case.walk.name[-8:]} | {means} |")
    return [*lines, ""]


def run(cases: Sequence[Case], known: bool = True) -> dict[str, list[Result]]:
    results: dict[str, list[Result]] = {name: [] for name in FILTERS}
    for case in cases:
        for name in FILTERS:
            results[name].append(tried(case, name, known))
    if known:
        results["dead reckoning"] = [reckoned(case) for case in cases]
    return results


def mean_of(results: Sequence[Result]) -> str:
    """Mean error, m, and its standard error over the seeds."""
    seeds = np.concatenate([r.errors for r in results], axis=1).mean(axis=1)
    return f"{seeds.mean():.2f} ± {seeds.std(ddof=1) / math.sqrt(len(seeds)):.2f}"


def halves(cases: Sequence[Case], results: dict[str, list[Result]], kaist: list[str]) -> list[str]:
    """A line a filter: KAIST, the mall's walks that forms were chosen on, and the others."""
    lines = [
        "| filter | KAIST, m | mall, chosen on, m | mall, the others, m |",
        "|---|---|---|---|",
    ]
    for name, on_kaist in zip(FILTERS, kaist, strict=True):
        of = results[name]
        lines.append(f"| {name} | {on_kaist} | {mean_of(of[0::2])} | {mean_of(of[1::2])} |")
    return [*lines, ""]


# The open forms, one changed at a time: filter, what it says in the table, what is changed.
FORMS: tuple[tuple[str, str, dict[str, float | bool]], ...] = (
    ("plain", "as shipped", {}),
    ("plain", "0.15 m of noise a step", {"step_m": 0.15}),
    ("plain", "0.35 m", {"step_m": 0.35}),
    ("plain", "length known to 8 % at the start", {"start_scale": 0.08}),
    ("firefly", "as shipped", {}),
    ("firefly", "all fly to the one brightest", {"brightest": True}),
    ("firefly", "the same, half the way", {"brightest": True, "attraction": 0.5}),
    ("firefly", "to brighter ones, half the way", {"attraction": 0.5}),
    ("firefly", "r_p gone after two right angles", {"turns": 2.0}),
    ("firefly", "r_p gone after ten", {"turns": 10.0}),
    ("firefly", "r_p starts at 0.5", {"rho_start": 0.5}),
    ("firefly", "r_p is 0: the field alone", {"rho_start": 0.0}),
    ("firefly", "W_p as narrow as 1 m", {"pdr_m": 1.0}),
    ("firefly", "disturbance counts: `calm_ut` 10 µT", {"calm_ut": 10.0}),
    ("firefly", "random step 0.6 m", {"jitter_m": 0.6}),
    ("firefly", "random step 1.2 m", {"jitter_m": 1.2}),
    ("firefly", "random step 1.8 m", {"jitter_m": 1.8}),
    ("firefly", "random turn 16°", {"jitter_turn": math.radians(16)}),
    ("firefly", "renewed below N/2", {"resample": 0.5}),
    ("firefly", "renewed below 0.9 N", {"resample": 0.9}),
    ("firefly", "never thrown open", {"narrow_m2": 0.0}),
    ("firefly", "thrown open below 1 m²", {"narrow_m2": 1.0}),
    ("centroid", "as shipped", {}),
    ("centroid", "near and far: shares of the cloud's radius", {"by_cloud": True}),
)


def form(case: Case, filter: str, changed: dict[str, float | bool]) -> Result:
    return tried(case, filter, True, replace(TUNING, **changed), FEW)  # type: ignore[arg-type]


def forms(on_kaist: Sequence[Case], on_mall: Sequence[Case]) -> list[str]:
    cases = [*on_kaist, *on_mall]
    lines = [
        "| filter | form | KAIST, m | mall, chosen on, m | mall, the others, m |",
        "|---|---|---|---|---|",
    ]
    with ProcessPoolExecutor(2) as pool:
        for filter, said, changed in FORMS:
            n = len(cases)
            found = list(pool.map(form, cases, [filter] * n, [changed] * n))
            first, mall = found[: len(on_kaist)], found[len(on_kaist) :]
            sets = " | ".join(mean_of(of) for of in (first, mall[0::2], mall[1::2]))
            lines.append(f"| {filter} | {said} | {sets} |")
    return [*lines, ""]


def _met(*sets: dict[str, float]) -> str:
    """Whether firefly's mean error is at most plain's on every data set."""
    return "met" if all(one["firefly"] <= one["plain"] for one in sets) else "missed"


def _slower(results: dict[str, list[Result]]) -> float:
    """Firefly's time a step, of plain's."""
    plain, firefly = (sum(r.seconds.min() for r in results[f]) for f in ("plain", "firefly"))
    return float(firefly / plain)


def magmap_page(data: Path, on_kaist: list[Case], on_mall: list[Case]) -> str:
    results = {"KAIST": run(on_kaist), "mall": run(on_mall)}
    unknown = run(on_kaist, known=False)
    pooled = {
        name: {f: np.concatenate([r.errors.ravel() for r in of]) for f, of in found.items()}
        for name, found in results.items()
    }
    figures.draw_errors(pooled, FIGURES / "magmap-errors.png")
    walls = kaist.read_floor(data / "phone/kaist/map/KI-1F.json")
    draw_ways(on_kaist, results["KAIST"], walls, FIGURES / "magmap-kaist.png")
    draw_plan(data, on_mall, results["mall"], FIGURES / "magmap-mall.png")
    mean, mall = ({f: float(pooled[s][f].mean()) for f in FILTERS} for s in ("KAIST", "mall"))
    better = sum(
        firefly.errors.mean() < plain.errors.mean()
        for of in results.values()
        for firefly, plain in zip(of["firefly"], of["plain"], strict=True)
    )
    apart = [
        abs(firefly.errors.mean() - plain.errors.mean())
        for firefly, plain in zip(results["mall"]["firefly"], results["mall"]["plain"], strict=True)
    ]
    odd = int(np.argmax(apart))
    rest = {
        f: np.concatenate(
            [r.errors.ravel() for k, r in enumerate(results["mall"][f]) if k != odd]
        ).mean()
        for f in ("firefly", "plain")
    }
    slower = ", ".join(f"{_slower(of):.2f} times on {name}" for name, of in results.items())
    parts = [
        "# Magnetic maps",
        wrapped(
            "Written by `python tools/studies/related.py DATA`. Methods: Wu and Li, University of "
            "Science and Technology Beijing (firefly adaptive particle filter over dead reckoning "
            "and magnetic fingerprints), and the partial resampling of the patent application in "
            "[pdr.md](pdr.md). Code: `solenav.magmap`; commands `solenav magmap build`, `magmap "
            "show`, `locate`."
        ),
        "",
        "## Goals",
        wrapped(
            f"- Mean error on the KAIST runs with the given map, 1.1 m: plain {mean['plain']:.2f}, "
            f"firefly {mean['firefly']:.2f}, centroid {mean['centroid']:.2f} m, given where the "
            "walk begins and in which direction it sets off."
        ),
        wrapped(
            f"- Firefly no worse than plain: {_met(mean, mall)}; KAIST {mean['firefly']:.2f} "
            f"against {mean['plain']:.2f} m, mall {mall['firefly']:.2f} against "
            f"{mall['plain']:.2f} m (mean error). The two are close: firefly is the better one on "
            f"{better} of {len(on_kaist) + len(on_mall)} walks. At most twice plain's time: "
            f"{slower}."
        ),
        wrapped(
            "- Truth is known at way points only, as a person pressed a button there; KAIST's "
            "first run has one pressed some 3 s off (legs of 0.84 and 1.70 m/s side by side), "
            "which alone costs each filter 3.5 m there. It is counted."
        ),
        "",
        "## How",
        wrapped(
            "- **Survey**: a walk is dead reckoned and laid onto the lines between its way points; "
            "one point a step, its field in the floor's axes (x, y, up), the yaw turned to fit the "
            "lines. **Kriging**: ordinary, exponential variogram, 24 neighbours, component by "
            "component (PyKrige; GSTools would do as well, PyKrige is smaller); the kriging "
            "variance is kept. **File**: `.magmap.npz`, described in `magmap/grid.py`, checked "
            "when it is read."
        ),
        wrapped(
            "- **Particle**: place, turn of the yaw, factor on the length. The mean field of a "
            "step, turned by the particle's heading, is compared with the map's in three "
            "components, so it says something of the heading too. Deviation: "
            f"{TUNING.field_ut:g} µT and the map's own; one component is capped at 3 sigma; "
            "squared deviations count half, as steps in a row repeat each other. Off the map is "
            f"very unlikely, so the map's edge is a wall. {TUNING.particles} particles; a step "
            f"adds {TUNING.step_m:g} m and {math.degrees(TUNING.step_turn):.0f}° of noise, the "
            f"length is known to {100 * TUNING.start_scale:.0f} % at the start."
        ),
        wrapped(
            "- **firefly**: weight W = r_p W_p + r_m W_m, both normalised, W_p of the distance to "
            f"the place reckoned from the last mean ({TUNING.pdr_m:g} m). r_p falls from "
            f"{TUNING.rho_start:g}, the paper's, in proportion to the turns so far and is gone "
            f"after {TUNING.turns:g} right angles; r_m is the rest times exp(-change of the field "
            f"/ {TUNING.calm_ut:g} µT). Below 2N/3 effective particles each flies by exp(-N W) of "
            "the way to a brighter one and takes a random step, even over "
            f"{TUNING.jitter_m:g} m and {math.degrees(TUNING.jitter_turn):.0f}°; weights become "
            "equal. Whom it flies to is drawn among those above the mean weight, by how much they "
            "are above it; the paper's is the one brightest. A cloud narrower than "
            f"{TUNING.narrow_m2:g} m² (mean square) is spread over 4 step lengths."
        ),
        wrapped(
            f"- **centroid**: centre of least distances (Weiszfeld); particles nearer than "
            f"{TUNING.near:g} and farther than {TUNING.far:g} step lengths are resampled together "
            "after averaging their weights in pairs; anew, spread by "
            f"{TUNING.anew_m:g} m, after {TUNING.lost_steps} steps that the field contradicts. The "
            "source's L is read as the step length, as it is called there; as the cloud's radius "
            "hardly any particle is near or far, and the light ones in between stay for good."
        ),
        "",
        "## Choices and judgement",
        wrapped(
            "The forms that the sources leave open, and the noise of a step, were chosen on the "
            "KAIST runs and every second of the mall's walks (the first, third, ... of the table "
            "below): first the noise and the spread of the length by the plain filter's error, so "
            "that firefly is held against the best plain one, then firefly's forms, with the "
            "paper's start of r_p and its 2N/3. Least was to be the sum of the two sets' means. "
            "The mall's other walks were measured beside them and decided nothing. Mean error and "
            f"its standard error over {len(SEEDS)} seeds:"
        ),
        "",
        *halves(on_mall, results["mall"], [mean_of(results["KAIST"][f]) for f in FILTERS]),
        wrapped(
            "Seeds say how much luck there is in the particles, not how another floor or person "
            "would do: walks differ far more than filters. Without the mall's walk on which "
            f"firefly and plain differ most, {on_mall[odd].walk.name[-8:]}, they have "
            f"{rest['firefly']:.2f} and {rest['plain']:.2f} m there."
        ),
        "",
        f"The open forms, one changed at a time, {len(FEW)} seeds:",
        "",
        *forms(on_kaist, on_mall),
        wrapped(
            "What kept firefly behind was the flight to the one brightest: nearly all particles "
            "are light, so nearly all met in one place, with that particle's heading and length, "
            "and what the rest of the cloud knew was lost at each renewal. Drawing whom to fly to "
            "keeps it, and is near a resampling of the residuals. Flying part of the way draws the "
            "cloud together, so the random step must be wide: wider is better on the mall's map, "
            "narrower on KAIST's. W_p brings nothing here: without it the errors are the same, and "
            "kept longer it holds the cloud to the filter's own dead reckoning. No cloud gets so "
            "narrow that it is thrown open."
        ),
        "",
        "## KAIST, given map (0.6 m)",
        wrapped(
            f"{len(on_kaist)} runs, {len(SEEDS)} seeds; the first way point is given. Time is one "
            "core's of the computer that measured, of the quickest seed."
        ),
        "",
        *table(results["KAIST"]),
        *each(on_kaist, results["KAIST"]),
        "![Walks over the floor's walls](figures/magmap-kaist.png)",
        "",
        wrapped(
            "Without the direction, which then comes from the field at the start: the map is wrong "
            "at the third run's start, at its edge, by 150°."
        ),
        "",
        *each(on_kaist, unknown),
        "## Mall (indoor competition, site2/F8), leave one out",
        wrapped(
            "Each walk on the map kriged from the 23 others; walks of which less than "
            f"{100 * COVERED:.0f} % is within 2 m of others have no map to be found on and are "
            f"left out: {len(on_mall)} remain. The phone recalibrates its magnetometer between "
            "walks: the field's mean differs by up to 9 µT between them, as much as the floor "
            "varies (6 µT), and 24 short walks cover the corridors once or twice."
        ),
        "",
        *table(results["mall"]),
        *each(on_mall, results["mall"]),
        "![Errors](figures/magmap-errors.png)",
        "",
        "The map of all walks, its uncertainty, and the variograms:",
        "",
        "![Field and uncertainty](figures/magmap-map.png)",
        "",
        "![Walks over the floor plan](figures/magmap-mall.png)",
        "",
    ]
    return "\n".join(parts)


def draw_ways(
    cases: Sequence[Case],
    results: dict[str, list[Result]],
    walls: Sequence[FloatArray],
    out: Path,
) -> None:
    with sheet(out, (15.0, 5.2), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        for k, (panel, case) in enumerate(zip(figure.subplots(1, len(cases)), cases, strict=True)):
            ways = {name: of[k].way for name, of in results.items()}
            figures.draw_walks(panel, case.floor, ways, truth=case.walk.truth, walls=walls)
            panel.set_title(f"KAIST run {k + 1}")
        figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=5)


def draw_plan(
    data: Path, cases: Sequence[Case], results: dict[str, list[Result]], out: Path
) -> None:
    folder = data / "phone/indoor_competition/site2/F8"
    size = indoor.read_size(folder / "floor_info.json")
    image = steps.need("matplotlib.image").imread(folder / "floor_image.png")
    longest = sorted(range(len(cases)), key=lambda k: -len(way_points(cases[k].walk).time_s))[:3]
    with sheet(out, (15.0, 5.2), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        for panel, k in zip(figure.subplots(1, len(longest)), longest, strict=True):
            ways = {name: of[k].way for name, of in results.items()}
            figures.draw_walks(
                panel, cases[k].floor, ways, truth=cases[k].walk.truth, plan=(image, size)
            )
            panel.set_title(cases[k].walk.name[-8:])
        figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=5)


def study(data: Path) -> None:
    """Everything, into docs/."""
    at_kaist, mall = kaist_walks(data), indoor_walks(data)
    (DOCS / "pdr.md").write_text(pdr_page([*at_kaist, *mall]))
    cells = kaist.read_field(data / "phone/kaist/mats/magmap-KI-1F-0.6a.mat")
    given = magmap.of_cells(cells, site="", floor="1F", deviation=GIVEN_UT)
    surveys = [magmap.survey(walk) for walk in mall]
    whole, _ = magmap.build(surveys, site="", floor="F8")
    figures.draw_map(whole, FIGURES / "magmap-map.png")
    with ProcessPoolExecutor(2) as pool:
        cases = list(pool.map(left_out, [surveys] * len(mall), mall))
    on_kaist = [
        Case("KAIST", walk, given, 1.0, magmap.paces(walk, begin_s=begun(walk)))
        for walk in at_kaist
    ]
    on_mall = [case for case in cases if case.seen >= COVERED]
    (DOCS / "magmap.md").write_text(magmap_page(data, on_kaist, on_mall))


if __name__ == "__main__":
    as_script(study)
