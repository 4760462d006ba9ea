"""The command line: puts the subcommands together and turns errors into exit codes.

Exit codes: 0 done; 1 the answer is no, or something was lost on the way; 2 the command could
not do its job with what it was given.
"""

from __future__ import annotations

import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from solenav import engines
from solenav.errors import SolenavError
from solenav_core import messages
from solenav_tools import settings
from solenav_tools.cli import (
    batch,
    bench,
    calibrate,
    cat,
    compare,
    doctor,
    download,
    emulate,
    evaluate,
    export,
    flash,
    import_recording,
    info,
    locate,
    magmap,
    matrix,
    modes,
    monitor,
    pdr,
    plot,
    record,
    replay,
    run_firmware,
    simulate,
    tune,
    verify,
)
from solenav_tools.cli.output import be_quiet, fail, say

app = typer.Typer(
    name="solenav",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _version(asked: bool) -> None:
    if not asked:
        return
    say(f"solenav {metadata.version('solenav')}, wire schema {messages.SCHEMA:04x}")
    say(f"Python {platform.python_version()}, engine {engines.default_name()}")
    say(f"settings: {settings.load().path or f'none, looked for in {settings.user_path()}'}")
    raise typer.Exit


def _settings(chosen: Path | None) -> None:
    if chosen is not None:
        # Read where it is used; a process that a command starts should see it as well.
        os.environ[settings.VARIABLE] = str(chosen)


@app.callback()
def solenav(
    version: Annotated[
        bool,
        typer.Option("--version", help="Versions, and where the settings are.", callback=_version),
    ] = False,
    chosen: Annotated[
        Path | None,
        typer.Option(
            "--settings",
            help=f"Your {settings.NAME}: ports, parameters.",
            callback=_settings,
            is_eager=True,
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Only errors, warnings and --json.")
    ] = False,
) -> None:
    """Pedestrian inertial navigation from a foot-mounted MPU-9150."""
    if quiet:
        be_quiet()


app.command("simulate")(simulate.simulate)
app.command("import")(import_recording.import_recording)
app.command("replay")(replay.replay)
app.command("run-firmware")(run_firmware.run_firmware)
app.command("flash")(flash.flash)
app.command("emulate")(emulate.emulate)
app.command("bench")(bench.bench)
app.command("record")(record.record)
app.command("monitor")(monitor.monitor)
app.command("doctor")(doctor.doctor)
app.command("download")(download.download)
app.command("batch")(batch.batch)
app.command("cat")(cat.cat)
app.command("export")(export.export)
app.command("info")(info.info)
app.command("verify")(verify.verify)
app.command("matrix")(matrix.matrix)
app.command("plot")(plot.plot)
app.command("evaluate")(evaluate.evaluate)
app.command("compare")(compare.compare)
app.command("tune")(tune.tune)
app.add_typer(modes.app, name="modes")
app.add_typer(calibrate.app, name="calibrate")
app.command("pdr")(pdr.pdr)
app.add_typer(magmap.app, name="magmap")
app.command("locate")(locate.locate)


def _quiet_first(arguments: list[str]) -> list[str]:
    """`--quiet` counts wherever it stands: people add it at the end."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    kept = [a for a in arguments[:end] if a not in ("-q", "--quiet")]
    return ["--quiet"] * (len(kept) < end) + kept + arguments[end:]


def main() -> None:
    """Entry point of the `solenav` command."""
    try:
        app(_quiet_first(sys.argv[1:]))
    except SolenavError as error:
        sys.exit(fail(error))
    except BrokenPipeError:
        # The reader of our output went away: nothing more to say to it.
        sys.stderr.close()
        sys.exit(1)
