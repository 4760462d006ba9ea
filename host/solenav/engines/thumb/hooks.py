"""What the emulated CPU calls at every block of code and every access to memory.

Both are compiled by numba, since a call into Python would cost more than the code that it
counts; both work on one record, the tally, that they share with Python.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solenav.engines.thumb.memory import BASE, IMAGE_MAX, SIZE, STACK_SIZE, STACK_TOP

READ, WRITE = 1, 2
_WRITING = 17  # unicorn's UC_MEM_WRITE
_HALFWORDS = IMAGE_MAX // 2 + 1

# All places in code are halfwords from BASE.
#   last         where the block executed last stops
#   fault, ...   READ or WRITE once an access was refused, its address and size
#   runs         executions: +1 where a block starts, -1 where it stops; their running sum
#                is how often each halfword ran, however the emulator cut the blocks
#   taken        how often a branch that ends here went elsewhere
#   access       what each byte of RAM may be used for
TALLY = np.dtype(
    [
        ("last", "i8"),
        ("fault", "i8"),
        ("address", "i8"),
        ("size", "i8"),
        ("runs", "i8", (_HALFWORDS,)),
        ("taken", "i8", (_HALFWORDS,)),
        ("access", "u1", (SIZE,)),
    ]
)


@cache
def _compiled() -> tuple[Any, Any]:
    """The two callbacks (block, memory)."""
    from numba import carray, cfunc, from_dtype, types
    from unicorn.unicorn_py3.unicorn import uclib

    stop = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(("uc_emu_stop", uclib))
    tally = types.CPointer(from_dtype(TALLY))

    @cfunc(types.void(types.voidptr, types.uint64, types.uint32, tally))
    def on_block(machine: Any, address: Any, size: Any, data: Any) -> None:
        t = carray(data, 1)[0]
        first = (np.int64(address) - BASE) >> 1
        t.runs[first] += 1
        if first != t.last:
            t.taken[t.last] += 1
        t.last = first + (np.int64(size) >> 1)
        t.runs[t.last] -= 1

    @cfunc(types.void(types.voidptr, types.int32, types.uint64, types.int32, types.int64, tally))
    def on_memory(machine: Any, kind: Any, address: Any, size: Any, value: Any, data: Any) -> None:
        t = carray(data, 1)[0]
        at = np.int64(address) - BASE
        use = WRITE if kind == _WRITING else READ
        # The Cortex-M0+ refuses unaligned accesses too.
        if 0 <= at <= SIZE - size and at & (size - 1) == 0 and t.access[at] & use:
            return
        if t.fault == 0:
            t.fault = use
            t.address = np.int64(address)
            t.size = size
        stop(machine)

    return on_block, on_memory


def attach(machine: Any, tally: NDArray[Any], code: tuple[int, int]) -> None:
    """Have `machine` (a unicorn `Uc`) count blocks from code[0] to code[1], and check accesses.

    Those to the stack are not checked. `tally` is an array of one TALLY, to live as long as the
    machine does.
    """
    import unicorn
    from unicorn.unicorn_py3.unicorn import uclib

    on_block, on_memory = _compiled()
    accesses = unicorn.UC_HOOK_MEM_READ | unicorn.UC_HOOK_MEM_WRITE
    # Half of all accesses are to locals on the stack; left alone, they are three times as fast.
    below_stack = (0, STACK_TOP - STACK_SIZE - 1)
    for kind, callback, (begin, end) in (
        (unicorn.UC_HOOK_BLOCK, on_block, code),
        (accesses, on_memory, below_stack),
    ):
        # The binding takes Python callbacks only; this is the call that it makes with them.
        status = uclib.uc_hook_add(
            machine._uch,
            ctypes.byref(ctypes.c_size_t()),
            kind,
            ctypes.c_void_p(callback.address),
            ctypes.c_void_p(tally.ctypes.data),
            ctypes.c_uint64(begin),
            ctypes.c_uint64(end),
        )
        if status:
            raise unicorn.UcError(status)
