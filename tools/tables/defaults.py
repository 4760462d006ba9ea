"""Write `solenav_core/tables/defaults.py`: the parameters at 200 Hz, or check that it is current.

python tools/tables/defaults.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path

from generated import keep

from solenav import parameters
from solenav_core import params

TARGET = Path(__file__).resolve().parents[2] / "shared/solenav_core/tables/defaults.py"


def render() -> str:
    values = parameters.to_integers(parameters.Settings(), parameters.REFERENCE_RATE_HZ)
    lines = [
        '"""Default parameters at 200 Hz. Written by tools/tables/defaults.py: do not edit."""',
        "",
        "from array import array",
        "",
        "PARAMS = array(",
        '    "i",',
        "    [",
        *[f"        {v},  # {n}" for n, v in zip(params.NAMES, values, strict=True)],
        "    ],",
        ")",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(keep(TARGET, render()))
