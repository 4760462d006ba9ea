"""The one exception that means "the user's input or set-up is at fault"."""

from __future__ import annotations

from pathlib import Path


class SolenavError(Exception):
    """What happened and what to do about it, for a person.

    Every command turns it into two lines on stderr and a non-zero exit; no traceback.
    """

    def __init__(self, message: str, remedy: str = "", exit_code: int = 2) -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy
        self.exit_code = exit_code


def unreadable(path: Path, error: OSError) -> SolenavError:
    """The error for a file that can't be read."""
    return SolenavError(f"can't read {path}: {error.strerror}", "check its name")


def unwritable(path: Path, error: OSError, *, exit_code: int = 2) -> SolenavError:
    """The error for a file that can't be written."""
    return SolenavError(f"can't write {path}: {error.strerror}", "choose another file", exit_code)
