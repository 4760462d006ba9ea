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

SEEDS = range(1, 11)
COVERED = 0.8
GIVEN_UT = 4.0
FILTERS = ("plain", "firefly", "centroid")
SWAYS = (1.0, 1.5, 2.0)
FIGURES = DOCS / "figures"


@dataclass(frozen=True)
class Case:
    """A walk and the map that it is tested on, which it had no part in; `seen` of it is covered."""

    set: str
    walk: Recording
    floor: magmap.MagneticMap
    seen: float


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


def walked_off(walk: Recording) -> float:
    """Where the phone points at the start, from the direction of the first leg."""
    truth = way_points(walk)
    seen = pdr.level(walk)
    a, b = truth.time_s[:2]
    middle = (seen.time_s > a + 0.3 * (b - a)) & (seen.time_s < b - 0.3 * (b - a))
    begun = (seen.time_s >= a) & (seen.time_s <= a + 1.0)
    east, north = (truth.position_enu[1] - truth.position_enu[0])[:2]
    turned = float(np.median(seen.yaw[middle]) - seen.yaw[begun].mean())
    return math.atan2(north, east) - turned


def left_out(surveys: Sequence[magmap.Survey], walk: Recording) -> Case:
    """The walk with the map of all others."""
    others = [s for s in surveys if s.name != walk.name]
    own = next(s for s in surveys if s.name == walk.name)
    floor, _ = magmap.build(others, site="", floor="F8")
    seen = np.isfinite(floor.at(own.points)[0][:, 0]).mean()
    return Case("indoor competition", walk, floor, float(seen))


def tried(case: Case, filter: str, known: bool, tuning: Tuning = TUNING) -> Result:
    truth = way_points(case.walk)
    points = truth.position_enu[:, :2]
    errors, seconds, way = [], [], np.empty((0, 2))
    for seed in SEEDS:
        found = magmap.locate(
            case.walk,
            case.floor,
            (float(points[0, 0]), float(points[0, 1])),
            filter=filter,
            start_heading=walked_off(case.walk) if known else None,
            seed=seed,
            tuning=tuning,
            begin_s=max(0.0, float(truth.time_s[0])),
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
    seen = pdr.level(case.walk)
    begin = max(0.0, float(truth.time_s[0]))
    found = pdr.reckoning.between(pdr.detect(seen.time_s, seen.vertical), begin, math.inf)
    soon = (seen.time_s >= begin) & (seen.time_s <= begin + 1.0)
    yaw = seen.yaw + walked_off(case.walk) - seen.yaw[soon].mean()
    start = (float(points[0, 0]), float(points[0, 1]))
    track = pdr.reckoning.track_of(
        case.walk.name, found, seen.time_s, yaw, pdr.GENERIC.of(found), start
    )
    at = np.column_stack(
        [np.interp(truth.time_s, track.position_s, track.position[:, k]) for k in (0, 1)]
    )
    return Result(
        np.hypot(*(at - points).T)[np.newaxis, 1:], np.array([math.nan]), track.position[:, :2]
    )


def table(results: dict[str, list[Result]]) -> list[str]:
    """A line a filter: mean and 75 % error over way points and seeds, spread of seeds, time."""
    plain = np.mean([r.seconds.mean() for r in results["plain"]])
    lines = [
        "| filter | mean, m | 75 %, m | mean by seed, m | time a step, of plain's |",
        "|---|---|---|---|---|",
    ]
    for name, of in results.items():
        pooled = np.concatenate([r.errors.ravel() for r in of])
        seeds = np.concatenate([r.errors for r in of], axis=1).mean(axis=1)
        ratio = np.mean([r.seconds.mean() for r in of]) / plain
        lines.append(
            f"| {name} | {pooled.mean():.2f} | {np.percentile(pooled, 75):.2f} | "
            f"{seeds.min():.2f} to {seeds.max():.2f} | "
            + ("-" if math.isnan(ratio) else f"{ratio:.2f}")
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
    results = {name: [tried(case, name, known) for case in cases] for name in FILTERS}
    if known:
        results["dead reckoning"] = [reckoned(case) for case in cases]
    return results


def variants(cases: Sequence[Case]) -> list[str]:
    """The firefly filter's open forms, one changed at a time."""
    changed: dict[str, Tuning] = {
        "as shipped": TUNING,
        "share of dead reckoning starts at 0.9 (the paper's)": replace(TUNING, rho_start=0.9),
        "starts at 0.9, gone after half a turn": replace(TUNING, rho_start=0.9, turns=0.5),
        "starts at 0: the field alone": replace(TUNING, rho_start=0.0),
        "disturbance counts (20 µT)": replace(TUNING, calm_ut=20.0),
        "attraction 0.5": replace(TUNING, attraction=0.5),
        "half the random step": replace(
            TUNING, jitter_m=TUNING.jitter_m / 2, jitter_turn=TUNING.jitter_turn / 2
        ),
        "thrown open below 0.1 m²": replace(TUNING, narrow_m2=0.1),
    }
    lines = ["| firefly | mean, m | 75 %, m |", "|---|---|---|"]
    for name, tuning in changed.items():
        errors = np.concatenate(
            [tried(case, "firefly", True, tuning).errors.ravel() for case in cases]
        )
        lines.append(f"| {name} | {errors.mean():.2f} | {np.percentile(errors, 75):.2f} |")
    return [*lines, ""]


def _met(*sets: dict[str, float]) -> str:
    """Whether firefly's mean error is at most plain's on every data set."""
    return "met" if all(one["firefly"] <= one["plain"] for one in sets) else "missed"


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
    mean = {name: pooled["KAIST"][name].mean() for name in FILTERS}
    mall = {name: pooled["mall"][name].mean() for name in FILTERS}
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
            f"{mall['plain']:.2f} m. At most twice its time: the tables."
        ),
        wrapped(
            "- Truth is known at way points only, as a person pressed a button there; KAIST's "
            "first run has one pressed some 3 s off (legs of 0.84 and 1.70 m/s side by side), "
            "which alone costs each filter 3.5 m there. It is counted. Tuning was chosen on the "
            "KAIST runs; the mall's were not looked at for it."
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
            "step, turned by the particle's heading, is compared with the map's in "
            "three components, so "
            "it says something of the heading too. Deviation: 10 µT and the map's own; one "
            "component is capped at 3 sigma; squared deviations count half, as steps in a row "
            "repeat each other. Off the map is very unlikely, so the map's edge is a wall. 500 "
            "particles."
        ),
        wrapped(
            "- **firefly**: weight W = r_p W_p + r_m W_m, both normalised, W_p of the distance to "
            "the place reckoned from the last mean (1 m). r_p falls from `rho_start` in "
            "proportion to "
            "turns (right angles) so far, over `turns`; r_m is the rest times exp(-change of the "
            "field / `calm_ut`). Below 2N/3 effective particles each flies by exp(-N W) of the way "
            "to the brightest and takes a random step; weights become equal. A cloud narrower than "
            "0.01 m² (mean square) is spread over 4 step lengths."
        ),
        wrapped(
            "- **centroid**: centre of least distances (Weiszfeld); particles nearer than 0.2 and "
            "farther than 0.8 of the largest distance are resampled together after averaging their "
            "weights in pairs; anew, spread by 2 m, after 5 steps that the field contradicts."
        ),
        "",
        "## KAIST, given map (0.6 m)",
        wrapped(f"{len(on_kaist)} runs, {len(SEEDS)} seeds; the first way point is given."),
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
        "The open forms of the firefly filter, direction given:",
        "",
        *variants(on_kaist),
        wrapped(
            "The paper's start of 0.9 makes the filter believe its own dead reckoning: a weight of "
            "0.1 for the field bends a wrong heading too slowly. Hence 0.2."
        ),
        "",
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
    ]
    draw_plan(data, on_mall, results["mall"], FIGURES / "magmap-mall.png")
    parts += ["![Walks over the floor plan](figures/magmap-mall.png)", ""]
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
        panel.legend(loc="upper left", fontsize=8)


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
        panel.legend(loc="best", fontsize=8)


def study(data: Path) -> None:
    """Everything, into docs/."""
    at_kaist, mall = kaist_walks(data), indoor_walks(data)
    (DOCS / "pdr.md").write_text(pdr_page([*at_kaist, *mall]))
    cells = kaist.read_field(data / "phone/kaist/mats/magmap-KI-1F-0.6a.mat")
    given = magmap.of_cells(cells, site="", floor="1F", deviation=GIVEN_UT)
    surveys = [magmap.survey(walk) for walk in mall]
    whole, variograms = magmap.build(surveys, site="", floor="F8")
    figures.draw_map(whole, FIGURES / "magmap-map.png", variograms)
    with ProcessPoolExecutor(2) as pool:
        cases = list(pool.map(left_out, [surveys] * len(mall), mall))
    on_kaist = [Case("KAIST", walk, given, 1.0) for walk in at_kaist]
    on_mall = [case for case in cases if case.seen >= COVERED]
    (DOCS / "magmap.md").write_text(magmap_page(data, on_kaist, on_mall))


if __name__ == "__main__":
    as_script(study)
