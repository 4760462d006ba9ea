"""The machine's memory map: the RAM of the Raspberry Pi Pico's RP2040, where boards run kernels.

An address there times two plus one still fits a word, so a pointer goes through a call as a
small int, as it does on the board.
"""

BASE = 0x20000000
SIZE = 264 * 1024
IMAGE_MAX = 128 * 1024  # the runtime's services, tables and the kernels, from BASE on
STACK_SIZE = 8 * 1024  # at the end of the RAM
STACK_TOP = BASE + SIZE
GAP = 256  # bytes that nobody may touch, before and after every buffer
