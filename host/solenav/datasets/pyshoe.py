"""PyShoe: LORD IMU on a foot, 200 Hz, with Vicon's position at every sample.

One `.mat` per walk: `imu` (m/s², rad/s), `ts` (s), `gt` (m), `zv_*_opt` (stance labels).
Source: the foot-mounted inertial data of Wagstaff, Peretroukhin and Kelly's PyShoe (2019).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solenav.datasets import checks
from solenav.recording import Recording, Truth

# Of the five detectors' labels this one is within 3 mm of each walk's best in the authors'
# `trial_error`, and doesn't flicker; Vicon's own calls up to two thirds of some walks stance.
STANCE_LABELS = "zv_shoe_opt"

# `gt` has z up but is mirrored: y must turn for a right-handed frame. A ZUPT track of each walk
# fits so, not with z turned (the foot rises in swing from 0.12 m, as it should).
TO_Z_UP = np.array([1.0, -1.0, 1.0])


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of one walk; truth is None without `gt`, its stance without labels.

    `foot` has no use here: there is one sensor. Raises SolenavError for a faulty file.
    """
    content = checks.load_mat(path, ("ts", "imu"))
    time_s = checks.mat_array(path, content, "ts", 1)
    imu = checks.mat_array(path, content, "imu", 6)
    checks.check_lengths(path, ts=time_s, imu=imu)
    recording = checks.make_recording(
        path,
        "pyshoe",
        time_s,
        imu[:, :3],
        imu[:, 3:],
        checks.row_place(path),
        axes="sensor z points down",
    )
    if "gt" in content:
        position = checks.mat_array(path, content, "gt", 3)
        checks.check_lengths(path, ts=time_s, gt=position)
        recording.truth = Truth(recording.time_s, position * TO_Z_UP)
        if STANCE_LABELS in content:
            stance = checks.mat_array(path, content, STANCE_LABELS, 1)
            checks.check_lengths(path, ts=time_s, **{STANCE_LABELS: stance})
            recording.truth.stance = stance != 0
            recording.notes["stance_labels"] = STANCE_LABELS
    return recording
