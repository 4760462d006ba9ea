"""The fault campaign: `python tools/faults [--part host|board|cuts] [--short] [--write] ...`.

`board`: a thousand runs of the real firmware on the simulated board, with faults; `cuts`: the
power cut at every operation of its flash (`firmware.py`). `host`: every truncation and thousands
of random damages of captures and streams, damaged sidecars and truths; through everything that
reads captures (`host.py`). All of it takes the better part of an hour on two cores, `--short` a
minute or two. `--write` writes docs/robustness.md, of which each part has its section. Exit code 1
where anything went wrong.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import firmware
import host
from solenav.comparison.table import Sheet, to_markdown

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "studies"))
from pages import DOCS, wrapped  # noqa: E402

PAGE = DOCS / "robustness.md"
CORRUPTIONS = 10_000
BESIDE = 2_000
CHANCE = 4_000_000
RUNS = 1_012
"""On the board: 44 of each kind."""
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
frame whose tick the frames on both sides contradict, and `evaluate` and `plot` a pose whose
position or velocity leaps away and back. The row above makes such frames on purpose: {made} of
them, {left} still in the tables after that; `verify` contradicts {caught}, and {unnoticed} have
no effect on anything that it compares. So a damaged frame gets into a proven run unnoticed with a
probability of about {residual}. `evaluate`, `plot` and the monitor don't prove: there a wrong
payload in its right place shows until the next frame, {shown} of all damaged frames. Verify
before you trust a single point.
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
        wrapped(_ABOUT.format(**named).strip()),
        to_markdown(table(outcomes)),
        "**Frames whose CRC fits by accident**",
        wrapped(_ACCIDENTS.format(**named).strip()),
    )
    return "\n\n".join(parts) + "\n"


_BOARD = """
The firmware's own files on MicroPython, on the simulated board: a walk of 24 s, faults in it as
`host/solenav/sim/board/faults.py` describes them, at random moments and of random lengths, a
quarter of the runs with `sampling` "ready" (which by itself loses some 50 samples to erasing
flash). A checkpoint every 2 s. Each pose is laid beside the one of a fault-free run at the same
sample. *Survived*: navigating in the last second, or, with the sensor gone for good, in a clear
fault. *Flagged*: the last pose says GAP, RESUMED, SATURATED or FROZEN. *Error*: of the last pose;
what was walked while there were no samples is lost, and a metre of it is an error of a metre.
*Samples lost*: against the fault-free run; below 0 where a fast clock gave more.
*Silent*: runs in which poses without a flag are more than {tolerance} m off for longer than
{detection} s. *Unproven*: `verify` finds a difference between the firmware and the core on the
host, or nothing to compare. *Records lost*: bytes that the black box had acknowledged in STATUS
and that aren't in flash.
"""
_CUTS = """
A session of 8 s that records everything; the power is cut at every single one of the {count}
pages and blocks that it writes or erases, the board starts again {after} and goes on. *Survived*:
it samples again. Runs cut before their first step start afresh.
"""


def _row_of_runs(kind: str, found: Sequence[firmware.Outcome]) -> tuple[str, ...]:
    errors = sorted(o.error_m for o in found if o.error_m is not None)
    lost = sorted(o.lost for o in found)
    return (
        kind,
        f"{len(found)}",
        f"{sum(o.survived for o in found)}",
        f"{sum(o.anew for o in found)}",
        f"{sum(o.flagged for o in found)}",
        f"{errors[len(errors) // 2]:.2f} / {errors[-1]:.2f}" if errors else "-",
        f"{lost[len(lost) // 2]} / {lost[-1]}",
        f"{sum(o.silent_m > 0 for o in found)}",
        f"{sum(bool(o.difference) for o in found)}",
        f"{sum(o.unsafe for o in found)}",
        f"{sum(bool(o.traceback) for o in found)}",
        f"{sum(o.hang for o in found)}",
    )


def runs_table(outcomes: Iterable[firmware.Outcome]) -> Sheet:
    """A line a kind of fault."""
    kinds: dict[str, list[firmware.Outcome]] = {}
    for outcome in outcomes:
        kinds.setdefault(outcome.case.kind, []).append(outcome)
    rows = [_row_of_runs(kind, found) for kind, found in kinds.items()]
    if len(kinds) > 1:
        rows.append(_row_of_runs("all", [o for found in kinds.values() for o in found]))
    columns = (
        "fault",
        "runs",
        "survived",
        "anew",
        "flagged",
        "error, m: median / max",
        "samples lost: median / max",
        "silent",
        "unproven",
        "records lost",
        "tracebacks",
        "hangs",
    )
    return Sheet("Runs of the firmware", columns, rows)


def _some_runs(work: tuple[bool, list[firmware.Case]]) -> list[firmware.Outcome]:
    """A part of the board's campaign, in a process of its own."""
    short, cases = work
    walk = firmware.short_walk() if short else firmware.Walk()
    with host.scratch() as name:
        return [firmware.run(walk, case, Path(name)) for case in cases]


def board_runs(
    cases: Sequence[firmware.Case], jobs: int, *, short_walk: bool = False
) -> list[firmware.Outcome]:
    """Every outcome of these runs."""
    work = [(short_walk, list(cases[i : i + 10])) for i in range(0, len(cases), 10)]
    outcomes = []
    with ProcessPoolExecutor(jobs) as pool:
        for part in pool.map(_some_runs, work):
            outcomes += part
            for outcome in part:
                if not outcome.clean:
                    print(outcome, file=sys.stderr, flush=True)
    return outcomes


def cut_runs(jobs: int, step: int = 1) -> list[firmware.Outcome]:
    """The power cut at every `step`-th operation of a session's flash."""
    session = firmware.Case("session", (), firmware.SESSION)
    whole = _some_runs((True, [session]))[0]
    cases = [firmware.cut_at(n) for n in range(1, whole.operations + 1, step)]
    return board_runs(cases, jobs, short_walk=True)


def _host_part(asked: argparse.Namespace) -> tuple[str, Sequence[object]]:
    outcomes = run(asked.short, asked.seed, asked.jobs)
    with host.scratch() as name:
        tries = CHANCE // (SHORT if asked.short else 1)
        chance = host.chance(host.small_subject(Path(name)), asked.seed, tries)
    return page(outcomes, chance, asked.seed), [o for o in outcomes if not o.clean]


def _board_part(asked: argparse.Namespace) -> tuple[str, Sequence[object]]:
    cases = firmware.cases(asked.seed, RUNS // (SHORT // 2) if asked.short else RUNS)
    outcomes = board_runs(cases, asked.jobs)
    text = wrapped(
        _BOARD.format(tolerance=firmware.TOLERANCE_M, detection=firmware.DETECTION_S).strip()
    )
    parts = ("## The firmware with faults", text, to_markdown(runs_table(outcomes)))
    return "\n\n".join(parts) + "\n", [o for o in outcomes if not o.clean]


def _cuts_part(asked: argparse.Namespace) -> tuple[str, Sequence[object]]:
    outcomes = cut_runs(asked.jobs, SHORT if asked.short else 1)
    text = wrapped(_CUTS.format(count=len(outcomes), after="0.2 s later").strip())
    parts = ("## Power cut at every flash write", text, to_markdown(runs_table(outcomes)))
    return "\n\n".join(parts) + "\n", [o for o in outcomes if not o.clean]


PARTS = {"board": _board_part, "cuts": _cuts_part, "host": _host_part}


def _written(sections: dict[str, str]) -> None:
    """The page with these sections in place of those of before."""
    title = "# Robustness\n"
    old = PAGE.read_text(encoding="utf-8") if PAGE.exists() else title
    found = {part.splitlines()[0]: "## " + part for part in old.split("\n## ")[1:]}
    new = {text.splitlines()[0].removeprefix("## "): text for text in sections.values()}
    found.update(new)
    body = "\n".join(
        text.rstrip("\n") + "\n" for _head, text in sorted(found.items(), reverse=True)
    )
    PAGE.write_text(title + "\n" + body, encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--part", choices=PARTS, help="default: all")
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    sections = {}
    failed = False
    for name in [asked.part] if asked.part else list(PARTS):
        sections[name], bad = PARTS[name](asked)
        print(sections[name])
        if name == "host":
            for outcome in bad:
                print(outcome, file=sys.stderr)
        failed = failed or bool(bad)
    if asked.write:
        _written(sections)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
