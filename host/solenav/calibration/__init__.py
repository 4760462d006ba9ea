"""Calibration of the sensors, and what their noise is."""
