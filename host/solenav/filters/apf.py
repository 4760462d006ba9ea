"""`apf`: the integer core itself, as the firmware runs it (docs/algorithm.md)."""

from __future__ import annotations

from solenav.engines.traced import trace
from solenav.filters.walk import Aids, Track, Walk


def run(walk: Walk, aids: Aids) -> Track:
    """The walk by the core, on the walk's stance decisions."""
    found = trace(walk.counts, walk.params, walk.stance)
    return Track(found.position, found.velocity)
