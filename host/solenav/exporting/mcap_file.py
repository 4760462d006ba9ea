"""MCAP for Foxglove: pose, path and transforms in its own schemas, scalars to plot, events.

JSON messages with JSON schemas; those named `foxglove.` have the fields that Foxglove documents.
Times are the board's, laid onto the arrival of the run's first frame, so that several wearers'
files lie beside each other on the time of day.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solenav import mpu9150
from solenav.errors import SolenavError
from solenav.exporting.source import Source, Track, Written
from solenav.link.units import POSE_FLAGS
from solenav.recording import Truth

WORLD, BODY = "enu", "foot"
_PATH_POSES = 2000
_LEVELS = {"info": 2, "warning": 3, "error": 4}  # as foxglove.Log counts

_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_VECTOR = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_TURN = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_POSE = {"type": "object", "properties": {"position": _VECTOR, "orientation": _TURN}}
_TEXT = {"type": "string"}


def _schema(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _numbers(*names: str) -> dict[str, Any]:
    return _schema(timestamp=_TIME, **{name: {"type": "number"} for name in names})


SCHEMAS = {
    "foxglove.PoseInFrame": _schema(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "foxglove.PosesInFrame": _schema(
        timestamp=_TIME, frame_id=_TEXT, poses={"type": "array", "items": _POSE}
    ),
    "foxglove.FrameTransform": _schema(
        timestamp=_TIME,
        parent_frame_id=_TEXT,
        child_frame_id=_TEXT,
        translation=_VECTOR,
        rotation=_TURN,
    ),
    "foxglove.Log": _schema(timestamp=_TIME, level={"type": "integer"}, message=_TEXT, name=_TEXT),
    "solenav.State": _schema(
        **_numbers("speed", "vel_e", "vel_n", "vel_u", "threshold", "n_eff", "m2", "distance")[
            "properties"
        ],
        steps={"type": "integer"},
        **{name: {"type": "boolean"} for name in POSE_FLAGS.values()},
    ),
    "solenav.Imu": _numbers("acc_x", "acc_y", "acc_z", "rate_x", "rate_y", "rate_z", "temperature"),
    "solenav.Step": _numbers("east", "north", "up", "turn", "heading", "distance", "steps"),
}
_TOPICS = {
    "/path": "foxglove.PosesInFrame",
    "/pose": "foxglove.PoseInFrame",
    "/tf": "foxglove.FrameTransform",
    "/state": "solenav.State",
    "/imu": "solenav.Imu",
    "/step": "solenav.Step",
    "/log": "foxglove.Log",
    "/truth/path": "foxglove.PosesInFrame",
}
_LEVEL = (1.0, 0.0, 0.0, 0.0)


def write(source: Source, output: Path) -> Written:
    """The last run. SolenavError without the package mcap, or without poses."""
    try:
        writer_module: Any = import_module("mcap.writer")
    except ImportError:
        raise SolenavError("writing MCAP needs mcap", "pip install 'solenav[export]'") from None
    track = source.track
    begin = source.capture.arrival[0]
    begin = begin if begin > 0 else 0.0
    # Foxglove plays messages in the order of their times.
    items = sorted(
        [
            *_of_poses(track),
            *_of_samples(source),
            *_of_steps(source),
            *_of_logs(source),
            *_of_truth(source.capture.truth),
        ],
        key=lambda item: item[1],
    )
    with output.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start(profile="", library="solenav")
        channels = {}
        for topic, name in _TOPICS.items():
            schema = writer.register_schema(
                name, "jsonschema", json.dumps({"title": name, **SCHEMAS[name]}).encode()
            )
            channels[topic] = writer.register_channel(topic, "json", schema)
        for topic, seconds, content in items:
            stamp = max(0, round((begin + seconds) * 1e9))
            content = {"timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9}, **content}
            writer.add_message(channels[topic], stamp, json.dumps(content).encode(), stamp)
        writer.finish()
    losses = ["STATUS, SNAPSHOT, PARAMS, the digests", *source.run_losses()]
    return Written([output], len(items), losses)


Item = tuple[str, float, dict[str, Any]]


def _vector(values: Any) -> dict[str, float]:
    return dict(zip("xyz", (float(v) for v in values), strict=True))


def _turn(attitude: Any) -> dict[str, float]:
    return dict(zip("wxyz", (float(v) for v in attitude), strict=True))


def _pose(position: Any, attitude: Any) -> dict[str, Any]:
    return {"position": _vector(position), "orientation": _turn(attitude)}


def _path(positions: Any, attitudes: Any) -> dict[str, Any]:
    thin = max(1, -(-len(positions) // _PATH_POSES))
    pairs = zip(positions[::thin], attitudes[::thin], strict=True)
    return {"frame_id": WORLD, "poses": [_pose(*pair) for pair in pairs]}


def _of_poses(track: Track) -> Iterator[Item]:
    # The whole way at the very beginning: Foxglove shows the last path that came.
    yield "/path", float(track.time_s[0]), _path(track.position, track.attitude)
    rows = track.poses
    for i, seconds in enumerate(track.time_s.tolist()):
        position, attitude = track.position[i], track.attitude[i]
        velocity, flags = track.velocity[i], int(rows["flags"][i])
        yield "/pose", seconds, {"frame_id": WORLD, "pose": _pose(position, attitude)}
        transform = {"translation": _vector(position), "rotation": _turn(attitude)}
        yield "/tf", seconds, {"parent_frame_id": WORLD, "child_frame_id": BODY, **transform}
        yield (
            "/state",
            seconds,
            {
                "speed": float(np.linalg.norm(velocity)),
                **dict(zip(("vel_e", "vel_n", "vel_u"), velocity.tolist(), strict=True)),
                "threshold": rows["threshold"][i] / 2**14,
                "n_eff": rows["n_eff"][i] / 2**8,
                "m2": rows["m2"][i] / 2**10,
                "distance": rows["distance"][i] / 2**10,
                "steps": int(rows["steps"][i]),
                **{name: bool(flags & flag) for flag, name in POSE_FLAGS.items()},
            },
        )


def _of_samples(source: Source) -> Iterator[Item]:
    run, _earlier = source.last
    rows = run.samples.rows
    accel, gyro = mpu9150.from_counts(np.hstack([rows["acc"], rows["gyro"]]).reshape(-1, 6))
    degrees = np.rad2deg(gyro)
    degrees_c = mpu9150.celsius(rows["temperature"])
    for i, seconds in enumerate(run.time_of_tick(run.samples.tick).tolist()):
        values = [*accel[i].tolist(), *degrees[i].tolist(), float(degrees_c[i])]
        names = ("acc_x", "acc_y", "acc_z", "rate_x", "rate_y", "rate_z", "temperature")
        yield "/imu", seconds, dict(zip(names, values, strict=True))


def _of_steps(source: Source) -> Iterator[Item]:
    run, _earlier = source.last
    rows = run.steps.rows
    for i, seconds in enumerate(run.time_of_tick(run.steps.tick).tolist()):
        east, north, up = (rows["displacement"][i] / 2**18).tolist()
        yield (
            "/step",
            seconds,
            {
                "east": east,
                "north": north,
                "up": up,
                "turn": float(rows["turn"][i]) * 360 / 2**16,
                "heading": float(rows["heading"][i]) * 360 / 2**16 % 360,
                "distance": rows["distance"][i] / 2**10,
                "steps": int(rows["steps"][i]),
            },
        )


def _of_logs(source: Source) -> Iterator[Item]:
    logs = source.capture.logs
    times = source.capture.time_of_tick(np.array([tick for tick, _level, _text in logs], np.int64))
    for seconds, (_tick, level, text) in zip(times.tolist(), logs, strict=True):
        yield "/log", seconds, {"level": _LEVELS[level], "message": text, "name": "firmware"}


def _of_truth(truth: Truth | None) -> Iterator[Item]:
    if truth is None or not len(truth.time_s):
        return
    # A survey of the floor knows no height.
    positions = np.nan_to_num(truth.position_enu, nan=0.0)
    attitudes = np.tile(_LEVEL, (len(positions), 1))
    yield "/truth/path", float(truth.time_s[0]), _path(positions, attitudes)
