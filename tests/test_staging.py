"""What is put on a board is complete: it runs on MicroPython as it is."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from solenav.errors import SolenavError
from solenav_tools import micropython32
from solenav_tools.staging import stage_board


def test_a_board_s_files_import_and_pass_the_self_test(tmp_path: Path) -> None:
    """The compiled core for the Pico, loaded and tested by a real 32-bit MicroPython."""
    try:
        interpreter = micropython32.command()
    except SolenavError as error:
        pytest.skip(f"no 32-bit MicroPython: {error.message}")
    stage_board(tmp_path, "armv6m")
    script = (
        "from solenav_core import selftest\n"
        "from solenav_core.tables.selftest import EXPECTED\n"
        "print(selftest.first_failure(EXPECTED))\n"
    )
    (tmp_path / "try.py").write_text(script, encoding="utf-8")
    done = subprocess.run([*interpreter, "try.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.strip() == "0", done.stdout + done.stderr
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")}
    assert {"main.py", "boards/rp2_pico.mpy", "solenav_core/navigator.mpy", "build.json"} <= names
    assert not [name for name in names if name.startswith("solenav_core") and name.endswith(".py")]
