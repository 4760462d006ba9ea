"""The change indicator: digests of the core over fixed integer samples.

    python tests/golden/make.py     rewrites tests/golden/digests.json

Any change of the core's outcome shows as a change of that file in review. The samples come from
integer arithmetic alone (`solenav.sim.torture`), so that they are the same on every machine.
"""

from __future__ import annotations

import json
from pathlib import Path

from solenav import engines, parameters
from solenav.sim import torture

TARGET = Path(__file__).with_name("digests.json")
EVERY = 100  # ticks between two digests


def digests(engine_name: str) -> dict[str, dict[str, list[str]]]:
    """Digest after every EVERY-th tick of each run, by rate."""
    out: dict[str, dict[str, list[str]]] = {}
    for rate in (100.0, 200.0, 400.0):
        params = parameters.to_integers(parameters.Settings(), rate)
        for case in torture.walks():
            engine = engines.create(engine_name, params)
            found = []
            for start in range(0, len(case.counts), EVERY):
                engine.advance(case.counts, start, min(start + EVERY, len(case.counts)))
                found.append(f"{engine.digest():08x}")
            out.setdefault(f"{rate:g} Hz", {})[case.name] = found
    return out


if __name__ == "__main__":
    TARGET.write_text(json.dumps(digests("pure"), indent=1) + "\n", encoding="utf-8")
