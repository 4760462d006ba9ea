"""The one exception that means "the user's input or set-up is at fault"."""

from __future__ import annotations


class SolenavError(Exception):
    """What happened and what to do about it, for a person.

    Every command turns it into two lines on stderr and a non-zero exit; no traceback.
    """

    def __init__(self, message: str, remedy: str = "", exit_code: int = 2) -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy
        self.exit_code = exit_code
