"""Parameters: SI in, integers that the core can hold out."""

from __future__ import annotations

import math
from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from solenav import parameters
from solenav.errors import SolenavError
from solenav_core import params
from solenav_core.tables.defaults import PARAMS


def value(settings: parameters.Settings, rate: float, name: str) -> int:
    return parameters.to_integers(settings, rate)[params.NAMES.index(name)]


def test_the_boards_defaults_are_the_hosts_at_200_hz() -> None:
    assert parameters.to_integers(parameters.Settings(), 200.0) == PARAMS


@given(st.floats(50.0, 600.0))
def test_every_rate_in_range_gives_parameters_in_range(rate: float) -> None:
    parameters.checked(list(parameters.to_integers(parameters.Settings(), rate)))


@given(st.floats(50.0, 600.0))
def test_times_stay_the_same_at_every_rate(rate: float) -> None:
    settings = parameters.Settings()
    assert value(settings, rate, "ALIGN_TICKS") / rate == pytest.approx(1.0, rel=0.01)
    assert value(settings, rate, "DT") / 2**30 == pytest.approx(1 / rate, rel=1e-6)
    assert value(settings, rate, "R") / 2**24 * 200 / rate == pytest.approx(
        settings.observation_noise, rel=1e-3
    )


@given(st.floats(-720.0, 720.0))
def test_the_initial_heading_is_clockwise_from_north(heading: float) -> None:
    settings = parameters.Settings(initial_heading_deg=heading)
    w, z = (value(settings, 200.0, name) / 2**30 for name in ("YAW_W", "YAW_Z"))
    # Turning by psi about Up takes North to azimuth -psi.
    psi = 2 * math.atan2(z, w)
    assert math.cos(-psi - math.radians(heading)) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("rate", [0.0, 20.0, 1000.0, float("nan")])
def test_a_rate_that_the_core_cannot_hold_is_refused(rate: float) -> None:
    with pytest.raises(SolenavError, match="sample rate"):
        parameters.to_integers(parameters.Settings(), rate)


def test_a_turn_and_a_gain_that_overflow_together_are_refused() -> None:
    turned = dict(zip(params.NAMES, PARAMS, strict=True)) | {"YAW_W": 2**30 - 1, "YAW_Z": 2**29}
    with pytest.raises(SolenavError, match="no rotation"):
        parameters.checked(list(turned.values()))
    with pytest.raises(SolenavError, match="STILL_GAIN"):
        parameters.to_integers(
            parameters.Settings(still_rate_dps=300.0, still_time_constant_s=0.5), 200.0
        )


def test_a_setting_that_a_word_cannot_hold_is_refused_by_name() -> None:
    with pytest.raises(SolenavError, match="RATE_MAX"):
        parameters.to_integers(parameters.Settings(rate_max_dps=2000.0), 200.0)


@given(st.floats(53.0, 570.0), st.floats(0.96, 1.04))
def test_a_clock_that_is_off_gets_its_own_parameters(rate: float, factor: float) -> None:
    """What the board makes in integers is what the host makes in floats for the true rate."""
    settings = parameters.Settings()
    base = parameters.to_integers(settings, rate)
    period_q8 = round(256e6 / rate * factor)
    timed = array("i", base)
    params.retimed(timed, base, period_q8)
    wanted = parameters.to_integers(settings, 256e6 / period_q8)
    for name, was, now, want in zip(params.NAMES, base, timed, wanted, strict=True):
        if name in ("RATE_MHZ", "DT", "HALF_ANGLE", "GAMMA", "GAMMA2"):
            # The nominal rate itself is a whole number of mHz.
            assert now == pytest.approx(want, rel=2e-5, abs=1), name
        else:
            assert now == was, name
    parameters.checked(list(timed))


def test_the_nominal_period_changes_nothing() -> None:
    timed = array("i", bytes(4 * len(PARAMS)))
    params.retimed(timed, PARAMS, 5000 * 256)
    assert timed == PARAMS
