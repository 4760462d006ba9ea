"""CSV: a table a message type, in a folder; and back into a capture.

The integers make the frames again, to the byte. The columns after them, with a unit in brackets,
say the same in units and aren't read.
"""

from __future__ import annotations

import csv
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

from numpy.typing import NDArray

from solenav.capture.file import CaptureWriter
from solenav.errors import SolenavError
from solenav.exporting.columns import FRAME, columns, integers
from solenav.exporting.source import Source, Written
from solenav.link import NAMES, encode

KINDS = {name: kind for kind, name in NAMES.items()}
_AGAIN = "export it again with `solenav export --to csv`"


def write(source: Source, output: Path) -> Written:
    """`POSE.csv`, `SAMPLE.csv`, ... in the folder `output`."""
    files = []
    items = 0
    for kind, rows in source.rows.items():
        path = output / f"{NAMES[kind]}.csv"
        found = columns(rows)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([column.header for column in found])
            writer.writerows(zip(*(_texts(column.values) for column in found), strict=True))
        files.append(path)
        items += len(rows.frames)
    return Written(files, items, [*source.common_losses(), "the truth and the sidecar: copy them"])


def _texts(values: NDArray[Any]) -> list[str]:
    if values.dtype.kind == "f":
        # The shortest text that gives the same number again.
        return [repr(value) for value in values.tolist()]
    return [str(value) for value in values.tolist()]


def read(folder: Path, output: Path) -> int:
    """Make the capture again from a folder of tables; how many frames it has.

    SolenavError names file, line and column of what can't be read.
    """
    paths = sorted(folder.glob("*.csv")) if folder.is_dir() else []
    frames = [frame for path in paths if path.stem in KINDS for frame in _frames(path)]
    if not frames:
        names = ", ".join(f"{name}.csv" for name in ("SAMPLE", "POSE"))
        raise SolenavError(f"{folder} is no folder with {names}, ...", _AGAIN)
    frames.sort(key=lambda frame: frame[0])
    for (order, *_one), (next_order, *_other) in pairwise(frames):
        if order == next_order:
            raise SolenavError(f"{folder}: two frames have the order {order}", _AGAIN)
    with CaptureWriter(output, flush=False) as writer:
        for _order, arrival, data in frames:
            writer.write(arrival, data)
    return len(frames)


def _frames(path: Path) -> list[tuple[int, float, bytes]]:
    """Order, arrival (s) and bytes of each row's frame."""
    kind = KINDS[path.stem]
    wanted = [*FRAME, *(name for name, _code in integers(kind))]
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            header = next(reader, [])
            missing = [name for name in wanted if name not in header]
            if missing:
                raise SolenavError(f"{path} has no column {', '.join(missing)}", _AGAIN)
            at = [header.index(name) for name in wanted]
            return [
                _frame(
                    path,
                    reader.line_num,
                    kind,
                    dict(zip(wanted, (row[i] for i in at), strict=True)),
                )
                if len(row) == len(header)
                else _wrong(path, reader.line_num, f"{len(row)} cells instead of {len(header)}")
                for row in reader
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SolenavError(f"can't read {path}: {error}", _AGAIN) from None


def _frame(path: Path, line: int, kind: int, row: dict[str, str]) -> tuple[int, float, bytes]:
    payload = b""
    name = ""
    try:
        for name, code in integers(kind):
            if code == "*":
                payload += bytes.fromhex(row[name])
            else:
                payload += struct.pack("<" + code, int(row[name]))
        name = "seq, tick, order or arrival_s"
        seq, tick, order = int(row["seq"]), int(row["tick"]), int(row["order"])
        arrival = float(row["arrival_s"])
        if not (0 <= seq <= 255 and 0 <= tick < 2**32 and order >= 0):
            raise ValueError("out of range")
        return order, arrival, encode(kind, seq, tick, payload)
    except (ValueError, struct.error) as error:
        _wrong(path, line, f"{name}: {error}")


def _wrong(path: Path, line: int, what: str) -> NoReturn:
    raise SolenavError(f"{path}, line {line}: {what}", _AGAIN)
