"""A message type as columns: its integers as they are, and beside them in their units."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solenav.exporting.source import Rows
from solenav.link import FIELDS
from solenav.link.units import UNITS, readable
from solenav_core import messages


class Column(NamedTuple):
    """`values` (n,): integers of the wire where `unit` is None, else values in that unit."""

    name: str
    values: NDArray[Any]
    unit: str | None = None

    @property
    def header(self) -> str:
        """The name, with the unit of what is measured in brackets."""
        return self.name if self.unit is None else f"{self.name} [{self.unit}]"


FRAME = ("arrival_s", "order", "seq", "tick")
"""Columns that every frame has: when it came, its place in the stream, its header."""


def columns(rows: Rows) -> list[Column]:
    """All columns of a message type. A field of several numbers has a column each, from _0 on."""
    out = [
        Column("arrival_s", np.array(rows.arrival)),
        Column("order", np.array(rows.order, np.int64)),
        Column("seq", np.array([frame.seq for frame in rows.frames], np.int64)),
        Column("tick", np.array([frame.tick for frame in rows.frames], np.int64)),
    ]
    measured = []
    for name, code, count, _form, _meaning in FIELDS[rows.kind]:
        if code == "*":
            ends = [frame.payload[messages.SIZES[rows.kind] :] for frame in rows.frames]
            out.append(Column(f"{name}_hex", np.array([end.hex() for end in ends], object)))
            texts = np.array([readable(rows.kind, name, end) for end in ends], object)
            if (texts != out[-1].values).any():
                measured.append(Column(name, texts, "UTF-8"))
            continue
        unit = UNITS[rows.kind][name]
        for i in range(count):
            column = f"{name}_{i}" if count > 1 else name
            values = rows.table[name][:, i] if count > 1 else rows.table[name]
            out.append(Column(column, values))
            if unit.name:
                measured.append(Column(column, unit.scale * values + unit.offset, unit.name))
    return out + measured


def integers(kind: int) -> list[tuple[str, str]]:
    """The columns from which a frame of this type can be made again, with their struct codes."""
    out = []
    for name, code, count, _form, _meaning in FIELDS[kind]:
        if code == "*":
            out.append((f"{name}_hex", code))
        else:
            out += [(f"{name}_{i}" if count > 1 else name, code) for i in range(count)]
    return out
