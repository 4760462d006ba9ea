"""OpenShoe: MicroStrain 3DM-GX2 in the sole of a shoe, 250 Hz, closed figures of eight.

`Measurement_*_data_inert.txt`, g, rad/s and gauss. Source: KTH's OpenShoe project, ISC licence.

The magnetometer's axes are the accelerometer's: of the 48 ways to name three axes the field fits
the gyro's turns best as it is, on all four walks (docs/heading.md). Some 3 % of its rows are NaN.
"""

from __future__ import annotations

from pathlib import Path

from solenav.datasets import checks
from solenav.errors import SolenavError
from solenav.mpu9150 import STANDARD_GRAVITY, UT_PER_GAUSS
from solenav.recording import Recording

# The host's stamps jitter by milliseconds; this is the slope of a line through them.
PERIOD_S = 4.004e-3

NUMBER_COLUMN = "Nr"
COLUMNS = [f"a_{axis} [g]" for axis in "xyz"] + [f"ar_{axis} [rad/s]" for axis in "xyz"]
MAG_COLUMNS = [f"m_{axis} [G]" for axis in "xyz"]


def read(path: Path, *, foot: str = "right") -> Recording:
    """Recording of one text file; all that is known of the walk is that it closes.

    `foot` has no use here: there is one sensor. Raises SolenavError for a faulty file.
    """
    lines = checks.read_lines(path, ".txt")
    header = next((i for i, line in enumerate(lines) if line.startswith("Header:")), None)
    if header is None:
        raise SolenavError(f"{path} has no line 'Header:'", checks.CHOOSE_FORMAT)
    names = [name.strip() for name in lines[header].rstrip().removesuffix(":").split(":")]
    optional = checks.present(names, MAG_COLUMNS)
    wanted = checks.find_columns(path, names, [NUMBER_COLUMN, *COLUMNS, *optional])

    rows = [line.split() for line in lines[header + 1 :]]
    # The logger was stopped in the middle of a line.
    cut = bool(rows) and len(rows[-1]) < len(names)
    if cut:
        rows.pop()
    place = checks.line_place(path, header + 1)
    table = checks.to_numbers(rows, len(names), wanted, place)
    return checks.make_recording(
        path,
        "openshoe",
        table[:, 0] * PERIOD_S,
        table[:, 1:4] * STANDARD_GRAVITY,
        table[:, 4:7],
        place,
        checks.closed_loop(),
        table[:, 7:] * UT_PER_GAUSS,
        last_line_dropped=cut,
    )
