"""Parquet: a table a message type, in a folder, for pandas, DuckDB and Spark."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from solenav.errors import SolenavError
from solenav.exporting.columns import Column, columns
from solenav.exporting.source import Source, Written
from solenav.link import NAMES
from solenav_core import messages


def write(source: Source, output: Path) -> Written:
    """`POSE.parquet`, `SAMPLE.parquet`, ...; the columns of the CSV, units as field metadata.

    SolenavError without pyarrow.
    """
    try:
        arrow: Any = import_module("pyarrow")
        tables: Any = import_module("pyarrow.parquet")
    except ImportError:
        raise SolenavError(
            "writing Parquet needs pyarrow", "pip install 'solenav[export]'"
        ) from None
    about = {
        "capture": source.path.name,
        "schema": f"{messages.SCHEMA:04x}",
        "rate_hz": repr(source.capture.rate_hz()),
    }
    files = []
    items = 0
    for kind, rows in source.rows.items():
        found = columns(rows)
        fields = [
            arrow.field(column.header, _type(arrow, column), metadata={"unit": column.unit or ""})
            for column in found
        ]
        table = arrow.table(
            [arrow.array(column.values) for column in found],
            schema=arrow.schema(fields, metadata=about),
        )
        path = output / f"{NAMES[kind]}.parquet"
        tables.write_table(table, path)
        files.append(path)
        items += len(rows.frames)
    return Written(files, items, [*source.common_losses(), "the truth and the sidecar"])


def _type(arrow: Any, column: Column) -> Any:
    values = column.values
    return arrow.string() if values.dtype.hasobject else arrow.from_numpy_dtype(values.dtype)
