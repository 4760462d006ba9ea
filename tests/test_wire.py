"""Frames and messages: what is sent is what is read, and damage never looks like data."""

from __future__ import annotations

from array import array

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from solenav import link, parameters
from solenav_core import framing, layout, messages, navigator

_STATE_BYTES = 4 * layout.size(layout.STATE_FIELDS)

payloads = st.binary(max_size=framing.PAYLOAD_MAX)


def core_frame(data: bytes) -> bytes:
    out = bytearray(len(data) + 2)
    end = framing.stuff(data, len(data), out, 0)
    return bytes(out[:end])


@given(st.binary(max_size=254))
def test_the_boards_cobs_is_everybodys_cobs(data: bytes) -> None:
    assert core_frame(data) == cobs.encode(data) + b"\0"


@given(st.binary(max_size=254))
def test_unstuff_undoes_stuff(data: bytes) -> None:
    stuffed = cobs.encode(data)
    out = bytearray(len(stuffed))
    n = framing.unstuff(stuffed, len(stuffed), out)
    assert bytes(out[:n]) == data


@given(st.binary(max_size=60))
def test_unstuff_never_reads_past_the_end(data: bytes) -> None:
    out = bytearray(len(data) + 1)
    n = framing.unstuff(data, len(data), out)
    try:
        expected = cobs.decode(data)
    except cobs.DecodeError:
        assert n == -1
    else:
        assert bytes(out[:n]) == expected


def test_crc_is_ccitt_false() -> None:
    assert framing.crc16(b"123456789", 0, 9, 0xFFFF) == 0x29B1


@given(st.sampled_from(sorted(link.NAMES)), st.integers(0, 255), st.integers(0, 2**32 - 1))
def test_a_frame_comes_back(kind: int, seq: int, tick: int) -> None:
    payload = bytes(range(1, messages.SIZES[kind] + 1))
    reader = link.FrameReader()
    assert list(reader.feed(link.encode(kind, seq, tick, payload))) == [
        link.Frame(kind, seq, tick, payload)
    ]


@given(st.lists(st.integers(0, 500), min_size=1, max_size=6), st.data())
def test_one_damaged_byte_costs_one_frame(ticks: list[int], data: st.DataObject) -> None:
    size = messages.SIZES[messages.STATUS]
    frames = [link.encode(messages.STATUS, i, t, bytes(size)) for i, t in enumerate(ticks)]
    stream = bytearray(b"".join(frames))
    at = data.draw(st.integers(0, len(stream) - 1))
    stream[at] ^= data.draw(st.integers(1, 255))
    items = list(link.FrameReader().feed(bytes(stream)))
    good = [item for item in items if isinstance(item, link.Frame)]
    # A hit delimiter joins two frames; either way every frame that comes is one that was sent.
    assert len(good) >= len(frames) - 2
    assert {f.tick for f in good} <= set(ticks)
    assert all(f.payload == bytes(size) for f in good)


@given(st.binary(max_size=400), st.lists(st.integers(1, 50), max_size=10))
def test_garbage_is_damage_however_it_is_cut(data: bytes, cuts: list[int]) -> None:
    reader = link.FrameReader()
    items: list[object] = []
    for cut in cuts:
        items += reader.feed(data[:cut])
        data = data[cut:]
    items += reader.feed(data)
    items += reader.close()
    for item in items:
        assert isinstance(item, link.Damage | link.Frame)


def test_another_schema_is_damage_but_its_hello_is_read() -> None:
    """HELLO keeps the standard seed, so a host can say that firmware and host differ."""
    body = bytes([messages.STATUS, 0, 0, 0, 0, 0]) + bytes(messages.SIZES[messages.STATUS])
    foreign = framing.crc16(body, 0, len(body), messages.SCHEMA ^ 1)
    stuffed = cobs.encode(body + foreign.to_bytes(2, "little"))
    assert isinstance(link.decode(stuffed), link.Damage)
    hello = link.encode(messages.HELLO, 0, 0, bytes(messages.SIZES[messages.HELLO]))
    assert isinstance(link.decode(hello[:-1]), link.Frame)


def test_the_schema_hash_changes_with_any_field(monkeypatch: pytest.MonkeyPatch) -> None:
    kind, name, when, fields = messages.MESSAGES[4]
    renamed = ((fields[0][0] + "x", *fields[0][1:]), *fields[1:])
    changed = (*messages.MESSAGES[:4], (kind, name, when, renamed), *messages.MESSAGES[5:])
    monkeypatch.setattr(messages, "MESSAGES", changed)
    assert messages.schema_hash() != messages.SCHEMA


@given(st.binary(min_size=_STATE_BYTES, max_size=_STATE_BYTES))
def test_a_pose_of_any_state_packs(data: bytes) -> None:
    """Ranges that the core keeps are respected; the rest of the words may be anything."""
    params = parameters.to_integers(parameters.Settings(), 200.0)
    state = navigator.new_state()
    at = messages._AT
    state[:] = array("i", data)
    for name, top in (
        ("STANCE", 1),
        ("MODE", 1),
        ("MOTION", 5),
        ("THRESHOLD", 16384),
        ("N_EFF", 25600),
    ):
        state[at[name]] = abs(state[at[name]]) % (top + 1)
    for name in ("M2", "RESAMPLED", "DISTANCE"):
        state[at[name]] = abs(state[at[name]] // 2)
    state[at["ACC_NORM"]] = abs(state[at["ACC_NORM"]]) % 34800
    buffer = bytearray(256)
    end = messages.pack_pose(buffer, 0, state, params)
    frame = link.Frame(messages.POSE, 0, 1, bytes(buffer[:end]))
    fields = link.unpack(frame)
    assert fields["velocity"] == tuple(state[at["VEL"] : at["VEL"] + 3])
    assert fields["digest"] == navigator.digest(state)
