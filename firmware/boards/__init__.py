"""Boards: a module each, whose `open()` returns a `Board`. Pins and clocks, nothing else."""

from collections import namedtuple

# i2c: bus of the sensor. ready: pin of its INT line. uart: link to the host, non-blocking.
# name: for people, in HELLO. baud: of the UART.
Board = namedtuple("Board", ("i2c", "ready", "uart", "name", "baud"))
