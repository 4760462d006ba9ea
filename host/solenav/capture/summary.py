"""What a capture holds, in numbers: for `solenav info` and for deciding whether to trust it."""

from __future__ import annotations

from binascii import crc32
from typing import Any

import numpy as np

from solenav.capture.contents import Capture, Table, unwrap
from solenav.link.units import POSE_FLAGS
from solenav.mpu9150 import celsius
from solenav_core import messages, selftest

_TESTED = {1: "accelerometer", 2: "gyro", 4: "magnetometer"}


def summary(capture: Capture) -> dict[str, Any]:
    """Duration, messages, gaps, rates, faults and hashes; nothing in it raises on damage."""
    out: dict[str, Any] = {
        "capture": str(capture.path),
        "messages": dict(capture.counts),
        "damaged": dict(capture.damaged),
        "cut_off_bytes": capture.cut_off_bytes,
        "wall_clock_s": round(capture.arrival[1] - capture.arrival[0], 3),
    }
    if capture.hellos:
        _order, hello = capture.hellos[-1]
        out["firmware"] = {
            "text": hello["text"].decode("utf-8", "replace"),
            "build": f"{hello['build']:08x}",
            "schema": f"{hello['schema']:04x}",
            "schema_is_ours": hello["schema"] == messages.SCHEMA,
            "sensor": messages.SENSORS[min(hello["sensor"], len(messages.SENSORS) - 1)],
            "rate_hz": hello["rate"] / 1000,
            "pose_every": hello["pose_every"],
            "self_test": _self_test(hello["self_test"]),
            "sensor_test": _sensor_test(hello["sensor_test"]),
            "boot_reason": hello["boot_reason"],
        }
    if capture.params:
        out["params"] = f"{crc32(capture.params[-1][1]):08x}"
    out["starts"] = 1 + max(_restarts(capture.samples), _restarts(capture.poses))
    if len(capture.samples):
        out["samples"] = _samples(capture)
    if len(capture.aligns):
        out["alignment"] = _alignment(capture.aligns)
    if len(capture.poses):
        out["poses"] = _poses(capture.poses)
    if len(capture.statuses):
        last = capture.statuses.rows[-1]
        out["status"] = {
            name: int(last[name])
            for name in last.dtype.names
            if name not in ("mode", "period", "temperature")
        }
        out["status"]["learned_period_us"] = round(int(last["period"]) / 256, 3)
    out["log"] = [f"tick {tick}, {level}: {text}" for tick, level, text in capture.logs]
    return out


def _self_test(failed: int) -> str:
    """The board's verdict on itself, from HELLO."""
    if failed == 0:
        return "passed"
    return f"FAILED: {core_test(failed)}"


def core_test(failed: int) -> str:
    """The name of the core's self-test that HELLO gives by its number, from 1."""
    names = [name for name, _test in selftest.TESTS]
    return names[failed - 1] if failed <= len(names) else str(failed)


def _sensor_test(bits: int) -> str:
    """What the sensor's own tests said, from HELLO."""
    failed = failed_sensors(bits)
    if failed:
        return f"FAILED: {', '.join(failed)}"
    return "not run: it was moved" if bits & messages.NOT_TESTED else "passed"


def failed_sensors(bits: int) -> list[str]:
    """The sensors whose own tests failed, from HELLO's bits."""
    return [name for bit, name in _TESTED.items() if bits & bit]


def _restarts(table: Table) -> int:
    return int(np.count_nonzero(np.diff(table.tick) < 0))


def _poses(poses: Table) -> dict[str, Any]:
    """How many, and how many of them with which flag; how far the last one came."""
    flags = poses.rows["flags"]
    words = {name: int(np.count_nonzero(flags & flag)) for flag, name in POSE_FLAGS.items()}
    return {
        "count": len(poses),
        "flagged": words,
        "steps": int(poses.rows["steps"][-1]),
        "distance_m": round(float(poses.rows["distance"][-1]) / 2**10, 2),
    }


def _samples(capture: Capture) -> dict[str, Any]:
    ticks = capture.samples.tick
    lost = np.diff(ticks) - 1
    lost = lost[lost > 0]  # a restart counts from 1 again and loses nothing
    flags = capture.samples.rows["flags"]
    stamps = unwrap(capture.samples.rows["time"])
    steps = np.diff(stamps)[np.diff(ticks) == 1]
    period = float(np.mean(steps)) if len(steps) else 0.0
    temperatures = capture.samples.rows["temperature"]
    coldest, hottest = temperatures.min(), temperatures.max()
    return {
        "count": len(ticks),
        "duration_s": round(float(stamps[-1] - stamps[0]), 3),
        "measured_rate_hz": round(1 / period, 3) if period else None,
        "gaps": len(lost),
        "missing": int(lost.sum()),
        "longest_gap": int(lost.max()) if len(lost) else 0,
        "clipped_accel": int(np.count_nonzero(flags & messages.CLIPPED_ACC)),
        "clipped_gyro": int(np.count_nonzero(flags & messages.CLIPPED_GYRO)),
        "temperature_c": [round(float(celsius(edge)), 1) for edge in (coldest, hottest)],
        "overrun": int(np.count_nonzero(flags & messages.GAP_BEFORE)),
    }


def _alignment(aligns: Table) -> dict[str, Any]:
    row = aligns.rows[-1]
    return {
        "tick": int(aligns.tick[-1]),
        "ticks_used": int(row["ticks"]),
        "restarts": int(row["restarts"]),
        "gravity": round(int(row["gravity"]) / 2**20, 4),
        "bias_dps": [round(float(b) / 2**20 / 16.4, 4) for b in row["bias"]],
    }
