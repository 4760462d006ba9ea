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
# Garbage without a delimiter must not grow without end; no frame is longer than this.
_LONGEST = 4 * framing.PAYLOAD_MAX


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


class FrameReader:
    """Splits a byte stream into frames. One damaged byte costs at most the frame that it hit."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[Frame | Damage]:
        """The frames and damages that end within `data`, in order."""
        *whole, self._rest = (self._rest + data).split(b"\0")
        for stuffed in whole:
            # Two delimiters in a row are what a sender uses to say "from here".
            if stuffed:
                yield decode(stuffed)
        if len(self._rest) > _LONGEST:
            lost, self._rest = self._rest, b""
            yield Damage(lost, "no delimiter")

    def close(self) -> Iterator[Damage]:
        """What is left of a frame that never ended."""
        if self._rest:
            lost, self._rest = self._rest, b""
            yield Damage(lost, "cut off")


class FrameWriter:
    """Encodes frames with running sequence numbers, modulo 256."""

    def __init__(self, first_seq: int = 0) -> None:
        self._seq = first_seq

    def frame(self, kind: int, tick: int, payload: bytes = b"") -> bytes:
        data = encode(kind, self._seq, tick, payload)
        self._seq = (self._seq + 1) & 255
        return data
