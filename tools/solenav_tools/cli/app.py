"""The command line: puts the subcommands together and turns errors into exit codes.

Exit codes: 0 done; 1 the answer is no, or something was lost on the way; 2 the command could
not do its job with what it was given.
"""

from __future__ import annotations

import sys

import typer

from solenav.errors import SolenavError
from solenav_tools.cli import (
    calibrate,
    compare,
    download,
    evaluate,
    import_recording,
    info,
    locate,
    magmap,
    matrix,
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
from solenav_tools.cli.output import fail

app = typer.Typer(
    name="solenav",
    help="Pedestrian inertial navigation from a foot-mounted MPU-9150.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("simulate")(simulate.simulate)
app.command("import")(import_recording.import_recording)
app.command("replay")(replay.replay)
app.command("run-firmware")(run_firmware.run_firmware)
app.command("record")(record.record)
app.command("monitor")(monitor.monitor)
app.command("download")(download.download)
app.command("info")(info.info)
app.command("verify")(verify.verify)
app.command("matrix")(matrix.matrix)
app.command("plot")(plot.plot)
app.command("evaluate")(evaluate.evaluate)
app.command("compare")(compare.compare)
app.command("tune")(tune.tune)
app.add_typer(calibrate.app, name="calibrate")
app.command("pdr")(pdr.pdr)
app.add_typer(magmap.app, name="magmap")
app.command("locate")(locate.locate)


def main() -> None:
    """Entry point of the `solenav` command."""
    try:
        app()
    except SolenavError as error:
        sys.exit(fail(error))
    except BrokenPipeError:
        # The reader of our output went away: nothing more to say to it.
        sys.stderr.close()
        sys.exit(1)
