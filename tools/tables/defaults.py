"""Write `solenav_core/tables/defaults.py`: the parameters at 200 Hz and the limits of each.

Or check that it is current.

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
        '"""Parameters at 200 Hz, and the least and largest that keep the core\'s words in range.',
        "",
        "Written by tools/tables/defaults.py: do not edit.",
        '"""',
        "",
        "from array import array",
        "",
        *table("PARAMS", list(values)),
        *table("LEAST", [parameters.LIMITS[name][0] for name in params.NAMES]),
        *table("LARGEST", [parameters.LIMITS[name][1] for name in params.NAMES]),
    ]
    return "\n".join(lines)


def table(name: str, values: list[int]) -> list[str]:
    rows = [f"        {v},  # {n}" for n, v in zip(params.NAMES, values, strict=True)]
    return [f"{name} = array(", '    "i",', "    [", *rows, "    ],", ")", ""]


if __name__ == "__main__":
    sys.exit(keep(TARGET, render()))
