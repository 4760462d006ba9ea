"""Magnetic maps: a floor surveyed, kriged, kept, and walks found on it."""

from __future__ import annotations

from solenav.magmap.grid import MagneticMap, load, of_cells
from solenav.magmap.positioning import FILTERS, Located, Paces, locate, paces
from solenav.magmap.surveying import Survey, Variogram, build, survey

__all__ = [
    "FILTERS",
    "Located",
    "MagneticMap",
    "Paces",
    "Survey",
    "Variogram",
    "build",
    "load",
    "locate",
    "of_cells",
    "paces",
    "survey",
]
