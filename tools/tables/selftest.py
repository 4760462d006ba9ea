"""Write `solenav_core/tables/selftest.py`: the CRCs of the power-up self-test, from plain CPython.

python tools/tables/selftest.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path

from generated import keep

from solenav_core import selftest

TARGET = Path(__file__).resolve().parents[2] / "shared/solenav_core/tables/selftest.py"


def render() -> str:
    names = [name for name, _test in selftest.TESTS]
    crcs = selftest.measure()
    lines = [
        '"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""',
        "",
        "EXPECTED = (",
        *[f"    {crc},  # {name}" for name, crc in zip(names, crcs, strict=True)],
        ")",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(keep(TARGET, render()))
