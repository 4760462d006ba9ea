"""Boards: a module each, whose `open()` returns a `Board`. Pins and clocks, nothing else."""

from collections import namedtuple

# open_bus: makes the sensor's I2C, given its clock in Hz, again and again. scl, sda: the numbers
# of its pins, for freeing it. ready: pin of the sensor's INT line. uart: link to the host,
# non-blocking. name: for people, in HELLO. baud: of the UART. power: number of the pin that
# switches the sensor's supply, high for on; None where none does.
Board = namedtuple("Board", ("open_bus", "scl", "sda", "ready", "uart", "name", "baud", "power"))
