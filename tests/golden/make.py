"""The change indicator: digests of the core over fixed integer samples.

    python tests/golden/make.py     rewrites tests/golden/digests.json

Any change of the core's outcome shows as a change of that file in review. The samples come from
integer arithmetic alone, so that they are the same on every machine.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solenav import engines, parameters

TARGET = Path(__file__).with_name("digests.json")
EVERY = 100  # ticks between two digests


def noise(count: int, size: int, seed: int) -> NDArray[np.int64]:
    """(count, 6) integers within +-size from a linear congruence (Numerical Recipes)."""
    x = seed
    values = []
    for _ in range(count * 6):
        x = (x * 1664525 + 1013904223) % 2**32
        values.append((x >> 8) % (2 * size + 1) - size)
    return np.array(values).reshape(count, 6)


def standing(count: int, seed: int) -> NDArray[np.int64]:
    """A foot at rest, tilted a little, with a gyro bias."""
    return noise(count, 4, seed) + np.array([150, -90, 2040, 12, -7, 3])


def swing(count: int, seed: int) -> NDArray[np.int64]:
    """Something like a stride: a push forward, a brake, a turn of the foot and back."""
    half = count // 2
    push = np.array([0, 1500, 300, 6000, 200, 150])
    strides = np.concatenate([np.tile(push, (half, 1)), np.tile(-push, (count - half, 1))])
    return strides + standing(count, seed) + noise(count, 60, seed + 1)


def samples() -> dict[str, NDArray[np.int16]]:
    """Named runs."""
    walk = [standing(240, 1)]
    for i in range(12):
        walk += [swing(100, 10 + i), standing(90, 40 + i)]
    restless = [standing(80, 2), noise(20, 3000, 3), standing(210, 4), noise(400, 32767, 5)]
    flight = [standing(220, 6), np.tile([32767, -32768, 32767, -32768, 32767, 3], (900, 1))]
    runs = {"walk": walk, "restless": [*restless, standing(300, 7)], "flight": flight}
    return {name: np.vstack(parts).astype(np.int16) for name, parts in runs.items()}


def digests(engine_name: str) -> dict[str, dict[str, list[str]]]:
    """Digest after every EVERY-th tick of each run, by rate."""
    out: dict[str, dict[str, list[str]]] = {}
    for rate in (100.0, 200.0, 400.0):
        params = parameters.to_integers(parameters.Settings(), rate)
        for name, counts in samples().items():
            engine = engines.create(engine_name, params)
            found = []
            for start in range(0, len(counts), EVERY):
                engine.advance(counts, start, min(start + EVERY, len(counts)))
                found.append(f"{engine.digest():08x}")
            out.setdefault(f"{rate:g} Hz", {})[name] = found
    return out


if __name__ == "__main__":
    TARGET.write_text(json.dumps(digests("pure"), indent=1) + "\n", encoding="utf-8")
