"""Write the core's offsets into its kernel modules, or check that they are there.

Viper kernels can only use constants of their own module, so each module repeats the offsets
that it uses: ``_S_`` state, ``_P_`` parameters, ``_W_`` work area, ``_I_`` sample, ``_T_``
tables. This script fills in the numbers from `solenav_core.layout` and `solenav_core.params`.

    python tools/tables/constants.py           rewrites the modules
    python tools/tables/constants.py --check   exits 1 and names what is stale
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

CORE = Path(__file__).resolve().parents[2] / "shared" / "solenav_core"
sys.path.insert(0, str(CORE.parent))

from generated import keep  # noqa: E402

from solenav_core import layout, params  # noqa: E402

OFFSETS = {
    "S": layout.offsets(layout.STATE_FIELDS),
    "P": {name: i for i, name in enumerate(params.NAMES)},
    "W": layout.offsets(layout.WORK_FIELDS),
    "I": layout.offsets(layout.SAMPLE_FIELDS),
    "T": layout.offsets(layout.TABLE_FIELDS),
}
LINE = re.compile(r"^_([SPWIT])_(\w+) = const\(-?\d+\)$", re.MULTILINE)


def current(source: str) -> str:
    """The module's source with every offset as the layout has it. KeyError: no such field."""
    return LINE.sub(lambda m: f"_{m[1]}_{m[2]} = const({OFFSETS[m[1]][m[2]]})", source)


def main() -> int:
    stale = 0
    for path in sorted(CORE.glob("*.py")):
        source = path.read_text(encoding="utf-8")
        if LINE.search(source):
            stale |= keep(path, current(source))
    return stale


if __name__ == "__main__":
    sys.exit(main())
