"""`solenav import`: a public recording as a capture of MPU-9150 counts."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from solenav import datasets, importing
from solenav.errors import SolenavError
from solenav.exporting import csv_tables
from solenav.parameters import Settings
from solenav_tools import settings
from solenav_tools.cli.calibrate import CalibrationFile, calibration_from
from solenav_tools.cli.output import Json, check_output, say, say_json, warn

_EXPORTED = "solenav-csv"
Format = Enum("Format", {name: name for name in (*datasets.FORMATS, _EXPORTED)}, type=str)  # type: ignore[misc]


class Foot(str, Enum):
    """Which foot, where a file holds both."""

    left = "left"
    right = "right"


def import_recording(
    file: Annotated[Path, typer.Argument(help="The recording.")],
    format: Annotated[Format, typer.Option("--format", "-f", help="Whose format it has.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Capture to write; default: FILE.solcap here."),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Only the first so many seconds.")] = None,
    foot: Annotated[Foot, typer.Option(help="Where the file holds both feet.")] = Foot.right,
    calibration: CalibrationFile = None,
    as_json: Json = False,
) -> None:
    """Turn a public foot-mounted recording into MPU-9150 counts (±16 g, ±2000 °/s)."""
    chosen = settings.load().apply(Settings(calibration=calibration_from(calibration)))
    if format.value == _EXPORTED:
        _from_tables(file, output, as_json)
        return
    recording = datasets.read(file, format.value, foot=foot.value)
    if duration is not None:
        recording = recording.first(duration)
        if len(recording.time_s) < 2:
            raise SolenavError(
                f"{duration:g} s of {file} hold no two samples", "choose a longer --duration"
            )
    target = check_output(output or Path(f"{recording.name}.solcap"), ".solcap")
    notes = importing.to_capture(recording, target, chosen)
    for what in ("accel", "gyro"):
        if notes[f"clipped_{what}"]:
            warn(
                f"{notes[f'clipped_{what}']} samples clipped at the MPU-9150's full scale ({what})"
            )
    if notes["mag_overflows"]:
        warn(f"{notes['mag_overflows']} readings past the AK8975's full scale, flagged as unsound")
    if as_json:
        say_json({"capture": str(target), "truth": recording.truth is not None, **notes})
        return
    truth = "with truth" if recording.truth is not None else "no truth"
    say(f"{target}: {notes['samples']} samples at {recording.rate_hz:.2f} Hz, {truth}")
    for key, value in recording.notes.items():
        say(f"  {key}: {value}")


def _from_tables(folder: Path, output: Path | None, as_json: bool) -> None:
    """What `solenav export --to csv` wrote, as the capture that it was."""
    target = check_output(output or Path(f"{folder.stem}.solcap"), ".solcap")
    frames = csv_tables.read(folder, target)
    if as_json:
        say_json({"capture": str(target), "frames": frames})
    else:
        say(f"{target}: {frames} frames")
