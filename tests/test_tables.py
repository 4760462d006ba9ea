"""What scripts generate is what is committed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from solenav_core import layout
from solenav_core.tables.lookup import TABLES

TABLE_SCRIPTS = Path(__file__).parents[1] / "tools" / "tables"


@pytest.mark.parametrize(
    "script",
    ["constants.py", "defaults.py", "lookup.py", "protocol.py", "ranges.py", "selftest.py"],
)
def test_generated_files_are_current(script: str) -> None:
    done = subprocess.run(
        [sys.executable, TABLE_SCRIPTS / script, "--check"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_stale_offset_is_found(tmp_path: Path) -> None:
    sys.path.insert(0, str(TABLE_SCRIPTS))
    try:
        import constants
    finally:
        sys.path.pop(0)
    at = layout.offsets(layout.STATE_FIELDS)
    assert constants.current("_S_VEL = const(0)\n") == f"_S_VEL = const({at['VEL']})\n"
    with pytest.raises(KeyError):
        constants.current("_S_NOSUCH = const(0)\n")


def test_the_gaussian_table_is_white_and_antithetic() -> None:
    at = layout.offsets(layout.TABLE_FIELDS)["GAUSS"]
    rows = np.array(TABLES[at : at + 300]).reshape(3, 100).T / 2048
    assert np.abs(rows.sum(axis=0)).max() == 0
    assert np.abs(np.cov(rows.T, bias=True) - np.eye(3)).max() < 1e-3
    assert {tuple(r) for r in rows} == {tuple(-r) for r in rows}
