"""Stance decisions for filters that take each one at its word.

The core weighs every decision by the sample's unrest, so its detector may be wide. A fair rival
gets one that hardly ever calls a moving foot standing.
"""

from __future__ import annotations

from solenav import parameters
from solenav.filters.walk import Walk, walk_of

STRICT = parameters.Settings(
    accel_min=8.3, accel_max=11.3, rate_max_dps=50.0, accel_variance_max=9.0
)

LIMITS = (
    f"{STRICT.accel_min:g} to {STRICT.accel_max:g} m/s², {STRICT.rate_max_dps:g} °/s and a "
    f"variance of {STRICT.accel_variance_max:g} (m/s²)²"
)
"""The detector in words."""


def strictly(walk: Walk) -> Walk:
    """The walk on the decisions of a detector with the limits of `STRICT`."""
    params = parameters.to_integers(STRICT, walk.rate_hz)
    return walk.with_stance(walk_of(walk.counts, params, name=walk.name).stance)
