"""Words of an array, moved by machine code: no kernels, as nothing is computed."""

from solenav_core.compat import micropython, ptr32


@micropython.viper
def blank(words: ptr32, count: int) -> int:
    """Zeros; as bytecode they took a Pico 7 % of its boot, in the self-tests."""
    i = 0
    while i < count:
        words[i] = 0
        i = i + 1
    return count


@micropython.viper
def pick(words: ptr32, places: ptr32, out: ptr32, count: int) -> int:
    """out[i] = words[places[i]]."""
    i = 0
    while i < count:
        out[i] = words[places[i]]
        i = i + 1
    return count
