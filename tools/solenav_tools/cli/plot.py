"""`solenav plot`: the picture of a walk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solenav import capture
from solenav.pdr import step_table
from solenav_tools.cli.output import WalkFile, check_output, say


def plot(
    file: WalkFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="PNG to write.")],
) -> None:
    """Draw trajectory (with truth where known), velocity, detector, threshold and N_eff.

    Of steps: the trajectory, and how long each was.
    """
    from solenav import plotting

    check_output(output, ".png")
    if file.suffix.lower() == step_table.SUFFIX:
        walk, truth = step_table.read(file)
        plotting.plot_steps(walk, output, truth=truth)
    else:
        plotting.plot(capture.load(file), output)
    say(str(output))
