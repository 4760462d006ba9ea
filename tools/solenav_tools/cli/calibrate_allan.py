"""`solenav calibrate allan`: the sensors' noise from a long rest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from solenav import capture, mpu9150
from solenav.calibration import allan as deviations
from solenav.capture.contents import Capture
from solenav.errors import SolenavError
from solenav.recording import Recording
from solenav_tools.cli.output import CaptureFile, Json, check_output, say, say_json


def allan(
    file: CaptureFile,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="PNG to write.")] = None,
    as_json: Json = False,
) -> None:
    """Allan deviation from a long rest: random walk, bias instability, rate random walk."""
    if output is not None:
        check_output(output, ".png")
    report = deviations.analyse(_recording(capture.load(file)))
    if output is not None:
        deviations.plot(report, output)
    if as_json:
        say_json(report.as_dict())
        return
    say(
        f"{file}: rest from {report.start_s:.1f} to {report.end_s:.1f} s "
        f"of {report.recording_s:.1f} s, {report.rate_hz:.2f} Hz"
    )
    for axis in report.axes:
        say(f"{axis.name}: {axis.at(1.0):.4g} {axis.unit} at 1 s")
        for name, unit, figure in (
            ("N", f"{axis.unit}/√Hz", axis.random_walk),
            ("B", axis.unit, axis.bias_instability),
            ("K", f"{axis.unit}·√Hz", axis.rate_random_walk),
        ):
            sign = "≤" if figure.limit else "="
            say(
                f"  {name} {sign} {figure.value:.3g} {unit} ({figure.low:.3g} to {figure.high:.3g};"
                f" {figure.tau_s[0]:.2g} to {figure.tau_s[1]:.2g} s: {figure.how})"
            )


def _recording(content: Capture) -> Recording:
    """A capture's raw samples in SI units. SolenavError without samples."""
    content.need_schema()
    if len(content.samples) < 2:
        raise SolenavError(
            f"{content.path} holds no samples", "record with the firmware's `send_samples` on"
        )
    rows = content.samples.rows
    time_s = content.time_of_tick(content.samples.tick)
    accel, gyro = mpu9150.from_counts(np.hstack([rows["acc"], rows["gyro"]]))
    rate = (len(time_s) - 1) / max(float(time_s[-1] - time_s[0]), 1e-6)
    return Recording(
        content.path.stem, time_s - time_s[0], accel, gyro, rate, source=content.path.name
    )
