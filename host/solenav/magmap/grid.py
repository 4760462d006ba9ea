"""A floor's magnetic field on a grid, how sure it is, and the file it is kept in.

The file is NumPy's `.npz`, uncompressed names as here: `header` (JSON text: format, version, site,
floor, unit, spacing, what it was made of), `x` (nx,) and `y` (ny,) in m, ascending and regular,
`field` (3, ny, nx) in µT along x, y and up, `deviation` (3, ny, nx) in µT, standard deviation of
the field there. NaN in all of them: the map says nothing of that place.
"""

from __future__ import annotations

import dataclasses
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solenav.errors import SolenavError, unwritable
from solenav.recording import FloatArray

FORMAT, VERSION = "solenav magnetic map", 1
SUFFIX = ".magmap.npz"
# A compass that a phone calibrated reads so; indoors steel makes it up to a few hundred µT.
STRONGEST_UT = 1000.0


@dataclass(frozen=True)
class MagneticMap:
    """The field of one floor. Arrays as in the file; `made_of` names what it was built from."""

    site: str
    floor: str
    x: FloatArray
    y: FloatArray
    field: FloatArray
    deviation: FloatArray
    made_of: tuple[str, ...] = ()
    notes: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        _check(self)

    @property
    def spacing(self) -> float:
        """Metres from cell to cell."""
        return float(self.x[1] - self.x[0])

    @property
    def covered(self) -> Any:
        """(ny, nx): where the map knows the field."""
        return np.isfinite(self.field[0])

    @property
    def area_m2(self) -> float:
        return float(self.covered.sum() * self.spacing**2)

    def at(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Field (n, 3) and variance (n, 3), µT and µT², of the cells that points (n, 2) lie in.

        NaN where the map knows nothing.
        """
        column = np.rint((points[:, 0] - self.x[0]) / self.spacing).astype(np.intp)
        row = np.rint((points[:, 1] - self.y[0]) / self.spacing).astype(np.intp)
        known = (column >= 0) & (column < len(self.x)) & (row >= 0) & (row < len(self.y))
        cell = np.where(known, row * len(self.x) + column, 0)
        table = self._table
        found = table[cell]
        found[~known] = np.nan
        return found[:, :3], found[:, 3:]

    @property
    def _table(self) -> FloatArray:
        """(ny · nx, 6): field and variance, cell by cell; made once."""
        cache = self.__dict__.get("_cells")
        if cache is None:
            both = np.concatenate([self.field, self.deviation**2])
            cache = np.ascontiguousarray(both.reshape(6, -1).T)
            object.__setattr__(self, "_cells", cache)
        return np.asarray(cache)

    def save(self, path: Path) -> None:
        """Write the file. SolenavError where that fails."""
        header = {
            "format": FORMAT,
            "version": VERSION,
            "site": self.site,
            "floor": self.floor,
            "unit": "uT",
            "spacing_m": self.spacing,
            "made_of": list(self.made_of),
            "notes": self.notes,
        }
        try:
            with path.open("wb") as file:
                np.savez_compressed(
                    file,
                    header=np.array(json.dumps(header, ensure_ascii=False)),
                    x=self.x,
                    y=self.y,
                    field=self.field,
                    deviation=self.deviation,
                )
        except OSError as error:
            raise unwritable(path, error) from None


def load(path: Path) -> MagneticMap:
    """The map in a file. SolenavError where it isn't one, or is broken."""
    if not path.is_file():
        raise SolenavError(f"there is no map {path}", "build one: `solenav magmap build`")
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in ("x", "y", "field", "deviation")}
            header = json.loads(str(content["header"]))
            if not isinstance(header, dict):
                raise ValueError
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError):
        raise _broken(path, "it can't be read") from None
    except Exception as error:  # zlib and the zip reader raise their own on damaged bytes
        raise _broken(path, str(error)) from None
    if header.get("format") != FORMAT or header.get("version") != VERSION:
        raise _broken(path, f"its format is {header.get('format')!r} {header.get('version')!r}")
    notes, made_of = header.get("notes", {}), header.get("made_of", [])
    if not isinstance(notes, dict) or not isinstance(made_of, list):
        raise _broken(path, "its header is damaged")
    if any(array.dtype.kind != "f" for array in arrays.values()):
        raise _broken(path, "an array holds no numbers")
    try:
        return MagneticMap(
            str(header.get("site", "")),
            str(header.get("floor", "")),
            arrays["x"].astype(np.float64),
            arrays["y"].astype(np.float64),
            arrays["field"].astype(np.float64),
            arrays["deviation"].astype(np.float64),
            tuple(map(str, made_of)),
            notes,
        )
    except SolenavError as error:
        raise _broken(path, error.message) from None


def of_cells(
    cells: FloatArray, *, site: str, floor: str, deviation: float, made_of: tuple[str, ...] = ()
) -> MagneticMap:
    """A map from cells (n, 5): x, y in m, field along x, y and up in µT; all equally sure."""
    if cells.ndim != 2 or cells.shape[1] != 5 or len(cells) < 4 or not np.isfinite(cells).all():
        raise SolenavError("these are no cells of a map", "give rows of x, y and three components")
    xs, ys = np.unique(np.round(cells[:, 0], 6)), np.unique(np.round(cells[:, 1], 6))
    spacing = float(min(np.diff(xs).min(initial=np.inf), np.diff(ys).min(initial=np.inf)))
    if not np.isfinite(spacing):
        raise SolenavError("the map is a line, not a floor", "give cells of an area")
    x = xs[0] + spacing * np.arange(round((xs[-1] - xs[0]) / spacing) + 1)
    y = ys[0] + spacing * np.arange(round((ys[-1] - ys[0]) / spacing) + 1)
    grid = np.full((3, len(y), len(x)), np.nan)
    column = np.rint((cells[:, 0] - x[0]) / spacing).astype(np.intp)
    row = np.rint((cells[:, 1] - y[0]) / spacing).astype(np.intp)
    grid[:, row, column] = cells[:, 2:].T
    sure = np.where(np.isfinite(grid), deviation, np.nan)
    return MagneticMap(site, floor, x, y, grid, sure, made_of)


def _broken(path: Path, why: str) -> SolenavError:
    return SolenavError(
        f"{path} is no magnetic map: {why}", "build it again: `solenav magmap build`"
    )


def _check(given: MagneticMap) -> None:
    """Raise SolenavError unless the arrays are a map."""
    remedy = "build it again: `solenav magmap build`"
    for name, axis in (("x", given.x), ("y", given.y)):
        if axis.ndim != 1 or len(axis) < 2 or not np.isfinite(axis).all():
            raise SolenavError(f"{name} is no row of at least two numbers", remedy)
        steps = np.diff(axis)
        if steps[0] <= 0 or not np.allclose(steps, steps[0], rtol=1e-6, atol=1e-9):
            raise SolenavError(f"{name} doesn't ascend in equal steps", remedy)
    if not np.isclose(given.x[1] - given.x[0], given.y[1] - given.y[0]):
        raise SolenavError("x and y have different spacings", remedy)
    shape = (3, len(given.y), len(given.x))
    if given.field.shape != shape or given.deviation.shape != shape:
        raise SolenavError(f"field or deviation is not {shape}", remedy)
    known = np.isfinite(given.field)
    if (
        not known.any()
        or (known != known[0]).any()
        or (np.isfinite(given.deviation) != known).any()
    ):
        raise SolenavError("field and deviation are not known in the same places", remedy)
    if np.abs(given.field[known]).max() > STRONGEST_UT or given.deviation[known].min() < 0:
        raise SolenavError("the field is no field in µT", remedy)
