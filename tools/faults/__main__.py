"""The fault campaign: `python tools/faults [--short] [--write] [--seed N] [--jobs N]`.

The host's half: every truncation and thousands of random damages of captures and streams, damaged
sidecars and truths; through everything that reads captures (`host.py`). Some ten minutes on two
cores; `--short` is what CI runs, in seconds. `--write` writes docs/robustness.md. Exit code 1 where
anything went wrong.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import host
from solenav.compare.table import Sheet, to_markdown

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "studies"))
from pages import DOCS, wrapped  # noqa: E402

PAGE = DOCS / "robustness.md"
CORRUPTIONS = 10_000
BESIDE = 2_000
CHANCE = 4_000_000
SHORT = 50
"""The short campaign is so many times shorter."""
_CHUNK = 250
_ABOUT = """
Written by `python tools/faults --write` (seed {seed}). Each case damages a sound capture, then
loads it and runs `info`, `verify`, `evaluate` and the monitor's view over it (every 60th: `plot`
and `replay` too). *Refused*: something ends with an error and a remedy. *Whole frames lost*:
frames that the damage didn't hit and that weren't delivered; where two records within eight are
broken, frames across the headers between them count as hit. *Wrong frames taken*: delivered,
though nobody sent them. *Silent errors*: such a frame in a run that `verify` calls proven, or a
restart or a difference that never was.
"""
_ACCIDENTS = """
Of {tries} frames overwritten in 3 to 20 random bytes {passed} passed the 16-bit CRC: {share},
where 2^-16 is 1.5e-05. The reader checks type and length besides, and a capture leaves out a
frame whose tick, time stamp, position or velocity the frames on both sides contradict. The row
above makes such frames on purpose: {made} of them, {left} still in the tables after that;
`verify` contradicts {caught}, and {unnoticed} have no effect on anything that it compares. So a
damaged frame gets into a proven run unnoticed with a probability of about {residual}. `evaluate`,
`plot` and the monitor don't prove: there a wrong payload in its right place shows until the next
frame, {shown} of all damaged frames. Verify before you trust a single point.
"""


def _chunk(work: tuple[str, int, int, int, int]) -> list[host.Outcome]:
    """A part of the campaign, in a process of its own."""
    what, subject, seed, start, count = work
    with host.scratch() as name:
        folder = Path(name)
        if what == "cut":
            small = host.small_subject(folder)
            return host.cuts(small, range(start, start + count * seed, seed), folder)
        sound = host.subjects(folder)[subject]
        if what == "beside":
            return list(host.beside(sound, seed, count, folder))
        damages = host.corruptions(sound, seed, count)
        return [
            host.examine(sound, damage, folder, draw=i % 60 == 0)
            for i, damage in enumerate(damages)
        ]


def _work(short: bool, seed: int) -> list[tuple[str, int, int, int, int]]:
    """The campaign in parts: what, which subject, seed, from, how many."""
    share = SHORT if short else 1
    work = []
    for i in range(max(1, CORRUPTIONS // share // _CHUNK)):
        work.append(("damage", i % 2, seed + i, 0, min(_CHUNK, CORRUPTIONS // share)))
    work.append(("beside", 0, seed, 0, BESIDE // share))
    with host.scratch() as name:
        size = len(host.small_subject(Path(name)).file)
    step = SHORT if short else 1
    work += [
        ("cut", 0, step, start, min(_CHUNK, -(-(size - start) // step)))
        for start in range(0, size, _CHUNK * step)
    ]
    return work


def run(short: bool, seed: int, jobs: int) -> list[host.Outcome]:
    """Every outcome of the host's campaign."""
    work = _work(short, seed)
    with ProcessPoolExecutor(jobs) as pool:
        return [outcome for part in pool.map(_chunk, work) for outcome in part]


def table(outcomes: Iterable[host.Outcome]) -> Sheet:
    """A line a kind of damage."""
    kinds: dict[str, list[host.Outcome]] = {}
    for outcome in outcomes:
        kinds.setdefault(outcome.kind, []).append(outcome)
    rows = [_row(kind, found) for kind, found in kinds.items()]
    rows.append(_row("all", [outcome for found in kinds.values() for outcome in found]))
    columns = (
        "damage",
        "cases",
        "refused",
        "whole frames lost",
        "wrong frames taken",
        "silent errors",
        "tracebacks",
        "hangs",
    )
    return Sheet("Damaged captures, streams and files beside them", columns, rows)


def _row(kind: str, found: Sequence[host.Outcome]) -> tuple[str, ...]:
    numbers = (
        len(found),
        sum(bool(o.refused) for o in found),
        sum(o.missing for o in found),
        sum(o.accidents for o in found),
        sum(bool(o.silent) for o in found),
        sum(bool(o.traceback) for o in found),
        sum(o.hang for o in found),
    )
    return (kind, *(f"{number}" for number in numbers))


def page(outcomes: Sequence[host.Outcome], chance: host.Chance, seed: int) -> str:
    """The host's part of docs/robustness.md."""
    accidents = [o for o in outcomes if o.kind == host.ACCIDENT]
    left = sum(o.accidents > 0 for o in accidents)
    caught = sum(o.caught for o in accidents)
    unnoticed = sum(o.unnoticed for o in accidents)
    share = chance.passed / chance.tries
    residual = share * unnoticed / max(1, len(accidents))
    named = {
        "seed": seed,
        "tries": f"{chance.tries:,}",
        "passed": chance.passed,
        "share": f"{share:.1e}",
        "made": len(accidents),
        "left": left,
        "caught": caught,
        "unnoticed": unnoticed,
        "residual": f"{residual:.0e}",
        "shown": f"{share * left / max(1, len(accidents)):.0e}",
    }
    parts = (
        "## Captures and streams on the host",
        wrapped(_ABOUT.format(**named)),
        to_markdown(table(outcomes)),
        "**Frames whose CRC fits by accident**",
        wrapped(_ACCIDENTS.format(**named)),
    )
    return "\n\n".join(parts) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    outcomes = run(asked.short, asked.seed, asked.jobs)
    with host.scratch() as name:
        tries = CHANCE // (SHORT if asked.short else 1)
        chance = host.chance(host.small_subject(Path(name)), asked.seed, tries)
    text = page(outcomes, chance, asked.seed)
    if asked.write:
        PAGE.write_text("# Robustness\n\n" + text, encoding="utf-8")
    print(text)
    bad = [outcome for outcome in outcomes if not outcome.clean]
    for outcome in bad[:20]:
        print(outcome, file=sys.stderr)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
