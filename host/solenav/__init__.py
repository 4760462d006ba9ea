"""solenav on the host: a function for each command, for notebooks and scripts.

    import solenav

    run = solenav.load("walk.solcap")
    solenav.verify(run).verified
    solenav.evaluate(run).distance_m
    solenav.plot(run, "walk.png")

Each is the function that the command of that name calls, and is loaded when it is first used.
`solenav modes train`, `evaluate`, `export` and `send` are those of a forest (`train_forest`),
`solenav tune --modes` is `tune_modes`.
Those that touch a device come from `solenav_tools`, which nothing else in this package knows.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from solenav.batching import batch
    from solenav.calibration.finding import calibrate
    from solenav.capture import load
    from solenav.capture.summary import summary as info
    from solenav.comparison.runs import compare
    from solenav.datasets import read as read_recording
    from solenav.evaluation import evaluate
    from solenav.exporting import export
    from solenav.forests import export as export_forest
    from solenav.importing import to_capture
    from solenav.modes.making import evaluate as evaluate_forest
    from solenav.modes.making import train as train_forest
    from solenav.modes.thresholds import tune as tune_modes
    from solenav.plotting import plot
    from solenav.replaying import replay
    from solenav.sim.scenario import simulate
    from solenav.tuning import tune
    from solenav.verification import verify
    from solenav_tools.doctor import examine as doctor
    from solenav_tools.download import download
    from solenav_tools.emulated_run import run as emulate
    from solenav_tools.firmware_run import run as run_firmware
    from solenav_tools.flash.flashing import flash
    from solenav_tools.forest_upload import send as send_forest
    from solenav_tools.lines import cat
    from solenav_tools.matrix import run as matrix
    from solenav_tools.monitor.watch import monitor
    from solenav_tools.recording import record

_PLACES = {
    "batch": "solenav.batching:batch",
    "calibrate": "solenav.calibration.finding:calibrate",
    "cat": "solenav_tools.lines:cat",
    "compare": "solenav.comparison.runs:compare",
    "doctor": "solenav_tools.doctor:examine",
    "download": "solenav_tools.download:download",
    "emulate": "solenav_tools.emulated_run:run",
    "evaluate": "solenav.evaluation:evaluate",
    "evaluate_forest": "solenav.modes.making:evaluate",
    "export": "solenav.exporting:export",
    "export_forest": "solenav.forests:export",
    "flash": "solenav_tools.flash.flashing:flash",
    "info": "solenav.capture.summary:summary",
    "load": "solenav.capture:load",
    "matrix": "solenav_tools.matrix:run",
    "monitor": "solenav_tools.monitor.watch:monitor",
    "plot": "solenav.plotting:plot",
    "read_recording": "solenav.datasets:read",
    "record": "solenav_tools.recording:record",
    "replay": "solenav.replaying:replay",
    "run_firmware": "solenav_tools.firmware_run:run",
    "send_forest": "solenav_tools.forest_upload:send",
    "simulate": "solenav.sim.scenario:simulate",
    "to_capture": "solenav.importing:to_capture",
    "train_forest": "solenav.modes.making:train",
    "tune": "solenav.tuning:tune",
    "tune_modes": "solenav.modes.thresholds:tune",
    "verify": "solenav.verification:verify",
}

__all__ = [
    "batch",
    "calibrate",
    "cat",
    "compare",
    "doctor",
    "download",
    "emulate",
    "evaluate",
    "evaluate_forest",
    "export",
    "export_forest",
    "flash",
    "info",
    "load",
    "matrix",
    "monitor",
    "plot",
    "read_recording",
    "record",
    "replay",
    "run_firmware",
    "send_forest",
    "simulate",
    "to_capture",
    "train_forest",
    "tune",
    "tune_modes",
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
