"""TUM: `t x y z qx qy qz qw` a line, as evo reads it: seconds since the first sample, m, ENU."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solenav.exporting.source import Source, Written


def write(source: Source, output: Path) -> Written:
    """The poses of the last run; its truth, where known, into `NAME.truth.tum` (no attitude)."""
    track = source.track
    table = np.column_stack([track.time_s, track.position, track.attitude[:, [1, 2, 3, 0]]])
    np.savetxt(output, table, fmt="%.9f")
    files = [output]
    truth = source.capture.truth
    losses = ["velocity, flags, steps, samples", *source.run_losses()]
    if truth is not None and len(truth.time_s):
        beside = output.with_suffix(".truth.tum")
        level = np.tile([0.0, 0.0, 0.0, 1.0], (len(truth.time_s), 1))
        # evo takes no unknown coordinate; a floor survey has no height.
        known = np.nan_to_num(truth.position_enu, nan=0.0)
        np.savetxt(beside, np.column_stack([truth.time_s, known, level]), fmt="%.9f")
        files.append(beside)
    return Written(files, len(table), losses)
