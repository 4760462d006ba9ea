"""A capture in the formats of others: `export(path, format, output)`.

Each format is a module with `SUFFIX` and `write(source, output) -> Written`. What a format can't
hold is said in `Written.losses`, never left out in silence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from solenav.errors import SolenavError
from solenav.exporting import csv_tables, mcap_file, parquet, tum
from solenav.exporting.source import Source, Written, open_capture

__all__ = ["FORMATS", "Format", "Source", "Written", "export", "open_capture"]


@dataclass(frozen=True)
class Format:
    """`suffix` of the file; "" where it takes a folder."""

    about: str
    suffix: str
    write: Callable[[Source, Path], Written]


FORMATS = {
    "csv": Format(
        "a table a message type, integers and units; can be read back", "", csv_tables.write
    ),
    "tum": Format("poses for evo: t x y z qx qy qz qw", ".tum", tum.write),
    "mcap": Format("for Foxglove: pose, path, transforms, scalars", ".mcap", mcap_file.write),
    "parquet": Format("a table a message type, for pandas, DuckDB, Spark", "", parquet.write),
}


def export(capture: Path | str, format: str, output: Path | str) -> Written:
    """Write the capture at a path in a format: a file, or a folder of tables.

    SolenavError for an unknown format, a capture that can't be read, one without what the format
    is about, and where `output` can't be written.
    """
    if format not in FORMATS:
        raise SolenavError(f"unknown format {format!r}", f"choose one of {', '.join(FORMATS)}")
    chosen, output = FORMATS[format], Path(output)
    if chosen.suffix and output.suffix != chosen.suffix:
        raise SolenavError(
            f"{output} should end in {chosen.suffix}",
            f"name it {output.with_suffix(chosen.suffix)}",
        )
    source = open_capture(Path(capture))
    try:
        if not chosen.suffix:
            output.mkdir(parents=True, exist_ok=True)
        return chosen.write(source, output)
    except OSError as error:
        raise SolenavError(
            f"can't write {error.filename or output}: {error.strerror}", "choose another place", 1
        ) from None
