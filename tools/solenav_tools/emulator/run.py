"""A walk on the emulated board: what its sensor measures, and a recording of what it sends."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solenav import parameters, replaying
from solenav.capture import Capture, CaptureWriter
from solenav.errors import SolenavError
from solenav.recording import Recording
from solenav.sim.scenario import simulate
from solenav_tools.board import Samples
from solenav_tools.emulator import image
from solenav_tools.emulator.pico import EmulatedPico
from solenav_tools.staging import board_tree, switch

MARCH = "armv6m"
_STANDING_S = 2.0
_BOOT_S = 20.0  # in which a board samples, or never will; it takes 3 s


@dataclass(frozen=True)
class Outcome:
    """`seconds` of emulated time, `console` what the program printed."""

    seconds: float
    console: str


def walk_of(scenario: str, seconds: float | None = None, *, rate_hz: float = 200.0) -> Recording:
    """A simulated scenario; of `seconds` from two seconds before the first step, if given.

    Two seconds of standing are enough for the static start. SolenavError: no such scenario.
    """
    walk = simulate(scenario, rate_hz=rate_hz)
    if seconds is None or walk.truth is None:
        return walk
    moving = ~np.asarray(walk.truth.stance)
    first = max(0, int(moving.argmax()) - round(_STANDING_S * rate_hz)) if moving.any() else 0
    rows = slice(first, first + round(seconds * rate_hz))
    truth = walk.truth
    return replace(
        walk,
        time_s=walk.time_s[rows] - walk.time_s[first],
        accel=walk.accel[rows],
        gyro=walk.gyro[rows],
        mag=None if walk.mag is None else walk.mag[rows],
        truth=replace(
            truth,
            time_s=truth.time_s[rows] - walk.time_s[first],
            position_enu=truth.position_enu[rows],
            velocity_enu=None if truth.velocity_enu is None else truth.velocity_enu[rows],
            stance=None if truth.stance is None else truth.stance[rows],
            closed_loop=False,
        ),
    )


def feed_of(source: Capture) -> Samples:
    """What a sensor measures that plays the capture's samples. SolenavError where it has none."""
    source.need_samples()
    samples = replaying.samples_of(source)
    mag = samples.mag if samples.mag.any() else None
    return Samples(samples.time_us, samples.counts, samples.temperature, mag)


def file_system(config: Mapping[str, Any]) -> bytes:
    """An image of the firmware as `solenav flash` puts it on a new Pico, with this config.json."""
    return image.build(flashed(board_tree(MARCH), config))


def flashed(tree: Mapping[str, bytes], config: Mapping[str, Any]) -> dict[str, bytes]:
    """The files of a new board that `solenav flash` has put this tree onto."""
    files = {f"a/{path}": data for path, data in tree.items()}
    settings = json.dumps(dict(config)).encode()
    return {"main.py": switch(), "active": b"a", "config.json": settings, **files}


def settings_for(source: Capture, pose_every: int | None = None) -> dict[str, Any]:
    """The config.json for a capture: its parameters, poses so often (None: as the firmware's)."""
    often = {} if pose_every is None else {"pose_every": pose_every}
    return {"params": parameters.named(source.params[0][1]), **often}


def record(
    uf2: Path,
    source: Capture,
    output: Path,
    *,
    pose_every: int | None = None,
    config: Mapping[str, Any] | None = None,
    sensor: str = "MPU-9150",
    faults: Sequence[Mapping[str, Any]] = (),
    progress: Callable[[int], None] = lambda ms: None,
    watch: Callable[[EmulatedPico], None] = lambda pico: None,
) -> Outcome:
    """Record what the board sends over all of the capture's samples, as fast as it goes.

    Arrival times are when the last bit of a frame left the board: two runs give the same file.
    `watch` is called with the board at each millisecond of emulated time.
    SolenavError where the firmware crashes, what it sent before is in the file, and where it
    doesn't begin to sample.
    """
    files = file_system({**settings_for(source, pose_every), **(config or {})})
    said = bytearray()
    with (
        EmulatedPico(uf2, files, feed_of(source), sensor=sensor, faults=faults) as pico,
        CaptureWriter(output) as writer,
    ):
        frame = bytearray()

        def sent(byte: int, ns: int) -> None:
            frame.append(byte)
            if not byte:
                writer.write(ns * 1e-9, bytes(frame))
                frame.clear()

        def ended() -> bool:
            progress(pico.ns // 1_000_000)
            watch(pico)
            playback = pico.wiring.playback
            if not (playback and playback.start >= 0) and pico.ns > _BOOT_S * 1e9:
                raise SolenavError(
                    f"the emulated board doesn't sample; it said: {said.decode(errors='replace')}",
                    "look at its config.json, and whether the UF2 is a Pico's",
                    1,
                )
            return pico.over or b">>> " in said

        pico.on_uart = sent
        pico.console.on_data = said.extend
        pico.run(ended)
        if frame:
            writer.write(pico.ns * 1e-9, bytes(frame))
        seconds = pico.ns * 1e-9
    text = said.decode("utf-8", "replace")
    if "Traceback" in text:
        raise SolenavError(
            f"the firmware on the emulated board ended:\n{text}", "report it with this text", 1
        )
    replaying.finish(output, {**source.sidecar, "board": "emulated"}, source.truth, source.modes)
    return Outcome(seconds, text)
