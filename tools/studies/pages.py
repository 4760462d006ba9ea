"""Where studies write their pages, how wide, and how they are run."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

from solenav.errors import SolenavError

DOCS = Path(__file__).resolve().parents[2] / "docs"


def wrapped(paragraph: str, width: int = 100) -> str:
    """A paragraph in lines of at most `width`."""
    return textwrap.fill(paragraph, width, break_long_words=False, break_on_hyphens=False)


def as_script(study: Callable[[Path], None]) -> None:
    """A study as a script: its one argument is the folder of recordings."""
    if len(sys.argv) != 2:
        sys.exit(f"usage: python tools/studies/{Path(sys.argv[0]).name} DATA")
    try:
        study(Path(sys.argv[1]))
    except SolenavError as error:
        sys.exit(error.message)
