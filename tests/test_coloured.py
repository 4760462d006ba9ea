"""The EKF with coloured noise: its two forms, its noise, and how that is estimated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("numba")

from solenav.errors import SolenavError
from solenav.filters import Aids, Walk, coloured
from solenav.filters.coloured import Colour
from solenav.filters.walk import of_recording
from solenav.recording import FloatArray
from solenav.sim.scenario import simulate

COLOURS = [Colour((0.9,), 0.05), Colour((1.2, -0.3), 0.2), Colour((0.5, 0.2, 0.1, 0.05), 0.5)]


@pytest.fixture(scope="module")
def walk() -> Walk:
    return of_recording(simulate("loop", seed=2).first(20.0))


def noise(colour: Colour, samples: int, seed: int = 1) -> FloatArray:
    """AR noise (samples, 3), its beginning left out."""
    rng = np.random.default_rng(seed)
    values = np.zeros((samples + 500, 3))
    for n in range(4, len(values)):
        values[n] = rng.normal(0, colour.sigma, 3)
        for k, phi in enumerate(colour.phi, 1):
            values[n] += phi * values[n - k]
    return values[500:]


@pytest.mark.parametrize("colour", COLOURS, ids=lambda c: f"AR{len(c.phi)}")
def test_both_forms_are_one_filter(walk: Walk, colour: Colour) -> None:
    one, other = (coloured.run(walk, Aids(), colour=colour, form=form) for form in coloured.FORMS)
    assert np.abs(one.position).max() > 1.0
    assert other.position == pytest.approx(one.position, abs=1e-9)
    assert other.velocity == pytest.approx(one.velocity, abs=1e-9)


def test_the_forms_agree_on_broken_stances(walk: Walk) -> None:
    rng = np.random.default_rng(3)
    broken = replace(walk, stance=walk.stance & (rng.random(len(walk.stance)) < 0.7))
    one, other = (
        coloured.run(broken, Aids(still=True), colour=COLOURS[1], form=form)
        for form in coloured.FORMS
    )
    assert other.position == pytest.approx(one.position, abs=1e-9)


def test_the_autocovariance_is_that_of_the_noise() -> None:
    colour = COLOURS[1]
    values = noise(colour, 200_000)
    seen = [np.mean(values[: len(values) - k] * values[k:]) for k in range(3)]
    assert colour.autocovariance == pytest.approx(np.array(seen), rel=0.05)


def test_twice_the_samples_of_a_stance_say_no_more() -> None:
    twice = COLOURS[1].at(2 * COLOURS[1].rate_hz)
    assert twice.phi == COLOURS[1].phi
    assert twice.autocovariance == pytest.approx(2 * COLOURS[1].autocovariance)
    assert COLOURS[1].at(COLOURS[1].rate_hz) == COLOURS[1]


@pytest.mark.parametrize("samples", [6, 30, 400])
def test_estimated_noise_is_stationary_whatever_the_values(samples: int) -> None:
    pytest.importorskip("statsmodels")
    ramps = [np.arange(samples)[:, None] * np.array([[1.0, -2.0, 0.5]]) + k for k in range(30)]
    for one in coloured.estimate(ramps, 100.0):
        assert (np.abs(np.roots([1.0, *(-f for f in one.colour.phi)])) < 1).all()


@given(st.floats(-0.95, 0.95), st.floats(-0.95, 0.95), st.floats(0.01, 1.0))
def test_each_older_sample_makes_the_prediction_no_worse(a: float, b: float, sigma: float) -> None:
    # From partial autocorrelations, so that the noise is stationary.
    colour = Colour((a * (1 - b), b), sigma)
    coefficients, variances = colour.predictors()
    assert (np.diff(variances) <= 1e-9 * variances[0]).all()
    assert variances[-1] == pytest.approx(sigma**2, rel=1e-6)
    assert coefficients[-1] == pytest.approx(colour.phi, abs=1e-6)


def test_order_and_coefficients_are_found_again() -> None:
    pytest.importorskip("statsmodels")
    true = Colour((1.2, -0.5), 0.1)
    orders = coloured.estimate([noise(true, 400, seed) for seed in range(8)], 200.0)
    chosen = orders[1]
    assert [one.order for one in orders] == [1, 2, 3, 4]
    assert orders[0].aic - chosen.aic > 100
    assert abs(coloured.best(orders).aic - chosen.aic) < 8
    assert chosen.colour.phi == pytest.approx(true.phi, abs=0.05)
    assert chosen.colour.sigma == pytest.approx(0.1, rel=0.05)
    assert orders[0].whiteness < 0.01 < chosen.whiteness


def test_what_is_no_noise_is_refused(walk: Walk) -> None:
    for phi, sigma in (((1.1,), 0.1), ((), 0.1), ((0.5,), 0.0), ((float("nan"),), 0.1)):
        with pytest.raises(SolenavError, match="no stationary noise"):
            Colour(phi, sigma)
    with pytest.raises(SolenavError, match="unknown form"):
        coloured.run(walk, Aids(), form="other")
    with pytest.raises(SolenavError, match="too little stance"):
        coloured.estimate([np.zeros((3, 3))], 200.0)
    with pytest.raises(SolenavError, match="no noise"):
        coloured.estimate([np.zeros((100, 3))], 200.0)
