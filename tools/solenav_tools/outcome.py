"""Judgements that several commands share."""

from __future__ import annotations

from pathlib import Path

from solenav.capture import Capture
from solenav.errors import SolenavError


def need_alignment(navigating: bool, source: Capture, output: Path) -> None:
    """SolenavError (exit code 1) if the run never got through its static start."""
    if navigating:
        return
    seconds = len(source.samples) / max(source.rate_hz(), 1e-9)
    raise SolenavError(
        f"the foot never stood still for the alignment in {seconds:.1f} s: no poses in {output}",
        "stand still for a second at the start of a recording; the samples are all kept",
        1,
    )
