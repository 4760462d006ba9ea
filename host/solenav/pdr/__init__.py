"""Pedestrian dead reckoning with a phone in the hand: steps, their length, heading, track.

trace = datasets.kaist.read(folder)
walk = pdr.reckon(trace)            # a StepTrack: what a foot's STEP messages also make
"""

from __future__ import annotations

from solenav.pdr.attitude import Levelled, level
from solenav.pdr.bridging import Hole, holes, joined
from solenav.pdr.length import GENERIC, LengthModel
from solenav.pdr.reckoning import adapted, reckon
from solenav.pdr.steps import Steps, detect
from solenav.pdr.track import StepTrack, of_capture

__all__ = [
    "GENERIC",
    "Hole",
    "LengthModel",
    "Levelled",
    "StepTrack",
    "Steps",
    "adapted",
    "detect",
    "holes",
    "joined",
    "level",
    "of_capture",
    "reckon",
]
