"""solenav on the host: a function for each command, for notebooks and scripts.

    import solenav

    run = solenav.load("walk.solcap")
    solenav.verify(run).verified
    solenav.evaluate(run).distance_m
    solenav.plot(run, "walk.png")

Each is the function that the command of that name calls, and is loaded when it is first used.
Those that touch a device come from `solenav_tools`, which nothing else in this package knows.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from solenav.batching import batch
    from solenav.capture import load
    from solenav.capture.summary import summary as info
    from solenav.comparison.runs import compare
    from solenav.datasets import read as read_recording
    from solenav.evaluation import evaluate
    from solenav.exporting import export
    from solenav.importing import to_capture
    from solenav.plotting import plot
    from solenav.replaying import replay
    from solenav.sim.scenario import simulate
    from solenav.tuning import tune
    from solenav.verification import verify
    from solenav_tools.doctor import examine as doctor
    from solenav_tools.firmware_run import run as run_firmware
    from solenav_tools.matrix import run as matrix
    from solenav_tools.recording import record

_PLACES = {
    "batch": "solenav.batching:batch",
    "compare": "solenav.comparison.runs:compare",
    "doctor": "solenav_tools.doctor:examine",
    "evaluate": "solenav.evaluation:evaluate",
    "export": "solenav.exporting:export",
    "info": "solenav.capture.summary:summary",
    "load": "solenav.capture:load",
    "matrix": "solenav_tools.matrix:run",
    "plot": "solenav.plotting:plot",
    "record": "solenav_tools.recording:record",
    "read_recording": "solenav.datasets:read",
    "replay": "solenav.replaying:replay",
    "run_firmware": "solenav_tools.firmware_run:run",
    "simulate": "solenav.sim.scenario:simulate",
    "to_capture": "solenav.importing:to_capture",
    "tune": "solenav.tuning:tune",
    "verify": "solenav.verification:verify",
}

__all__ = [
    "batch",
    "compare",
    "doctor",
    "evaluate",
    "export",
    "info",
    "load",
    "matrix",
    "plot",
    "read_recording",
    "record",
    "replay",
    "run_firmware",
    "simulate",
    "to_capture",
    "tune",
    "verify",
]


def __getattr__(name: str) -> Any:
    """The function of that name, from where it lives."""
    if name not in _PLACES:
        raise AttributeError(f"module 'solenav' has no attribute {name!r}")
    place, _, function = _PLACES[name].partition(":")
    return getattr(import_module(place), function)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
