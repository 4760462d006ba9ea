"""The documentation as a site: it builds, its links lead somewhere, its drawings are current."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


def script(name: str) -> ModuleType:
    """A module of tools/site/."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / "site" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_site_builds_and_every_link_leads_somewhere(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path / "site"],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {path.name for path in (tmp_path / "site").glob("*.html")}
    assert {"index.html", "wiring.html", "troubleshooting.html", "protocol.html"} <= pages
    # Works without a network: nothing is fetched from elsewhere.
    for page in (tmp_path / "site").glob("*.html"):
        for part in page.read_text(encoding="utf-8").split("<")[1:]:
            if part.startswith(("script", "link", "img")):
                assert "http" not in part.split(">")[0] or 'rel="canonical"' in part, part[:200]
    algorithm = (tmp_path / "site" / "algorithm.html").read_text(encoding="utf-8")
    assert algorithm.count("<math") > 50
    assert "$$" not in algorithm and "-here" not in algorithm


def test_the_wiring_is_that_of_the_boards_modules() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "site" / "wiring.py", "--check"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    wiring = script("wiring")
    modules = {path.stem for path in (ROOT / "firmware" / "boards").glob("*.py")} - {"__init__"}
    assert set(wiring.BOARDS) == modules, "a board without a drawing, or the other way round"
    assert wiring.pins("rp2_pico") == ("GP4", "GP5", "GP6", "GP0", "GP1")


@pytest.mark.parametrize(
    ("text", "is_drawn"),
    [("$a+b$", True), ("$$x^2$$", True), ("`$a$`", False), ("5 $ and 6 $", False)],
)
def test_equations_are_drawn_and_code_is_left_alone(text: str, is_drawn: bool) -> None:
    equations = script("equations")
    page = equations.on_page_content(equations.on_page_markdown(text))
    assert ("<math" in page) == is_drawn
    assert is_drawn or page == text
