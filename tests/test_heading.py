"""Magnetic heading in stance: what it mends, what it must leave alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from solenav import engines, importing, parameters
from solenav.recording import Recording
from solenav.sim.field import Earth
from solenav.sim.scenario import simulate
from solenav_core import layout
from solenav_tools.monitor.live import heading_deg

AT = layout.offsets(layout.STATE_FIELDS)
DRIFT_DPS = 0.3
"""A gyro bias that comes after the start: on a walk of two minutes 39 degrees of heading."""
STEERING = {"magnetometer_s": 5.0, "magnetometer_bias_s": 60.0}
RESTLESS = {"still_s": 1000.0}
"""At rest the bias would be learned without any field."""


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate("line35", seed=1)


def drifting(recording: Recording, dps: float = DRIFT_DPS) -> NDArray[np.int16]:
    """The samples with a rate about the sensor's Up that isn't there, from 3 s on."""
    gyro = recording.gyro.copy()
    gyro[round(3 * recording.rate_hz) :, 2] += math.radians(dps)
    return importing.samples_of(replace(recording, gyro=gyro))[0].words


def run(
    counts: NDArray[np.int16], recording: Recording, **settings: float | bool
) -> engines.Engine:
    values = importing.parameters_of(recording, parameters.Settings(**settings))
    engine = engines.create("fast", values)
    engine.advance(counts)
    return engine


def heading(engine: engines.Engine) -> float:
    return heading_deg(tuple(engine.state[AT["ATT"] : AT["ATT"] + 4]))


def apart(a: float, b: float) -> float:
    return abs((a - b + 180) % 360 - 180)


def true_heading(recording: Recording) -> float:
    """Of the foot as it stands at the end of a straight walk."""
    return math.degrees(recording.notes["initial_heading_rad"]) % 360


def bias_up(engine: engines.Engine) -> float:
    return engine.state[AT["BIAS"] + 2] / 2**20 / 16.4


def test_it_is_off_unless_asked_for(walk: Recording) -> None:
    with_field = drifting(walk)
    without = with_field.copy()
    without[:, 6:] = 0
    engine = run(with_field, walk)
    plain = run(without, walk)
    assert engine.state[AT["MAG_USED"]] == 0
    assert engine.state[AT["POS"] : AT["POS"] + 3] == plain.state[AT["POS"] : AT["POS"] + 3]


def test_a_gyro_that_drifts_loses_the_heading_and_the_field_keeps_it(walk: Recording) -> None:
    counts = drifting(walk)
    lost, kept = run(counts, walk, **RESTLESS), run(counts, walk, **RESTLESS, **STEERING)
    assert apart(heading(lost), true_heading(walk)) > 20
    assert apart(heading(kept), true_heading(walk)) < 3
    assert kept.state[AT["MAG_USED"]] > 1000


def test_the_gyro_bias_is_learned_from_the_field(walk: Recording) -> None:
    counts = drifting(walk)[: round(100 * walk.rate_hz)]
    slow = run(counts, walk, **RESTLESS, magnetometer_s=5.0)
    learned = run(counts, walk, **RESTLESS, **STEERING)
    before = bias_up(slow)
    assert bias_up(learned) - before == pytest.approx(DRIFT_DPS, abs=0.1)


def test_the_start_takes_the_heading_from_the_field_and_the_declination() -> None:
    for declination in (0.0, 12.0, -20.0):
        earth = Earth(declination=math.radians(declination))
        recording = simulate("line35", seed=1, earth=earth)
        counts = importing.samples_of(recording)[0].words[: round(2.5 * recording.rate_hz)]
        values = parameters.to_integers(
            parameters.Settings(magnetometer_start=True, declination_deg=declination), 200.0
        )
        engine = engines.create("fast", values)
        engine.advance(counts)
        assert engine.navigating
        # The simulated magnetometer has the iron that a calibration leaves.
        assert apart(heading(engine), true_heading(recording)) < 3, declination


def test_the_field_of_steel_is_refused(walk: Recording) -> None:
    """A field of other strength, or of other dip, turns next to nothing."""
    counts = drifting(walk, 0.0)
    clean = run(counts, walk, **STEERING)
    for change in ((100, 0, 0), (0, -150, 0), (0, 0, 80)):
        spoilt = counts.copy()
        late = slice(round(5 * walk.rate_hz), None)
        spoilt[late, 6:9] += np.array(change, np.int16)
        engine = run(spoilt, walk, **STEERING)
        assert engine.state[AT["MAG_REFUSED"]] > engine.state[AT["MAG_USED"]]
        assert apart(heading(engine), heading(clean)) < 2.5, change


def test_a_single_wrong_reading_moves_the_heading_by_little(walk: Recording) -> None:
    counts = drifting(walk, 0.0)
    clean = run(counts, walk, **STEERING)
    spoilt = counts.copy()
    row = len(counts) - 20 + int(np.flatnonzero(counts[-20:, 9] & 8)[0])
    # Turned right round about Up: strength and dip are as they should be.
    spoilt[row, 6:8] *= -1
    engine = run(spoilt, walk, **STEERING)
    assert apart(heading(engine), heading(clean)) < 0.2


def test_no_field_of_the_earth_at_the_start_is_no_reference(walk: Recording) -> None:
    counts = drifting(walk)
    counts[:, 6:9] = 0
    engine = run(counts, walk, **STEERING)
    assert engine.state[AT["MAG_NORM"]] == 0 and engine.state[AT["MAG_USED"]] == 0


def test_hard_and_soft_iron_are_taken_out_by_the_parameters(walk: Recording) -> None:
    counts = drifting(walk)
    iron = np.array([[1.1, 0.05, 0.0], [0.05, 0.9, -0.04], [0.0, -0.04, 1.05]])
    off = np.array([90.0, -60.0, 40.0])
    bent = counts.copy()
    bent[:, 6:9] = np.rint(counts[:, 6:9] @ np.linalg.inv(iron).T + np.linalg.inv(iron) @ off)
    values = importing.parameters_of(walk, parameters.Settings(**STEERING))
    names = list(parameters.named(values))
    for i, a in enumerate("XYZ"):
        for j, b in enumerate("XYZ"):
            values[names.index(f"MAG_{a}{b}")] = round(iron[i, j] * 2**12)
        values[names.index(f"MAG_B{a}")] = round(off[i] * 16)
    engine = engines.create("fast", parameters.checked(values.tolist()))
    engine.advance(bent)
    assert apart(heading(engine), true_heading(walk)) < 3
