"""The magnetic field along a walk: the Earth's, and steel that bends it.

Fields in µT, positions in m, both East-North-Up. A piece of steel is a sphere of soft iron in
the Earth's field, which from outside is exactly a dipole, with a permanent dipole on top: what
beams, cabinets and the floor's reinforcement do from a little more than their size away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solenav.recording import FloatArray

TILE_M = 2.0
PIECES = 4
"""So many pieces of steel in each square of `TILE_M` that is within half of that of a foot."""
DEPTH_M = 0.05
"""The least cover between the floor and the steel in it."""
PERMANENT = 0.7
"""Standard deviation, per axis, of the permanent moment in units of the induced one."""


@dataclass(frozen=True)
class Earth:
    """The undisturbed field: `strength` in µT, `inclination` (rad) positive downward,
    `declination` (rad) of magnetic North clockwise from true North. Default: Central Europe."""

    strength: float = 49.0
    inclination: float = math.radians(66)
    declination: float = 0.0

    @property
    def enu(self) -> FloatArray:
        level = self.strength * math.cos(self.inclination)
        return np.array(
            [
                level * math.sin(self.declination),
                level * math.cos(self.declination),
                -self.strength * math.sin(self.inclination),
            ]
        )


@dataclass(frozen=True)
class Steel:
    """Pieces of steel: `position` (k, 3) m and `moment` (k, 3), both ENU.

    The moment is in µT m³: the field on its axis, at a distance r, is 2 moment / r³.
    """

    position: FloatArray
    moment: FloatArray


NO_STEEL = Steel(np.empty((0, 3)), np.empty((0, 3)))


def sphere(radius: FloatArray, field: FloatArray) -> FloatArray:
    """Moments (k, 3) of spheres of `radius` (k,) m that a `field` (3,) or (k, 3) magnetises.

    Of iron, whose permeability is a few hundred and more: r³ times the field, within a per cent.
    """
    return radius[:, np.newaxis] ** 3 * field


def field_at(position: FloatArray, earth: Earth, steel: Steel = NO_STEEL) -> FloatArray:
    """The field (n, 3) at `position` (n, 3): the Earth's and every piece's dipole.

    Pieces don't magnetise each other.
    """
    total = np.tile(earth.enu, (len(position), 1))
    for place, moment in zip(steel.position, steel.moment, strict=True):
        away = position - place
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        along = (away @ moment)[:, np.newaxis] / distance**5
        total += 3 * along * away - moment / distance**3
    return total


def indoors(way: FloatArray, earth: Earth, rng: np.random.Generator) -> Steel:
    """Steel in the floor, which is at height 0, along a `way` (m, 3) of the feet.

    Spheres of 10 to 30 cm radius. They lie below the floor, the top of each `DEPTH_M` under it or
    deeper, so that no foot gets inside one. At the footprints of simulated loops 90 % of the
    fields are 42 to 69 µT strong and dip by 57 to 75°; in stance on the OpenShoe walks, indoors,
    it is 39 to 67 µT and 53 to 81°.
    """
    near = way[:, np.newaxis, :2] + TILE_M / 2 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    tiles = np.unique(np.floor(near.reshape(-1, 2) / TILE_M), axis=0)
    count = PIECES * len(tiles)
    place = (np.repeat(tiles, PIECES, axis=0) + rng.random((count, 2))) * TILE_M
    radius = rng.uniform(0.1, 0.3, count)
    depth = DEPTH_M + radius + rng.exponential(0.1, count)
    position = np.column_stack([place, -depth])
    induced = sphere(radius, earth.enu)
    size = np.linalg.norm(induced, axis=1, keepdims=True)
    return Steel(position, induced + PERMANENT * size * rng.standard_normal((count, 3)))
