"""A Raspberry Pi Pico that isn't there: MicroPython's own UF2 on an emulated RP2040.

`pico.EmulatedPico` is the board: processor and flash from rp2040py, on its pins the MPU-9150 and
the faults of the simulated board (`solenav.sim.board`), time that of the emulated processor.
`workarounds` mends what rp2040py gets wrong. `image` makes the file system, `uf2` finds
MicroPython, `ports` lets others talk to it, `run` records a walk.
"""
