"""Run the staged firmware on the simulated board: ``micropython solenav/sim/board/start.py``.

The current folder is the flash: it holds the firmware and the core, and beside what the firmware
sees `feed.bin` and `board.json`: sensor (MPU-9150, MPU-6050 or none), baud, realtime, faults
(`faults.py` says which), flash (`flash.py`: capacity, torn). Standard output is the wire:
tracebacks and whatever else is printed go to standard error.

A process is one life of the processor. `board.state` carries over from one to the next what a
reset leaves: the time, the sensor, the recording's place, what was counted and rejected.
"""

# ruff: noqa: E402  (the path must be right before the imports)

import builtins
import json
import os
import sys

# The folder with the firmware only: this script's own would hide MicroPython's modules.
sys.path[:] = [""]

from solenav.sim.board import flash, machine, simtime, simulated
from solenav.sim.board.faults import World
from solenav.sim.board.feed import Feed
from solenav.sim.board.mpu9150_registers import Mpu9150
from solenav.sim.board.playback import Playback

_BOOT_US = 1_000_000
_STATE = "board.state"

_print = builtins.print
builtins.print = lambda *values, **options: _print(*values, file=sys.stderr)
_open = builtins.open


def load(path):
    """A JSON file's object; None without one."""
    try:
        with _open(path) as file:
            return json.load(file)
    except OSError:
        return None


def save(code):
    """What the next life begins with."""
    state = {
        "code": code,
        "off": machine.off_us,
        "now": simtime.now(),
        "flash": flash.counts(),
        "held": machine.bus.held or (5 if machine.bus.reading else 0),
        "sensor": sensor.save() if sensor else None,
        "playback": playback.save() if playback else None,
    }
    with _open(_STATE + ".new", "w") as file:
        json.dump(state, file)
    os.rename(_STATE + ".new", _STATE)


settings = load("board.json")
before = load(_STATE)
if before:
    settings["flash"]["counts"] = before["flash"]
flash.mount("", settings["flash"])
simulated.baud = settings["baud"]
sensor = playback = None
if settings["sensor"] != "none":
    sensor = Mpu9150(compass=settings["sensor"] == "MPU-9150")
    playback = Playback(
        sensor,
        Feed("feed.bin"),
        lambda: machine.rise(machine.READY_PIN),
        lambda: world.start(),
    )
    machine.wire(sensor, playback)
world = World(settings["faults"], sensor, playback)


def go_on():
    """Another life, after a reset or a power cut; the recording goes on while it boots."""
    simtime.clear(before["now"])
    machine.cause = machine.WDT_RESET
    if sensor:
        sensor.load(before["sensor"])
        machine.bus.held = before["held"]
    cut = before["code"] == machine.POWER_CUT
    if cut:
        machine.cause = machine.PWRON_RESET
    machine.power(not cut)  # a pin that had switched the sensor off is an input again
    world.switch_on(again=True)
    if playback:
        playback.load(before["playback"])
    if playback and playback.start >= 0:
        world.start()
    if cut:
        simtime.advance(before["off"])
        machine.power(True)
    simtime.advance(_BOOT_US)
    simtime.boot()


sys.modules["machine"] = machine
sys.modules["time"] = simtime
sys.modules["os"] = flash
builtins.open = flash.open

code = 0
try:
    go_on() if before else world.switch_on()
    if settings["realtime"]:
        simtime.follow_wall_clock()
    if not (playback and playback.over):
        # Names of its own: it may use any of this script's.
        execfile("main.py", {"__name__": "__main__"})  # noqa: F821
except SystemExit as ended:
    code = ended.args[0] if ended.args else 0
except Exception as error:
    # The interpreter itself would print it on standard output.
    sys.print_exception(error, sys.stderr)
    code = 1
machine.hang_up(code in machine.RESTARTS)
save(code)
sys.exit(code)
