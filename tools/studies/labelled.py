"""The public recordings with labels of motion, as far as these are certain.

    python tools/studies/labelled.py DATA FOLDER

writes them as captures with their tables of labels beside them, for `solenav modes train`. DATA is
the folder that holds foot/. Nobody labelled these recordings; what is known of them is:

- from the static start to the first lift-off, and in every rest of a second or more, the foot
  stands: still;
- all sets but two are walks on a floor: walk;
- `llio` 35 is walked and run by turns: run where the surveyed points, one a stride, are passed at
  2.6 m/s or more, walk from 0.8 to 2.0 m/s, else no label;
- gaitmap's stairs: a stride over two risers (0.2 m and more, by the core's own height) is upstairs
  or downstairs, one of less than 0.12 m, on the floor or a landing, is walk, no label between.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import recordings

from solenav import datasets, importing, mpu9150
from solenav.engines.traced import Trace, trace
from solenav.errors import SolenavError
from solenav.modes.labels import Label
from solenav.recording import Recording

STAIRS = "imu_sample_healthy_stair_*.csv"
_RUNNER = "_35_"
_REST_S = 1.0
_SETTLED_S = 0.2
"""After a landing and before a lift-off the foot may still move for so long."""
_STANCE_S, _SWING_S = 0.04, 0.15  # shorter ones are flicker of the detector, as in the core
_RUN_MPS, _WALK_MPS, _STOPPING_MPS = 2.6, 2.0, 0.8
_STAIR_M, _LEVEL_M = 0.2, 0.12


@dataclass(frozen=True)
class Stride:
    """From `start` to `end`, s, the foot moves in `mode`; "" where that isn't certain."""

    start: float
    end: float
    mode: str


def stairs(data: Path) -> list[tuple[str, Recording]]:
    """Each foot on gaitmap's stairs, with its name, without labels."""
    return [
        (f"gaitmap {one.name}", one)
        for path in sorted((data / "foot" / "gaitmap").glob(STAIRS))
        for one in (datasets.read(path, "gaitmap", foot=foot) for foot in ("left", "right"))
    ]


def labelled(data: Path) -> list[tuple[str, Recording]]:
    """Every recording with its name, format first, and its labels."""
    found = []
    for name, recording in recordings.recordings(data):
        run = _run(recording)
        strides = _paced(recording) if _RUNNER in name else list(_strides(run, recording.rate_hz))
        found.append((name, _with_labels(recording, run, strides)))
    for name, recording in stairs(data):
        run = _run(recording)
        strides = list(_climbing(run, recording.rate_hz))
        found.append((name, _with_labels(recording, run, strides)))
    return found


def _run(recording: Recording) -> Trace:
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    return trace(counts, importing.parameters_of(recording))


def _with_labels(recording: Recording, run: Trace, strides: Sequence[Stride]) -> Recording:
    started = run.start.row / recording.rate_hz
    return replace(recording, modes=tuple(_labels(started, strides)))


def _stances(run: Trace, rate_hz: float) -> list[tuple[int, int]]:
    """Rows (begin, end) of the stances, flicker left out."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], run.stance, [0]]).astype(int)))
    found: list[tuple[int, int]] = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - begin < _STANCE_S * rate_hz:
            continue
        if found and begin - found[-1][1] < _SWING_S * rate_hz:
            found[-1] = (found[-1][0], end)
        else:
            found.append((begin, end))
    return found


def _strides(run: Trace, rate_hz: float) -> Iterator[Stride]:
    """Strides on a floor."""
    for (_, lift_off), (landing, _) in pairwise(_stances(run, rate_hz)):
        yield Stride(lift_off / rate_hz, landing / rate_hz, "walk")


def _climbing(run: Trace, rate_hz: float) -> Iterator[Stride]:
    """Strides on stairs, by how far each rose from stance to stance."""
    for (begin, lift_off), (landing, end) in pairwise(_stances(run, rate_hz)):
        rise = float(
            run.position[(landing + end) // 2, 2] - run.position[(begin + lift_off) // 2, 2]
        )
        mode = "walk" if abs(rise) < _LEVEL_M else ""
        if abs(rise) >= _STAIR_M:
            mode = "upstairs" if rise > 0 else "downstairs"
        yield Stride(lift_off / rate_hz, landing / rate_hz, mode)


def _paced(recording: Recording) -> list[Stride]:
    """Strides from one surveyed point to the next, by their speed."""
    truth = recording.truth
    assert truth is not None
    way = np.linalg.norm(np.diff(truth.position_enu[:, :2], axis=0), axis=1)
    found = []
    for (start, end), length in zip(pairwise(truth.time_s.tolist()), way.tolist(), strict=True):
        speed = length / (end - start)
        mode = "walk" if _STOPPING_MPS <= speed < _WALK_MPS else ""
        if speed >= _RUN_MPS:
            mode = "run"
        found.append(Stride(start, end, mode))
    return found


def _labels(started: float, strides: Sequence[Stride]) -> Iterator[Label]:
    """Bouts of strides of one mode, and the rests: from the static start on, `started` s."""
    if not strides:
        return
    first = strides[0].start - _SETTLED_S
    if first > started:
        yield Label(started, first, "still")
    begin = strides[0].start
    for stride, after in pairwise([*strides, None]):
        assert stride is not None
        rests = after is not None and after.start - stride.end >= _REST_S
        if after is None or rests or after.mode != stride.mode:
            if stride.mode:
                yield Label(begin, stride.end, stride.mode)
            begin = after.start if after is not None else stride.end
        if after is not None and rests:
            yield Label(stride.end + _SETTLED_S, after.start - _SETTLED_S, "still")


def main(data: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, recording in labelled(data):
        importing.to_capture(recording, folder / f"{name.replace(' ', '-')}.solcap")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python tools/studies/labelled.py DATA FOLDER")
    try:
        main(Path(sys.argv[1]), Path(sys.argv[2]))
    except SolenavError as error:
        sys.exit(error.message)
