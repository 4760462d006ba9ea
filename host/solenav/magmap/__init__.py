"""Magnetic maps: a floor surveyed, kriged, kept, and walks found on it."""

from __future__ import annotations

from solenav.magmap.grid import MagneticMap, load, of_cells
from solenav.magmap.positioning import FILTERS, Located, locate
from solenav.magmap.surveying import Survey, Variogram, build, survey

__all__ = [
    "FILTERS",
    "Located",
    "MagneticMap",
    "Survey",
    "Variogram",
    "build",
    "load",
    "locate",
    "of_cells",
    "survey",
]
