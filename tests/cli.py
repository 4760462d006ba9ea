"""Running the installed `solenav` command as a person does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SOLENAV = Path(sys.executable).parent / "solenav"


def solenav(
    *arguments: str | Path, cwd: Path | None = None, timeout: float = 300
) -> subprocess.CompletedProcess[str]:
    """The finished command; nothing is a terminal."""
    return subprocess.run(
        [SOLENAV, *arguments], cwd=cwd, capture_output=True, text=True, timeout=timeout
    )


def refused(done: subprocess.CompletedProcess[str], code: int, *says: str) -> None:
    """Assert a refusal: exit code, what it says, a remedy, nothing of a traceback."""
    assert done.returncode == code, done.stdout + done.stderr
    text = " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert "error:" in text and "try:" in text, text
    for part in says:
        assert part in text, text
