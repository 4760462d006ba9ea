"""What the magnetometer does to the heading: `python tools/studies/heading.py DATA`.

DATA is a folder with the public recordings (see recordings.py). The integer core, its heading
stage off and with many settings, over every recording that has a magnetometer and over simulated
laps; writes docs/heading.md and its figures. Minutes on one core.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pages
from numpy.typing import NDArray

from solenav import datasets, importing, mpu9150
from solenav.engines.traced import Trace, trace
from solenav.errors import SolenavError
from solenav.parameters import Settings
from solenav.plotting import BLUE, GREEN, GREY, INK, PURPLE, RED, sheet
from solenav.recording import FloatArray, Recording
from solenav.sim.field import Earth
from solenav.sim.imu import TABLE1, rotate
from solenav.sim.scenario import simulate
from solenav_core import messages, navigator, params

wrapped = partial(pages.wrapped, width=110)

FILES = (
    ("SC_11", "llio", "llio/SC_11.csv"),
    ("SC_13", "llio", "llio/SC_13.csv"),
    *(
        (f"openshoe {n}", "openshoe", f"openshoe/Measurement_100521_{n}_data_inert.txt")
        for n in (2, 30, 31, 32)
    ),
    ("L walks", "gaitmap", "gaitmap/aligned_data_with_mag_l_walks.csv"),
)
SEEDS = (1, 2, 3, 4)
DRIFT_DPS, WARMING_S = 0.05, 60.0
DRIFTS_DPS = (0.0, 0.02, 0.05, 0.1, 0.2)
START_SEEDS = range(1, 21)
DECLINATION_DEG = 4.0
CAL = ", iron out"

_OPEN = {"magnetometer_strength": 1.0, "magnetometer_dip_deg": 57.0}

Measure = Callable[["Case", Trace], float]


@dataclass(frozen=True)
class Variant:
    """Settings of the heading stage under a name; `iron` takes the walk's own hard iron out."""

    name: str
    settings: Settings
    iron: bool = False


@dataclass(frozen=True)
class Case:
    """A walk: its recording, the core's words (n, 10), what it does unaided, and what of the
    magnetometer (µT, its own axes) is the sensor's own iron by `hard_iron`."""

    name: str
    recording: Recording
    words: NDArray[np.int16]
    off: Trace
    iron: FloatArray
    field: FloatArray


def variants() -> list[Variant]:
    """Off, gains, bias learning and open gates, each without and with the iron taken out."""
    chosen: list[tuple[str, dict[str, float]]] = [
        (f"{seconds:g} s", {"magnetometer_s": seconds}) for seconds in (3.0, 10.0, 30.0, 100.0)
    ]
    for seconds, bias in ((30.0, 100.0), (30.0, 30.0), (100.0, 100.0)):
        both = {"magnetometer_s": seconds, "magnetometer_bias_s": bias}
        chosen.append((f"{seconds:g} s, bias {bias:g} s", both))
    for seconds, bias in ((30.0, 0.0), (100.0, 0.0), (30.0, 100.0)):
        name = f"{seconds:g} s, bias {bias:g} s" if bias else f"{seconds:g} s"
        both = {"magnetometer_s": seconds, "magnetometer_bias_s": bias}
        chosen.append((f"{name}, open", {**both, **_OPEN}))
    off = Settings()
    found = [Variant("off", off)]
    for iron in (False, True):
        for name, changes in chosen:
            settings = replace(off, **changes)  # type: ignore[arg-type]
            found.append(Variant(name + CAL * iron, settings, iron))
    return found


def run(case: Case, variant: Variant) -> Trace:
    """The core over a case."""
    return _run(case.recording, case.words, variant.settings, case.iron if variant.iron else None)


def _run(
    recording: Recording, words: NDArray[np.int16], settings: Settings, iron: FloatArray | None
) -> Trace:
    values = importing.parameters_of(recording, settings)
    if iron is not None:
        for axis, bias in zip("XYZ", iron, strict=True):
            values[params.NAMES.index(f"MAG_B{axis}")] = round(16 * bias / mpu9150.MAG_UT_PER_LSB)
    return trace(words, values)


def case_of(name: str, recording: Recording) -> Case:
    """The case of a recording, its iron found from the walk itself."""
    samples, _ = importing.samples_of(recording)
    off = _run(recording, samples.words, Settings(), None)
    return Case(name, recording, samples.words, off, *hard_iron(samples.words, off))


def readings(words: NDArray[np.int16], done: Trace) -> tuple[NDArray[np.intp], FloatArray]:
    """Rows with a new reading once the core navigates, and the readings (k, 3) µT, body axes."""
    rows = np.flatnonzero(words[:, 9] & messages.MAG_NEW)
    rows = rows[rows > done.start.row]
    mount = np.array(done.start.mount)
    field = mpu9150.mag_from_counts(words[rows, 6:9])
    return rows, field[:, np.abs(mount) - 1] * np.sign(mount)


def hard_iron(words: NDArray[np.int16], done: Trace) -> tuple[FloatArray, FloatArray]:
    """The sensor's own iron (3,), µT in its axes, and the field (3,), ENU, that fit a walk best.

    One field that stands still in ENU, and one that turns with the foot: the core's attitude
    tells them apart, in swing too. Absolute deviations, by weights, as steel makes large ones.
    """
    rows, seen = readings(words, done)
    back = done.attitude[rows] * [1, -1, -1, -1]
    turns = np.stack([rotate(back, np.tile(axis, (len(rows), 1))) for axis in np.eye(3)], axis=2)
    model = np.concatenate([turns, np.tile(np.eye(3), (len(rows), 1, 1))], axis=2)
    weight = np.ones(len(rows))
    for _ in range(15):
        normal = np.einsum("k,kij,kil->jl", weight, model, model)
        found = np.linalg.solve(normal, np.einsum("k,kij,ki->j", weight, model, seen))
        weight = 1 / np.maximum(np.linalg.norm(seen - model @ found, axis=1), 3.0)
    mount = np.array(done.start.mount)
    iron = np.empty(3)
    iron[np.abs(mount) - 1] = found[3:] * np.sign(mount)
    return iron, found[:3]


# --- measures ------------------------------------------------------------------------------------


def closure(case: Case, done: Trace) -> float:
    """Horizontal distance from start to end, m."""
    return float(np.hypot(*done.position[-1, :2]))


def rmse(case: Case, done: Trace) -> float:
    """Horizontal, m, against the truth in its own frame: the initial heading is known."""
    truth = case.recording.truth
    assert truth is not None
    off = done.position[:, :2] - truth.position_enu[:, :2]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def straight_steps(done: Trace) -> tuple[NDArray[np.intp], FloatArray]:
    """Rows in which steps end that go straight on, and their courses in degrees from North."""
    ends = np.flatnonzero(np.diff(done.steps) > 0)
    moved = np.diff(done.position[ends, :2], axis=0)
    course = np.degrees(np.arctan2(moved[:, 0], moved[:, 1]))
    on = np.abs(_wrap(np.diff(course))) < 20
    straight = np.r_[False, on] & np.r_[on, False] & (np.linalg.norm(moved, axis=1) > 0.6)
    return ends[1:][straight], course[straight]


def _wrap(degrees: FloatArray) -> FloatArray:
    return (degrees + 180) % 360 - 180


def legs_apart(case: Case, done: Trace) -> float:
    """How far the legs' courses are from one another, standard deviation in degrees.

    Of straight steps, modulo 90°: the walks measured so have right angles.
    """
    _, course = straight_steps(done)
    turned = np.exp(4j * np.radians(course))
    return float(np.degrees(np.angle(turned / turned.mean())).std() / 4)


def drift(case: Case, done: Trace) -> float:
    """Of the legs' courses, degrees a minute, modulo 90° like `legs_apart`."""
    rows, course = straight_steps(done)
    unwrapped = np.unwrap(np.radians(4 * course)) / 4
    minutes = rows / case.recording.rate_hz / 60
    return float(np.degrees(np.polyfit(minutes, unwrapped, 1)[0]))


def turns_apart(case: Case, done: Trace) -> float:
    """How far the places where somebody turns back are from one another, m RMS.

    They alternate between the L's two ends.
    """
    rows, course = straight_steps(done)
    back = np.flatnonzero(np.abs(_wrap(np.diff(course))) > 140)
    places = np.array(
        [done.position[rows[i] : rows[i + 1], :2].mean(axis=0) for i in back.tolist()]
    )
    off = [places[end::2] - places[end::2].mean(axis=0) for end in (0, 1)]
    return float(np.sqrt((np.concatenate(off) ** 2).sum(axis=1).mean()))


# --- the cases -----------------------------------------------------------------------------------


def drifting(recording: Recording, drift_dps: float) -> Recording:
    """The same with a gyro that warms up after the static start, about the sensor's z axis."""
    risen = np.clip((recording.time_s - 5.0) / WARMING_S, 0, 1)
    gyro = recording.gyro.copy()
    gyro[:, 2] += math.radians(drift_dps) * risen
    return replace(recording, gyro=gyro)


def simulated() -> dict[str, list[Case]]:
    """Five times around, in several fields: a case for each seed."""
    iron = replace(TABLE1, hard_iron=10.0, soft_iron=0.03)
    conditions: dict[str, tuple[float, dict[str, Any]]] = {
        "outdoors": (0.0, {}),
        "outdoors, drift": (DRIFT_DPS, {}),
        "10 µT iron, drift": (DRIFT_DPS, {"errors": iron}),
        "indoors": (0.0, {"indoors": True}),
        "indoors, drift": (DRIFT_DPS, {"indoors": True}),
    }
    found = {}
    for name, (warming, options) in conditions.items():
        cases = []
        for seed in SEEDS:
            recording = simulate("laps", seed=seed, **options)
            cases.append(case_of(name, drifting(recording, warming)))
        found[name] = cases
    return found


# --- tables --------------------------------------------------------------------------------------


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def in_field(cases: Sequence[Case]) -> str:
    """What the magnetometers saw in stance."""
    rows = []
    for case in cases:
        at, seen, off = _stance_readings(case)
        size = np.linalg.norm(seen, axis=1)
        dip = np.degrees(np.arcsin(-seen[:, 2] / size))
        level = float(np.hypot(*case.field[:2]))
        size_found = float(np.linalg.norm(case.field))
        dip_found = math.degrees(math.atan2(-case.field[2], level))
        taken = off[_used(case, at)]
        rows.append(
            [
                case.name,
                f"{len(at)}",
                _quantiles(size),
                _quantiles(dip),
                f"{_rms(off):.0f}°",
                f"{_rms(taken):.0f}° of {len(taken)}",
                " ".join(f"{value:+.1f}" for value in case.iron),
                f"{size_found:.1f} µT, {dip_found:.0f}°",
            ]
        )
    head = "walk | stances | strength, µT | dip, ° | direction off | taken | iron, µT | field"
    return table(head.split(" | "), rows)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


def _stance_readings(case: Case) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Of each stance on the way the row, the field in ENU, µT, and how far its azimuth, by the
    unaided core, is from the static start's, degrees."""
    rows, seen = readings(case.words, case.off)
    stance = case.off.stance[rows]
    field = rotate(case.off.attitude[rows], seen)
    run_of = np.cumsum(np.diff(case.off.stance.astype(int), prepend=0) == 1)[rows]
    azimuth = np.degrees(np.arctan2(field[:, 0], field[:, 1]))
    steps = case.off.steps[rows]
    before = field[stance & (steps == 0)].mean(axis=0)
    reference = math.degrees(math.atan2(before[0], before[1]))
    chosen = []
    for which in np.unique(run_of[stance & (steps > 0) & (steps < steps[-1])]).tolist():
        of = np.flatnonzero(stance & (run_of == which))
        chosen.append(of[len(of) // 2])
    middle = np.array(chosen)
    return rows[middle], field[middle], _wrap(azimuth[middle] - reference)


def _quantiles(values: FloatArray) -> str:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{low:.0f} · {middle:.0f} · {high:.0f}"


def axes(cases: Sequence[Case]) -> str:
    """Which of the 24 rotations from the magnetometer's to the gyro's axes fits each recording."""
    rows = []
    for case in cases:
        fits = []
        for lag in range(-2, 9):
            for axis_names, misfit in _misfits(case.recording, lag * 0.005).items():
                fits.append((misfit, axis_names, lag * 5))
        best = min(fits)
        next_best = min(fit for fit in fits if fit[1] != best[1])
        rows.append(
            [
                case.name,
                best[1],
                f"{best[2]:+d} ms",
                f"{best[0]:.0f}",
                next_best[1],
                f"{next_best[0]:.0f}",
            ]
        )
    head = "walk | axes | late by | misfit, µT/s | next best | misfit, µT/s"
    return table(head.split(" | "), rows)


def _misfits(recording: Recording, late_s: float) -> dict[str, float]:
    """RMS by which the field's change isn't the foot's turn, for each right-handed naming."""
    mag = recording.mag
    assert mag is not None
    time_s = recording.time_s
    known = ~np.isnan(mag).any(axis=1)
    kernel = np.ones(round(0.05 * recording.rate_hz))
    kernel /= len(kernel)
    field = np.column_stack(
        [
            np.convolve(np.interp(time_s + late_s, time_s[known], axis[known]), kernel, "same")
            for axis in mag.T
        ]
    )
    rate = np.column_stack([np.convolve(axis, kernel, "same") for axis in recording.gyro.T])
    inner = slice(len(kernel), -len(kernel), 3)
    change = np.gradient(field, time_s, axis=0)[inner]
    field, rate = field[inner], rate[inner]
    found = {}
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(turn) > 0:
                off = change @ turn.T + np.cross(rate, field @ turn.T)
                name = " ".join(
                    f"{'+' if sign > 0 else '-'}{'xyz'[axis]}"
                    for sign, axis in zip(signs, order, strict=True)
                )
                found[name] = float(np.sqrt((off**2).sum(axis=1).mean()))
    return found


def _named(name: str) -> Variant:
    return next(variant for variant in variants() if variant.name == name)


def measured(
    cases: Sequence[Case],
    done: dict[tuple[str, str], Trace],
    columns: Sequence[tuple[str, Measure]],
) -> str:
    """A row for each variant, a column for each (case, measure)."""
    of = {case.name: case for case in cases}
    names: dict[Measure, str] = {
        closure: "closure, m",
        legs_apart: "legs, °",
        drift: "°/min",
        turns_apart: "turns, m",
    }
    rows = []
    for variant in variants():
        cells = [variant.name]
        for name, measure in columns:
            value = measure(of[name], done[name, variant.name])
            cells.append(f"{value:+.1f}" if measure is drift else f"{value:.2f}")
        rows.append(cells)
    return table(["", *(f"{name}: {names[measure]}" for name, measure in columns)], rows)


def in_simulation(errors: dict[str, FloatArray]) -> str:
    rows = [
        [variant.name, *(f"{of[i].mean():.2f} · {of[i].max():.2f}" for of in errors.values())]
        for i, variant in enumerate(variants())
    ]
    return table(["", *errors], rows)


def worth() -> str:
    """The error against the gyro's drift: when steering begins to pay."""
    names = ("off", f"30 s, bias 30 s{CAL}", f"100 s{CAL}", f"100 s, open{CAL}")
    cells: dict[float, list[str]] = {drift_dps: [] for drift_dps in DRIFTS_DPS}
    for indoors in (False, True):
        walks = [simulate("laps", seed=seed, indoors=indoors) for seed in SEEDS]
        for drift_dps in DRIFTS_DPS:
            cases = [case_of("", drifting(recording, drift_dps)) for recording in walks]
            for name in names:
                found = [rmse(case, run(case, _named(name))) for case in cases]
                cells[drift_dps].append(f"{np.mean(found):.2f}")
    head = [f"{name}{place}" for place in ("", "; indoors") for name in names]
    return table(["drift, °/s", *head], [[f"{d:g}", *row] for d, row in cells.items()])


def starts() -> str:
    """The heading that the magnetometer gives at the static start, against the truth."""
    earth = Earth(declination=math.radians(DECLINATION_DEG))
    settings = Settings(
        magnetometer_s=30.0, magnetometer_start=True, declination_deg=DECLINATION_DEG
    )
    conditions: dict[str, dict[str, Any]] = {
        "no iron": {"errors": replace(TABLE1, hard_iron=0.0, soft_iron=0.0)},
        "1 µT": {},
        "10 µT": {"errors": replace(TABLE1, hard_iron=10.0)},
        "1 µT, indoors": {"indoors": True},
    }
    rows = []
    for name, options in conditions.items():
        errors = []
        for seed in START_SEEDS:
            scenario = ("stand", "loop", "line35")[seed % 3]
            recording = simulate(scenario, seed=seed, earth=earth, **options).first(5.0)
            truth = recording.notes.pop("initial_heading_rad")
            samples, _ = importing.samples_of(recording)
            done = _run(recording, samples.words, settings, None)
            w, x, y, z = done.attitude[-1]
            heading = math.atan2(2 * (x * y - w * z), 1 - 2 * (x * x + z * z))
            errors.append(math.degrees(math.remainder(heading - truth, 2 * math.pi)))
        off = np.array(errors)
        rows.append([name, f"{_rms(off):.1f}", f"{np.abs(off).max():.1f}"])
    return table(["iron left", "RMS, °", "largest, °"], rows)


# --- figures -------------------------------------------------------------------------------------


def draw_fields(cases: Sequence[Case], out: Path) -> None:
    """The field's azimuth at each stance against the static start's: used and refused."""
    with sheet(out, (12.5, 6.2), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        grid = figure.subplots(2, 4, sharey=True)
        for panel, case in zip(grid.flat, cases, strict=False):
            at, _seen, off = _stance_readings(case)
            gated = _used(case, at)
            time_s = case.recording.time_s[at]
            panel.axhline(0, color=GREY, linewidth=0.8)
            panel.plot(time_s[~gated], off[~gated], "x", color=RED, markersize=4, label="refused")
            panel.plot(time_s[gated], off[gated], "o", color=BLUE, markersize=3.5, label="taken")
            panel.set_title(case.name)
            panel.set_ylim(-100, 100)
            panel.set_xlabel("s")
        for panel in grid[:, 0]:
            panel.set_ylabel("azimuth of the field\nagainst the start's, °")
        last = grid.flat[-1]
        last.axis("off")
        handles, labels = grid.flat[0].get_legend_handles_labels()
        last.legend(handles, labels, loc="center")


def _used(case: Case, at: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether the gates of the default settings let the readings of rows `at` pass."""
    steered = run(case, _named("100 s"))
    return np.asarray((steered.events[at] & navigator.STEERED) != 0)


def draw_tracks(
    cases: Sequence[Case], done: dict[tuple[str, str], Trace], out: Path, aided: Sequence[str]
) -> None:
    """Unaided and aided, one beside the other."""
    colours = (INK, BLUE, RED, GREEN)
    with sheet(out, (12.5, 6.0), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        grid = figure.subplots(1, len(cases))
        for panel, case in zip(grid, cases, strict=True):
            for name, colour in zip(("off", *aided), colours, strict=False):
                way = done[case.name, name].position
                panel.plot(way[:, 0], way[:, 1], color=colour, linewidth=0.9, label=name)
            panel.plot(0, 0, "o", color=GREY, markersize=4)
            panel.set_title(case.name)
            panel.set_aspect("equal", adjustable="datalim")
            panel.set_xlabel("E, m")
        grid[0].set_ylabel("N, m")
        handles, labels = grid[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)


def draw_gains(
    cases: dict[str, list[Case]],
    errors: dict[str, FloatArray],
    recorded: dict[str, tuple[str, list[float]]],
    out: Path,
) -> None:
    """Error against the time constant: simulated and recorded."""
    seconds = [3.0, 10.0, 30.0, 100.0]
    rows = {variant.name: i for i, variant in enumerate(variants())}
    with sheet(out, (12.5, 5.0), dpi=90) as figure:
        figure.set_layout_engine("constrained")
        left, right = figure.subplots(1, 2)
        for (name, of), colour in zip(
            errors.items(), (GREY, BLUE, PURPLE, GREEN, RED), strict=True
        ):
            for suffix, style in (("", "--"), (CAL, "-")):
                values = [of[rows[f"{s:g} s{suffix}"]].mean() for s in seconds]
                label = name if suffix else None
                left.plot(
                    [*seconds, 300.0], [*values, of[0].mean()], style, color=colour, label=label
                )
                left.plot(300.0, of[0].mean(), "o", color=colour)
        left.set_title("simulated laps: RMSE, m (dashed: iron not taken out)")
        for (name, (unit, values)), colour in zip(
            recorded.items(), (GREY, BLUE, PURPLE, GREEN, RED), strict=False
        ):
            right.plot([*seconds, 300.0], values, "-", color=colour, label=f"{name}, {unit}")
            right.plot(300.0, values[-1], "o", color=colour)
        right.set_title("recorded walks, iron taken out")
        for panel in (left, right):
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_xticks([*seconds, 300.0], [*(f"{s:g}" for s in seconds), "off"])
            panel.minorticks_off()
            panel.set_xlabel("time constant, s")
            panel.legend(loc="lower left", bbox_to_anchor=(0, 1.08), ncols=3, fontsize=8)


# --- the page ------------------------------------------------------------------------------------

COLUMNS: list[tuple[str, Measure]] = [
    ("SC_11", closure),
    ("SC_11", legs_apart),
    ("SC_13", closure),
    ("SC_13", legs_apart),
    *((f"openshoe {n}", closure) for n in (2, 30, 31, 32)),
    ("L walks", legs_apart),
    ("L walks", drift),
    ("L walks", turns_apart),
]


def study(data: Path) -> None:
    """Everything, into docs/. SolenavError where the recordings are not there."""
    if not (data / "foot").is_dir():
        raise SolenavError(f"no recordings in {data / 'foot'}", "give the folder that holds foot/")
    cases = [
        case_of(name, datasets.read(data / "foot" / path, format)) for name, format, path in FILES
    ]
    done = {
        (case.name, variant.name): run(case, variant) for case in cases for variant in variants()
    }
    laps = simulated()
    errors = {
        name: np.array([[rmse(case, run(case, variant)) for case in of] for variant in variants()])
        for name, of in laps.items()
    }
    figures = pages.DOCS / "figures"
    draw_fields(cases, figures / "heading_fields.png")
    draw_tracks(
        [cases[-1], cases[1], cases[5]],
        done,
        figures / "heading_tracks.png",
        [f"30 s{CAL}", f"30 s, bias 100 s, open{CAL}", f"3 s{CAL}"],
    )
    curves: dict[str, tuple[str, list[float]]] = {}
    for name, unit, measure in (
        ("SC_11", "closure, m", closure),
        ("SC_13", "closure, m", closure),
        ("openshoe, mean", "closure, m", closure),
        ("L walks", "legs apart, °", legs_apart),
    ):
        of = [case for case in cases if case.name.startswith(name.split(",")[0])]
        curves[name] = (
            unit,
            [
                float(np.mean([measure(case, done[case.name, variant]) for case in of]))
                for variant in (*(f"{s:g} s{CAL}" for s in (3, 10, 30, 100)), "off")
            ],
        )
    draw_gains(laps, errors, curves, figures / "heading_gains.png")
    text = page(cases, done, errors)
    (pages.DOCS / "heading.md").write_text(text)


def page(
    cases: Sequence[Case], done: dict[tuple[str, str], Trace], errors: dict[str, FloatArray]
) -> str:
    begins = starts()
    rows = {variant.name: i for i, variant in enumerate(variants())}
    of = {case.name: case for case in cases}

    def error(condition: str, name: str) -> str:
        return f"{errors[condition][rows[name]].mean():.2f} m"

    def value(name: str, variant: str, measure: Measure) -> float:
        return measure(of[name], done[name, variant])

    def shoes(variant: str) -> str:
        found = [value(c.name, variant, closure) for c in cases if c.name.startswith("openshoe")]
        return f"{np.mean(found):.2f} m"

    def legs(variant: str) -> str:
        return f"{value('L walks', variant, legs_apart):.1f}°"

    gentle, open_gates, keen = f"30 s, bias 30 s{CAL}", f"30 s, open{CAL}", f"3 s{CAL}"
    parts = [
        "# What the magnetometer does to the heading",
        wrapped(
            "Written by `python tools/studies/heading.py DATA`, where every number here comes "
            "from. The integer core with its heading stage off and on, over every public "
            "recording that has a magnetometer and over simulated laps. A variant's name is the "
            "time constant of the correction (`magnetometer_s`), then that of the learning of "
            "the gyro's bias (`magnetometer_bias_s`). *Open*: readings are taken whatever their "
            "strength and dip; otherwise within 10 % and 8° of the static start's, the default. "
            "*Iron out*: what turns with the foot is taken for the sensor's own iron and "
            "calibrated away; it is found afterwards from the whole walk, so this is what a "
            "good calibration could do, not what a first walk does."
        ),
        "",
        "## When to switch it on",
        wrapped(
            "It is off by default, and should stay so in buildings and on walks of a few "
            "minutes. Indoors the steel in the floor turns the field at a shoe by tens of "
            "degrees from one step to the next, by far more than a gyro that was started at "
            "rest drifts, and most of that is in directions that neither strength nor dip gives "
            "away. On the recordings:"
        ),
        "",
        wrapped(
            "- openshoe, a minute indoors with a gyro that hardly drifts: mean closure "
            f"{shoes('off')} off, {shoes(gentle)} at 30 s with bias learning, {shoes(keen)} at 3 "
            "s. It does harm; the slower it is, the less."
        ),
        wrapped(
            "- SC_11 and SC_13, half a minute around a rectangle: SC_13 closes within "
            f"{value('SC_13', 'off', closure):.2f} m off, {value('SC_13', gentle, closure):.2f} "
            f"m aided with the iron out, {value('SC_13', '30 s, bias 30 s', closure):.2f} m with "
            f"it left in; SC_11 within {value('SC_11', 'off', closure):.2f} m and "
            f"{value('SC_11', gentle, closure):.2f} m. Two walks are no proof."
        ),
        wrapped(
            "- L walks, four minutes indoors with a gyro that drifts by "
            f"{value('L walks', 'off', drift):.1f}° a minute: the legs are {legs('off')} apart "
            f"off, {legs(gentle)} aided with the gates shut, {legs(open_gates)} with them open. "
            "Here it helps, as the drift is larger than what steel does on average; it helps "
            "more with open gates, because the foot first stood in a field that the rest of the "
            "way doesn't have."
        ),
        "",
        wrapped(
            f"Outdoors, simulated, five minutes and 343 m: with a drift of {DRIFT_DPS:g} °/s the "
            f"error is {error('outdoors, drift', 'off')} off and "
            f"{error('outdoors, drift', gentle)} with 30 s and 30 s. But only with the iron out: "
            "1 µT of it left in each axis (a twentieth of the horizontal field, 3° of heading) "
            f"makes {error('outdoors, drift', '30 s, bias 30 s')}, 10 µT "
            f"{error('10 µT iron, drift', '30 s, bias 30 s')}. Without drift, 1 µT turns "
            f"{error('outdoors', 'off')} into {error('outdoors', '30 s, bias 30 s')}."
        ),
        "",
        wrapped(
            "So: switch it on outdoors, on walks of many minutes, with the magnetometer "
            "calibrated in place on the shoe; then `magnetometer_s` = 30, `magnetometer_bias_s` "
            "= 30, gates as they are. Indoors only where the gyro is known to drift: with "
            "`magnetometer_s` = 100 and no bias learning from some 0.02 °/s on, with 30 and 30 "
            "from some 0.1 °/s on (the last table of the simulated laps). Let the foot stand "
            "for the static start away from steel: its field is the reference for all that "
            "follows. The time constants are those of a foot that stands; in walking, where "
            "less than half of the readings are taken in stance, they are two to three times as "
            "long."
        ),
        "",
        "## What the field is like at a foot",
        wrapped(
            "One reading for each stance on the way, turned into East-North-Up by the unaided "
            "core: 5, 50 and 95 % of its strength and dip; how far its direction is from the "
            "static start's, RMS, over all stances and over those whose reading the gates let "
            "pass; the sensor's own iron, in its axes; and the field that fits the whole walk. "
            "Unaided drift is in the directions too: of the L walks' it is a part, of the "
            "others' hardly any."
        ),
        "",
        in_field(cases),
        "![Azimuth of the field at each stance](figures/heading_fields.png)",
        "",
        "## Whose axes",
        wrapped(
            "A field that stands still turns, in the sensor's axes, against the foot's turns: "
            "of the 24 right-handed namings of the magnetometer's axes the one that misses the "
            "gyro's turns least, RMS, and the next best. Turns can't tell it from its mirror "
            "image, all signs changed, but the dip can, which is down in Europe. All sets have "
            "the accelerometer's axes. The LORD's magnetometer is late."
        ),
        "",
        axes(cases),
        "## Recorded walks",
        wrapped(
            "Closure: from start to end, horizontally. The openshoe walks are known to close; "
            "SC_11 and SC_13 have no truth, but are rectangles of 6 by 9 m that come back. "
            "Legs: standard deviation of the courses of straight steps modulo 90°, as all these "
            "ways have right angles; °/min: the trend of it. Turns: how far the three places at "
            "each end of the L, where the walker turns back, are from one another, RMS."
        ),
        "",
        measured(cases, done, COLUMNS),
        "![Unaided and aided tracks](figures/heading_tracks.png)",
        "",
        "## Simulated laps",
        wrapped(
            f"Five times around a rectangle, {len(SEEDS)} seeds: horizontal RMSE in m against "
            "the truth, mean · worst. 49 µT at a dip of 66°; 1 µT of hard iron in each axis (1 "
            "sigma) but where 10 are named, 0.4 µT noise; drift: the gyro's z bias grows by "
            f"{DRIFT_DPS:g} °/s in the first {WARMING_S:.0f} s after the static start; indoors: "
            "spheres of steel in the floor, whose fields spread as those of the openshoe walks "
            "do."
        ),
        "",
        in_simulation(errors),
        "![Error against the time constant](figures/heading_gains.png)",
        "",
        wrapped("How much drift makes it worth while, mean RMSE in m, iron out:"),
        "",
        worth(),
        "## Heading at the start",
        wrapped(
            "`magnetometer_start` takes the initial heading from the magnetometer. Against the "
            f"truth of {len(START_SEEDS)} simulated starts, declination {DECLINATION_DEG:g}°, "
            "set so. Every µT of iron costs some 3°, whatever the gain is: calibrate before "
            "relying on it, and not inside."
        ),
        "",
        begins,
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    pages.as_script(study)
