"""What the Cortex-M0+ spends on an instruction (its Technical Reference Manual, table 3-1).

Memory answers without waiting, as the RP2040's RAM does, and the multiplier takes one cycle.
"""

from __future__ import annotations


def cycles(op: int) -> int:
    """Cycles of the instruction of halfword `op`; of a conditional branch, when not taken.

    A taken conditional branch costs one more. BL's second halfword costs nothing.
    """
    if op >> 12 == 0xB:
        registers = (op & 0x1FF).bit_count()
        if op & 0xFE00 == 0xB400:  # PUSH
            return 1 + registers
        if op & 0xFE00 == 0xBC00:  # POP; with PC it is a branch too
            return 1 + registers if op & 0x100 == 0 else 3 + registers
        return 1
    if op >> 12 == 0xC:  # LDM, STM
        return 1 + (op & 0xFF).bit_count()
    if 0x4800 <= op <= 0x9FFF:  # every LDR and STR
        return 2
    if op & 0xFF00 == 0x4700:  # BX, BLX
        return 2
    if op & 0xFC00 == 0x4400:  # ADD, CMP, MOV of high registers: to PC it is a branch
        return 2 if op & 0x87 == 0x87 and op & 0x300 != 0x100 else 1
    if op & 0xF800 == 0xE000:  # B
        return 2
    if op & 0xF800 == 0xF000:  # BL
        return 3
    return 1 if is_instruction(op) else 0


def is_conditional(op: int) -> bool:
    """A conditional branch."""
    return 0xD000 <= op <= 0xDDFF


def is_instruction(op: int) -> bool:
    """The first halfword of an instruction, if the halfword is executed at all."""
    return op < 0xE800 or op & 0xF800 == 0xF000
