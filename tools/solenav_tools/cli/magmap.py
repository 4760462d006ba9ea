"""`solenav magmap`: build and show the magnetic map of a floor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from solenav import magmap as maps
from solenav.datasets import kaist
from solenav.errors import SolenavError
from solenav.magmap.grid import SUFFIX
from solenav_tools.cli import traces
from solenav_tools.cli.output import Json, check_output, progress, say, say_json, warn

app = typer.Typer(help="Magnetic maps of floors.", no_args_is_help=True)
# What a map that comes without its own uncertainty is taken for.
GIVEN_UT = 4.0


@app.command()
def build(
    files: Annotated[list[Path], typer.Argument(help="Survey traces (.txt) or one .mat map.")],
    output: Annotated[Path, typer.Option("-o", "--output", help=f"Map to write ({SUFFIX}).")],
    floor: Annotated[str | None, typer.Option(help="Floor; default: what the traces say.")] = None,
    site: Annotated[str | None, typer.Option(help="Site; default: what the traces say.")] = None,
    spacing: Annotated[float, typer.Option(help="Metres from cell to cell.")] = 0.5,
    reach: Annotated[float, typer.Option(help="Metres from the walks that the map covers.")] = 2.0,
    as_json: Json = False,
) -> None:
    """Krige a map from indoor traces with way points, or take over KAIST's map (.mat)."""
    if not output.name.endswith(SUFFIX):
        raise SolenavError(f"{output} should end in {SUFFIX}", f"name it {output.stem}{SUFFIX}")
    check_output(output, ".npz")
    variograms: list[maps.Variogram] = []
    if len(files) == 1 and files[0].suffix == ".mat":
        made = maps.of_cells(
            kaist.read_field(files[0]),
            site=site or "",
            floor=floor or "",
            deviation=GIVEN_UT,
            made_of=(files[0].name,),
        )
    else:
        surveys, said = [], {"floor": set[str](), "site": set[str]()}
        with progress("surveying", len(files)) as done:
            for k, file in enumerate(files):
                trace = traces.read(file, traces.TraceFormat.indoor, None)
                for key, found in said.items():
                    if key in trace.notes:
                        found.add(str(trace.notes[key]))
                surveys.append(maps.survey(trace))
                done(k + 1)
        if len(said["floor"]) > 1 or len(said["site"]) > 1:
            raise SolenavError("the traces are of several floors", "build a map for each")
        made, variograms = maps.build(
            surveys,
            site=site or "".join(said["site"]),
            floor=floor or "".join(said["floor"]),
            spacing=spacing,
            reach=reach,
        )
    if not made.floor:
        warn("the map says no floor, so no trace of another can be refused: give --floor")
    made.save(output)
    _tell(made, output, as_json)
    if not as_json:
        for one in variograms:
            say(
                f"  variogram {one.component}: sill {one.sill:.1f} µT², range {one.range_m:.1f} m, "
                f"nugget {one.nugget:.1f} µT²"
            )


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help=f"A map ({SUFFIX}).", metavar="MAP")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG of field and uncertainty.")
    ] = None,
    as_json: Json = False,
) -> None:
    """What a map covers, how sure it is, and its picture."""
    made = maps.load(file)
    if output is not None:
        from solenav.magmap import figures

        figures.draw_map(made, check_output(output, ".png"))
    _tell(made, file, as_json)


def _tell(made: maps.MagneticMap, file: Path, as_json: bool) -> None:
    size = np.linalg.norm(made.field, axis=0)
    low, middle, high = (float(v) for v in np.nanpercentile(size, (5, 50, 95)))
    sure = float(np.nanmedian(made.deviation))
    if as_json:
        say_json(
            {
                "map": str(file),
                "site": made.site,
                "floor": made.floor,
                "spacing_m": made.spacing,
                "area_m2": made.area_m2,
                "field_ut": {"p5": low, "median": middle, "p95": high},
                "deviation_ut": sure,
                "made_of": list(made.made_of),
                **made.notes,
            }
        )
        return
    say(
        f"{file}: floor {made.floor or '?'}, {made.area_m2:.0f} m² in cells of {made.spacing:g} m, "
        f"from {len(made.made_of)} files"
    )
    say(f"  field {low:.0f}, {middle:.0f}, {high:.0f} µT (5, 50, 95 %), sure to {sure:.1f} µT")
