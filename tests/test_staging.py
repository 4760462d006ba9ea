"""What is put on a board is complete: it runs on MicroPython as it is."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from solenav import engines
from solenav.errors import SolenavError
from solenav_core.tables.defaults import PARAMS
from solenav_tools import micropython32
from solenav_tools.staging import stage_board

PICO_HEAP = 245_888  # bytes, of MicroPython 1.28


@pytest.fixture
def interpreter() -> list[str]:
    try:
        return list(micropython32.command())
    except SolenavError as error:
        pytest.skip(f"no 32-bit MicroPython: {error.message}")


def test_a_board_s_files_import_and_pass_the_self_test(
    interpreter: list[str], tmp_path: Path
) -> None:
    """The compiled core for the Pico, loaded and tested by a real 32-bit MicroPython."""
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


def test_after_the_self_test_nearly_half_a_pico_s_heap_is_free_and_the_core_still_computes(
    interpreter: list[str], tmp_path: Path
) -> None:
    """What was let go of is called by nothing: standing, then blows that no foot survives."""
    stage_board(tmp_path, "armv6m")
    rng = np.random.default_rng(7)
    rows = np.zeros((400, 10), np.int16)
    rows[:, 2] = 2048
    rows[:300, :6] += rng.integers(-3, 4, (300, 6), np.int16)
    rows[300:, :6] += rng.integers(-9000, 9001, (100, 6), np.int16)
    (tmp_path / "rows.bin").write_bytes(rows.astype("<i4").tobytes())
    script = (
        "import gc, main, config\n"
        "from array import array\n"
        "print(main.self_test())\n"
        "gc.collect()\n"
        "print(gc.mem_free())\n"
        "params, tables = config.load()[1:3]\n"
        "from solenav_core import navigator\n"
        "state, work = navigator.new_state(), navigator.new_work()\n"
        "sample = navigator.new_sample()\n"
        "with open('rows.bin', 'rb') as file:\n"
        "    while file.readinto(sample):\n"
        "        navigator.tick(state, params, work, tables, sample)\n"
        "print(navigator.digest(state))\n"
    )
    (tmp_path / "try.py").write_text(script, encoding="utf-8")
    done = subprocess.run(
        [*interpreter, "-X", f"heapsize={PICO_HEAP}", "try.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    tested, free, digest = done.stdout.splitlines()
    assert tested == "(0, '')"
    assert int(free) > PICO_HEAP * 0.45
    engine = engines.create("pure", PARAMS)
    engine.advance(rows, 0, len(rows))
    assert int(digest) == engine.digest()
