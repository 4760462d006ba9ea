"""`solenav plot`: the picture of a walk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solenav import capture
from solenav_tools.cli.output import CaptureFile, check_output, say


def plot(
    file: CaptureFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="PNG to write.")],
) -> None:
    """Draw trajectory (with truth where known), velocity, detector, threshold and N_eff."""
    from solenav import plotting

    check_output(output, ".png")
    plotting.plot(capture.load(file), output)
    say(str(output))
