"""`solenav replay`: the core over a capture's samples, on the host."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from solenav import capture, engines, replaying
from solenav_tools.cli.arguments import ForestFile, forest_from
from solenav_tools.cli.output import CaptureFile, Json, check_output, progress, say, say_json, warn
from solenav_tools.outcome import need_alignment

EngineName = Enum("EngineName", {name: name for name in engines.NAMES}, type=str)  # type: ignore[misc]


def replay(
    file: CaptureFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture to write.")],
    engine: Annotated[
        EngineName | None, typer.Option(help="Default: fast where numba is installed, else pure.")
    ] = None,
    pose_every: Annotated[int, typer.Option(min=1, help="A POSE on every n-th tick.")] = 1,
    forest: ForestFile = None,
    as_json: Json = False,
) -> None:
    """Run the core over a capture's samples and write what the firmware would have sent."""
    check_output(output, ".solcap")
    source = capture.load(file)
    gaps = np.diff(source.samples.tick) - 1
    if missing := int(gaps[gaps > 0].sum()):
        warn(
            f"{missing} samples never arrived, the core runs on without them: "
            "from the first gap on its poses are not the board's"
        )
    name = engine.value if engine else engines.default_name()
    words = forest_from(forest)
    with progress(f"replaying on {name}", len(source.samples)) as done:
        runner = replaying.replay(
            source, output, engine=name, forest=words, pose_every=pose_every, progress=done
        )
    result = {"capture": str(output), "engine": name, "samples": len(source.samples)}
    result["digest"] = f"{runner.digest():08x}"
    need_alignment(runner.navigating, source, output)
    if as_json:
        say_json(result)
    else:
        say(f"{output}: {result['samples']} ticks on {name}, last digest {result['digest']}")
