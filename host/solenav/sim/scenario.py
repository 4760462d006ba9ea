"""A simulated recording: a gait, the IMU that rides on it, and the truth beside the samples."""

from __future__ import annotations

import numpy as np

from solenav.errors import SolenavError
from solenav.recording import Recording, Truth
from solenav.sim.field import NO_STEEL, Earth, field_at
from solenav.sim.field import indoors as steel_along
from solenav.sim.gait import SCENARIOS, motion
from solenav.sim.imu import (
    TABLE1,
    SensorErrors,
    coloured_noise,
    ideal_samples,
    measured_field,
    with_errors,
)

MIN_RATE_HZ = 50.0
MAX_RATE_HZ = 1000.0


def simulate(
    scenario: str,
    *,
    rate_hz: float = 200.0,
    seed: int = 1,
    errors: SensorErrors = TABLE1,
    duration_s: float | None = None,
    earth: Earth | None = None,
    indoors: bool = False,
) -> Recording:
    """The recording of `scenario` (a key of `SCENARIOS`), in body axes (right-front-up).

    Sample i covers the interval of 1 / `rate_hz` before its time stamp, and row i of the truth
    is the state at the stamp, hence what a navigator should hold once it has taken the sample.
    The state before the first sample is stance at the origin, at the heading that
    `notes["initial_heading_rad"]` gives (azimuth of the foot's front, clockwise from North).
    `duration_s` None is the scenario's own; more lengthens the standing at the end. The gait of
    a seed is the same at every rate and with any errors. The magnetometer reads, at the stamp,
    the field of `earth` (None: Central Europe) and, `indoors`, of steel along the way.
    """
    _check(scenario, rate_hz, seed)
    earth = earth or Earth()
    gait_rng, sensor_rng, mag_rng, steel_rng, colour_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)
    )
    gait = SCENARIOS[scenario](gait_rng, duration_s)

    count = int(np.ceil(gait.duration_s * rate_hz - 1e-6))
    states = motion(gait, np.arange(count + 1) / rate_hz)
    accel, gyro = with_errors(*ideal_samples(states, rate_hz), rate_hz, errors, sensor_rng)
    accel_colour, gyro_colour = coloured_noise(count, rate_hz, errors, colour_rng)
    steel = steel_along(gait.foot, earth, steel_rng) if indoors else NO_STEEL
    field = field_at(states.position_enu[1:], earth, steel)
    time = np.arange(count) / rate_hz
    return Recording(
        name=f"{scenario}-{seed}",
        time_s=time,
        accel=accel + accel_colour,
        gyro=gyro + gyro_colour,
        rate_hz=float(rate_hz),
        truth=Truth(
            time_s=time.copy(),
            position_enu=states.position_enu[1:],
            velocity_enu=states.velocity_enu[1:],
            stance=states.stance[1:],
            frame="enu",
            closed_loop=gait.closed_loop,
        ),
        source="simulation",
        notes={
            "scenario": scenario,
            "seed": seed,
            "initial_heading_rad": gait.initial_heading_rad,
            "strides": len(gait.lift_off),
            "declination_rad": earth.declination,
            "indoors": indoors,
        },
        modes=gait.modes,
        mag=measured_field(field, states.attitude[1:], errors, mag_rng),
    )


def _check(scenario: str, rate_hz: float, seed: int) -> None:
    if scenario not in SCENARIOS:
        raise SolenavError(
            f"there is no scenario {scenario!r}", f"choose one of {', '.join(SCENARIOS)}"
        )
    if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
        raise SolenavError(
            f"the sample rate {rate_hz:g} Hz is out of range",
            f"choose from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz",
        )
    if seed < 0:
        raise SolenavError(f"the seed {seed} is negative", "choose 0 or a positive whole number")
