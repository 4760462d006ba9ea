"""The firmware over a capture's samples, on the emulated Pico."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solenav.capture import Capture
from solenav_tools.emulator import uf2 as firmware

if TYPE_CHECKING:
    from solenav_tools.emulator.run import Outcome


def run(
    source: Capture,
    output: Path | str,
    *,
    uf2: Path | str | None = None,
    pose_every: int | None = None,
    config: Mapping[str, Any] | None = None,
    faults: Sequence[Mapping[str, Any]] = (),
    progress: Callable[[int], None] = lambda ms: None,
) -> Outcome:
    """Record what the firmware sends over all of the capture's samples, as fast as it goes.

    `uf2`: MicroPython's file, or its version to download; None: what SOLENAV_UF2 says.
    `pose_every`: ticks from POSE to POSE, None: as a board. `config`: more of the firmware's
    config.json. `faults` as for the simulated board. `progress` gets the
    board's time in ms. SolenavError without samples, MicroPython or the emulator, and where the
    firmware crashes; what it sent before is in the file.
    """
    image = firmware.find(None if uf2 is None else str(uf2))
    # It imports the emulator.
    from solenav_tools.emulator.run import record

    return record(
        image,
        source,
        Path(output),
        pose_every=pose_every,
        config=config,
        faults=faults,
        progress=progress,
    )
