"""Where studies write their pages, and how wide."""

from __future__ import annotations

import textwrap
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"


def wrapped(paragraph: str, width: int = 100) -> str:
    """A paragraph in lines of at most `width`."""
    return textwrap.fill(paragraph, width, break_long_words=False, break_on_hyphens=False)
