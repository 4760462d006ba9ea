"""A decoder of our frames that shares nothing with the host's but the schema's tables."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from typing import Any, NamedTuple

from cobs import cobs

from solenav_core import messages

SCHEMA = {kind: (name, fields) for kind, name, _when, fields in messages.MESSAGES}
STANDARD = 0xFFFF


class Message(NamedTuple):
    name: str
    seq: int
    tick: int
    fields: dict[str, Any]


def crc(kind: int, body: bytes) -> int:
    return crc_hqx(body, STANDARD if kind in messages.OPEN else messages.SCHEMA)


def decode(data: bytes) -> list[Message]:
    """Every frame of `data`; AssertionError where anything in it is no whole frame."""
    *frames, rest = data.split(b"\0")
    assert not rest, f"cut off: {rest!r}"
    return [decode_frame(frame) for frame in frames if frame]


def decode_frame(stuffed: bytes) -> Message:
    body = cobs.decode(stuffed)
    kind, seq, tick = struct.unpack_from("<BBI", body)
    assert crc(kind, body[:-2]) == int.from_bytes(body[-2:], "little")
    name, layout = SCHEMA[kind]
    at = 6
    fields: dict[str, Any] = {}
    for field, code, count, _format, _meaning in layout:
        if code == "*":
            fields[field] = body[at:-2]
            at = len(body) - 2
        else:
            values = struct.unpack_from(f"<{count}{code}", body, at)
            fields[field] = values[0] if count == 1 else values
            at += struct.calcsize(f"<{count}{code}")
    assert at == len(body) - 2, f"{name} of {len(body)} bytes"
    return Message(name, seq, tick, fields)


def command(kind: int, seq: int, payload: bytes = b"") -> bytes:
    body = struct.pack("<BBI", kind, seq, 0) + payload
    return cobs.encode(body + struct.pack("<H", crc(kind, body))) + b"\0"
