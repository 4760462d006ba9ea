"""What particles are worth: `python tools/studies/particles.py DATA`.

DATA is a folder with the public recordings (see recordings.py). The core, its algorithm in floats,
variants of that and Gaussian controls run beside `kf-twin` in conditions where a cloud might know
more than a Gaussian; writes docs/particles.md and docs/figures/particles.png. Some minutes on two
cores.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pages import DOCS, as_script, wrapped
from recordings import FLOOR_SHARE, walks

from solenav import mpu9150, parameters
from solenav.comparison.faults import spoil, stances
from solenav.comparison.metrics import LOST_SHARE, score
from solenav.comparison.runs import beginning, reseeded
from solenav.comparison.strict import STRICT
from solenav.comparison.table import Sheet, to_markdown
from solenav.errors import SolenavError
from solenav.filters import adaptive, named
from solenav.filters.adaptive import Variant
from solenav.filters.walk import Aids, Track, Walk, walk_of
from solenav.plotting import INK, sheet
from solenav.recording import FloatArray, Truth
from solenav.sim.gait import SCENARIOS, Gait, Motion, attitude, bump, motion, multiply, progress
from solenav.sim.imu import TABLE1, ideal_samples, rotate, with_errors
from solenav_core import params as core

FAULT_SEEDS = (1, 2)
SEEDS, VARIANT_SEEDS = (1, 2, 3, 4), (1, 2)
"""Of the particles."""
SHARE = 0.20
RUNNING = "llio SensorConnectData_35_LLIO"
SIMULATED = (1, 2, 3, 4)
RATE_HZ = 200.0
TILT_DEG = 4.0
KNOCK_MPS, KNOCK_S, KNOCK_SHARE = 1.0, 0.05, 0.1
ROCK_DEG = (4.0, 9.0)
SLIP_M, SLIP_SHARE = 0.05, 0.15
# Of the sensor on the instep, in m: the toes before it, the heel behind it, the sole below.
TOE, HEEL, SOLE = 0.13, -0.12, -0.08
RESAMPLES = 2000

Filter = Callable[[Walk], Track]


def _cloud(variant: Variant, walk: Walk) -> Track:
    return adaptive.particles(walk, Aids(), variant)


def _gaussian(variant: Variant, walk: Walk) -> Track:
    return adaptive.twin(walk, Aids(), variant)


def _sharp(factor: int, walk: Walk) -> Track:
    """The twin with a fraction of the observation noise."""
    values = walk.params[:]
    values[core.NAMES.index("R")] //= factor
    return named("kf-twin")(replace(walk, params=values))


TWIN = "kf-twin"
OWN = ("apf", "apf-float")
_MIXED = Variant(doubt=0.1, widen=False)
VARIANTS: dict[str, tuple[str, Variant]] = {
    "mixture, m²": ("each sample's likelihood is a mixture, R is widened by m²", Variant(0.1)),
    "mixture": ("the same without the widening by m²", _MIXED),
    "kept": ("the cloud lives on in swing, H2 resamples it", Variant(keep=True)),
    "mixture, kept": ("both, without the widening", _MIXED._replace(keep=True)),
    "hypotheses": (
        "a tenth of the particles takes each stance for none, no widening",
        _MIXED._replace(per_stance=True),
    ),
    "hypotheses, kept": (
        "the same with the cloud kept",
        _MIXED._replace(per_stance=True, keep=True),
    ),
    "Student t": (
        "likelihood with 4 degrees of freedom, no widening",
        Variant(freedom=4.0, widen=False),
    ),
    "heavy tails": ("a tenth of what is drawn has three times the deviation", Variant(tails=True)),
}
CONTROLS: dict[str, tuple[str, Filter]] = {
    "twin: mixture, m²": (
        "the twin with the same mixture, as one Gaussian",
        partial(_gaussian, Variant(0.1)),
    ),
    "twin: mixture": ("the same without the widening", partial(_gaussian, _MIXED)),
    "twin: R/2": ("the twin with half the observation noise", partial(_sharp, 2)),
    "twin: R/4": ("the twin with a quarter of it", partial(_sharp, 4)),
}
FILTERS: dict[str, Filter] = {
    **{name: named(name) for name in OWN},
    **{name: partial(_cloud, variant) for name, (_about, variant) in VARIANTS.items()},
    **{name: run for name, (_about, run) in CONTROLS.items()},
}
TRIED = {
    (doubt, spread, widen): partial(_cloud, Variant(doubt, spread, widen=widen))
    for doubt, spread in ((0.03, 1.0), (0.1, 1.0), (0.3, 1.0), (0.1, 0.5), (0.1, 2.0))
    for widen in (True, False)
}
"""Mixtures by probability, speed in m/s and whether R is widened by m²."""
TRIED_AT = ("clean", "3 samples", "hard, strict, false", "hard, strict, both")


@dataclass(frozen=True)
class Condition:
    """`make` gives the walks of one recording, one a fault seed."""

    name: str
    about: str
    make: Callable[[Walk], list[Walk]]
    of: str = "all"


@dataclass(frozen=True)
class Outcome:
    """Logarithms of errors in m in one condition, the distance at most (`log_error`).

    `twin` (recordings, fault seeds); `others` (recordings, fault seeds, particle seeds) by filter;
    `lost` the share of the twin's runs above `LOST_SHARE`.
    """

    twin: FloatArray
    others: dict[str, FloatArray]
    lost: float

    def units(self, name: str, against: str = TWIN) -> FloatArray:
        """(n,) log ratio of errors of a filter to another's, one a recording.

        Of a single recording each run counts.
        """
        base = self.twin if against == TWIN else self.others[against].mean(axis=2)
        ratio = self.others[name] - base[..., None]
        return ratio.ravel() if len(ratio) == 1 else ratio.mean(axis=(1, 2))

    def spread(self, name: str) -> float:
        """Median deviation of the log error from one particle seed to the other."""
        if self.others[name].shape[2] == 1:
            return 0.0
        return float(np.median(self.others[name].std(axis=2, ddof=1)))


@dataclass(frozen=True)
class Judgement:
    """Median log ratio, its bootstrap interval, and what follows with a spread."""

    median: float
    low: float
    high: float
    spread: float

    @property
    def word(self) -> str:
        if self.high < 0 and -self.median > self.spread:
            return "win"
        if self.low > 0 and self.median > self.spread:
            return "lose"
        return "tie"


def judge(outcome: Outcome, name: str, against: str = TWIN) -> Judgement:
    """How a filter compares with another in a condition."""
    units = outcome.units(name, against)
    rng = np.random.default_rng(1)
    medians = np.median(units[rng.integers(0, len(units), (RESAMPLES, len(units)))], axis=1)
    low, high = np.quantile(medians, (0.025, 0.975)).tolist()
    return Judgement(float(np.median(units)), low, high, outcome.spread(name))


# Conditions


def once(walk: Walk) -> list[Walk]:
    return [walk]


def spoilt(false: float, missed: float, walk: Walk) -> list[Walk]:
    return [spoil(walk, seed, false, missed) for seed in FAULT_SEEDS]


def hard(
    settings: parameters.Settings, then: Callable[[Walk], list[Walk]], walk: Walk
) -> list[Walk]:
    """Every sample in stance weighs the same: unrest counts for nothing."""
    values = parameters.to_integers(settings, walk.rate_hz)
    for name in ("UNREST_RATE", "UNREST_ACC"):
        values[core.NAMES.index(name)] = 0
    return then(walk_of(walk.counts, values, name=walk.name, truth=walk.truth))


def thinned(samples: int, walk: Walk) -> list[Walk]:
    """So few samples of each whole stance are left, about its middle."""
    rng = np.random.default_rng(1)
    stance = walk.stance.copy()
    for begin, end in stances(walk):
        stance[begin:end] = False
        first = (begin + end - samples) // 2 + int(rng.integers(-3, 4))
        first = max(begin, min(first, end - samples))
        stance[first : first + samples] = True
    return [walk.with_stance(stance)]


def tilted(walk: Walk) -> list[Walk]:
    """Specific force turned until the static start is over: its tilt is wrong by `TILT_DEG`."""
    rows = walk.start.row + 1
    half = math.radians(TILT_DEG) / 2
    way = np.random.default_rng(1).uniform(0, 2 * math.pi)
    turn = [math.cos(half), math.sin(half) * math.cos(way), math.sin(half) * math.sin(way), 0.0]
    counts = walk.counts.astype(np.float64)
    counts[:rows, :3] = rotate(np.tile(turn, (rows, 1)), counts[:rows, :3])
    return [walk_of(as_counts(counts), walk.params, name=walk.name, truth=walk.truth)]


def knocked(walk: Walk) -> list[Walk]:
    """The accelerometer errs by `KNOCK_MPS` in the middle of some of the swings."""
    size = KNOCK_MPS * walk.rate_hz * mpu9150.ACCEL_LSB_PER_G / mpu9150.STANDARD_GRAVITY
    length = max(1, round(KNOCK_S * walk.rate_hz))
    rng = np.random.default_rng(1)
    counts = walk.counts.astype(np.float64)
    for (_, lift_off), (landing, _) in pairwise(stances(walk)):
        way = rng.standard_normal(3)
        if rng.random() < KNOCK_SHARE:
            middle = (lift_off + landing) // 2
            counts[middle : middle + length, :3] += size / length * way / np.linalg.norm(way)
    whole = as_counts(counts)
    accel, gyro = mpu9150.from_counts(whole)
    return [replace(walk, counts=whole, accel=accel, gyro=gyro)]


def as_counts(values: FloatArray) -> NDArray[np.int16]:
    return np.rint(values).clip(-32768, 32767).astype(np.int16)


def simulated(change: Callable[[Gait, FloatArray, Motion], Motion], seed: int) -> Walk:
    """The loop under the paper's sensor with its motion changed."""
    gait_rng, sensor_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    gait = SCENARIOS["loop"](gait_rng, None)
    time = np.arange(math.ceil(gait.duration_s * RATE_HZ - 1e-6) + 1) / RATE_HZ
    states = change(gait, time, motion(gait, time))
    measured = with_errors(*ideal_samples(states, RATE_HZ), RATE_HZ, TABLE1, sensor_rng)
    settings = parameters.Settings(initial_heading_deg=math.degrees(gait.initial_heading_rad))
    truth = Truth(
        time_s=time[:-1],
        position_enu=states.position_enu[1:],
        velocity_enu=states.velocity_enu[1:],
        stance=states.stance[1:],
        frame="enu",
        closed_loop=False,
    )
    params = parameters.to_integers(settings, RATE_HZ)
    return walk_of(mpu9150.to_counts(*measured).counts, params, name=f"loop-{seed}", truth=truth)


def rocking(degrees: float, gait: Gait, time: FloatArray, states: Motion) -> Motion:
    """In each stance the foot turns about its toes or its heel by some degrees, and back."""
    rng = np.random.default_rng(len(time))
    position, velocity = states.position_enu.copy(), states.velocity_enu.copy()
    turned = states.attitude.copy()
    for begin, end in pairwise_stances(gait):
        rows = (time >= begin) & (time <= end)
        size = math.radians(degrees) * (1 + 0.3 * float(np.clip(rng.standard_normal(), -2, 2)))
        size *= float(rng.choice([-1.0, 1.0]))
        share, slope = bump((time[rows] - begin) / (end - begin), 4, 4)
        angle, rate = size * share, size * slope / (end - begin)
        ahead = TOE if size < 0 else HEEL
        cosine, sine = np.cos(angle), np.sin(angle)
        none = 0 * angle
        pivot = np.stack([none, ahead * cosine - SOLE * sine, ahead * sine + SOLE * cosine], axis=1)
        moving = np.stack([none, -pivot[:, 2] * rate, pivot[:, 1] * rate], axis=1)
        position[rows] += rotate(turned[rows], [0.0, ahead, SOLE] - pivot)
        velocity[rows] -= rotate(turned[rows], moving)
        turned[rows] = multiply(turned[rows], attitude(none, angle, none))
    return Motion(position, velocity, turned, states.stance)


def slipping(gait: Gait, time: FloatArray, states: Motion) -> Motion:
    """In some of the stances the foot slides on, about forward."""
    rng = np.random.default_rng(len(time))
    position, velocity = states.position_enu.copy(), states.velocity_enu.copy()
    for yaw, (begin, end) in zip(gait.yaw[1:], pairwise_stances(gait), strict=False):
        way = yaw + rng.uniform(-0.5, 0.5)
        size = SLIP_M * rng.uniform(0.5, 1.5) * (rng.random() < SLIP_SHARE)
        slide = size * np.array([-math.sin(way), math.cos(way), 0.0])
        share, slope = progress(np.clip((time - begin) / (end - begin), 0.0, 1.0))
        position += share[:, None] * slide
        velocity += slope[:, None] * slide / (end - begin)
    return Motion(position, velocity, states.attitude, states.stance)


def pairwise_stances(gait: Gait) -> list[tuple[float, float]]:
    """When the foot stands between two strides, s."""
    return list(zip(gait.landing[:-1].tolist(), gait.lift_off[1:].tolist(), strict=True))


def unchanged(gait: Gait, time: FloatArray, states: Motion) -> Motion:
    return states


USUAL = parameters.Settings()
_FALSE, _MISSED = partial(spoilt, SHARE, 0.0), partial(spoilt, 0.0, SHARE)
_BOTH = partial(spoilt, SHARE, SHARE)
_P = f"{SHARE:.0%}"
_SIMULATIONS: dict[str, Callable[[Gait, FloatArray, Motion], Motion]] = {
    "simulated": unchanged,
    **{f"rocking, {degrees:g}°": partial(rocking, degrees) for degrees in ROCK_DEG},
    "slipping": slipping,
}
CONDITIONS = (
    Condition("clean", "the recordings as they are", once),
    Condition("false", f"{_P} of the swing samples called stance", _FALSE),
    Condition("missed", f"{_P} of the stances missed", _MISSED),
    Condition("both", "both of these", _BOTH),
    Condition("running", "the running recording alone", once, "running"),
    Condition("running, both", "the same with both faults", _BOTH, "running"),
    Condition("simulated", "simulated loops, the paper's sensor", once, "simulated"),
    *(
        Condition(
            f"rocking, {degrees:g}°",
            f"simulated; in stance the foot turns by {degrees:g}° about heel or toes and back",
            once,
            f"rocking, {degrees:g}°",
        )
        for degrees in ROCK_DEG
    ),
    Condition(
        "slipping",
        f"simulated; the foot slides by {100 * SLIP_M:g} cm in {SLIP_SHARE:.0%} of the stances",
        once,
        "slipping",
    ),
    Condition("wrong tilt", f"the static start's tilt is wrong by {TILT_DEG:g}°", tilted),
    Condition(
        "knocks",
        f"the velocity jumps by {KNOCK_MPS:g} m/s in {KNOCK_SHARE:.0%} of the swings",
        knocked,
    ),
    Condition("3 samples", "3 samples of each stance are left", partial(thinned, 3)),
    Condition("1 sample", "1 sample of each stance is left", partial(thinned, 1)),
    Condition("hard", "hard decisions: no unrest", partial(hard, USUAL, once)),
    Condition("hard, strict", "hard, by a strict detector", partial(hard, STRICT, once)),
    Condition("hard, strict, false", "with false stances", partial(hard, STRICT, _FALSE)),
    Condition("hard, strict, both", "with both faults", partial(hard, STRICT, _BOTH)),
    Condition("hard, both", "wide thresholds, both faults", partial(hard, USUAL, _BOTH)),
)


# Runs


def measured(
    condition: Condition, walk: Walk
) -> tuple[FloatArray, dict[str, FloatArray], float, FloatArray]:
    """One recording's part of an `Outcome`, and the mixtures' change of the log error, if tried."""
    spoilt_walks = condition.make(walk)
    twin = np.array([log_error(w, named(TWIN)) for w in spoilt_walks])
    others = {}
    for name, run in FILTERS.items():
        seeds = SEEDS if name in OWN else VARIANT_SEEDS if name in VARIANTS else (SEEDS[0],)
        errors = [[log_error(reseeded(w, s), run) for s in seeds] for w in spoilt_walks]
        others[name] = np.array(errors)
    lost = float(np.mean(twin > math.log(LOST_SHARE * walk.distance_m)))
    tried = [
        np.mean([log_error(w, run) for w in spoilt_walks]) - twin.mean()
        for run in (TRIED.values() if condition.name in TRIED_AT else ())
    ]
    return twin, others, lost, np.array(tried)


def log_error(walk: Walk, run: Filter) -> float:
    found = score(walk, run(walk), with_evo=False)
    if found.error_m is None:
        raise SolenavError(f"{walk.name} has no truth and is no loop", "take another")
    least = FLOOR_SHARE * walk.distance_m if found.kind == "closure" else 0.0
    return math.log(min(max(found.error_m, least), walk.distance_m))


def gathered(data: Path) -> tuple[dict[str, Outcome], dict[str, FloatArray]]:
    """Every condition's outcome, and the mixtures' median change of the log error where tried."""
    real = walks(data)
    of = {
        "all": real,
        "running": [walk for walk in real if walk.name == RUNNING],
        **{
            name: [simulated(change, seed) for seed in SIMULATED]
            for name, change in _SIMULATIONS.items()
        },
    }
    # Compiled once and kept, not by each process.
    short = beginning(real[0], real[0].start.row + 2)
    for run in FILTERS.values():
        run(short)
    named(TWIN)(short)
    found, tried = {}, {}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        futures = {
            condition.name: [pool.submit(measured, condition, walk) for walk in of[condition.of]]
            for condition in CONDITIONS
        }
        for name, parts in futures.items():
            done = [part.result() for part in parts]
            found[name] = Outcome(
                np.array([twin for twin, *_ in done]),
                {n: np.array([others[n] for _, others, *_ in done]) for n in FILTERS},
                float(np.mean([lost for _, _, lost, _ in done])),
            )
            if name in TRIED_AT:
                tried[name] = np.median([change for *_, change in done], axis=0)
            print(name, flush=True)
    return found, tried


# Report


def report(found: dict[str, Outcome], tried: dict[str, FloatArray]) -> str:
    """docs/particles.md."""
    judged = {c: {n: judge(outcome, n) for n in FILTERS} for c, outcome in found.items()}
    return "\n".join(
        [
            _head(),
            _verdict(found, judged),
            WHY,
            "## The core's particles\n",
            _own(found, judged),
            "## Variants and controls\n",
            _about(),
            _variants(judged),
            "## The mixture's parameters\n",
            _tuning(tried),
            "## Where a cloud wins\n",
            _wins(found, judged),
        ]
    )


def _head() -> str:
    return (
        "# Do the particles earn their keep?\n\n"
        "Written by `python tools/studies/particles.py DATA`; don't edit.\n\n"
        + wrapped(
            f"`{TWIN}` is the core's logic with a Kalman filter per axis in the place of the "
            "particles. Each filter gets the same samples and decisions as the twin; what counts "
            "is the ratio of the horizontal errors: RMSE against the truth, or closure of a loop, "
            f"which counts as {FLOOR_SHARE:.1%} of the distance at least. Given is the change "
            "of the error, from the median of the ratio over the recordings, each the geometric "
            f"mean over {len(FAULT_SEEDS)} seeds where stances are spoilt and {len(SEEDS)} seeds "
            f"of the particles ({len(VARIANT_SEEDS)} for the variants); the interval is 95 % of a "
            "bootstrap over recordings (over runs where there is one recording). *Spread* is the "
            "deviation of the error from one particle seed to the other on the same walk. A filter "
            "wins or loses where the interval leaves out 0 and the change is more than the spread."
        )
        + "\n\n![Change of the error by condition and filter](figures/particles.png)\n"
    )


def _verdict(found: dict[str, Outcome], judged: dict[str, dict[str, Judgement]]) -> str:
    won = [c for c, row in judged.items() if row[OWN[0]].word == "win"]
    lost = [c for c, row in judged.items() if row[OWN[0]].word == "lose"]
    alone = [f"`{n}` at {c}" for n, c, _control, left in matched(found, judged) if left]
    most = max(judged, key=lambda c: abs(judged[c][OWN[0]].median))
    text = (
        f"**`{OWN[0]}` beats `{TWIN}` by more than the spread in {len(won)} of {len(judged)} "
        f"conditions{_listed(won)} and loses in {len(lost)}{_listed(lost)}; its largest change "
        f"is {percent(judged[most][OWN[0]].median)}, at {most} (spread "
        f"{math.expm1(judged[most][OWN[0]].spread):.1%}). "
    )
    text += (
        f"Against the best Gaussian control these wins of clouds stand: {'; '.join(alone)}.**"
        if alone
        else "No cloud that wins somewhere beats the best Gaussian control there.**"
    )
    return wrapped(text) + "\n"


def _listed(names: Sequence[str]) -> str:
    return f" ({'; '.join(names)})" if names else ""


def _own(found: dict[str, Outcome], judged: dict[str, dict[str, Judgement]]) -> str:
    head = ("condition", f"`{TWIN}`, m", "lost", *(f"`{name}`" for name in OWN))
    rows = []
    for condition in CONDITIONS:
        outcome = found[condition.name]
        rows.append(
            (
                f"{condition.name}: {condition.about}",
                f"{math.exp(outcome.twin.mean()):.3f}",
                f"{outcome.lost:.0%}",
                *(_full(judged[condition.name][name]) for name in OWN),
            )
        )
    return (
        "The twin's error is a geometric mean; lost is the share of its runs above "
        f"{LOST_SHARE:.0%} of the distance.\n\n{to_markdown(Sheet('', head, rows))}\n"
    )


def _full(found: Judgement) -> str:
    return (
        f"{percent(found.median)} ({percent(found.low)} to {percent(found.high)}), "
        f"spread {math.expm1(found.spread):.1%}: {found.word}"
    )


def _about() -> str:
    lines = [f"- `{name}`: {about}." for name, (about, _variant) in VARIANTS.items()]
    lines += [f"- `{name}` (control): {about}." for name, (about, _run) in CONTROLS.items()]
    return (
        wrapped(
            f"Variants of `{OWN[1]}`, options of `solenav.filters.adaptive.Variant`. The mixture "
            f"says that with probability {_MIXED.doubt:g} the foot moves, at {_MIXED.spread:g} m/s "
            "per axis; other values stand further down. Controls are Gaussians without random "
            "numbers: a gain that they have too isn't the cloud's."
        )
        + "\n\n"
        + "\n".join(lines)
        + "\n"
    )


def _variants(judged: dict[str, dict[str, Judgement]]) -> str:
    names = [*VARIANTS, *CONTROLS]
    rows = [(c, *(_short(row[n]) for n in names)) for c, row in judged.items()]
    return (
        "**Bold** wins, *italic* loses.\n\n"
        + to_markdown(Sheet("", ("condition", *names), rows))
        + "\n"
    )


def _tuning(tried: dict[str, FloatArray]) -> str:
    head = ("probability", "speed, m/s", "R widened", *tried)
    rows = [
        (
            f"{doubt:g}",
            f"{spread:g}",
            "yes" if widen else "no",
            *(percent(float(change[i])) for change in tried.values()),
        )
        for i, (doubt, spread, widen) in enumerate(TRIED)
    ]
    return f"Median change of the error, one seed.\n\n{to_markdown(Sheet('', head, rows))}\n"


def _short(found: Judgement) -> str:
    mark = {"win": "**", "lose": "*", "tie": ""}[found.word]
    return f"{mark}{percent(found.median)}{mark}"


def matched(
    found: dict[str, Outcome], judged: dict[str, dict[str, Judgement]]
) -> list[tuple[str, str, str, bool]]:
    """Wins of clouds: filter, condition, best control, whether it beats that one too."""
    out = []
    for condition, row in judged.items():
        best = min(CONTROLS, key=lambda name: row[name].median)
        for name in (*OWN, *VARIANTS):
            if row[name].word == "win":
                left = judge(found[condition], name, best).word == "win"
                out.append((name, condition, best, left))
    return out


def _wins(found: dict[str, Outcome], judged: dict[str, dict[str, Judgement]]) -> str:
    lines = []
    for name, condition, best, _left in matched(found, judged):
        row = judged[condition]
        against = judge(found[condition], name, best)
        worst = max(judged, key=lambda c: judged[c][name].median)
        lines.append(
            f"- `{name}` at {condition}: {percent(row[name].median)}; the best control there, "
            f"`{best}`, has {percent(row[best].median)}, and against it the cloud's change is "
            f"{percent(against.median)} ({percent(against.low)} to {percent(against.high)}: "
            f"{against.word}). It has {percent(judged['clean'][name].median)} on clean decisions "
            f"and {percent(judged[worst][name].median)} at {worst}."
        )
    note = wrapped(
        "The best control is chosen in each condition by itself; so are the wins, "
        f"{len(judged) * (len(OWN) + len(VARIANTS))} comparisons without a correction for their "
        "number."
    )
    return f"{note}\n\n" + ("\n".join(lines) if lines else "Nowhere.") + "\n"


WHY = """\
Why a cloud has so little to add: the INS velocity observes its own error, so the likelihood is
normal but for samples in doubt, and those have little weight by their unrest and by m² already; a
mixture says the same again. And what a cloud remembers of a dubious stance has to live through a
swing, in which P_vv grows to several times what the stance left; the samples of the next one decide
anew. An error of the foot that is the same in every stance no likelihood can see.
"""


def percent(log_ratio: float) -> str:
    """A change of the error, signed, from the logarithm of a ratio."""
    return f"{100 * math.expm1(log_ratio):+.1f} %"


def draw(found: dict[str, Outcome], out: Path) -> None:
    """Change of the error, a row a condition and a column a filter; frames where it wins."""
    reach = math.log(1.5)
    with sheet(out, (11.0, 7.2), 90) as figure:
        axes = figure.add_axes((0.15, 0.02, 0.8, 0.79))
        axes.grid(visible=False)
        judged = [[judge(outcome, name) for name in FILTERS] for outcome in found.values()]
        values = np.array([[one.median for one in row] for row in judged])
        axes.imshow(values, cmap="PuOr_r", vmin=-reach, vmax=reach, aspect="auto")
        for (i, j), value in np.ndenumerate(values):
            one = judged[i][j]
            colour = "white" if abs(value) > 0.7 * reach else INK
            weight = "bold" if one.word == "win" else "normal"
            text = f"{round(100 * math.expm1(value)):+d}"
            axes.text(
                j, i, text, ha="center", va="center", color=colour, fontsize=9, fontweight=weight
            )
            if one.word == "win":
                # Inside the cell, so that neighbours don't share an edge.
                box = {"facecolor": "none", "edgecolor": INK, "linewidth": 1.6, "pad": 3.2}
                axes.texts[-1].set_bbox(box)
        axes.set_xticks(range(len(FILTERS)), list(FILTERS), rotation=40, ha="left")
        axes.xaxis.tick_top()
        axes.set_yticks(range(len(found)), list(found))
        axes.tick_params(length=0, labelcolor=INK)
        for at in (len(OWN), len(OWN) + len(VARIANTS)):
            axes.axvline(at - 0.5, color="white", linewidth=5)
        title = f"Change of the error against {TWIN}, %"
        figure.text(0.015, 0.965, title, fontsize=12.5, fontweight="bold", color=INK)
        figure.text(0.015, 0.938, "violet: better; framed: by more than the spread", color=INK)


def study(data: Path) -> None:
    """docs/particles.md and its figure, from the folder of recordings."""
    found, tried = gathered(data)
    draw(found, DOCS / "figures" / "particles.png")
    (DOCS / "particles.md").write_text(report(found, tried), encoding="utf-8")


if __name__ == "__main__":
    as_script(study)
