"""Where a recording holds still, and which way is up there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import mpu9150
from solenav.capture.contents import Capture, unwrap
from solenav.errors import SolenavError
from solenav.recording import FloatArray, Recording
from solenav_core import messages


def _directions() -> dict[str, FloatArray]:
    out = {}
    for signs in product((1, 0, -1), repeat=3):
        if any(signs):
            name = "".join(f"{'+-'[s < 0]}{a}" for s, a in zip(signs, "xyz", strict=True) if s)
            out[name] = np.array(signs) / np.linalg.norm(signs)
    return dict(sorted(out.items(), key=lambda item: len(item[0])))


DIRECTIONS = _directions()
"""Faces, edges and corners of a cube by name, such as "+x" and "-y+z", as unit vectors (3,)."""

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""The sensor's axis that points up; the specific force at rest is along it."""

EDGES = ("+x+y", "+x-y", "+y+z", "+y-z", "+x+z", "-x+z")
"""Attitudes half-way between faces that tell how far the axes are from right angles."""

WINDOW_S = 0.5
STILL_ACCEL = 0.15  # m/s², standard deviation in a window: a steady hand, twice the noise
STILL_RATE = np.radians(2.0)
SHORTEST_S = 1.5
LEAN_MAX_DEG = 20.0
DRIFT_MAX_DEG = 1.5  # between a stretch's halves; a hand that turns slowly shakes little
_HOLD_DEG = 30.0  # an attitude so near to a face was meant for it
_EDGE_S = 0.1  # left off either end of a stretch


@dataclass(frozen=True)
class Pose:
    """A time for which the sensor was held in one attitude.

    Rows `first` to `last` (excluded) of the recording, from `start_s` to `end_s`; mean specific
    force (3,) m/s² and rate (3,) rad/s as measured; the nearest of FACES and the angle to it.
    `fault` says why it can't be used, `leans` whether it is too far from the face to stand for
    it, while its gravity is as good as another's.
    """

    first: int
    last: int
    start_s: float
    end_s: float
    force: tuple[float, float, float]
    rate: tuple[float, float, float]
    face: str
    lean_deg: float
    fault: str = ""

    @property
    def leans(self) -> bool:
        return self.lean_deg > LEAN_MAX_DEG

    @property
    def complaint(self) -> str:
        """Why it can't stand for its face; empty where it can."""
        lean = f"leans {self.lean_deg:.0f}° from {self.face} up, at most {LEAN_MAX_DEG:.0f}° do"
        return self.fault or (lean if self.leans else "")

    def __str__(self) -> str:
        why = f": {self.complaint}" if self.complaint else ""
        return f"{self.face} up at {self.start_s:.1f} to {self.end_s:.1f} s{why}"


def from_capture(capture: Capture) -> Recording:
    """A capture's raw samples in SI units, with the magnetometer's new readings.

    As measured: nothing is corrected, whatever parameters the board ran with. SolenavError
    where there is less than a second of them.
    """
    capture.need_schema()
    rows = capture.samples.rows
    if len(rows) < 2 or unwrap(rows["time"])[-1] - unwrap(rows["time"])[0] < 1.0:
        raise SolenavError(
            f"{capture.path} holds no second of samples",
            "record with the firmware's `send_samples` on",
        )
    return from_rows(rows, capture.path.name)


def from_rows(rows: NDArray[Any], source: str) -> Recording:
    """Rows (n,) of SAMPLE, two at least, in SI units, as `from_capture` gives them."""
    time_s = unwrap(rows["time"])
    accel, gyro = mpu9150.from_counts(np.hstack([rows["acc"], rows["gyro"]]))
    new = (rows["flags"] & messages.MAG_NEW) != 0
    mag = np.where(new[:, None], mpu9150.mag_from_counts(rows["mag"]), np.nan)
    period = float(np.median(np.diff(time_s)))
    return Recording(
        Path(source).stem,
        time_s - time_s[0],
        accel,
        gyro,
        1.0 / max(period, 1e-6),
        source=source,
        mag=mag if new.any() else None,
    )


def poses(recording: Recording) -> list[Pose]:
    """Every attitude that the recording holds for a while, in order, the bad ones with a fault."""
    n = max(2, round(WINDOW_S * recording.rate_hz))
    if len(recording.time_s) <= n:
        return []
    mean, spread = _windows(recording.accel, n)
    turning = _windows(recording.gyro, n)[1]
    quiet = (spread < STILL_ACCEL) & (turning < STILL_RATE)
    found = _joined(
        recording, [_pose(recording, first, last + n - 1) for first, last in _runs(quiet)], n
    )
    return sorted(found + _held(recording, found, mean, quiet, n), key=_start)


def _start(pose: Pose) -> float:
    return pose.start_s


def _joined(recording: Recording, found: list[Pose], n: int) -> list[Pose]:
    """Rests less than a window of `n` rows apart in one attitude made one: a knock ends none."""
    out: list[Pose] = []
    for pose in found:
        if (
            out
            and pose.first - out[-1].last < n
            and _angle(out[-1].force, pose.force) < DRIFT_MAX_DEG
        ):
            out[-1] = _pose(recording, out[-1].first, pose.last)
        else:
            out.append(pose)
    return out


def _held(
    recording: Recording, still: list[Pose], mean: FloatArray, quiet: NDArray[np.bool_], n: int
) -> list[Pose]:
    """Holds near a face in which the sensor moved all the time."""
    size = np.linalg.norm(mean, axis=1)
    near = np.abs(mean).max(axis=1) > np.cos(np.radians(_HOLD_DEG)) * size
    axis = np.abs(mean).argmax(axis=1)
    face = np.where(near, 2 * axis + (np.take_along_axis(mean, axis[:, None], 1)[:, 0] < 0), -1)
    out = []
    for which in range(len(FACES)):
        for first, last in _runs(face == which):
            rows = slice(first, last)
            seconds = (last - first) / recording.rate_hz
            if seconds < SHORTEST_S or quiet[rows].any():
                continue
            if any(pose.first < last + n and pose.last > first for pose in still):
                continue
            out.append(_pose(recording, first, last + n - 1, "moving"))
    return out


def _pose(recording: Recording, first: int, last: int, fault: str = "") -> Pose:
    time_s = recording.time_s
    last = min(last, len(time_s))
    edge = min(round(_EDGE_S * recording.rate_hz), (last - first) // 4)
    inside = slice(first + edge, last - edge)
    force = recording.accel[inside].mean(axis=0)
    half = (first + last) // 2
    drift = _angle(
        recording.accel[first + edge : half].mean(axis=0),
        recording.accel[half : last - edge].mean(axis=0),
    )
    seconds = float(time_s[last - 1] - time_s[first])
    if not fault and drift > DRIFT_MAX_DEG:
        fault = f"moving: turned by {drift:.1f}°"
    elif not fault and seconds < SHORTEST_S:
        fault = f"too short: still for {seconds:.1f} s, {SHORTEST_S:g} s are needed"
    face, lean = face_of(force)
    x, y, z = (float(v) for v in force)
    a, b, c = (float(v) for v in recording.gyro[inside].mean(axis=0))
    return Pose(
        first + edge,
        last - edge,
        float(time_s[first]),
        float(time_s[last - 1]),
        (x, y, z),
        (a, b, c),
        face,
        lean,
        fault,
    )


def face_of(force: FloatArray, faces: Sequence[str] = FACES) -> tuple[str, float]:
    """The nearest of `faces` to a specific force (3,), and the angle between them in degrees."""
    cosines = np.array([DIRECTIONS[face] for face in faces]) @ force
    nearest = faces[int(cosines.argmax())]
    return nearest, _angle(force, DIRECTIONS[nearest])


def missing(found: list[Pose]) -> list[str]:
    """The FACES for which no pose is good."""
    good = {pose.face for pose in found if not pose.complaint}
    return [face for face in FACES if face not in good]


def _angle(a: FloatArray | tuple[float, ...], b: FloatArray | tuple[float, ...]) -> float:
    """Degrees between two vectors (3,)."""
    cross = float(np.linalg.norm(np.cross(a, b)))
    return float(np.degrees(np.arctan2(cross, float(np.dot(a, b)))))


def _windows(values: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Mean (m, 3) and norm (m,) of the standard deviations of every window of n rows."""
    centre = values.mean(axis=0)
    total = np.cumsum(np.vstack([np.zeros(3), values - centre]), axis=0)
    squares = np.cumsum(np.vstack([np.zeros(3), (values - centre) ** 2]), axis=0)
    mean = (total[n:] - total[:-n]) / n
    variance = (squares[n:] - squares[:-n]) / n - mean**2
    return mean + centre, np.sqrt(np.maximum(variance, 0.0).sum(axis=1))


def _runs(mask: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and last (excluded) of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        yield int(first), int(last)
