"""Simulation of a walking foot and of the inertial sensor on it, with exact truth."""
