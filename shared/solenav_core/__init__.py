"""The navigation core: integers only, the same source on CPython and on MicroPython."""
