"""Filters on spoilt stance decisions: `python tools/studies/faults.py DATA`.

DATA is a folder with the public recordings (see recordings.py). Every filter runs over all of them
with a growing share of swing samples called stance, of stances missed, and of both
(`solenav.comparison.faults`); writes docs/faults.md and docs/figures/faults.png. Some minutes on
two cores. `--seeds N` spoils each recording in N ways.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Sequence
from pathlib import Path

from pages import DOCS
from recordings import walks
from rich.progress import Progress

from solenav.comparison import figures
from solenav.comparison.metrics import LOST_SHARE
from solenav.comparison.runs import CLEAN, Condition, Run, amount, compare
from solenav.comparison.strict import LIMITS, strictly
from solenav.comparison.table import Sheet, to_markdown
from solenav.filters.walk import Walk

SEEDS = 2
SHARES = (0.0, 0.05, 0.10, 0.15, 0.20)
KINDS = {
    "swing samples called stance": [Condition(share, 0.0) for share in SHARES],
    "stances missed": [Condition(0.0, share) for share in SHARES],
    "both": [Condition(share, share) for share in SHARES],
}
HARD = Condition(0.20, 0.10)
FEW = (CLEAN, Condition(0.20, 0.0), Condition(0.0, 0.10), HARD)
FILTERS = (
    "ins",
    "reset",
    "reset+still+gate",
    "ekf",
    "ekf+still",
    "ekf+gate",
    "ekf+still+gate",
    "ekf15",
    "ekf15+still+gate",
    "pf",
    "pf+still+gate",
    "apf-literal",
    "kf-twin",
    "apf-float",
    "apf",
)
DRAWN = (
    "reset",
    "apf-literal",
    "pf",
    "ekf",
    "ekf+still+gate",
    "ekf15+still+gate",
    "kf-twin",
    "apf",
)
CORE = ("kf-twin", "apf-float", "apf")
"""No rivals: the core's logic in other arithmetic, and the core."""
OWN = "apf"
SIMPLE = ("ekf", "reset")
WORSE = 1.25
PLAIN = "ekf"
"""Whose error the core's should be at most half of."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("data", type=Path)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    asked = parser.parse_args()
    found = walks(asked.data)
    conditions = list(dict.fromkeys([*(c for kind in KINDS.values() for c in kind), HARD]))
    rivals = [name for name in FILTERS if name not in CORE]
    runs = compared("the core's decisions", found, FILTERS, conditions, asked.seeds)
    strict = compared("strict decisions", [strictly(w) for w in found], rivals, FEW, asked.seeds)
    picture = DOCS / "figures" / "faults.png"
    picture.parent.mkdir(exist_ok=True)
    curves = {
        kind: {
            name: [(100 * SHARES[i], 100 * median_share(runs, name, c)) for i, c in enumerate(line)]
            for name in DRAWN
        }
        for kind, line in KINDS.items()
    }
    figures.draw_curves(curves, picture, f"Spoilt stance decisions, {len(found)} recordings")
    (DOCS / "faults.md").write_text(report(runs, strict, conditions, asked.seeds), encoding="utf-8")


def compared(
    what: str,
    found: Sequence[Walk],
    filters: Sequence[str],
    conditions: Sequence[Condition],
    seeds: int,
) -> list[Run]:
    """All runs, with a bar that tells how far they are."""
    with Progress() as bar:
        task = bar.add_task(what, total=amount(len(found), len(conditions), seeds))
        return compare(
            found,
            filters,
            conditions,
            range(1, seeds + 1),
            with_evo=False,
            timed=False,
            progress=lambda done: bar.update(task, completed=done),
        )


def scores(runs: Sequence[Run], name: str, condition: Condition) -> list[Run]:
    """A filter's runs in a condition."""
    return [run for run in runs if run.filter == name and run.condition == condition]


def shares(runs: Sequence[Run], name: str, condition: Condition) -> list[float]:
    """The errors of a filter in a condition, as shares of the distance."""
    found = [run.score.error_share for run in scores(runs, name, condition)]
    return [share for share in found if share is not None]


def median_share(runs: Sequence[Run], name: str, condition: Condition) -> float:
    return statistics.median(shares(runs, name, condition))


def median_m(runs: Sequence[Run], name: str, condition: Condition) -> float:
    found = [run.score.error_m for run in scores(runs, name, condition)]
    return statistics.median(error for error in found if error is not None)


def lost(runs: Sequence[Run], name: str, condition: Condition) -> int:
    """How many recordings are lost with at least one seed."""
    return len({run.recording for run in scores(runs, name, condition) if run.score.lost})


def report(
    runs: Sequence[Run], strict: Sequence[Run], conditions: Sequence[Condition], seeds: int
) -> str:
    """docs/faults.md."""
    recordings = len({run.recording for run in runs})
    parts = [
        f"""# Detector faults

Written by `python tools/studies/faults.py DATA`; don't edit. {recordings} public recordings on the
default parameters, each spoilt with {seeds} seed{"s" if seeds > 1 else ""}.

Every filter gets the same spoilt decisions. A share of the swing samples is called stance, in
bursts of 15 to 50 ms at random places, none next to another. A share of the whole stances is
missed, from end to end, but for the standing at the start and at the end. Errors are horizontal:
RMSE against the truth, or closure of a loop; "lost" is an error above {LOST_SHARE:.0%} of the
distance.

![Error against share of faults](figures/faults.png)
""",
        "## What the faults do to each filter\n\n"
        "Median error in m over all recordings and seeds; after the stroke the recordings lost "
        f"with at least one seed, of {recordings}.\n",
    ]
    for kind, line in KINDS.items():
        columns = ("filter", *(f"{share:.0%}" for share in SHARES))
        rows = [
            (name, *(f"{metres(median_m(runs, name, c))} / {lost(runs, name, c)}" for c in line))
            for name in FILTERS
        ]
        parts.append(
            f"**{kind[0].upper()}{kind[1:]}**\n\n{to_markdown(Sheet('', columns, rows))}\n"
        )
    parts += [
        _hard(runs),
        _strict(strict),
        "## What was to be reached\n",
        _goals(runs, strict, conditions),
        _lost_recordings(runs, conditions),
    ]
    return "\n".join(parts)


def _hard(runs: Sequence[Run]) -> str:
    head = (
        "filter",
        "clean, m",
        "spoilt, m",
        "spoilt / clean",
        f"spoilt / {PLAIN}'s",
        "lost",
        "lost under any fault",
    )
    reference = median_m(runs, PLAIN, HARD)
    rows = []
    for name in FILTERS:
        clean, spoilt = median_m(runs, name, CLEAN), median_m(runs, name, HARD)
        rows.append(
            (
                name,
                metres(clean),
                metres(spoilt),
                f"{spoilt / clean:.2f}",
                f"{spoilt / reference:.2f}",
                str(lost(runs, name, HARD)),
                str(len({run.recording for run in runs if run.filter == name and run.score.lost})),
            )
        )
    what = f"{HARD.false_share:.0%} of the swing samples called stance and {HARD.missed_share:.0%}"
    return f"## {what} of the stances missed\n\n{to_markdown(Sheet('', head, rows))}\n"


def _strict(strict: Sequence[Run]) -> str:
    head = ("filter", *(_short(condition) for condition in FEW))
    rows = [
        (name, *(f"{metres(median_m(strict, name, c))} / {lost(strict, name, c)}" for c in FEW))
        for name in dict.fromkeys(run.filter for run in strict)
    ]
    return f"""## Rivals on a stricter detector

The core's detector may call a moving foot standing, since the core weighs each decision; a filter
that takes it at its word wants a stricter one. Here the rivals run on the decisions of a detector
with {LIMITS}, spoilt in the same way: median error
in m and recordings lost, at shares of false and missed.

{to_markdown(Sheet("", head, rows))}
"""


def _goals(runs: Sequence[Run], strict: Sequence[Run], conditions: Sequence[Condition]) -> str:
    """The goals of the core, and whether they are reached."""
    clean, spoilt = median_m(runs, OWN, CLEAN), median_m(runs, OWN, HARD)
    reference = min(median_m(each, PLAIN, HARD) for each in (runs, strict))
    rivals = {
        name: min(median_m(each, name, CLEAN) for each in (runs, strict))
        for name in dict.fromkeys(run.filter for run in strict)
    }
    plain = min(SIMPLE, key=lambda name: rivals[name])
    best = min(rivals, key=lambda name: rivals[name])
    worse = _worse(runs, strict)
    single = [c for c in conditions if not (c.false_share and c.missed_share)]
    alone = {
        r.recording for r in runs if r.filter == OWN and r.score.lost and r.condition in single
    }
    anyhow = {r.recording for r in runs if r.filter == OWN and r.score.lost}
    lines = [
        *(
            (
                clean <= rivals[name],
                f"`{OWN}`'s clean median is no worse than that of {what}, `{name}`: "
                f"{clean:.3f} m, {rivals[name]:.3f} m",
            )
            for what, name in (("the better plain rival", plain), ("the best of all rivals", best))
        ),
        (
            not worse,
            f"no clean recording is worse than {WORSE:g} times the better of "
            f"{' and '.join(SIMPLE)}: {', '.join(worse) or 'none'}",
        ),
        (
            spoilt <= reference / 2,
            f"`{OWN}` has at most half of `{PLAIN}`'s median error, on decisions that suit that "
            f"better: {spoilt:.3f} m of {reference:.3f} m",
        ),
        (
            spoilt <= 1.5 * clean,
            f"`{OWN}` stays within 1.5 times its clean median: {spoilt:.3f} m of {clean:.3f} m",
        ),
        (not alone, f"`{OWN}` loses no recording to one kind of fault: {len(alone)} lost"),
        (not anyhow, f"`{OWN}` loses no recording at all: {len(anyhow)} lost"),
    ]
    return (
        "\n".join(f"- {'reached' if yes else 'not reached'}: {text}" for yes, text in lines) + "\n"
    )


def _worse(runs: Sequence[Run], strict: Sequence[Run]) -> list[str]:
    """Recordings on which the core, clean, is over `WORSE` times the better plain rival."""

    def error(some: Sequence[Run], name: str, recording: str) -> float:
        found = [r.score.error_m for r in scores(some, name, CLEAN) if r.recording == recording]
        return statistics.median(math.inf if e is None else e for e in found)

    out = []
    for recording in dict.fromkeys(run.recording for run in runs):
        least = min(error(each, name, recording) for each in (runs, strict) for name in SIMPLE)
        own = error(runs, OWN, recording)
        if own > WORSE * least:
            out.append(f"{recording} ({own:.3f} m, {least:.3f} m)")
    return out


def _lost_recordings(runs: Sequence[Run], conditions: Sequence[Condition]) -> str:
    """Which recordings the core loses, and where."""
    rows = []
    for recording in dict.fromkeys(run.recording for run in runs):
        own = [r for r in runs if r.recording == recording and r.filter == OWN]
        where = [c for c in conditions if any(r.score.lost for r in own if r.condition == c)]
        if where:
            worst = max((r for r in own), key=lambda r: r.score.error_share or 0.0)
            rows.append(
                (
                    recording,
                    ", ".join(_short(c) for c in where),
                    f"{worst.score.error_share:.1%} at {_short(worst.condition)}",
                )
            )
    if not rows:
        return ""
    sheet = Sheet("", ("recording", "lost at (false, missed)", "worst"), rows)
    return f"## What `{OWN}` loses\n\n{to_markdown(sheet)}\n"


def _short(condition: Condition) -> str:
    return f"{100 * condition.false_share:.0f}+{100 * condition.missed_share:.0f} %"


def metres(value: float) -> str:
    if not math.isfinite(value):
        return "∞"
    return f"{value:.3f}" if value < 10 else f"{value:.1f}"


if __name__ == "__main__":
    main()
