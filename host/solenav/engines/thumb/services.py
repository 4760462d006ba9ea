"""The runtime that a kernel's machine code calls: MicroPython's `mp_fun_table`, in Thumb code.

A kernel calls the runtime for everything that is no arithmetic on words: to unpack its
arguments, to find another kernel and to call it. The common case of each such service is a few
instructions here, so that ticks run without leaving the emulated CPU. The rest is an SVC with
the service's number, which the host answers (`cpu.py`): ints that don't fit 31 bits, division,
and everything that kernels have no business with.

Objects are words as on every 32-bit MicroPython: a small int is ``value * 2 + 1``.
"""

from __future__ import annotations

FROM_OBJECT = 3
TO_OBJECT = 4
SWAP_GLOBALS = 5
LOAD_GLOBAL = 7
CALL = 27
NLR_PUSH = 32
NLR_POP = 33
ARGUMENTS = 44
FLOOR_DIVIDE = 46
MODULO = 47
COUNT = 50

# For messages: services that some viper code needs and kernels must not.
NAMES = {
    6: "load_name",
    9: "load_attr",
    10: "load_method",
    13: "store_global",
    15: "subscript",
    16: "is_true",
    17: "unary_op",
    18: "binary_op",
    19: "build_tuple",
    20: "build_list",
    26: "make_function",
    28: "call_method",
    30: "getiter",
    31: "iternext",
    34: "raise",
    35: "import_name",
    43: "new_closure",
}

OBJECT_TYPE, BOOL_TYPE, INT_TYPE = 0, 1, 2  # what is converted; larger ones are unsigned

# Objects of the host's, outside RAM: the three constants, then ints too large for 31 bits.
NONE, FALSE, TRUE, BOXED = 0x10000000, 0x10000004, 0x10000008, 0x10000100

_FROM_OBJECT = (
    0x2902,  # cmp r1, #2: an object or a bool is wanted
    0xD303,  # blo svc
    0x1042,  # asrs r2, r0, #1: the tag goes to the carry
    0xD301,  # blo svc
    0x0010,  # movs r0, r2
    0x4770,  # bx lr
    0xDF00 | FROM_OBJECT,
    0x4770,
)
_TO_OBJECT = (
    0x2901,  # cmp r1, #1
    0xD903,  # bls svc
    0x1802,  # adds r2, r0, r0
    0xD601,  # bvs svc: no small int
    0x1C50,  # adds r0, r2, #1
    0x4770,
    0xDF00 | TO_OBJECT,
    0x4770,
)
_SWAP_GLOBALS = (  # 0 in r0, or the globals that are in use already: 0. Else the old ones.
    0x4A05,  # ldr r2, [pc, #20]: where the globals in use are kept
    0x6811,  # ldr r1, [r2]
    0x2800,  # cmp r0, #0
    0xD004,  # beq same
    0x4288,  # cmp r0, r1
    0xD002,  # beq same
    0x6010,  # str r0, [r2]
    0x0008,  # movs r0, r1
    0x4770,
    0x2000,  # same: movs r0, #0
    0x4770,
    0xBF00,
)
_LOAD_GLOBAL = (  # A name's number is its place in the table: names of two modules differ.
    0x4904,  # ldr r1, [pc, #16]: the table of objects
    0x0082,  # lsls r2, r0, #2
    0x5889,  # ldr r1, [r1, r2]
    0x2900,  # cmp r1, #0
    0xD001,  # beq svc
    0x0008,  # movs r0, r1
    0x4770,
    0xDF00 | LOAD_GLOBAL,
    0x4770,
    0xBF00,
)
_CALL = (  # (function, count, arguments) becomes (function, count, 0, arguments).
    0xB510,  # push {r4, lr}
    0x68C4,  # ldr r4, [r0, #12]: the function's code
    0x0013,  # movs r3, r2
    0x2200,  # movs r2, #0
    0x47A0,  # blx r4
    0xBD10,  # pop {r4, pc}
)
_NLR_PUSH = (0x2000, 0x4770)  # nothing is ever raised inside the machine
_NLR_POP = (0x4770, 0xBF00)


def _bytes(*halfwords: int) -> bytes:
    return b"".join(h.to_bytes(2, "little") for h in halfwords)


def _code(service: int, globals_in_use: int, global_objects: int) -> bytes:
    own = {
        FROM_OBJECT: _bytes(*_FROM_OBJECT),
        TO_OBJECT: _bytes(*_TO_OBJECT),
        SWAP_GLOBALS: _bytes(*_SWAP_GLOBALS) + globals_in_use.to_bytes(4, "little"),
        LOAD_GLOBAL: _bytes(*_LOAD_GLOBAL) + global_objects.to_bytes(4, "little"),
        CALL: _bytes(*_CALL),
        NLR_PUSH: _bytes(*_NLR_PUSH),
        NLR_POP: _bytes(*_NLR_POP),
    }
    return own.get(service) or _bytes(0xDF00 | service, 0x4770)


def build(base: int, globals_in_use: int, global_objects: int) -> tuple[bytes, list[int]]:
    """The services' code, laid out from `base`, and the words of the table that points to them.

    `globals_in_use` and `global_objects` are the addresses of a word and of a table.
    """
    data = b""
    table = [NONE, FALSE, TRUE]
    for service in range(len(table), COUNT):
        table.append(base + len(data) | 1)
        data += _code(service, globals_in_use, global_objects)
    return data, table
