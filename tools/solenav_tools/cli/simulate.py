"""`solenav simulate`: a walk that never was, with the truth beside it."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from solenav import importing
from solenav.parameters import Settings
from solenav.sim import scenario as scenarios
from solenav.sim.field import Earth
from solenav.sim.gait import SCENARIOS
from solenav.sim.imu import IDEAL, TABLE1
from solenav_tools import settings
from solenav_tools.cli.calibrate import CalibrationFile, calibration_from
from solenav_tools.cli.output import Json, check_output, say, say_json

Scenario = Enum("Scenario", {name: name for name in SCENARIOS}, type=str)  # type: ignore[misc]


class Errors(str, Enum):
    """Presets of the sensor's errors."""

    table1 = "table1"
    ideal = "ideal"


def simulate(
    scenario: Annotated[Scenario, typer.Argument(help="What walk.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture to write.")],
    seed: Annotated[int, typer.Option(help="Of gait and sensor errors.")] = 1,
    rate: Annotated[float, typer.Option(help="Samples per second.")] = 200.0,
    duration: Annotated[float | None, typer.Option(help="Seconds; default: the walk's.")] = None,
    errors: Annotated[
        Errors, typer.Option(help="table1: the paper's drifts, MPU-9150 noise.")
    ] = Errors.table1,
    accel_bias: Annotated[
        float | None, typer.Option(help="Instead of the preset's, 1 sigma, m/s².")
    ] = None,
    gyro_bias: Annotated[
        float | None, typer.Option(help="Instead of the preset's, 1 sigma, °/s.")
    ] = None,
    accel_noise: Annotated[
        float | None, typer.Option(help="Instead of the preset's, µg/√Hz.")
    ] = None,
    gyro_noise: Annotated[
        float | None, typer.Option(help="Instead of the preset's, °/s/√Hz.")
    ] = None,
    hard_iron: Annotated[
        float | None, typer.Option(help="Instead of the preset's, 1 sigma, µT.")
    ] = None,
    indoors: Annotated[
        bool, typer.Option("--indoors", help="Steel in the floor bends the magnetic field.")
    ] = False,
    declination: Annotated[float, typer.Option(help="Of magnetic North, ° clockwise.")] = 0.0,
    calibration: CalibrationFile = None,
    as_json: Json = False,
) -> None:
    """Simulate a walk with a foot-mounted MPU-9150 into a capture, with its truth."""
    chosen = settings.load().apply(Settings(calibration=calibration_from(calibration)))
    check_output(output, ".solcap")
    model = TABLE1 if errors is Errors.table1 else IDEAL
    if accel_bias is not None:
        model = replace(model, accel_bias=accel_bias)
    if gyro_bias is not None:
        model = replace(model, gyro_bias=radians(gyro_bias))
    if accel_noise is not None:
        model = replace(model, accel_noise=accel_noise * 9.80665e-6)
    if gyro_noise is not None:
        model = replace(model, gyro_noise=radians(gyro_noise))
    if hard_iron is not None:
        model = replace(model, hard_iron=hard_iron)
    recording = scenarios.simulate(
        scenario.value,
        rate_hz=rate,
        seed=seed,
        errors=model,
        duration_s=duration,
        earth=Earth(declination=radians(declination)),
        indoors=indoors,
    )
    notes = importing.to_capture(recording, output, chosen)
    if as_json:
        say_json({"capture": str(output), **notes})
    else:
        say(
            f"{output}: {notes['samples']} samples at {rate:g} Hz, "
            f"{notes['notes']['strides']} strides"
        )
