"""Fetching a board's black box: list, check, fetch with resumption, verify, erase."""

from __future__ import annotations

import os
import time
from binascii import crc32
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import serial

from solenav.capture import CaptureWriter, read_records
from solenav.capture.sidecar import write_sidecar
from solenav.errors import SolenavError
from solenav.link import NAMES, Damage, Frame, FrameReader, decode, unpack
from solenav.progress import Progress, unseen
from solenav_core import messages
from solenav_tools.conversation import FLASH, PATIENCE_S, TRIES, Conversation, Refused, unheard
from solenav_tools.ports import PortVanished, open_port

_WINDOW = 16384  # bytes asked for at once
_IN_FLIGHT_S = 0.5  # for so long what was asked for before still arrives


class Stored(NamedTuple):
    """A file of the black box, as the board lists it."""

    number: int
    size: int


class Checked(NamedTuple):
    """A file of the black box, as the board has read it through: CRC-32 over all of it."""

    number: int
    size: int
    crc: int


@dataclass
class Downloaded:
    """What came of a black box. `files`: Fetched, or Stored where only the list was asked for."""

    port: str
    bytes: int = 0  # of all files
    free: int = 0  # bytes of flash on the board
    longest_access_us: int = 0  # to its flash, since power-up
    files: list[Fetched] | list[Stored] = field(default_factory=list)
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        listed = [f.as_dict() if isinstance(f, Fetched) else f._asdict() for f in self.files]
        return {**self.__dict__, "files": listed}


@dataclass
class Fetched:
    """A file of the black box that is here, equal to the board's to the byte."""

    number: int
    size: int
    crc: int
    capture: Path
    frames: int
    damaged: int
    resumed_from: int  # bytes that an earlier try had fetched
    there_already: bool
    erased: bool = False

    def as_dict(self) -> dict[str, Any]:
        return {**self.__dict__, "capture": str(self.capture), "crc": f"{self.crc:08x}"}


class BlackBox:
    """A board's black box at an open port.

    PortVanished where the other end goes away; SolenavError where it doesn't answer, refuses,
    or speaks another schema.
    """

    def __init__(self, port: serial.Serial) -> None:
        self.free = 0  # bytes of flash, from the last listing
        self.longest = 0  # µs, the longest access to flash since power-up
        self._talk = Conversation(port)

    def hello(self) -> None:
        """Ask who is there. SolenavError where that is nobody, or one of another schema."""
        self._talk.hello()

    def files(self) -> list[Stored]:
        """The files, oldest first."""
        out: list[Stored] = []
        while True:
            for frame in self._answers(messages.FILE, messages.ASK_FILES, len(out)):
                fields = unpack(frame)
                self.free, self.longest = fields["free"], fields["longest"]
                if fields["count"] == 0:
                    return []
                if fields["index"] != len(out):
                    break  # one was lost on the way: ask for it
                out.append(Stored(fields["number"], fields["size"]))
                if len(out) == fields["count"]:
                    return out

    def check(self, number: int) -> Checked:
        """Let the board compute a file's CRC."""
        for frame in self._answers(messages.FILE_CHECK, messages.ASK_CHECK, number):
            checked = Checked(**unpack(frame))
            if checked.number == number:
                break
        return checked

    def pieces(self, number: int, start: int, stop: int) -> Iterator[bytes]:
        """The file's bytes from `start` to `stop`, in order."""
        while start < stop:
            length = min(stop - start, _WINDOW)
            end = start + length
            asked = time.monotonic()
            for frame in self._answers(
                messages.FILE_DATA, messages.ASK_DATA, number, start, length
            ):
                fields = unpack(frame)
                if fields["number"] != number or fields["offset"] < start:
                    continue
                if fields["offset"] > start:
                    # A piece was lost on the way: ask for it, once.
                    if time.monotonic() - asked > _IN_FLIGHT_S:
                        break
                    continue
                start += len(fields["data"])
                yield fields["data"]
                if start >= end:
                    break

    def erase(self, file: Checked) -> None:
        """Erase a file that the board itself has just checked, and found to be this one."""
        for _frame in self._answers(messages.ACK, messages.ASK_ERASE, *file):
            return

    def _answers(self, wanted: int, kind: int, *values: int) -> Iterator[Frame]:
        """Ask, and ask again where nothing comes; yield what comes of the type `wanted`."""
        refused = False
        for _try in range(TRIES):
            seq = self._talk.ask(kind, *values)
            deadline = time.monotonic() + PATIENCE_S
            while time.monotonic() < deadline:
                for frame in self._talk.frames():
                    if frame.kind == messages.ACK:
                        fields = unpack(frame)
                        if (fields["command"], fields["command_seq"]) != (kind, seq):
                            continue
                        if fields["result"] == messages.UNKNOWN:
                            raise SolenavError(
                                f"{self._talk.where}: the firmware doesn't know {NAMES[kind]}",
                                FLASH,
                            )
                        if fields["result"] == messages.REFUSED:
                            # It may still be writing what we have missed: again in a while.
                            refused = True
                            continue
                    if frame.kind == wanted:
                        deadline = time.monotonic() + PATIENCE_S
                        yield frame
        if refused:
            raise Refused(NAMES[kind], "", "start again")
        raise unheard(self._talk.where, NAMES[kind])


def download(
    port: str,
    folder: Path | str = ".",
    *,
    erase: bool = False,
    only_list: bool = False,
    baud: int | None = None,
    progress: Progress = unseen,
) -> Downloaded:
    """Fetch all files of the black box of the board at a port into captures in `folder`.

    After a break the same call goes on from where it was. `erase`: the board lets go of each file
    whose copy is verified. SolenavError where the board doesn't answer, or the port vanishes.
    """
    output = Path(folder)
    began = time.monotonic()
    found = Downloaded(port)
    done: list[Fetched] = []
    try:
        with open_port(port, baud) as opened:
            box = BlackBox(opened)
            box.hello()
            stored = box.files()
            found.bytes = sum(file.size for file in stored)
            found.free, found.longest_access_us = box.free, box.longest
            if only_list:
                found.files = stored
            else:
                notes = {"port": port, "baud": opened.baudrate, "downloaded": time.time()}
                with progress("downloading", found.bytes) as show:
                    here = 0
                    for file in stored:
                        count = lambda part, before=here: show(before + part)  # noqa: E731
                        done.append(fetch(box, file, output, notes, count, erase=erase))
                        here += file.size
                found.files = done
    except (PortVanished, KeyboardInterrupt) as error:
        what = f"{port} vanished" if isinstance(error, PortVanished) else "stopped"
        raise SolenavError(
            f"{what} after {len(done)} whole files; all that came is kept in {output}",
            "the same command goes on from there",
            1,
        ) from None
    found.seconds = round(time.monotonic() - began, 3)
    return found


def fetch(
    box: BlackBox,
    stored: Stored,
    folder: Path,
    notes: dict[str, Any],
    progress: Callable[[int], None] = lambda done: None,
    *,
    erase: bool = False,
) -> Fetched:
    """Bring a file into `folder` as a capture; `progress` takes the bytes that are here.

    The name holds number and CRC, so a broken try is gone on with only where it was the same
    file. What the capture holds is read back and compared with the board's CRC; with `erase` the
    board then lets go of the file. Errors as BlackBox, and SolenavError where the disk refuses.
    """
    checked = box.check(stored.number)
    fetched = _fetch(box, checked, folder, notes, progress)
    if erase:
        box.erase(checked)
        fetched.erased = True
    return fetched


def _fetch(
    box: BlackBox,
    checked: Checked,
    folder: Path,
    notes: dict[str, Any],
    progress: Callable[[int], None],
) -> Fetched:
    target = folder / f"blackbox-{checked.number:06d}-{checked.crc:08x}.solcap"
    if target.exists():
        data = _bytes_of(target)
        if crc32(data) == checked.crc:
            progress(len(data))
            return Fetched(*checked, target, *_count(data), len(data), True)
    part = target.with_suffix(".part")
    resumed = _complete(box, checked, part, progress)
    data = part.read_bytes()
    if crc32(data) != checked.crc and resumed:
        # The earlier try's bytes were bad: once more, from the start.
        part.unlink()
        resumed = _complete(box, checked, part, progress)
        data = part.read_bytes()
    if crc32(data) != checked.crc:
        part.unlink()
        raise SolenavError(
            f"file {checked.number} of the black box differs from what the board has read",
            "fetch it again; if that doesn't help the board's flash is failing",
            1,
        )
    unfinished = target.with_suffix(".unfinished")
    _write(unfinished, data)
    if _bytes_of(unfinished) != data:
        raise SolenavError(f"{unfinished} is not what was written", "check the disk", 1)
    about = {"number": checked.number, "crc": f"{checked.crc:08x}"}
    try:
        write_sidecar(target, {**notes, "blackbox": about})
        unfinished.replace(target)
        part.unlink()
    except OSError as error:
        raise _disk(target, error) from None
    frames, damaged = _count(data)
    return Fetched(*checked, target, frames, damaged, resumed, False)


def _complete(box: BlackBox, file: Checked, part: Path, progress: Callable[[int], None]) -> int:
    """Fetch into `part` what it lacks; the bytes that were there before."""
    try:
        with part.open("ab") as out:
            before = out.tell()
            if before > file.size:
                out.truncate(0)
                before = 0
            have = before
            progress(have)
            for piece in box.pieces(file.number, have, file.size):
                out.write(piece)
                # After a break of any kind all that came is there to go on from.
                out.flush()
                have += len(piece)
                progress(have)
            os.fsync(out.fileno())
    except OSError as error:
        raise _disk(part, error) from None
    return before


def _disk(path: Path, error: OSError) -> SolenavError:
    remedy = "free some space, or choose another folder with -o"
    return SolenavError(f"{path}: {error.strerror}", remedy, 1)


def _write(path: Path, data: bytes) -> None:
    """The stream as a capture, a frame a record, with arrival times after the frames' ticks."""
    period = 0.0
    arrival = 0.0
    with CaptureWriter(path, flush=False) as writer:
        *whole, rest = data.split(b"\0")
        for stuffed in whole:
            item = decode(stuffed) if stuffed else None
            if isinstance(item, Frame):
                if item.kind == messages.HELLO:
                    period = 1000 / max(unpack(item)["rate"], 1)
                arrival = max(arrival, item.tick * period)
            writer.write(arrival, stuffed + b"\0")
        writer.write(arrival, rest)


def _bytes_of(capture: Path) -> bytes:
    return b"".join(data for _arrival, data in read_records(capture))


def _count(data: bytes) -> tuple[int, int]:
    """Frames and damages in a stream."""
    reader = FrameReader()
    items = [*reader.feed(data), *reader.close()]
    damaged = sum(isinstance(item, Damage) for item in items)
    return len(items) - damaged, damaged
