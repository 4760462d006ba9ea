"""Frames on the wire: COBS between zero bytes, CRC-16 inside.

A frame is ``type u8, seq u8, tick u32, payload, crc16`` (little-endian), stuffed by COBS
(Cheshire and Baker 1999) so that 0x00 only ever ends a frame. The CRC is CRC-16/CCITT-FALSE,
seeded with the hash of the message schema; HELLO and ACK use the standard seed, so that hosts
and boards of different schemas can still say who they are.
"""

from solenav_core.compat import micropython, ptr8

HEADER = 6  # bytes before the payload
CRC = 2
STANDARD_SEED = 0xFFFF
PAYLOAD_MAX = 240  # with header and CRC one COBS block: encoding needs no second pass


@micropython.viper
def crc16(data: ptr8, start: int, stop: int, crc: int) -> int:
    """CRC-16/CCITT-FALSE of data[start:stop], going on from `crc`, bytewise without a table."""
    i = start
    while i < stop:
        x = ((crc >> 8) ^ data[i]) & 255
        x = x ^ (x >> 4)
        crc = ((crc << 8) ^ (x << 12) ^ (x << 5) ^ x) & 65535
        i = i + 1
    return crc


@micropython.viper
def stuff(frame: ptr8, length: int, out: ptr8, at: int) -> int:
    """COBS of frame[:length] (at most 254 bytes) and a closing 0x00 into out[at:]; the end."""
    code_at = at
    at = at + 1
    i = 0
    while i < length:
        byte = frame[i]
        if byte == 0:
            out[code_at] = (at - code_at) & 255
            code_at = at
        else:
            out[at] = byte
        at = at + 1
        i = i + 1
    out[code_at] = (at - code_at) & 255
    out[at] = 0
    return at + 1


@micropython.viper
def seal(frame: ptr8, kind: int, seq: int, tick: int, end: int, seed: int) -> int:
    """The header before the payload in frame[HEADER:end], the CRC after it; the frame's length."""
    frame[0] = kind & 255
    frame[1] = seq & 255
    i = 2
    while i < 6:
        frame[i] = tick & 255
        tick = tick >> 8
        i = i + 1
    crc = int(crc16(frame, 0, end, seed))
    frame[end] = crc & 255
    frame[end + 1] = (crc >> 8) & 255
    return end + 2


@micropython.viper
def unstuff(data: ptr8, length: int, out: ptr8) -> int:
    """Undo COBS of data[:length] (without the 0x00) into out; its length, or -1 if malformed."""
    i = 0
    n = 0
    while i < length:
        code = data[i]
        if code == 0 or i + code > length:
            return -1
        if i > 0:
            out[n] = 0
            n = n + 1
        j = 1
        while j < code:
            byte = data[i + j]
            if byte == 0:
                return -1
            out[n] = byte
            n = n + 1
            j = j + 1
        i = i + code
    return n
