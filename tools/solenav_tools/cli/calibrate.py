"""`solenav calibrate`: what undoes a board's errors, from recordings or from the board itself."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from solenav import calibration as calibrations
from solenav import capture
from solenav.calibration import Calibration, accelerometer, finding, guide, gyro, magnetometer
from solenav.calibration.still import EDGES, FACES, from_capture
from solenav.capture.sidecar import sidecar_path
from solenav.errors import SolenavError, unreadable
from solenav.recording import Recording
from solenav_tools.calibration_run import guided
from solenav_tools.cli.arguments import Baud
from solenav_tools.cli.calibrate_allan import calibrate_allan
from solenav_tools.cli.output import Json, check_output, say, say_json, tell, warn, write_text
from solenav_tools.flash.boards import parse_config

app = typer.Typer(
    help="Find a board's calibration, and put it into the firmware's config.json.",
    no_args_is_help=True,
)

Input = Annotated[
    str, typer.Argument(help="A capture (.solcap), or a board's serial port.", metavar="INPUT")
]
Output = Annotated[
    Path, typer.Option("-o", "--output", help="Calibration to write; one that is there is kept.")
]
Record = Annotated[
    Path | None, typer.Option("--record", help="Keep what the board sent as a capture.")
]
CalibrationFile = Annotated[
    Path | None, typer.Option("--calibration", help="A file of `solenav calibrate`.")
]
_DEFAULT = Path("calibration.json")


@app.command("accelerometer")
def calibrate_accelerometer(
    source: Input,
    output: Output = _DEFAULT,
    edges: Annotated[
        bool, typer.Option("--edges", help="Guide through six positions on edge as well.")
    ] = False,
    record: Record = None,
    baud: Baud = None,
    as_json: Json = False,
) -> None:
    """From rests with each of the six faces up: scale, bias, and angles of the axes."""
    before = _prepared(source, output)
    if _is_port(source):
        leader = guide.Poses(FACES + EDGES if edges else FACES)
        _followed(source, baud, leader, record)
        found = accelerometer.fit(list(leader.taken.values()), [])
    else:
        found = accelerometer.calibrate(_loaded(source))
    for pose in found.refused:
        warn(f"refused: {pose}")
    if not found.skew:
        tell("the rests don't tell the axes' angles: taken as right (more attitudes would)")
    _finish("accelerometer", found, before, output, source, as_json)


@app.command("gyro")
def calibrate_gyro(
    source: Input,
    output: Output = _DEFAULT,
    record: Record = None,
    baud: Baud = None,
    as_json: Json = False,
) -> None:
    """From rest: bias and noise. From turns between rests, in a capture: scale and axes too."""
    before = _prepared(source, output)
    recording = _guided_or_loaded(source, baud, guide.Rest(), record)
    found = gyro.calibrate(recording, before)
    if found.why:
        tell(f"scale and axes stay as they are: {found.why}")
    _finish("gyro", found, before, output, source, as_json)


@app.command("magnetometer")
def calibrate_magnetometer(
    source: Input,
    output: Output = _DEFAULT,
    record: Record = None,
    baud: Baud = None,
    as_json: Json = False,
) -> None:
    """From a tumble through all attitudes: hard and soft iron, axes turned to gravity's."""
    before = _prepared(source, output)
    recording = _guided_or_loaded(source, baud, guide.Tumble(), record)
    found = magnetometer.calibrate(recording, before)
    _finish("magnetometer", found, before, output, source, as_json)


app.command("allan")(calibrate_allan)


@app.command("show")
def show(
    file: Annotated[Path, typer.Argument(help="A calibration.", metavar="FILE")],
    as_json: Json = False,
) -> None:
    """Print a calibration, what it was made from, and its integers."""
    found = calibrations.load(file)
    if as_json:
        say_json({**found.as_dict(), "params": found.words()})
        return
    content = found.as_dict()
    for sensor in ("accelerometer", "gyro", "magnetometer"):
        part = content[sensor]
        bias = next(name for name in part if name.startswith("bias_"))
        say(f"{sensor:15}{'matrix':^30}  {bias}")
        for row, value in zip(part["matrix"], part[bias], strict=True):
            say(" " * 15 + "".join(f"{v:10.5f}" for v in row) + f"  {value:10.5f}")
        made = part.get("made_from")
        say("  from " + _line(made) if made else "  not calibrated")
    say(f"mounting: {found.mount}")


@app.command("apply")
def apply(
    file: Annotated[Path, typer.Argument(help="A calibration.", metavar="FILE")],
    config: Annotated[Path, typer.Argument(help="The firmware's config.json.", metavar="CONFIG")],
    as_json: Json = False,
) -> None:
    """Write a calibration's integers under "params" of the firmware's config.json.

    Every other key stays. A mounting in the file stays where the calibration's is "auto".
    """
    found = calibrations.load(file)
    check_output(config, ".json")
    if config.resolve() == file.resolve():
        raise SolenavError(f"{config} is the calibration itself", "name the firmware's config.json")
    content = _config(config)
    words = found.words()
    kept = dict(content.get("params", {}))
    for name, value in calibrations.IDENTITY.words().items():
        if name.startswith("MOUNT_") and found.mount == "auto":
            continue
        kept.pop(name, None)
        if words[name] != value:
            kept[name] = words[name]
    write_text(config, json.dumps({**content, "params": kept}, indent=2) + "\n")
    changed = {name: value for name, value in kept.items() if name in words}
    if as_json:
        say_json({"config": str(config), "params": changed})
    else:
        say(f"{config}: {len(changed)} parameters of the calibration; copy it beside main.py")


def calibration_from(file: Path | None) -> Calibration:
    """The calibration of an option `--calibration`; none without."""
    return calibrations.IDENTITY if file is None else calibrations.load(file)


def _prepared(source: str, output: Path) -> Calibration:
    """The calibration that is in `output` already. SolenavError before any long work."""
    if not find_spec("scipy"):
        raise SolenavError("calibrating needs scipy", "pip install 'solenav[calibrate]'")
    check_output(output, ".json")
    if not _is_port(source) and output.resolve() == sidecar_path(Path(source)).resolve():
        raise SolenavError(
            f"{output} is what stands beside the capture", "choose another file for -o"
        )
    return calibrations.load(output) if output.exists() else calibrations.IDENTITY


def _is_port(source: str) -> bool:
    path = Path(source)
    return path.suffix != ".solcap" and not path.is_file()


def _followed(source: str, baud: int | None, leader: guide.Guide, record: Path | None) -> Recording:
    """What a board measures while the person does as the guide says."""
    recording_to = None if record is None else check_output(record, ".solcap")
    return guided(source, baud, leader, tell, recording_to)


def _guided_or_loaded(
    source: str, baud: int | None, leader: guide.Guide, record: Path | None
) -> Recording:
    """From a port with a guide, or a capture made before."""
    return _followed(source, baud, leader, record) if _is_port(source) else _loaded(source)


def _loaded(source: str) -> Recording:
    return from_capture(capture.load(Path(source)))


def _finish(
    sensor: str,
    found: finding.Found,
    before: Calibration,
    output: Path,
    source: str,
    as_json: bool,
) -> None:
    """Merge what was found into the file, and say what it is."""
    name = source if _is_port(source) else Path(source).name
    merged = finding.kept(sensor, found, before, name)
    calibrations.save(output, merged)
    if as_json:
        say_json({"calibration": str(output), "sensor": sensor, **merged.as_dict()[sensor]})
        return
    say(f"{output}: {sensor} calibrated from {name}")
    for key, value in found.report().items():
        say(f"  {key}: {value}")


def _line(made: dict[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in made.items() if value not in ([], None))


def _config(path: Path) -> dict[str, Any]:
    """The object in a config.json; an empty one where there is no file."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise unreadable(path, error) from None
    return parse_config(text, str(path))
