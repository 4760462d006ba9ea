"""Run the core over samples and write down what the firmware would have sent."""

from __future__ import annotations

from array import array
from binascii import crc32
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav import engines
from solenav.capture.contents import Capture, unwrap, words
from solenav.capture.file import CaptureWriter
from solenav.capture.sidecar import truth_notes, write_sidecar, write_truth
from solenav.engines.source import fingerprint
from solenav.link import FrameWriter
from solenav.modes import labels
from solenav.modes.labels import Label
from solenav.recording import Truth
from solenav_core import messages, navigator

FRAGMENT = 192  # bytes of state or parameters in one frame
_BUFFER = 256


@dataclass
class Samples:
    """Raw samples, as SAMPLE has them.

    `time_us` (n,) board time, `counts` (n, 6) ax ay az gx gy gz, `mag` (n, 3) counts,
    `temperature`, `flags` and `lost` (n,).
    """

    time_us: NDArray[np.int64]
    counts: NDArray[np.int16]
    temperature: NDArray[np.int16]
    flags: NDArray[np.uint8]
    mag: NDArray[np.int16]
    lost: NDArray[np.uint8]

    @property
    def words(self) -> NDArray[np.int16]:
        """The samples as the core takes them, (n, 10)."""
        return words(self.counts, self.mag, self.flags, self.lost)


def samples_of(capture: Capture) -> Samples:
    """A capture's samples, those before a restart or gap included."""
    rows = capture.samples.rows
    time_us = np.rint(unwrap(rows["time"]) * 1e6).astype(np.int64)
    counts = capture.sample_counts[:, :6]
    return Samples(time_us, counts, rows["temperature"], rows["flags"], rows["mag"], rows["lost"])


class _Pen:
    """Packs messages from a state."""

    def __init__(self) -> None:
        self.frames = FrameWriter()
        self.buffer = bytearray(_BUFFER)

    def packed(self, kind: int, tick: int, pack: Callable[..., int], *arguments: Any) -> bytes:
        end = pack(self.buffer, 0, *arguments)
        return self.frames.frame(kind, tick, bytes(self.buffer[:end]))

    def sample(self, tick: int, samples: Samples, row: int) -> bytes:
        return self.packed(messages.SAMPLE, tick, _pack_sample, samples, row)


def _pack_sample(buffer: bytearray, at: int, samples: Samples, row: int) -> int:
    messages.pack_into(
        messages.FORMATS[messages.SAMPLE],
        buffer,
        at,
        int(samples.time_us[row]) & 0xFFFFFFFF,
        *samples.counts[row].tolist(),
        *samples.mag[row].tolist(),
        int(samples.temperature[row]),
        int(samples.flags[row]),
        int(samples.lost[row]),
    )
    return at + messages.SIZES[messages.SAMPLE]


def _opening(
    pen: _Pen, params: array[int], text: str, pose_every: int, forest: array[int] | None = None
) -> bytes:
    """HELLO and PARAMS of a run made on the host."""
    hello = bytearray(_BUFFER)
    messages.pack_into(
        messages.FORMATS[messages.HELLO],
        hello,
        0,
        messages.SCHEMA,
        int(fingerprint()[:8], 16),
        crc32(params),
        navigator.forest_hash(navigator.new_tables(forest)),
        params[messages.NAMES.index("RATE_MHZ")],
        pose_every,
        0,
        0,
        0,
        messages.NOT_TESTED,
    )
    payload = bytes(hello[: messages.SIZES[messages.HELLO]]) + text.encode()
    frames = pen.frames.frame(messages.HELLO, 0, payload)
    return frames + b"".join(fragments(pen.frames, messages.PARAMS, 0, params.tobytes()))


def fragments(pen: FrameWriter, kind: int, tick: int, data: bytes) -> Iterator[bytes]:
    """The frames of a message that comes in fragments: SNAPSHOT or PARAMS."""
    for offset in range(0, len(data), FRAGMENT):
        head = offset.to_bytes(2, "little") + len(data).to_bytes(2, "little")
        yield pen.frame(kind, tick, head + data[offset : offset + FRAGMENT])


def write_samples(
    path: Path,
    samples: Samples,
    params: array[int],
    *,
    text: str,
    notes: dict[str, Any],
    truth: Truth | None,
    modes: Sequence[Label] = (),
) -> None:
    """A capture of samples alone, as `simulate` and `import` make it, with what is beside it."""
    pen = _Pen()
    with CaptureWriter(path, flush=False) as writer:
        writer.write(0.0, _opening(pen, params, text, 0))
        for row in range(len(samples.counts)):
            writer.write(samples.time_us[row] * 1e-6, pen.sample(row + 1, samples, row))
    finish(path, notes, truth, modes)


def finish(
    path: Path, notes: dict[str, Any], truth: Truth | None, modes: Sequence[Label] = ()
) -> None:
    """Sidecar, truth and labels of motion beside a capture."""
    about = truth_notes(truth)
    write_sidecar(path, {**notes, **({"truth": about} if about else {})})
    if truth is not None and len(truth.time_s):
        write_truth(path, truth)
    if modes:
        labels.write(path, modes)


def parameter_changes(capture: Capture) -> dict[int, array[int]]:
    """The parameters that hold from a row of the samples on, where they changed on the way."""
    return {
        int(np.searchsorted(capture.samples.order, order)): changed
        for order, changed in capture.params[1:]
    }


def replay(
    capture: Capture,
    path: Path,
    *,
    engine: str | None = None,
    forest: array[int] | None = None,
    pose_every: int = 1,
    snapshot_s: float = 10.0,
    progress: Callable[[int], None] = lambda done: None,
) -> engines.Engine:
    """Run an engine over all samples of a capture, as one run, and write the frames of it.

    A POSE on every `pose_every`-th tick, a SNAPSHOT every `snapshot_s` seconds; parameters change
    where they did on the board. `forest` (words) replaces the shipped one. `progress` gets the
    number of samples done now and then. SolenavError where there is nothing to run on.
    """
    capture.need_samples()
    params = capture.params[0][1][:]
    changes = parameter_changes(capture)
    samples = samples_of(capture)
    runner = engines.create(engine or engines.default_name(), params, forest)
    rows = samples.words
    every = round(snapshot_s * capture.rate_hz())
    pen = _Pen()
    with CaptureWriter(path, flush=False) as writer:
        writer.write(0.0, _opening(pen, params, f"replay on {engine}", pose_every, forest))
        for row in range(len(samples.counts)):
            if changes.get(row, params) != params:
                params[:] = changes[row]
                data = b"".join(fragments(pen.frames, messages.PARAMS, row, params.tobytes()))
                writer.write(samples.time_us[row] * 1e-6, data)
            _row, events = runner.advance(rows, row, row + 1)
            tick = row + 1
            data = pen.sample(tick, samples, row)
            data += _after_tick(pen, runner, tick, events, pose_every, every)
            writer.write(samples.time_us[row] * 1e-6, data)
            if row % 200 == 0:
                progress(row)
    progress(len(samples.counts))
    finish(path, {**capture.sidecar, "replayed": engine}, capture.truth, capture.modes)
    return runner


def _after_tick(
    pen: _Pen, runner: engines.Engine, tick: int, events: int, pose_every: int, every: int
) -> bytes:
    """What the firmware sends after a tick, in its order."""
    data = b""
    state = runner.state
    if events & navigator.ALIGNED:
        data += pen.packed(messages.ALIGN, tick, messages.pack_align, state)
    if events & navigator.STEP:
        data += pen.packed(messages.STEP, tick, messages.pack_step, state)
    if runner.navigating and tick % pose_every == 0:
        data += pen.packed(messages.POSE, tick, messages.pack_pose, state, runner.params)
    if every and tick % every == 0:
        data += b"".join(fragments(pen.frames, messages.SNAPSHOT, tick, runner.snapshot()))
    return data
