"""The fixed-point primitives say what exact integer arithmetic says."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from solenav.engines import checked, fast
from solenav_core import qmath
from solenav_core.tables.lookup import TABLES

WORD = 2**31 - 2**16 - 1
factors = st.integers(-WORD, WORD)
kernels = checked.load()


@given(factors, factors, st.integers(17, 46))
@example(WORD, WORD, 46)
@example(-WORD, WORD, 46)
@example(32768, -32768, 17)
def test_mulshift_is_the_product_shifted_and_rounded(a: int, b: int, n: int) -> None:
    exact = (a * b + (1 << (n - 1))) >> n
    assume(abs(exact) < 2**31)
    # The checked engine raises on any intermediate past 32 bits.
    assert kernels["mulshift"](a, b, n) == exact


@given(st.integers(-(2**25), 2**25), st.integers(-(2**30), 2**30), st.integers(17, 30))
def test_mulsat_is_mulshift_up_to_its_limit(a: int, b: int, n: int) -> None:
    assume(abs(a * b) >> (n + 8) < 2**31 - 1)
    exact = (a * b + (1 << (n - 1))) >> n
    got = kernels["mulsat"](a, b, n)
    if abs(exact) < 2**30 - 512:
        assert got == exact
    else:
        assert abs(got) >= 2**30 - 1024 and (got > 0) == (exact > 0)


@given(st.integers(-(2**30), 2**30), st.integers(1, 2**30 - 2), st.integers(0, 30))
def test_div_truncates_the_quotient(num: int, den: int, n: int) -> None:
    exact = (abs(num) << n) // den
    assume(exact < 2**31)
    assert kernels["div"](num, den, n) == (exact if num >= 0 else -exact)


@given(st.integers(-(2**30), 2**30), st.integers(-10, 0))
def test_div_by_nothing_gives_zero_not_a_dead_board(num: int, den: int) -> None:
    assert kernels["div"](num, den, 8) == 0


@given(st.integers(0, 2**31 - 1))
@example(2**31 - 1)
def test_isqrt_is_the_integer_square_root(x: int) -> None:
    assert kernels["isqrt"](x) == math.isqrt(x)


@given(st.floats(0, 2 * math.pi), st.integers(2**17, 2**29 - 1))
def test_azimuth_is_the_angle_clockwise_from_north(angle: float, length: int) -> None:
    east, north = round(length * math.sin(angle)), round(length * math.cos(angle))
    got = kernels["azimuth"](east, north, list(TABLES))
    error = (got / 65536 * 2 * math.pi - angle + math.pi) % (2 * math.pi) - math.pi
    assert abs(error) < 2 * math.pi / 65536 * 1.5


def test_azimuth_of_the_axes_is_exact() -> None:
    one = 2**28
    quarters = [qmath.azimuth(e, n, TABLES) for e, n in ((0, one), (one, 0), (0, -one), (-one, 0))]
    assert quarters == [0, 16384, -32768, -16384]


@pytest.mark.parametrize(
    ("kernel", "arguments"),
    [
        ("mulshift", (2**31 - 1, 2**31 - 1, 30)),
        ("mulshift", (2**30, 2**30, 17)),
        ("div", (2**30, 1, 30)),
    ],
)
def test_checked_raises_where_a_word_would_wrap(kernel: str, arguments: tuple[int, ...]) -> None:
    with pytest.raises(checked.RangeError, match=f"qmath.{kernel} line"):
        kernels[kernel](*arguments)


@given(factors, factors, st.integers(17, 46))
def test_fast_multiplies_like_pure(a: int, b: int, n: int) -> None:
    assume(abs(a * b) >> n < 2**31 - 1)
    assert fast.load()["mulshift"](a, b, n) == qmath.mulshift(a, b, n)
