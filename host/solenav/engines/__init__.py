"""Engines: ways to run the core's one source on the host, equal to the last bit.

`pure` is plain Python, `checked` raises where a 32-bit word would overflow, `fast` is compiled
by numba, `thumb` is the machine code of a Cortex-M0+ on an emulated CPU.
"""

from __future__ import annotations

import importlib.util
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.errors import SolenavError
from solenav_core import navigator
from solenav_core.layout import CLASSES, STATE_FIELDS, WINDOW_MAX, offsets

NAMES = ("pure", "checked", "fast", "thumb")
_AT = offsets(STATE_FIELDS)
_MODE = _AT["MODE"]
# Words of the state that lead into arrays, and their largest values.
_INDICES = (
    (_AT["RING_HEAD"], WINDOW_MAX - 1),
    (_AT["RING_FILL"], WINDOW_MAX),
    (_AT["GLRT_HEAD"], WINDOW_MAX - 1),
    (_AT["GLRT_FILL"], WINDOW_MAX),
    (_AT["BLOCK_SLOT"], 2),
    (_AT["STAGE"], 255),
    (_AT["RIVAL"], CLASSES),
    (_AT["MOTION"], CLASSES),
    (_AT["RNG"], 65535),
    (_AT["RNG"] + 1, 65535),
)


class Engine:
    """A navigator on the host: a state and the kernels that move it.

    `state`, `params` are the core's `array('i')`; after each call they hold what the firmware's
    would hold after the same samples.
    """

    def __init__(self, name: str, params: array[int], forest: array[int] | None = None) -> None:
        self.name = name
        self.params = params
        self.state = navigator.new_state()
        self._arrays: tuple[Any, ...] = (
            self.state,
            params,
            navigator.new_work(),
            navigator.new_tables(forest),
            navigator.new_sample(),
        )
        self._advance = self._looped(navigator.tick)
        if name == "checked":
            from solenav.engines import checked

            self._advance = self._looped(checked.load()["tick"])
        elif name == "fast":
            from solenav.engines import fast

            self._advance = fast.load()["advance"]
            # Views of the same memory: the state stays an array for snapshots and digests.
            self._arrays = tuple(np.frombuffer(a, np.int32) for a in self._arrays)

    @staticmethod
    def _looped(tick: Callable[..., int]) -> Callable[..., tuple[int, int]]:
        def advance(
            s: Any, p: Any, w: Any, t: Any, m: Any, counts: Any, start: int, stop: int, mask: int
        ) -> tuple[int, int]:
            events = 0
            for row in range(start, stop):
                for i, value in enumerate(counts[row].tolist()):
                    m[i] = value
                events = tick(s, p, w, t, m)
                if events & mask:
                    return row + 1, events
            return stop, events

        return advance

    def advance(
        self,
        counts: NDArray[np.int16],
        start: int = 0,
        stop: int | None = None,
        mask: int = 0,
    ) -> tuple[int, int]:
        """Run samples `start` to `stop` of `counts`, or until an event in `mask`.

        `counts` (n, 10) are the words of a sample as in `layout.SAMPLE_FIELDS`; without
        magnetometer and flags (n, 6) will do.

        Returns the first row not run and the events of the last tick. RangeError (checked
        engine): a word would have overflowed.
        """
        end = len(counts) if stop is None else stop
        return self._advance(*self._arrays, counts, start, end, mask)

    @property
    def navigating(self) -> bool:
        """True once the static start is over."""
        return self.state[_MODE] == 1

    def digest(self) -> int:
        return navigator.digest(self.state)

    def snapshot(self) -> bytes:
        return self.state.tobytes()

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot.

        ValueError where its size is not the state's, or a word that the core uses as an index is
        none: compiled kernels don't check.
        """
        if len(snapshot) != 4 * len(self.state):
            raise ValueError(f"snapshot of {len(snapshot)} bytes, state of {4 * len(self.state)}")
        words = array("i", snapshot)
        for at, top in _INDICES:
            if not 0 <= words[at] <= top:
                raise ValueError(f"word {at} = {words[at]} is outside 0 to {top}")
        for i, word in enumerate(words):
            self.state[i] = word


def create(name: str, params: array[int], forest: array[int] | None = None) -> Engine:
    """An engine by name, with another `forest` (words as `forests.pack` makes) than the shipped.

    SolenavError for an unknown name, or `fast` without numba.
    """
    if name not in NAMES:
        raise SolenavError(f"there is no engine {name!r}", f"choose one of {', '.join(NAMES)}")
    if name == "thumb":
        from solenav.engines import device_form, thumb

        return thumb.ThumbEngine(params, device_form.kernel_modules(), forest)
    return Engine(name, params, forest)


def default_name() -> str:
    """`fast` where numba is installed, else `pure`."""
    return "fast" if importlib.util.find_spec("numba") else "pure"
