"""Run the staged firmware on the simulated board: ``micropython solenav/sim/board/start.py``.

The current folder holds the firmware, the core, `feed.bin` and `board.json`: sensor (MPU-9150,
MPU-6050 or none), baud, realtime, nacks (times in µs of the recording). Standard output is the
wire: tracebacks and whatever else is printed go to standard error.
"""

# ruff: noqa: E402  (the path must be right before the imports)

import builtins
import json
import sys

# The folder with the firmware only: this script's own would hide MicroPython's modules.
sys.path[:] = [""]

from solenav.sim.board import machine, simtime, simulated
from solenav.sim.board.feed import Feed
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav.sim.board.playback import Playback

_print = builtins.print
builtins.print = lambda *values, **options: _print(*values, file=sys.stderr)
sys.modules["machine"] = machine
sys.modules["time"] = simtime

with open("board.json") as file:
    settings = json.load(file)
simulated.baud = settings["baud"]
if settings["sensor"] != "none":
    sensor = Mpu9150(compass=settings["sensor"] == "MPU-9150")
    feed = Feed("feed.bin")
    rise = lambda: machine.rise(simulated.READY_PIN)  # noqa: E731
    machine.wire(sensor, Playback(sensor, feed, rise, settings["nacks"]))
if settings["realtime"]:
    simtime.follow_wall_clock()

try:
    execfile("main.py")  # noqa: F821
except Exception as error:
    # The interpreter itself would print it on standard output.
    sys.print_exception(error, sys.stderr)
    sys.exit(1)
