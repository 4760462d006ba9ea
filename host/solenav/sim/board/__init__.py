"""A board without hardware: the firmware, unmodified, on MicroPython's unix port.

These files run on MicroPython, staged by `solenav_tools.board` beside the firmware and the core,
under the same module names as here; plain Python that CPython imports as well. Time is
simulated: it passes by bus transfers and waiting only, so a run is as fast as the machine allows
and the same to the byte each time.
"""
