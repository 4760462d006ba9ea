"""The change indicator: what the core makes of fixed samples, committed with the reason.

    python tests/golden/make.py "why it changed"        or: make golden REASON="why it changed"

computes the outcomes anew, prints what is different, writes `outcomes.json` and puts the reason
on top of `REASONS.md`. A change of the core's outcome so shows in review with its cause, as final
poses and errors, not only as digests. Without a reason nothing is written.

The torture walks (`solenav.sim.torture`) come from integer arithmetic alone, so they are the same
on every machine. The public recordings are read from the data beside the checkout; only what the
core makes of them stands here, and their rows are compared where the data are.
"""

from __future__ import annotations

import hashlib
import json
import sys
from itertools import zip_longest
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "studies"))

from recordings import walks  # noqa: E402

from solenav import engines, parameters  # noqa: E402
from solenav.comparison.metrics import score  # noqa: E402
from solenav.engines.traced import trace  # noqa: E402
from solenav.filters.walk import Track, Walk  # noqa: E402
from solenav.sim import torture  # noqa: E402
from solenav_core import layout, navigator  # noqa: E402

OUTCOMES = Path(__file__).with_name("outcomes.json")
REASONS = Path(__file__).with_name("REASONS.md")
DATA = ROOT.parent / "shared" / "data"
RATES_HZ = (100.0, 200.0, 400.0)
EVERY = 100  # ticks between two digests
HEAD = "# Why the core's outcomes changed\n\nNewest first; `tests/golden/make.py` writes it.\n"

Outcomes = dict[str, dict[str, Any]]

_AT = layout.offsets(layout.STATE_FIELDS)


def torture_outcomes(engine_name: str) -> Outcomes:
    """The torture walks at each rate, with the digest after every EVERY-th tick."""
    found = {}
    for rate in RATES_HZ:
        params = parameters.to_integers(parameters.Settings(), rate)
        for case in torture.walks():
            engine = engines.create(engine_name, params)
            digests = []
            for start in range(0, len(case.counts), EVERY):
                engine.advance(case.counts, start, min(start + EVERY, len(case.counts)))
                digests.append(f"{engine.digest():08x}")
            found[f"{case.name}, {rate:g} Hz"] = {**_final(engine.state), "digests": digests}
    return found


def recording_outcomes() -> Outcomes:
    """Every public recording at its own rate, with its horizontal error."""
    return {walk.name: _walked(walk) for walk in walks(DATA)}


def _walked(walk: Walk) -> dict[str, Any]:
    run = trace(walk.counts, walk.params)
    error = score(walk, Track(run.position, run.velocity), with_evo=False).error_m
    return {
        **_final(run.state),
        "stance share": round(float(run.stance.mean()), 4),
        "horizontal error, m": None if error is None else round(error, 3),
        "digest": f"{navigator.digest(run.state):08x}",
    }


def _final(state: Any) -> dict[str, Any]:
    """Where a run ended, and what it counted."""
    position = [
        round(layout.CELL_M * state[_AT["CELL"] + i] + state[_AT["POS"] + i] / 2**18, 5)
        for i in range(3)
    ]
    return {
        "ticks": state[_AT["TICK"]],
        "position ENU, m": position,
        "heading, °": round(state[_AT["HEADING_LAST"]] * 360 / 2**16, 2),
        "distance, m": round(state[_AT["DISTANCE"]] / 2**10, 3),
        "steps": state[_AT["STEPS"]],
        "resampled": state[_AT["RESAMPLED"]],
        "lock-outs": state[_AT["LOCKOUTS"]],
    }


def differences(before: Outcomes, now: Outcomes) -> list[str]:
    """A line for each input and field that differs: what it was and what it is."""
    lines = []
    for name in dict.fromkeys([*before, *now]):
        old, new = before.get(name, {}), now.get(name, {})
        for field in dict.fromkeys([*old, *new]):
            was, is_ = old.get(field), new.get(field)
            if was == is_:
                continue
            if field == "digests" and was and is_:
                # All later ones follow from the first that differs.
                at = next(i for i, (a, b) in enumerate(zip_longest(was, is_)) if a != b)
                field = f"digest {at + 1}, to tick {EVERY * (at + 1)}"
                was, is_ = (dict(enumerate(each)).get(at) for each in (was, is_))
            lines.append(f"{name}: {field}: was {_brief(was)}, is {_brief(is_)}")
    return lines


def _brief(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."


def committed() -> dict[str, Outcomes]:
    """The outcomes of the two kinds of inputs that stand in the repository."""
    if not OUTCOMES.exists():
        return {"torture": {}, "recordings": {}}
    found: dict[str, Outcomes] = json.loads(OUTCOMES.read_text(encoding="utf-8"))
    return found


def fingerprint() -> str:
    """The first digits of the committed outcomes' SHA-256, which a reason is tied to."""
    return hashlib.sha256(OUTCOMES.read_bytes()).hexdigest()[:12]


def newest() -> str:
    """The hash that the newest reason is tied to; empty where there is none."""
    if not REASONS.exists():
        return ""
    text = REASONS.read_text(encoding="utf-8").removeprefix(HEAD)
    return text.strip().removeprefix("- `").partition("`")[0]


def main() -> None:
    if not DATA.is_dir():
        sys.exit(f"the recorded data are not beside the checkout ({DATA.name}): nothing written")
    before = committed()
    now = {"torture": torture_outcomes("fast"), "recordings": recording_outcomes()}
    lines = [line for kind in now for line in differences(before[kind], now[kind])]
    # Outcomes that were edited by hand, or by a merge, want their reason too.
    if not lines and newest() == fingerprint():
        print("nothing changed")
        return
    print("\n".join(lines))
    reason = " ".join(sys.argv[1:]).strip()
    if not reason:
        sys.exit('\nnothing written: say why, make golden REASON="why it changed"')
    text = json.dumps(now, indent=1, ensure_ascii=False) + "\n"
    OUTCOMES.write_text(text, encoding="utf-8")
    earlier = REASONS.read_text(encoding="utf-8").removeprefix(HEAD) if REASONS.exists() else ""
    REASONS.write_text(
        f"{HEAD}\n- `{fingerprint()}`: {reason}{earlier or chr(10)}", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
