"""Zero-velocity filters side by side: samples and stance in, trajectory out.

All but `apf`, which is the integer core, are float64 and share nothing with the core's state. Each
gets the same samples, static start and stance decisions (`walk.Walk`); so what differs is what the
filter makes of a stance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from solenav.errors import SolenavError
from solenav.filters import adaptive, apf, coloured, ekf, particle, reset
from solenav.filters.walk import Aids, Track, Walk

__all__ = ["FILTERS", "Aids", "Filter", "Track", "Walk", "named"]


@dataclass(frozen=True)
class Filter:
    """A filter by name: what it is, and which aids it can take on top of what it has."""

    name: str
    about: str
    run: Callable[[Walk, Aids], Track]
    aids: tuple[str, ...] = ("still", "gate")


_ALL = (
    Filter("ins", "no correction", reset.ins, ("still",)),
    Filter("reset", "velocity to zero in stance", reset.reset),
    Filter("ekf", "error-state ZUPT EKF, 9 states", partial(ekf.run, states=9)),
    Filter("ekf15", "error-state ZUPT EKF, 15 states", partial(ekf.run, states=15)),
    Filter("coloured", "9-state ZUPT EKF, AR(2) noise in stance", coloured.run, ("still",)),
    Filter("pf", "plain bootstrap particle filter, 100 particles, SIR", particle.bootstrap),
    Filter("apf-literal", "the paper's filter word for word, its table 1", particle.literal),
    Filter("kf-twin", "the core's logic on a Kalman filter per axis", adaptive.twin, ()),
    Filter("apf-float", "the core's algorithm in floats", adaptive.particles, ()),
    Filter("apf", "the core itself, integers", apf.run, ()),
)
FILTERS = {f.name: f for f in _ALL}
"""Every filter; `still` and `gate` are built into the last three."""


def named(name: str) -> Callable[[Walk], Track]:
    """A filter by its name, with aids after plus signs: `ekf`, `ekf+gate`, `reset+still+gate`.

    SolenavError for what is not there.
    """
    base, *wanted = name.split("+")
    if base not in FILTERS:
        raise SolenavError(f"there is no filter {base!r}", f"choose from {', '.join(FILTERS)}")
    for aid in wanted:
        if aid not in FILTERS[base].aids:
            can = ", ".join(FILTERS[base].aids) or "none: it has its own"
            raise SolenavError(f"filter {base!r} takes no aid {aid!r}", f"it takes {can}")
    aids = Aids(still="still" in wanted, gate="gate" in wanted)
    return partial(_run, FILTERS[base], aids)


def _run(chosen: Filter, aids: Aids, walk: Walk) -> Track:
    return chosen.run(walk, aids)
