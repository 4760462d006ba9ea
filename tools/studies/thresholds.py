"""What the detector's parameters do: `python tools/studies/thresholds.py DATA`.

DATA is a folder with the public recordings (see recordings.py). Writes docs/thresholds.md and its
figures. The integer core runs over every recording, at its own rate and resampled, with one
parameter set for all: each parameter by itself, pairs of them, and sets drawn at random, from
which each data set's parameters are chosen by the others. Minutes on two cores.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pages
from numpy.typing import NDArray
from recordings import FLOOR_SHARE, recordings
from scipy.stats import qmc

from solenav import mpu9150, plotting
from solenav.comparison.metrics import LOST_SHARE
from solenav.filters.walk import Walk
from solenav.parameters import Settings
from solenav.recording import FloatArray, Recording
from solenav.tuning import error_m, from_recording, run

wrapped = partial(pages.wrapped, width=110)
RATES_HZ = (50.0, 100.0, 200.0, 400.0)
SEEDS = (1, 2)

VALUES: dict[str, tuple[float, ...]] = {
    "accel_max": (10.3, 10.8, 11.3, 11.8, 12.3, 12.8, 13.8, 15.8, 18.0),
    "accel_min": (4.0, 6.0, 7.5, 8.3, 8.8, 9.3),
    "rate_max_dps": (25, 35, 40, 45, 50, 60, 70, 85, 100, 120, 150, 200, 300),
    "accel_variance_max": (0.5, 1, 2, 4, 9, 16, 30, 100),
    "window_s": (0.01, 0.02, 0.03, 0.05, 0.06, 0.075),
    "unrest_rate_dps": (2, 3, 4, 5, 7, 10, 20, 50),
    "unrest_accel": (0.26, 0.35, 0.5, 0.7, 1, 2, 5),
    "unrest_s": (0.3, 0.5, 0.7, 1, 1.5, 2, 4),
    "unrest_max": (3, 7, 15, 31, 63, 126),
    "unrest_sure": (1, 2, 4, 7, 12, 20),
}
UNITS = {
    "accel_max": "m/s²",
    "accel_min": "m/s²",
    "rate_max_dps": "°/s",
    "accel_variance_max": "(m/s²)²",
    "window_s": "s",
    "unrest_rate_dps": "°/s",
    "unrest_accel": "m/s²",
    "unrest_s": "s",
    "unrest_max": "u",
    "unrest_sure": "u",
}
ABOUT = {
    "accel_max": "C1, above: what the heel's landing and a hurried foot's turning push |a| past.",
    "accel_min": "C1, below: a foot that falls or is unloaded.",
    "rate_max_dps": "C2: how slowly the foot must turn. It ends a stance as the heel comes up.",
    "accel_variance_max": "C3: how steady |a| must be over the window.",
    "window_s": "C3: the window. At low rates it holds two or three samples.",
    "unrest_rate_dps": "Unrest: the rate that makes T = 1. A large one trusts a turning foot.",
    "unrest_accel": "Unrest: the deviation of |a| from g that makes T = 1.",
    "unrest_s": "Unrest: how fast the least T of late is forgotten.",
    "unrest_max": "Unrest of a sample that still observes zero velocity.",
    "unrest_sure": "Unrest of a sample that has a say in whether the filter is right.",
}
MAP_RATES = (30.0, 40.0, 50.0, 65.0, 85.0, 120.0, 180.0, 300.0)
MAP_ABOVE = (10.8, 11.3, 11.8, 12.3, 13.3, 15.3, 18.0)
MAP_VARIANCES = (0.5, 2.0, 4.0, 9.0, 30.0, 100.0)
MAP_WINDOWS = (0.02, 0.03, 0.05, 0.075)
DRAWN = 256
BOX = {
    "accel_min": (4.0, 9.3),
    "accel_max": (10.3, 18.0),
    "rate_max_dps": (25.0, 300.0),
    "accel_variance_max": (0.5, 100.0),
    "window_s": (0.02, 0.075),
}


@dataclass(frozen=True)
class Outcome:
    """What settings did, (settings, recordings) each.

    `share` is the horizontal error over the distance; `stance` the share of samples in stance.
    """

    share: FloatArray
    stance: FloatArray
    steps: FloatArray

    @property
    def lost(self) -> NDArray[np.intp]:
        """(settings,) recordings lost."""
        return np.asarray((self.share > LOST_SHARE).sum(axis=1))

    @property
    def mean(self) -> FloatArray:
        """(settings,) geometric mean of the bounded share."""
        return np.asarray(np.exp(_bounded_log(self.share).mean(axis=1)))

    @property
    def median(self) -> FloatArray:
        return np.asarray(np.median(self.share, axis=1))

    def of(self, rows: Sequence[int]) -> Outcome:
        """The outcome of some of the settings."""
        chosen = list(rows)
        return Outcome(self.share[chosen], self.stance[chosen], self.steps[chosen])


def _bounded_log(share: FloatArray) -> FloatArray:
    return np.asarray(np.log(np.clip(share, FLOOR_SHARE, 1.0)))


def resampled(recording: Recording, rate_hz: float) -> Recording:
    """The recording at another rate, by a Kaiser-windowed sinc that delays nothing.

    It passes what both rates can hold: at the lower of them, 0.45 of it and less. Truth keeps its
    times, so the result is judged by the same points.
    """
    own = recording.rate_hz
    cutoff = 0.45 * min(own, rate_hz) / own
    reach = math.ceil(8 / cutoff)
    at = np.arange(int((len(recording.time_s) - 1) / own * rate_hz) + 1) / rate_hz * own
    rows = np.floor(at).astype(int)[:, None] + np.arange(1 - reach, reach + 1)
    off = at[:, None] - rows
    window = np.i0(8 * np.sqrt(np.maximum(0.0, 1 - (off / reach) ** 2)))
    weights = np.sinc(2 * cutoff * off) * window
    weights /= weights.sum(axis=1, keepdims=True)
    near = np.clip(rows, 0, len(recording.time_s) - 1)

    def filtered(values: FloatArray) -> FloatArray:
        return np.column_stack([(weights * column[near]).sum(axis=1) for column in values.T])

    return replace(
        recording,
        time_s=np.arange(len(at)) / rate_hz,
        accel=filtered(recording.accel),
        gyro=filtered(recording.gyro),
        rate_hz=rate_hz,
    )


def outcome(settings: Sequence[Settings], seeds: Sequence[int], walk: Walk) -> FloatArray:
    """Error in m (geometric mean over the seeds), stance share and steps, (settings, 3)."""
    rows = []
    for one in settings:
        found = [run(walk, replace(one, seed=seed)) for seed in seeds]
        errors = np.array([error_m(walk, trace) for trace in found])
        stance = found[0].stance[found[0].start.row + 1 :].mean()
        rows.append((np.exp(np.log(np.maximum(errors, 1e-4)).mean()), stance, found[0].steps[-1]))
    return np.array(rows, np.float64)


@dataclass(frozen=True)
class Bench:
    """The recordings, at their own rate (None) and the others, and processes to run them in."""

    names: list[str]
    walks: dict[float | None, list[Walk]]
    distance_m: FloatArray
    pool: ProcessPoolExecutor

    def run(self, settings: Sequence[Settings], rate_hz: float | None) -> Outcome:
        walks = self.walks[rate_hz]
        seeds = SEEDS if rate_hz is None else SEEDS[:1]
        found = np.array(list(self.pool.map(partial(outcome, settings, seeds), walks)))
        error, stance, steps = found.transpose(2, 1, 0)
        return Outcome(error / self.distance_m, stance, steps)


def bench(data: Path, pool: ProcessPoolExecutor) -> Bench:
    found = recordings(data)
    walks: dict[float | None, list[Walk]] = {
        None: [from_recording(recording) for _name, recording in found]
    }
    for rate_hz in RATES_HZ:
        walks[rate_hz] = [from_recording(resampled(r, rate_hz)) for _name, r in found]
    distance = np.array([walk.distance_m for walk in walks[None]])
    return Bench([name for name, _recording in found], walks, distance, pool)


def with_default(name: str, values: Sequence[float]) -> list[float]:
    """The values and the default, ascending."""
    return sorted({*values, float(getattr(Settings(), name))})


def drawn() -> list[Settings]:
    """Sets at random over the logarithms of the thresholds, the same each time."""
    sides = dict(BOX)
    g = mpu9150.STANDARD_GRAVITY
    # The band's sides as distances from g, or the logarithm means nothing.
    sides["accel_min"] = (g - BOX["accel_min"][1], g - BOX["accel_min"][0])
    sides["accel_max"] = (BOX["accel_max"][0] - g, BOX["accel_max"][1] - g)
    low, high = np.log(np.array(list(sides.values()))).T
    cube = qmc.Sobol(len(sides), seed=1).random(DRAWN)
    found = []
    for point in np.exp(low + cube * (high - low)).tolist():
        values: dict[str, Any] = dict(zip(sides, point, strict=True))
        values["accel_min"] = g - values["accel_min"]
        values["accel_max"] = g + values["accel_max"]
        found.append(replace(Settings(), **values))
    return found


def grid(one: str, ones: Sequence[float], other: str, others: Sequence[float]) -> list[Settings]:
    """A setting for each pair of values, `others` fastest."""
    return [replace(Settings(), **{one: a, other: b}) for a in ones for b in others]


@dataclass(frozen=True)
class Map:
    """An outcome over a grid of two parameters."""

    one: str
    ones: list[float]
    other: str
    others: list[float]
    settings: list[Settings]
    found: Outcome
    title: str


def study(data: Path) -> None:
    """Run it all and write it down. SolenavError where there are no recordings."""
    # Spawned: a fork of a process with threads may hang.
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        table = bench(data, pool)
        alone = {
            name: {
                rate: table.run(
                    [replace(Settings(), **{name: v}) for v in with_default(name, values)],
                    rate,
                )
                for rate in (None, *RATES_HZ)
            }
            for name, values in VALUES.items()
        }
        maps = {
            rate: _map(table, "rate_max_dps", MAP_RATES, "accel_max", MAP_ABOVE, rate)
            for rate in (None, *RATES_HZ)
        }
        others = [
            _map(table, "rate_max_dps", MAP_RATES, "accel_variance_max", MAP_VARIANCES),
            _map(table, "accel_max", MAP_ABOVE, "accel_variance_max", MAP_VARIANCES),
            _map(table, "accel_variance_max", MAP_VARIANCES, "window_s", MAP_WINDOWS),
        ]
        random = drawn()
        random_found = table.run(random, None)
    pool_settings = [s for m in (maps[None], *others) for s in m.settings] + random
    pool_found = _stacked([m.found for m in (maps[None], *others)] + [random_found])
    (pages.DOCS / "figures").mkdir(exist_ok=True)
    draw_alone(alone, pages.DOCS / "figures" / "thresholds.png")
    draw_maps([*maps.values(), *others], pages.DOCS / "figures" / "thresholds_pairs.png")
    text = "\n".join(
        [
            _head(table),
            *(_parameter(name, alone[name]) for name in VALUES),
            _pairs(maps),
            _left_out(table, pool_settings, pool_found, alone["rate_max_dps"][None]),
            _recordings(table, alone),
        ]
    )
    (pages.DOCS / "thresholds.md").write_text(text, encoding="utf-8")


def _map(
    table: Bench,
    one: str,
    ones: Sequence[float],
    other: str,
    others: Sequence[float],
    rate_hz: float | None = None,
) -> Map:
    first, second = with_default(one, ones), with_default(other, others)
    settings = grid(one, first, other, second)
    found = table.run(settings, rate_hz)
    title = "own rate" if rate_hz is None else f"{rate_hz:g} Hz"
    return Map(one, first, other, second, settings, found, title)


def _stacked(parts: Sequence[Outcome]) -> Outcome:
    return Outcome(
        np.vstack([part.share for part in parts]),
        np.vstack([part.stance for part in parts]),
        np.vstack([part.steps for part in parts]),
    )


def _head(table: Bench) -> str:
    sets = sorted({name.split()[0] for name in table.names})
    s = Settings()
    paragraphs = [
        "# What the detector's parameters do",
        "Written by `python tools/studies/thresholds.py DATA`, where every number here comes from. "
        f"The integer core over {len(table.names)} public recordings ({', '.join(sets)}), one "
        f"parameter set for all, the others at their defaults: {s.accel_min:g} < |a| < "
        f"{s.accel_max:g} m/s² (C1), |ω| below {s.rate_max_dps:g} °/s (C2), variance of |a| below "
        f"{s.accel_variance_max:g} (m/s²)² (C3) over {1000 * s.window_s:g} ms.",
        "An error is the horizontal RMSE against the truth, else the closure of a closed loop, "
        f"over the distance walked; seeds {' and '.join(map(str, SEEDS))} of the particles, at "
        f"other rates than the recordings' own {SEEDS[0]} alone. *Mean* "
        f"is geometric over the recordings, each held between {FLOOR_SHARE:.1%} of the distance (a "
        f"closure of 0 is luck) and all of it; *lost* counts those above {LOST_SHARE:.0%}, "
        "*stance* is the share of samples, *missed* the share of steps that are found with most "
        "other values but not with this one. The last columns are the mean, and the lost in "
        "brackets, at other rates: recordings resampled in m/s² and rad/s with a filter against "
        "aliasing, then turned into counts. **Bold** is the default.",
        "Two things to know before reading. A lost recording jumps: whether one stance in a run is "
        "found decides over metres, so the count of the lost is no smooth function of anything. "
        "And a closure says nothing of scale.",
        "![Mean error against each parameter](figures/thresholds.png)",
    ]
    return "\n\n".join(map(wrapped, paragraphs)) + "\n"


def _parameter(name: str, found: dict[float | None, Outcome]) -> str:
    values = with_default(name, VALUES[name])
    own = found[None]
    usual = np.median(own.steps, axis=0)
    missed = np.maximum(0.0, usual - own.steps).sum(axis=1) / usual.sum()
    head = f"{name}, {UNITS[name]} | median | mean | worst | lost | stance | missed"
    lines = [
        f"## `{name}`",
        wrapped(ABOUT[name] + " " + _summary(name, values, own)),
        "",
        f"| {head} | " + " | ".join(f"{rate:g} Hz" for rate in RATES_HZ) + " |",
        "|---" * (7 + len(RATES_HZ)) + "|",
    ]
    for i, value in enumerate(values):
        cells = [
            f"{value:g}",
            f"{own.median[i]:.2%}",
            f"{own.mean[i]:.2%}",
            f"{own.share[i].max():.1%}",
            f"{own.lost[i]}",
            f"{own.stance[i].mean():.0%}",
            f"{missed[i]:.1%}",
            *(f"{found[rate].mean[i]:.2%} ({found[rate].lost[i]})" for rate in RATES_HZ),
        ]
        if value == getattr(Settings(), name):
            cells = [f"**{cell}**" for cell in cells]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _summary(name: str, values: list[float], own: Outcome) -> str:
    """What the numbers say of a parameter, whatever they are."""
    fewest = own.lost.min()
    sound = np.flatnonzero(own.lost == fewest)
    best = sound[own.mean[sound].argmin()]
    here = values.index(float(getattr(Settings(), name)))
    near = [values[i] for i in sound if own.mean[i] <= 1.05 * own.mean[best]]
    change = own.mean.max() / own.mean.min()
    if change < 1.05:
        text = (
            f"From {values[0]:g} to {values[-1]:g} it changes the mean by {change - 1:.1%} in all."
        )
    else:
        text = (
            f"The mean changes by a factor of {change:.2f} from its best to its worst value; "
            f"of those with the fewest lost ({fewest}) {values[best]:g} is best, and those from "
            f"{near[0]:g} to {near[-1]:g} are within 5 % of it."
        )
    gain = own.mean[here] / own.mean[best] - 1
    text += f" The default's mean is {abs(gain):.1%} {'above' if gain >= 0 else 'below'} the best's"
    return text + (f", with {own.lost[here]} lost." if own.lost[here] != fewest else ".")


def _pairs(maps: dict[float | None, Map]) -> str:
    """The pair that matters, and the values that serve all rates alike."""
    some = [rate for rate in RATES_HZ if rate >= 100.0]
    serving: list[float | None] = [None, *some]
    lost = np.sum([maps[rate].found.lost for rate in serving], axis=0)
    mean = np.exp(np.mean([np.log(maps[rate].found.mean) for rate in serving], axis=0))
    settings = maps[None].settings
    order = np.lexsort((mean, lost))
    here = next(i for i in order if settings[i] == Settings())
    head = "rate_max_dps | accel_max | mean | lost"
    lines = [
        "## In pairs",
        wrapped(
            "Colour is the mean over that of the default at the same rate, a number in a cell the "
            "recordings lost, the frame the default."
        ),
        "",
        "![Mean error against pairs of parameters](figures/thresholds_pairs.png)",
        "",
        wrapped(
            "C1's upper side against C2, over the own rate and "
            f"{', '.join(f'{rate:g}' for rate in some)} Hz together ({len(serving)} runs of each "
            "recording): the best pairs, fewest lost first."
        ),
        "",
        f"| {head} |",
        "|---" * 4 + "|",
    ]
    for i in dict.fromkeys([*order[:6].tolist(), here]):
        one = settings[i]
        cells = [f"{one.rate_max_dps:g}", f"{one.accel_max:g}", f"{mean[i]:.2%}", f"{lost[i]}"]
        if i == here:
            cells = [f"**{cell}**" for cell in cells]
        lines.append("| " + " | ".join(cells) + " |")
    place = int(np.flatnonzero(order == here)[0]) + 1
    lines.append(f"\nThe default is number {place} of {len(order)}.")
    return "\n".join(lines) + "\n"


def _choice(found: Outcome, columns: NDArray[np.bool_]) -> int:
    """The settings with the fewest lost and then the least mean over some recordings."""
    part = Outcome(found.share[:, columns], found.stance[:, columns], found.steps[:, columns])
    return int(np.lexsort((part.mean, part.lost))[0])


def _left_out(table: Bench, settings: Sequence[Settings], found: Outcome, rates: Outcome) -> str:
    """Parameters for each data set chosen by the others."""
    of = np.array([name.split()[0] for name in table.names])
    values = with_default("rate_max_dps", VALUES["rate_max_dps"])
    default = rates.of([values.index(Settings().rate_max_dps)])
    everything = _choice(found, np.ones(len(of), bool))
    head = "left out | C1 | C2 | C3 | window | by the others | default | by all"
    lines = [
        "## Chosen without the set that judges",
        wrapped(
            f"Of {len(settings)} sets (the pairs above and {DRAWN} drawn at random), the one with "
            "the fewest lost and then the least mean on all data sets but one, and what it does on "
            "that one: mean and, in brackets, lost. A default that is as good there as what was "
            "chosen with the set in hand is not fitted to it. Where the only run is left out, "
            "nothing asks for what only running needs."
        ),
        "",
        f"| {head} |",
        "|---" * 8 + "|",
    ]
    for name in (*dict.fromkeys(of.tolist()), None):
        mine = of == name if name is not None else np.ones(len(of), bool)
        chosen = _choice(found, ~mine) if name is not None else everything
        one = settings[chosen]
        cells = [
            name or "nothing",
            f"{one.accel_min:.2f} to {one.accel_max:.2f}",
            f"{one.rate_max_dps:.0f}",
            f"{one.accel_variance_max:.3g}",
            f"{1000 * one.window_s:.0f} ms",
            *(_judged(share[mine]) for share in (found.share[chosen], default.share[0])),
            _judged(found.share[everything][mine]),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    better = int(((found.lost <= default.lost[0]) & (found.mean < default.mean[0])).sum())
    text = (
        f"Over all recordings {better} of the {len(settings)} sets lose no more than the default "
        "and have a smaller mean."
    )
    if better:
        gain = 1 - found.mean[everything] / default.mean[0]
        text += f" The best of all, with {found.lost[everything]} lost, has one {gain:.1%} smaller."
    lines.append("\n" + wrapped(text))
    return "\n".join(lines) + "\n"


def _judged(share: FloatArray) -> str:
    mean = math.exp(float(_bounded_log(share).mean()))
    return f"{mean:.2%} ({int((share > LOST_SHARE).sum())})"


def _recordings(table: Bench, alone: dict[str, dict[float | None, Outcome]]) -> str:
    """The default on each recording at every rate."""
    at = with_default("rate_max_dps", VALUES["rate_max_dps"]).index(Settings().rate_max_dps)
    found = alone["rate_max_dps"]
    rates = (None, *RATES_HZ)
    lines = [
        "## The default, recording by recording",
        "| recording | distance, m | stance | own rate | "
        + " | ".join(f"{rate:g} Hz" for rate in RATES_HZ)
        + " |",
        "|---" * (4 + len(RATES_HZ)) + "|",
    ]
    for i, name in enumerate(table.names):
        cells = [
            name,
            f"{table.distance_m[i]:.1f}",
            f"{found[None].stance[at, i]:.0%}",
            *(f"{found[rate].share[at, i]:.2%}" for rate in rates),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


_SKY = "#56B4E9"
_COLOURS = (plotting.INK, _SKY, plotting.GREEN, plotting.BLUE, plotting.PURPLE)


def draw_alone(alone: dict[str, dict[float | None, Outcome]], out: Path) -> None:
    """Mean error against each parameter, a line a rate; crosses where recordings are lost."""
    plt = _pyplot()
    with plt.rc_context(plotting.STYLE):
        figure, grid_of = plt.subplots(3, 4, figsize=(13.5, 9.0), sharey=True, layout="constrained")
        for axes, (name, found) in zip(grid_of.flat, alone.items(), strict=False):
            values = with_default(name, VALUES[name])
            for (rate, one), colour in zip(found.items(), _COLOURS, strict=True):
                label = "own rate" if rate is None else f"{rate:g} Hz"
                width = 2.2 if rate is None else 1.2
                axes.plot(values, 100 * one.mean, color=colour, linewidth=width, label=label)
                for value, mean, lost in zip(values, 100 * one.mean, one.lost, strict=True):
                    if lost:
                        axes.plot(value, mean, "x", color=plotting.RED, markersize=3 + 2 * lost)
            axes.axvline(getattr(Settings(), name), color=plotting.GREY, linestyle=":", linewidth=1)
            if values[-1] > 4 * values[0]:
                axes.set_xscale("log")
                ticks = _apart(values)
                axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
                axes.minorticks_off()
            axes.set_title(name)
            axes.set_xlabel(UNITS[name])
        for axes in grid_of[:, 0]:
            axes.set_ylabel("mean error, % of distance")
        for axes in grid_of.flat[len(alone) :]:
            axes.axis("off")
        last = grid_of.flat[-1]
        handles, labels = grid_of.flat[0].get_legend_handles_labels()
        lost = plt.Line2D([], [], color=plotting.RED, marker="x", linestyle="none")
        usual = plt.Line2D([], [], color=plotting.GREY, linestyle=":")
        last.legend(
            [*handles, lost, usual],
            [*labels, f"recordings above {LOST_SHARE:.0%}, larger: more", "default"],
            loc="center",
        )
        figure.savefig(out, dpi=90)
        plt.close(figure)


def _apart(values: Sequence[float]) -> list[float]:
    """Those values whose labels don't touch on a logarithmic axis."""
    kept = [values[0]]
    for value in values[1:]:
        if math.log(value / kept[-1]) > 0.11 * math.log(values[-1] / values[0]):
            kept.append(value)
    return kept


def draw_maps(maps: Sequence[Map], out: Path) -> None:
    """Mean error over the default's, for pairs of parameters."""
    plt = _pyplot()
    reach = 2.0
    with plt.rc_context({**plotting.STYLE, "axes.grid": False}):
        figure, grid_of = plt.subplots(2, 4, figsize=(14.0, 6.6), layout="constrained")
        for axes, one in zip(grid_of.flat, maps, strict=True):
            shape = (len(one.ones), len(one.others))
            here = one.settings.index(Settings())
            ratio = (one.found.mean / one.found.mean[here]).reshape(shape)
            shown = axes.imshow(
                np.log2(ratio).T, origin="lower", cmap="PuOr_r", vmin=-1, vmax=1, aspect="auto"
            )
            for (i, j), lost in np.ndenumerate(one.found.lost.reshape(shape)):
                if lost:
                    dark = abs(math.log2(ratio[i, j])) > 0.7
                    colour = "white" if dark else plotting.INK
                    axes.text(i, j, str(lost), ha="center", va="center", color=colour, fontsize=8)
            i, j = divmod(here, shape[1])
            axes.add_patch(
                plt.Rectangle(
                    (i - 0.5, j - 0.5), 1, 1, fill=False, edgecolor=plotting.INK, linewidth=2
                )
            )
            axes.set_xticks(range(shape[0]), [f"{v:g}" for v in one.ones], rotation=45)
            axes.set_yticks(range(shape[1]), [f"{v:g}" for v in one.others])
            axes.set_xlabel(f"{one.one}, {UNITS[one.one]}")
            axes.set_ylabel(f"{one.other}, {UNITS[one.other]}")
            axes.set_title(one.title)
        bar = figure.colorbar(shown, ax=grid_of, ticks=[-1, -0.5, 0, 0.5, 1], shrink=0.8)
        bar.ax.set_yticklabels([f"{reach**e:.2f}" for e in (-1, -0.5, 0, 0.5, 1)])
        bar.set_label("mean error over the default's")
        figure.savefig(out, dpi=80)
        plt.close(figure)


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


if __name__ == "__main__":
    pages.as_script(study)
