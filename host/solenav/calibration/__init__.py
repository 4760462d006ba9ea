"""Calibration: what undoes a sensor's errors, and how it is found from recordings."""

from solenav.calibration.model import IDENTITY, Calibration, load, save

__all__ = ["IDENTITY", "Calibration", "load", "save"]
