"""The names that MicroPython's compiler knows and CPython doesn't.

Kernels say ``@micropython.viper``, ``const(...)`` and ``ptr32``. MicroPython's compiler reads
all three by name; here CPython gets stand-ins that change nothing, so that the same file runs
as plain Python. The other host engines (`solenav.engines`) bring stand-ins of their own.
"""

import sys

if sys.implementation.name == "micropython":
    import micropython

    const = micropython.const
    ptr8 = ptr32 = None  # read by the viper emitter, never at run time
else:

    class micropython:  # noqa: N801  (the name is MicroPython's)
        """Stand-in for the module `micropython`."""

        @staticmethod
        def viper(function):
            return function

    def const(value):
        return value

    class ptr8:  # noqa: N801
        """A byte buffer, as viper's pointer to unsigned bytes sees it."""

    class ptr32:  # noqa: N801
        """An `array('i')`, as viper's pointer to signed words sees it."""
