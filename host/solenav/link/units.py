"""What the schema's numbers mean: the factor, offset and unit behind each field's format."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from solenav import mpu9150
from solenav.link import FIELDS, Frame, unpack
from solenav_core import messages


class Unit(NamedTuple):
    """value = scale * integer + offset, in `name`; "" where it is a count or a set of flags."""

    scale: float = 1.0
    offset: float = 0.0
    name: str = ""


_Q = re.compile(r"Q(\d+)(?: (.+))?")
_FIXED = {
    "mHz": Unit(1e-3, 0.0, "Hz"),
    "kHz": Unit(1e3, 0.0, "Hz"),
    "µs": Unit(1e-6, 0.0, "s"),
    "0.3 µT": Unit(mpu9150.MAG_UT_PER_LSB, 0.0, "µT"),
    "1/340 °C": Unit(1 / 340, 35.0, "°C"),
    "2**16 a turn": Unit(360 / 2**16, 0.0, "°"),
    "4096 m": Unit(4096.0, 0.0, "m"),
}
# What a count is worth depends on whose it is.
_COUNTS = {
    "acc": Unit(mpu9150.ACCEL_MPS2_PER_LSB, 0.0, "m/s²"),
    "gyro": Unit(1 / mpu9150.GYRO_LSB_PER_DPS, 0.0, "°/s"),
    "bias": Unit(1 / mpu9150.GYRO_LSB_PER_DPS, 0.0, "°/s"),
    "peak_acc": Unit(mpu9150.ACCEL_MPS2_PER_LSB, 0.0, "m/s²"),
    "peak_rate": Unit(1 / mpu9150.GYRO_LSB_PER_DPS, 0.0, "°/s"),
}


def unit_of(name: str, form: str) -> Unit:
    """The unit of a field by its name and its format in the schema."""
    scale, q = 1.0, _Q.fullmatch(form)
    if q:
        scale, form = 2.0 ** -int(q[1]), q[2] or "1"
    if form == "counts":
        return _scaled(scale, _COUNTS[name])
    if form in _FIXED:
        return _scaled(scale, _FIXED[form])
    # What is neither scaled nor of a unit is a count, flags, or bytes.
    return Unit(scale, 0.0, form) if q else Unit()


def _scaled(scale: float, unit: Unit) -> Unit:
    return Unit(scale * unit.scale, unit.offset, unit.name)


UNITS = {
    kind: {name: unit_of(name, form) for name, _code, _count, form, _meaning in fields}
    for kind, fields in FIELDS.items()
}
"""Of each field of each message type."""


def in_units(frame: Frame) -> dict[str, Any]:
    """The message's fields by name, in the units of `UNITS`; text as text, other bytes as hex."""
    out: dict[str, Any] = {}
    for name, value in unpack(frame).items():
        unit = UNITS[frame.kind][name]
        if isinstance(value, bytes):
            out[name] = readable(frame.kind, name, value)
        elif not unit.name:
            out[name] = list(value) if isinstance(value, tuple) else value
        elif isinstance(value, tuple):
            out[name] = [unit.scale * part + unit.offset for part in value]
        else:
            out[name] = unit.scale * value + unit.offset
    return out


def readable(kind: int, name: str, value: bytes) -> str:
    """The bytes at a message's open end: text, or hexadecimal digits."""
    form = next(form for field, _code, _count, form, _meaning in FIELDS[kind] if field == name)
    return value.decode("utf-8", "replace") if form == "UTF-8" else value.hex()


POSE_FLAGS = {
    messages.IN_STANCE: "stance",
    messages.NAVIGATING: "navigating",
    messages.FROZEN: "frozen",
    messages.SATURATED: "saturated",
    messages.GAP: "gap",
    messages.RESUMED: "resumed",
}
"""POSE's flags in words; the first two are no complaints."""

_MODES = ("idle", "aligning", "navigating", "sensor fault", "resuming")
_COMPLAINTS = {
    messages.FROZEN: "no stance for long: drifting",
    messages.SATURATED: "velocity has been at its limit: do not trust",
    messages.GAP: "samples were lost: may be off by metres",
    messages.RESUMED: "gone on after a hole: what was walked meanwhile is missing",
}


def mode_text(mode: int) -> str:
    """STATUS' mode in words."""
    return _MODES[mode] if mode < len(_MODES) else f"mode {mode}"


def complaints(flags: int) -> list[str]:
    """Why a POSE with these flags can't be trusted, in words."""
    return [text for flag, text in _COMPLAINTS.items() if flags & flag]
