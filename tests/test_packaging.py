"""Everything that must be in the wheel is named in pyproject.toml."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
HOMES = {
    "solenav": ROOT / "host" / "solenav",
    "solenav_core": ROOT / "shared" / "solenav_core",
    "solenav_tools": ROOT / "tools" / "solenav_tools",
    "solenav_tools.firmware": ROOT / "firmware",
}


def test_every_folder_with_modules_is_a_listed_package() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    match = re.search(r"^packages = \[(.*?)\]", text, re.DOTALL | re.MULTILINE)
    assert match is not None
    listed = set(re.findall(r'"([\w.]+)"', match[1]))
    there = {
        ".".join([name, *path.parent.relative_to(home).parts])
        for name, home in HOMES.items()
        for path in home.rglob("*.py")
    }
    assert listed == there
