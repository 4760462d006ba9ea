"""The firmware over a capture's samples, on the simulated board."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from solenav import link, parameters, replaying
from solenav.capture import Capture, CaptureWriter
from solenav_core import messages
from solenav_tools.board import Samples, SimulatedBoard
from solenav_tools.ports import PortVanished, open_port, read_some

_DENSE_HZ = 300  # at 400 Hz every sample and every pose are more than the link carries


def board_for(
    source: Capture,
    *,
    pose_every: int | None = None,
    realtime: bool = False,
    config: Mapping[str, Any] | None = None,
    **options: Any,
) -> SimulatedBoard:
    """A board whose sensor measures the capture's samples, with the capture's parameters.

    `pose_every`: ticks from POSE to POSE, None for as few as the link carries beside each sample.
    `config`: more keys of the firmware's config.json. `options`: SimulatedBoard's. SolenavError
    where the capture has no samples or parameters.
    """
    source.need_samples()
    if pose_every is None:
        pose_every = 1 if source.rate_hz() < _DENSE_HZ else 2
    samples = replaying.samples_of(source)
    params = parameters.named(source.params[0][1])
    settings = {"params": params, "pose_every": pose_every, **(config or {})}
    # Captures without a compass have zeros.
    mag = samples.mag if samples.mag.any() else None
    feed = Samples(samples.time_us, samples.counts, samples.temperature, mag)
    return SimulatedBoard(feed, settings, realtime, **options)


def run(
    source: Capture,
    output: Path,
    *,
    pose_every: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> None:
    """Record what the firmware sends over all of the capture's samples.

    `pose_every` as in `board_for`. Arrival times are the board's, so that two runs give the same
    file. SolenavError where the firmware crashes; what it sent before is in the file.
    """
    last = 0.0
    samples = 0
    rest = b""
    with board_for(source, pose_every=pose_every) as board, CaptureWriter(output) as writer:
        with open_port(board.port) as port:
            while True:
                try:
                    *whole, rest = (rest + read_some(port)).split(b"\0")
                except PortVanished:
                    break
                for stuffed in whole:
                    frame = link.decode(stuffed) if stuffed else None
                    if isinstance(frame, link.Frame) and frame.kind == messages.SAMPLE:
                        last = link.unpack(frame)["time"] * 1e-6
                        samples += 1
                    writer.write(last, stuffed + b"\0")
                progress(samples)
        if rest:
            writer.write(last, rest)
        board.wait()
        board.check()
    replaying.finish(output, {**source.sidecar, "board": "simulated"}, source.truth, source.modes)
