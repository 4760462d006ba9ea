"""Frames over any byte stream: decoding, encoding, resynchronising."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Iterator
from typing import Any, NamedTuple

from cobs import cobs

from solenav_core import framing, messages

NAMES = {kind: name for kind, name, _when, _fields in messages.MESSAGES}
FIELDS = {kind: fields for kind, _name, _when, fields in messages.MESSAGES}
_HEADER = struct.Struct("<BBI")
_CRC = struct.Struct("<H")
# Garbage without a delimiter must not grow without end; no frame is longer than `_FRAME_MAX`.
_LONGEST = 4 * framing.PAYLOAD_MAX
_FRAME_MAX = _HEADER.size + framing.PAYLOAD_MAX + _CRC.size + 1


class Frame(NamedTuple):
    """One intact frame: message type, sequence number modulo 256, tick, payload."""

    kind: int
    seq: int
    tick: int
    payload: bytes


class Damage(NamedTuple):
    """Bytes between two delimiters that are no frame of this schema, and why."""

    data: bytes
    reason: str


def _seed(kind: int) -> int:
    return framing.STANDARD_SEED if kind in messages.OPEN else messages.SCHEMA


def encode(kind: int, seq: int, tick: int, payload: bytes = b"") -> bytes:
    """The bytes of a frame on the wire, delimiter included."""
    body = _HEADER.pack(kind, seq & 255, tick) + payload
    return cobs.encode(body + _CRC.pack(crc_hqx(body, _seed(kind)))) + b"\0"


def command(kind: int, seq: int, *values: int) -> bytes:
    """The bytes of a command with its fields in the schema's order.

    A delimiter goes before it, so that what somebody left unfinished on the line can't spoil it.
    """
    return b"\0" + encode(kind, seq, 0, struct.pack(messages.FORMATS[kind], *values))


def decode(stuffed: bytes) -> Frame | Damage:
    """A frame from the bytes between two delimiters."""
    try:
        body = cobs.decode(stuffed)
    except cobs.DecodeError:
        return Damage(stuffed, "not COBS")
    if len(body) < _HEADER.size + _CRC.size:
        return Damage(stuffed, "too short")
    kind, seq, tick = _HEADER.unpack_from(body)
    (crc,) = _CRC.unpack_from(body, len(body) - 2)
    if crc_hqx(body[:-2], _seed(kind)) != crc:
        return Damage(stuffed, "CRC differs")
    payload = body[_HEADER.size : -2]
    if kind not in NAMES:
        return Damage(stuffed, f"unknown message type 0x{kind:02x}")
    size = messages.SIZES[kind]
    if len(payload) < size or (len(payload) > size and not _open_ended(kind)):
        return Damage(stuffed, f"{NAMES[kind]} of {len(payload)} bytes instead of {size}")
    return Frame(kind, seq, tick, payload)


def _open_ended(kind: int) -> bool:
    return any(code == "*" for _name, code, _count, _format, _meaning in FIELDS[kind])


def unpack(frame: Frame) -> dict[str, Any]:
    """The message's fields by name: integers, tuples of them, bytes for an open end."""
    values = iter(struct.unpack_from(messages.FORMATS[frame.kind], frame.payload))
    out: dict[str, Any] = {}
    for name, code, count, _format, _meaning in FIELDS[frame.kind]:
        if code == "*":
            out[name] = frame.payload[messages.SIZES[frame.kind] :]
        elif count == 1:
            out[name] = next(values)
        else:
            out[name] = tuple(next(values) for _ in range(count))
    return out


# Stuffed bytes of the types that always have the same size.
_STUFFED = {
    kind: _HEADER.size + size + _CRC.size + 1
    for kind, size in messages.SIZES.items()
    if not _open_ended(kind)
}


def _joined(stuffed: bytes) -> Iterator[Frame | Damage]:
    """What two delimiters hold where that is no frame: perhaps one behind noise, or two frames.

    A lost delimiter must not cost the frame after it. Only a frame with the type and the size of
    that type at the very end counts, and one before it only together with that.
    """
    for kind, size in _STUFFED.items():
        if len(stuffed) <= size or stuffed[1 - size] != kind:
            continue
        tail = decode(stuffed[-size:])
        if isinstance(tail, Frame):
            rest = stuffed[:-size]
            heads = [decode(rest), decode(rest[:-1])]  # the delimiter is gone, or another byte
            yield next((head for head in heads if isinstance(head, Frame)), heads[0])
            yield tail
            return
    yield decode(stuffed)


class FrameReader:
    """Splits a byte stream into frames. One damaged byte costs at most the frame that it hit.

    The delimiter counts as a part of the frame that it ends.
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[Frame | Damage]:
        """The frames and damages that end within `data`, in order."""
        *whole, self._rest = (self._rest + data).split(b"\0")
        for stuffed in whole:
            # Two delimiters in a row are what a sender uses to say "from here".
            if not stuffed:
                continue
            item = decode(stuffed)
            if isinstance(item, Frame):
                yield item
            else:
                yield from _joined(stuffed)
        if len(self._rest) > _LONGEST:
            lost, self._rest = self._rest[:-_FRAME_MAX], self._rest[-_FRAME_MAX:]
            yield Damage(lost, "no delimiter")

    def close(self) -> Iterator[Damage]:
        """What is left of a frame that never ended."""
        if self._rest:
            lost, self._rest = self._rest, b""
            yield Damage(lost, "cut off")


def missing(before: int, frame: Frame) -> int:
    """How many frames were lost since the one with seq `before` (below 0: none was heard).

    HELLO is out of the count: with it a board may have begun anew.
    """
    return (frame.seq - before - 1) % 256 if before >= 0 and frame.kind != messages.HELLO else 0


class FrameWriter:
    """Encodes frames with running sequence numbers, modulo 256."""

    def __init__(self, first_seq: int = 0) -> None:
        self._seq = first_seq

    def frame(self, kind: int, tick: int, payload: bytes = b"") -> bytes:
        data = encode(kind, self._seq, tick, payload)
        self._seq = (self._seq + 1) & 255
        return data
