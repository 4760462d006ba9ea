"""Parameters in SI units, and their conversion to the integers that the core runs on.

`Settings` is what a person sets; `to_integers` makes the core's parameter array for a sample
rate. Defaults: Guo, Xu, Ji 2020, table 1, as read by docs/algorithm.md, at 200 Hz;
what counts samples or accumulates per sample scales with the rate.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from solenav import mpu9150
from solenav.calibration import model as calibrations
from solenav.calibration.model import IDENTITY, Calibration
from solenav.errors import SolenavError
from solenav.recording import FloatArray
from solenav_core import layout, params

__all__ = ["Settings", "checked", "named", "replace", "to_integers"]

REFERENCE_RATE_HZ = 200.0
HALF_TURN = math.pi / 2**16 * 2**30  # Q30 rad of half the angle that is one in 2**16 of a turn


@dataclass(frozen=True)
class Settings:
    """Every tunable in SI units (times in s, rates in °/s where said)."""

    initial_heading_deg: float = 0.0  # azimuth of the foot's front axis, clockwise from North
    align_s: float = 1.0
    align_min_s: float = 0.2
    align_accel: float = 0.5  # m/s², largest deviation from the first still sample
    align_rate_dps: float = 3.5
    bias_max_dps: float = 50.0
    accel_min: float = 7.5  # m/s², C1
    accel_max: float = 12.1
    rate_max_dps: float = 100.0  # C2
    accel_variance_max: float = 9.0  # (m/s²)², C3
    window_s: float = 0.05
    detector: int = 0  # 0: C1 to C3; 1: GLRT with one threshold; 2: with the motion's threshold
    glrt_window_s: float = 0.05
    glrt_accel: float = 0.01  # m/s², sigma_a of T
    glrt_rate_dps: float = 0.1  # sigma_w of T
    glrt_max: float = 640_000.0  # T of a stance is below this with one threshold or none for it
    glrt_still: float = 640_000.0  # and with the motion's, standing
    glrt_walk: float = 640_000.0
    glrt_run: float = 640_000.0
    glrt_up: float = 640_000.0  # upstairs
    glrt_down: float = 640_000.0
    motion_window_s: float = 1.28  # whose features tell the motion, of 128 samples; 0: none
    motion_share: float = 0.3  # of the vote; with less the motion is unknown
    motion_hold: int = 1  # windows in a row that change the motion
    unrest_rate_dps: float = 5.0  # sigma of the rate in T
    unrest_accel: float = 0.35  # m/s², sigma of |a| in T
    unrest_s: float = 1.0  # time constant of the growth of the least T
    unrest_max: float = 31.0  # u of a sample that still observes zero velocity
    unrest_sure: float = 7.0  # u of a sample that may judge the filter
    still_rate_dps: float = 0.8
    still_s: float = 0.5
    still_time_constant_s: float = 2.0
    velocity_noise_horizontal: float = 0.015  # (m/s)²/s
    velocity_noise_up: float = 0.00015
    strike_noise: float = 0.08  # of the force's change since the last sample, 1 sigma over 5 ms
    tilt_noise: float = 2e-5  # rad²/s
    freeze_s: float = 10.0
    initial_velocity_variance: float = 1e-4
    initial_tilt_variance: float = 1.2e-3
    observation_noise: float = 0.005  # (m/s)², R at 200 Hz
    m2_max: float = 2.0
    log_floor: float = -16.0  # natural logarithm of the least weight
    threshold_min: float = 0.1  # M_a
    threshold_max: float = 0.5  # M_b
    threshold_growth: float = 0.4  # K_e at 200 Hz
    heavy_weight: float = 0.5  # K
    heavy_min: int = 50
    lockout_s: float = 1.0
    lockout_min: int = 5
    lockout_velocity_variance: float = 0.01
    step_swing_s: float = 0.15
    step_stance_s: float = 0.04
    seed: int = 1
    bridge_s: float = 0.05  # longest hole in the samples that doesn't spoil the pose
    resume_s: float = 0.08  # stance that levels the foot where navigation goes on
    resume_accel: float = 2.0  # m/s², largest deviation in it
    resume_rate_dps: float = 30.0
    magnetometer_s: float = 0.0  # time constant of the heading's correction; 0: none
    magnetometer_bias_s: float = 0.0  # of the gyro bias's, 0: none
    magnetometer_strength: float = 0.1  # share by which a good reading may differ
    magnetometer_dip_deg: float = 8.0
    magnetometer_error_deg: float = 20.0  # larger errors count for no more than this
    magnetometer_start: bool = False  # initial heading from the magnetometer
    declination_deg: float = 0.0  # of magnetic North from true North, East positive
    calibration: Calibration = IDENTITY  # of the sensor, and its mounting


def _limits() -> dict[str, tuple[int, int]]:
    """Least and largest value of each integer that keeps every word of the core in range."""
    word = 2**30 - 1
    limits = dict.fromkeys(params.NAMES, (0, word))
    limits |= {
        **calibrations.LIMITS,
        "HALF_ANGLE": (1, 54_000_000),
        "RATE_MHZ": (1000, 1_000_000),  # what the divider of the sensor and the timing can follow
        "DT": (1, 2**25),
        "YAW_W": (-word, word),
        "YAW_Z": (-word, word),
        "ALIGN_TICKS": (2, 32767),
        "ALIGN_MIN": (2, 32767),
        "BIAS_MAX": (1, 1600),
        "RATE_MAX": (1, 26000),
        "STILL_RATE": (1, 26000),
        "STILL_GAIN": (0, 65535),
        "WINDOW": (1, 31),
        "Q_VV_H": (0, 2**28),
        "Q_VV_U": (0, 2**28),
        "DETECTOR": (0, 2),
        "GLRT_WINDOW": (1, layout.WINDOW_MAX),
        "GLRT_ACC": (0, 2**25 - 1),
        "GLRT_RATE": (0, 2**25 - 1),
        **{f"GLRT_{name}": (0, 2**25) for name in ("MAX", "STILL", "WALK", "RUN", "UP", "DOWN")},
        "MOTION_STRIDE": (0, 32767),
        "MOTION_SHARE": (0, 256),
        "MOTION_HOLD": (1, 32767),
        "UNREST_RATE": (0, 2**24),
        "UNREST_ACC": (0, 2**22),
        "UNREST_GROWTH": (0, 2**29),
        "UNREST_MAX": (0, 32512),
        "UNREST_SURE": (0, 32512),
        "R": (2048, 2**22),
        "LIKELIHOOD": (2, 2**20),
        "LOG_FLOOR": (-(2**24), 0),
        "M_A": (0, 16384),
        "M_B": (1, 16384),
        "K_E": (0, 2**20),
        "K": (0, 16384),
        "HEAVY_MIN": (0, 100),
        "BRIDGE_TICKS": (0, 60),
        "RESUME_TICKS": (2, 32767),
        "RESUME_RATE": (1, 32767),
        "MAG_GAIN": (0, 16384),
        "MAG_BIAS_GAIN": (0, 65535),
        "MAG_NORM_TOL": (0, 256),
        "MAG_DIP_TOL": (0, 256),
        "MAG_ERR_MAX": (0, 32767),
        "MAG_ALIGN": (0, 1),
        "DECLINATION": (-32768, 32767),
        "STEP_STANCE": (1, word),
        "SEED": (1, word),
    }
    return limits


LIMITS = _limits()
_SIGMAS = ("unrest_rate_dps", "unrest_accel", "glrt_accel", "glrt_rate_dps", "observation_noise")


def to_integers(settings: Settings, rate_hz: float) -> array[int]:
    """The core's parameter array for samples every 1/rate_hz seconds.

    Raises SolenavError for a rate outside 50 to 600 Hz or a setting that the core can't hold.
    """
    if not 50.0 <= rate_hz <= 600.0:
        raise SolenavError(
            f"a sample rate of {rate_hz:g} Hz is outside what the core can hold (50 to 600 Hz)",
            "resample the recording, or record at 100 to 400 Hz",
        )
    s = settings
    for name in _SIGMAS:
        if not getattr(s, name) > 0:
            raise SolenavError(f"{name} = {getattr(s, name)} is no noise", "give more than 0")
    dt = 1.0 / rate_hz
    relative = rate_hz / REFERENCE_RATE_HZ
    counts_per_accel = mpu9150.ACCEL_LSB_PER_G / mpu9150.STANDARD_GRAVITY
    counts_per_dps = mpu9150.GYRO_LSB_PER_DPS
    half_yaw = -math.radians(s.initial_heading_deg) / 2
    window = max(1, round(s.window_s * rate_hz))
    glrt_window = max(1, round(s.glrt_window_s * rate_hz))
    noise = s.observation_noise * relative
    stride = max(1, round(s.motion_window_s * rate_hz / 128)) if s.motion_window_s else 0

    # An AK8975 gives at most a reading every 10 ms; a share of the error is taken on each.
    reading = max(dt, 0.01)
    yaw_share = reading / s.magnetometer_s if s.magnetometer_s else 0.0
    both = s.magnetometer_s * s.magnetometer_bias_s
    # rad/s of bias for each rad of error, in Q24 counts for each 2**16th of a turn.
    bias_share = reading / both if both else 0.0
    bias_share *= 2 * math.pi / 2**16 * math.degrees(1) * counts_per_dps * 2**24

    def ticks(seconds: float) -> int:
        return max(1, round(seconds * rate_hz))

    def q(value: float, bits: int) -> int:
        return round(value * 2**bits)

    one = 2**30 - 1
    values = {
        "RATE_MHZ": round(rate_hz * 1000),
        **s.calibration.words(),
        "HALF_ANGLE": q(math.radians(1 / counts_per_dps) * dt / 2, 42),
        "DT": q(dt, 30),
        "YAW_W": min(one, q(math.cos(half_yaw), 30)),
        "YAW_Z": max(-one, min(one, q(math.sin(half_yaw), 30))),
        "ALIGN_TICKS": ticks(s.align_s),
        "ALIGN_MIN": max(2, ticks(s.align_min_s)),
        "ALIGN_ACC": round(s.align_accel * counts_per_accel),
        "ALIGN_RATE": round(s.align_rate_dps * counts_per_dps),
        "BIAS_MAX": round(s.bias_max_dps * counts_per_dps),
        "ACC_MIN": q(s.accel_min, 7),
        "ACC_MAX": q(s.accel_max, 7),
        "RATE_MAX": q(s.rate_max_dps * counts_per_dps, 2),
        "VAR_MAX": q(s.accel_variance_max * window, 14),
        "WINDOW": window,
        "DETECTOR": s.detector,
        "GLRT_WINDOW": glrt_window,
        "GLRT_ACC": round(2**10 / (glrt_window * s.glrt_accel**2)),
        "GLRT_RATE": round(2**24 / (glrt_window * (s.glrt_rate_dps * counts_per_dps) ** 2)),
        "GLRT_MAX": q(s.glrt_max, 5),
        "GLRT_STILL": q(s.glrt_still, 5),
        "GLRT_WALK": q(s.glrt_walk, 5),
        "GLRT_RUN": q(s.glrt_run, 5),
        "GLRT_UP": q(s.glrt_up, 5),
        "GLRT_DOWN": q(s.glrt_down, 5),
        "MOTION_STRIDE": stride,
        "MOTION_SHARE": q(s.motion_share, 8),
        "MOTION_HOLD": s.motion_hold,
        "UNREST_RATE": round(2**32 * (2 / (s.unrest_rate_dps * counts_per_dps)) ** 2),
        "UNREST_ACC": round(2**18 / s.unrest_accel**2),
        "UNREST_GROWTH": q(dt / s.unrest_s, 30),
        "UNREST_MAX": q(s.unrest_max, 8),
        "UNREST_SURE": q(s.unrest_sure, 8),
        "STILL_RATE": q(s.still_rate_dps * counts_per_dps, 2),
        "STILL_TICKS": ticks(s.still_s),
        "STILL_GAIN": q(dt / s.still_time_constant_s, 22),
        "GAMMA": q(mpu9150.STANDARD_GRAVITY * dt, 30),
        "GAMMA2": q((mpu9150.STANDARD_GRAVITY * dt) ** 2, 30),
        "Q_VV_H": q(s.velocity_noise_horizontal * dt, 26),
        "Q_VV_U": q(s.velocity_noise_up * dt, 26),
        "STRIKE": q(s.strike_noise**2 * dt / REFERENCE_RATE_HZ, 40),
        "Q_TT": q(s.tilt_noise * dt, 30),
        "FREEZE_TICKS": ticks(s.freeze_s),
        "P_VV_0": q(s.initial_velocity_variance, 26),
        "P_TT_0": q(s.initial_tilt_variance, 30),
        "R": q(noise, 24),
        "LIKELIHOOD": q(1 / math.sqrt(2 * math.log(2) * noise), 11),
        "M2_MAX": q(s.m2_max, 10),
        "LOG_FLOOR": q(s.log_floor / math.log(2), 16),
        "M_A": q(s.threshold_min, 14),
        "M_B": q(s.threshold_max, 14),
        "K_E": q(s.threshold_growth / relative, 14),
        "K": q(s.heavy_weight, 14),
        "HEAVY_MIN": s.heavy_min,
        "LOCKOUT_TICKS": ticks(s.lockout_s),
        "LOCKOUT_MIN": s.lockout_min,
        "P_VV_H1": q(s.lockout_velocity_variance, 26),
        "BRIDGE_TICKS": round(s.bridge_s * rate_hz),
        "RESUME_TICKS": max(2, ticks(s.resume_s)),
        "RESUME_ACC": round(s.resume_accel * counts_per_accel),
        "RESUME_RATE": round(s.resume_rate_dps * counts_per_dps),
        "MAG_GAIN": round(yaw_share * HALF_TURN),
        "MAG_BIAS_GAIN": round(bias_share),
        "MAG_NORM_TOL": q(s.magnetometer_strength, 8),
        "MAG_DIP_TOL": q(math.radians(s.magnetometer_dip_deg), 8),
        "MAG_ERR_MAX": round(s.magnetometer_error_deg * 2**16 / 360),
        "MAG_ALIGN": int(s.magnetometer_start),
        "DECLINATION": round(s.declination_deg * 2**16 / 360),
        "STEP_SWING": ticks(s.step_swing_s),
        "STEP_STANCE": ticks(s.step_stance_s),
        "SEED": s.seed,
    }
    return checked([values[name] for name in params.NAMES])


def checked(values: list[int]) -> array[int]:
    """The parameter array, if every value is in range; else SolenavError naming the first bad."""
    if len(values) != len(params.NAMES):
        raise SolenavError(
            f"{len(values)} parameters where the core has {len(params.NAMES)}",
            "firmware and host differ: install the same version on both",
        )
    for name, value in zip(params.NAMES, values, strict=True):
        low, high = LIMITS[name]
        if not low <= value <= high:
            raise SolenavError(
                f"parameter {name} = {value} is outside {low} to {high}",
                "choose a setting that the core's word can hold",
            )
    found = array("i", values)
    wrong = params.conflict(found)
    if wrong:
        raise SolenavError(f"parameters {wrong[0]}", wrong[1])
    return found


def _mounting(axes: Sequence[int]) -> FloatArray:
    """The matrix (3, 3) from sensor to body axes, of the sensor's right, front and up."""
    out = np.zeros((3, 3))
    for row, axis in enumerate(axes):
        out[row, abs(axis) - 1] = np.sign(axis)
    return out


def body_samples(
    counts: NDArray[np.int16], values: array[int], mount: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Specific force (n, 3) in m/s² and rate (n, 3) in rad/s, body axes, as the core has them.

    `counts` (n, 6 or more) through the calibration in the parameters `values`; `mount` (3,) as
    in the core's state.
    """
    p = named(values)
    raw = counts[:, :6].astype(np.float64)

    def corrected(name: str, one: float, zero: float, part: FloatArray) -> FloatArray:
        matrix = np.array([[p[f"{name}_{a}{b}"] for b in "XYZ"] for a in "XYZ"]) / one
        bias = np.array([p[f"{name}_B{a}"] for a in "XYZ"]) / zero
        return (part @ matrix.T - bias) @ _mounting(mount).T

    force = corrected("ACC", 2**22, 2**20, raw[:, :3])
    return force, corrected("GYRO", 2**14, 2**20, raw[:, 3:]) * mpu9150.GYRO_RADPS_PER_LSB


def named(values: array[int]) -> dict[str, int]:
    """Parameter names to values."""
    return dict(zip(params.NAMES, values, strict=True))
