"""How long work tells how far it is: the library's side of a progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

Progress = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]
"""Takes what is done and how much it is in all; gives a function that takes how much is done."""


@contextmanager
def unseen(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Nobody looks."""
    yield lambda done: None
