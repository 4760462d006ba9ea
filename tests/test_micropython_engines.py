"""Real MicroPython runs the core to the same bits: bytecode on 64, viper on 32-bit words."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solenav import datasets, mpu9150, parameters
from solenav.engines.source import core_path
from solenav.errors import SolenavError
from solenav.sim import torture
from solenav_tools import micropython32
from solenav_tools.micropython import find_micropython
from solenav_tools.micropython_engine import ARCHITECTURES, first_difference, heap, stage

PARAMS = parameters.to_integers(parameters.Settings(), 200.0)
WALKS = {case.name: case.counts for case in torture.walks()}

on_32_bits = pytest.mark.parametrize("mode", ["viper", *ARCHITECTURES])
Staged = Callable[[str], Path]


@pytest.fixture
def micropython64() -> list[str]:
    return [str(find_micropython())]


@pytest.fixture(scope="module")
def micropython32_command() -> list[str]:
    try:
        return micropython32.command()
    except SolenavError as error:
        pytest.skip(f"{error.message}; {error.remedy}")


@pytest.fixture(scope="module")
def staged(tmp_path_factory: pytest.TempPathFactory) -> Staged:
    """Stages the core in a mode, once for all tests."""
    folders: dict[str, Path] = {}

    def folder(mode: str) -> Path:
        if mode not in folders:
            folders[mode] = tmp_path_factory.mktemp(mode)
            stage(folders[mode], mode)
        return folders[mode]

    return folder


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    """A core with another stride through the particles' table."""
    core = tmp_path / "planted"
    shutil.copytree(core_path(), core)
    particles = core / "particles.py"
    text = particles.read_text(encoding="utf-8")
    assert text.count("_STRIDE = const(37)") == 1
    particles.write_text(
        text.replace("_STRIDE = const(37)", "_STRIDE = const(39)"), encoding="utf-8"
    )
    return core


def test_bytecode_on_64_bits_equals_fast(micropython64: list[str], staged: Staged) -> None:
    parts = {
        "static start, strides and stances": WALKS["walk"][:900],
        "full-scale noise": WALKS["restless"][:800],
        "full scale for seconds": WALKS["flight"][:500],
    }
    for name, counts in parts.items():
        assert first_difference(micropython64, staged("bytecode"), counts, PARAMS) == "", name


@on_32_bits
def test_viper_on_32_bits_equals_fast(
    mode: str, micropython32_command: list[str], staged: Staged
) -> None:
    for name, counts in WALKS.items():
        assert first_difference(micropython32_command, staged(mode), counts, PARAMS) == "", name


@on_32_bits
def test_viper_on_32_bits_equals_fast_over_a_real_walk(
    mode: str, micropython32_command: list[str], staged: Staged, data: Path
) -> None:
    file = data / "foot" / "openshoe" / "Measurement_100521_2_data_inert.txt"
    recording = datasets.read(file, "openshoe")
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    # From the standing start into the walk.
    counts = counts[: round(15 * recording.rate_hz)]
    params = parameters.to_integers(parameters.Settings(), recording.rate_hz)
    assert first_difference(micropython32_command, staged(mode), counts, params) == ""


def test_a_planted_difference_is_found_in_bytecode(
    micropython64: list[str], planted: Path, tmp_path: Path
) -> None:
    stage(tmp_path, "bytecode", planted)
    found = first_difference(micropython64, tmp_path, WALKS["walk"][:300], PARAMS)
    assert "particles X[" in found


@on_32_bits
def test_a_planted_difference_is_found_on_32_bits(
    mode: str, micropython32_command: list[str], planted: Path, tmp_path: Path
) -> None:
    stage(tmp_path, mode, planted)
    found = first_difference(micropython32_command, tmp_path, WALKS["walk"][:300], PARAMS)
    assert "particles X[" in found


def test_what_the_interpreter_complains_about_is_said(
    micropython64: list[str], planted: Path, tmp_path: Path
) -> None:
    (planted / "params.py").write_text("raise ValueError('planted')\n", encoding="utf-8")
    (planted / "navigator.py").write_text("import solenav_core.params\n", encoding="utf-8")
    stage(tmp_path, "bytecode", planted)
    with pytest.raises(SolenavError, match="ValueError: planted"):
        first_difference(micropython64, tmp_path, np.zeros((1, 6), np.int16), PARAMS)


def test_what_mpy_cross_refuses_is_said(planted: Path, tmp_path: Path) -> None:
    broken = "@micropython.viper\ndef f(a: int) -> int:\n    return a / 2\n"
    (planted / "steps.py").write_text(broken, encoding="utf-8")
    with pytest.raises(SolenavError, match=r"(?s)mpy-cross refuses steps\.py"):
        stage(tmp_path, "armv6m", planted)


def test_a_tick_allocates_nothing(micropython32_command: list[str], staged: Staged) -> None:
    """On 32 bits an int past 2**30 that passes between kernels is an object."""
    counts = WALKS["walk"][:900]
    found = heap(micropython32_command, staged("viper"), counts, PARAMS)
    assert len(found) == len(counts)
    assert set(found) == {0}


def test_without_apt_the_reason_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SOLENAV_CACHE", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SolenavError, match=r"no 32-bit MicroPython here: .+"):
        micropython32.command()


def test_debian_s_main_archive_is_found_in_either_syntax(tmp_path: Path) -> None:
    (tmp_path / "sources.list.d").mkdir()
    (tmp_path / "sources.list").write_text(
        "# deb http://off.example/debian bookworm main\n"
        "deb-src http://source.example/debian bookworm main\n"
        "deb [arch=amd64,arm64 signed-by=/a.gpg,/b.gpg] http://one.example/debian bookworm main x\n"
        "deb http://one.example/debian bookworm-updates main\n"
        "deb http://flat.example/ ./\n",
        encoding="utf-8",
    )
    (tmp_path / "sources.list.d" / "two.sources").write_text(
        "Types: deb deb-src\nURIs: http://two.example/debian\nSuites: sid sid-updates\n"
        "# a comment\nComponents: main\nSigned-By:\n -----BEGIN\n .\n mQ\n\n"
        "Types: deb\nURIs: http://off.example/debian\nSuites: sid\nComponents: main\n"
        "Enabled: no\n",
        encoding="utf-8",
    )
    (tmp_path / "sources.list.d" / "three.list.disabled").write_text(
        "deb http://off.example/debian bookworm main\n", encoding="utf-8"
    )
    one, two = micropython32.debian_entries(tmp_path)
    assert (one["uris"], one["signed-by"]) == ("http://one.example/debian", "/a.gpg /b.gpg")
    assert (two["uris"], two["signed-by"]) == (
        "http://two.example/debian",
        "\n -----BEGIN\n .\n mQ",
    )
