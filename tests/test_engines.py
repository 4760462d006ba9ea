"""One core, several engines: every bit of every tick agrees."""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from solenav import capture, engines, parameters
from solenav.engines import checked, source
from solenav.errors import SolenavError
from solenav_core import layout, navigator

AT = layout.offsets(layout.STATE_FIELDS)
Counts = NDArray[np.int16]


def digests(name: str, counts: Counts, params: array[int]) -> list[int]:
    """The digest after every tick."""
    engine = engines.create(name, params)
    out = []
    for row in range(len(counts)):
        engine.advance(counts, row, row + 1)
        out.append(engine.digest())
    return out


def assert_same(counts: Counts, params: array[int]) -> None:
    reference = digests("pure", counts, params)
    for name in ("checked", "fast"):
        other = digests(name, counts, params)
        wrong = [i + 1 for i, (a, b) in enumerate(zip(reference, other, strict=True)) if a != b]
        assert not wrong, f"{name} differs from pure first at tick {wrong[0]}"


def still(count: int, rng: np.random.Generator) -> Counts:
    counts = rng.normal(0, 3, (count, 6))
    counts[:, 2] += 2048
    return np.rint(counts).astype(np.int16)


def test_engines_agree_on_every_tick_of_a_walk(walk: Path) -> None:
    source_capture = capture.load(walk)
    # From the end of the standing start into the third stride.
    counts = source_capture.sample_counts
    part = np.vstack([counts[:400], counts[3000:3800]])
    assert_same(part, source_capture.params[0][1])


@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0, 600.0])
def test_engines_agree_at_other_rates(rate: float) -> None:
    rng = np.random.default_rng(4)
    swing = rng.normal(0, 9000, (120, 6)).clip(-32768, 32767).astype(np.int16)
    counts = np.vstack([still(int(rate * 1.2), rng), swing, still(300, rng)])
    assert_same(counts, parameters.to_integers(parameters.Settings(), rate))


samples = st.integers(0, 2**32 - 1).flatmap(
    lambda seed: st.tuples(st.just(seed), st.sampled_from([40, 400, 4000, 40000]))
)


@settings(max_examples=15)
@given(st.lists(samples, min_size=1, max_size=4))
def test_no_sample_sequence_leaves_the_word(pieces: list[tuple[int, int]]) -> None:
    """Noise of any size, full scale included, between stills: `checked` raises on overflow."""
    params = parameters.to_integers(parameters.Settings(), 200.0)
    rng = np.random.default_rng(1)
    parts = [still(250, rng)]
    for seed, size in pieces:
        noise = np.random.default_rng(seed).normal(0, size, (60, 6))
        parts += [noise.clip(-32768, 32767).astype(np.int16), still(40, rng)]
    assert_same(np.vstack(parts), params)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("axis", range(6))
def test_full_scale_for_seconds_overflows_nothing(axis: int, sign: int) -> None:
    rng = np.random.default_rng(2)
    pinned = still(700, rng)
    pinned[:, axis] = -32768 if sign < 0 else 32767
    counts = np.vstack([still(250, rng), pinned, still(200, rng)])
    params = parameters.to_integers(parameters.Settings(), 200.0)
    assert digests("checked", counts, params) == digests("fast", counts, params)


def test_velocity_stops_at_its_limit_and_says_so() -> None:
    rng = np.random.default_rng(2)
    thrust = np.tile(np.array([32767, 0, 2048, 0, 0, 0], np.int16), (2000, 1))
    engine = engines.create("fast", parameters.to_integers(parameters.Settings(), 200.0))
    engine.advance(np.vstack([still(250, rng), thrust]))
    assert engine.state[AT["VEL"]] == 100 * 2**24
    assert engine.state[AT["SATURATED"]] > 0


def test_position_goes_on_past_eight_kilometres() -> None:
    """Cells of 4096 m: what one word of Q18 metres can't hold."""
    engine = engines.create("fast", parameters.to_integers(parameters.Settings(), 200.0))
    rng = np.random.default_rng(2)
    engine.advance(still(250, rng))
    flight = still(200 * 130, rng)
    flight[:, 3] = 3000  # turning: never stance
    for _ in range(3):
        engine.state[AT["VEL"]] = 95 * 2**24
        before = engine.state[AT["CELL"]] * 4096 + engine.state[AT["POS"]] / 2**18
        engine.advance(flight[: 200 * 20])
        after = engine.state[AT["CELL"]] * 4096 + engine.state[AT["POS"]] / 2**18
        assert abs(engine.state[AT["POS"]]) <= 2**29 + 2**19
        assert after != before
    assert abs(engine.state[AT["CELL"]]) >= 1


def test_checked_names_the_kernel_and_line_that_overflows() -> None:
    engine = engines.create("checked", parameters.to_integers(parameters.Settings(), 200.0))
    engine.advance(still(250, np.random.default_rng(1)))
    engine.state[AT["POS"]] = 2**31 - 1
    engine.state[AT["VEL"]] = 90 * 2**24
    moving = np.tile(np.array([0, 0, 2048, 3000, 0, 0], np.int16), (5, 1))
    with pytest.raises(checked.RangeError, match=r"strapdown\.propagate line \d+"):
        engine.advance(moving)


def test_a_snapshot_continues_exactly_where_it_was_taken(walk: Path) -> None:
    source_capture = capture.load(walk)
    counts, params = source_capture.sample_counts, source_capture.params[0][1]
    whole = engines.create("fast", params)
    whole.advance(counts, 0, 4000)
    other = engines.create("pure", params)
    other.restore(whole.snapshot())
    whole.advance(counts, 4000, 4100)
    other.advance(counts, 4000, 4100)
    assert whole.snapshot() == other.snapshot()


def test_a_snapshot_of_another_size_is_refused() -> None:
    engine = engines.create("pure", parameters.to_integers(parameters.Settings(), 200.0))
    with pytest.raises(ValueError, match="snapshot of 8 bytes"):
        engine.restore(bytes(8))


def test_an_unknown_engine_is_an_error_with_a_remedy() -> None:
    with pytest.raises(SolenavError) as caught:
        engines.create("warp", parameters.to_integers(parameters.Settings(), 200.0))
    assert "pure" in caught.value.remedy


def test_the_digest_sees_every_word() -> None:
    state = navigator.new_state()
    seen = {navigator.digest(state)}
    for i in range(len(state)):
        state[i] ^= 1
        seen.add(navigator.digest(state))
        state[i] ^= 1
    assert len(seen) == len(state) + 1


def test_every_kernel_is_in_the_engines() -> None:
    """A module with kernels that is missing from the list would silently not be checked."""
    listed = {kernel.definition.name for kernel in source.kernels()}
    for path in source.core_path().glob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "ptr8" in text or path.stem in ("compat", "selftest", "words"):
            continue  # bytes on the wire, the self-test's numbers, copies: no part of the tick
        assert text.count("@micropython.viper") == sum(
            k.module == path.stem for k in source.kernels()
        ), path.name
    assert "tick" in listed
