"""Keeping generated files current: what the scripts of this folder share."""

from __future__ import annotations

import sys
from pathlib import Path


def keep(target: Path, text: str) -> int:
    """Write `text` to `target`; with --check on the command line compare instead.

    Returns the exit code: 1 where the check finds another text.
    """
    if "--check" not in sys.argv[1:]:
        target.write_text(text, encoding="utf-8")
        return 0
    if target.exists() and target.read_text(encoding="utf-8") == text:
        return 0
    print(f"{target.name} is stale: run `make tables`")
    return 1
