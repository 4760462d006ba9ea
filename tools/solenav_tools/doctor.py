"""Whether a board is well: what it says of itself, and what can be measured from here."""

from __future__ import annotations

import time
from array import array
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import serial

from solenav import parameters
from solenav.capture.summary import core_test, failed_sensors
from solenav.errors import SolenavError
from solenav.link import Damage, Frame, missing, unpack
from solenav.link.units import complaints, mode_text
from solenav.mpu9150 import celsius
from solenav_core import messages
from solenav_core.tables.defaults import PARAMS
from solenav_tools.conversation import Conversation, Refused
from solenav_tools.ports import PortVanished, open_port
from solenav_tools.staging import build_hash

PASS, WARN, FAIL, SKIP = "pass", "warn", "fail", "skipped"

_ANSWER_S = 3.0
_READS = 500
# A period's learned value may differ so much from the nominal one: the data sheet's clock.
_CLOCK_SHARE = 0.05
# FIFO samples are stamped by count, so stamps spread little; a pulse's by an interrupt's latency.
_JITTER_SHARE = 0.1
_BUS_SHARE = 0.001
_FREE_WARN = 100_000  # bytes: seven minutes of walking
_HOT_C = 60.0


class Check(NamedTuple):
    """One line: what was looked at, PASS, WARN, FAIL or SKIP, what was found, what to do."""

    name: str
    verdict: str
    found: str
    remedy: str = ""


@dataclass
class Seen:
    """What came from the board while it was listened to."""

    hello: dict[str, Any] = field(default_factory=dict)
    statuses: list[dict[str, Any]] = field(default_factory=list)
    samples: list[tuple[int, dict[str, Any]]] = field(default_factory=list)  # tick, fields
    logs: list[str] = field(default_factory=list)
    flags: int = 0  # of the last POSE
    frames: int = 0
    damaged: int = 0
    lost: int = 0
    _seq: int = -1

    def take(self, item: Frame | Damage) -> None:
        """Keep what a check will ask for."""
        if isinstance(item, Damage):
            self.damaged += 1
            return
        self.frames += 1
        self.lost += missing(self._seq, item)
        self._seq = item.seq
        fields = unpack(item)
        if item.kind == messages.HELLO:
            self.hello = fields
        elif item.kind == messages.STATUS:
            self.statuses.append(fields)
        elif item.kind == messages.SAMPLE:
            self.samples.append((item.tick, fields))
        elif item.kind == messages.POSE:
            self.flags = fields["flags"]
        elif item.kind == messages.LOG:
            level = messages.LEVELS[min(fields["level"], 2)]
            self.logs.append(f"{level}: {fields['text'].decode('utf-8', 'replace')}")


def examine(port: str, *, seconds: float = 5.0, bus: bool = False) -> list[Check]:
    """All checks of the board at a port, or at one that solenav.toml names.

    SolenavError where nobody answers or the port vanishes.
    """
    with open_port(port) as opened:
        try:
            return list(Doctor(opened, seconds).examine(bus=bus))
        except PortVanished:
            raise SolenavError(
                f"{port} vanished in the middle", "plug it in and start again", 1
            ) from None


class Doctor:
    """Examines the board at an open port. PortVanished where it goes away."""

    def __init__(self, port: serial.Serial, seconds: float) -> None:
        self._seconds = seconds
        self.seen = Seen()
        self._talk = Conversation(port, self.seen.take)

    def examine(self, *, bus: bool) -> Iterator[Check]:
        """One check after the other. `bus`: test the bus even where that ends a walk.

        SolenavError where nobody speaks to us, or another schema.
        """
        hello = self._talk.hello()
        params = self._talk.params()
        text = hello["text"].decode("utf-8", "replace")
        yield Check("board", PASS, text)
        yield self._build()
        yield _self_test(hello["self_test"])
        yield _sensor(hello["sensor"])
        yield _sensor_test(hello["sensor_test"])
        yield _parameters(params)
        self._listen(self._seconds)
        yield from self._status()
        yield self._jitter()
        yield self._clipping()
        yield self._link()
        yield self._commands()
        yield self._trust()
        yield self._flash()
        yield from self._bus(bus)

    def _listen(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for _item in self._talk.items():
                pass  # `seen` has it

    def _build(self) -> Check:
        there, here = self.seen.hello["build"], build_hash()
        if there == here:
            return Check("firmware", PASS, f"build {there:08x}, as here")
        return Check(
            "firmware",
            WARN,
            f"build {there:08x}, here {here:08x}; the same messages",
            "solenav flash, to have the same on both sides",
        )

    def _status(self) -> Iterator[Check]:
        if not self.seen.statuses:
            yield Check("state", FAIL, "no STATUS came", "look at the link first")
            return
        s = self.seen.statuses[-1]
        mode = mode_text(s["mode"])
        if s["mode"] == messages.FAULT:
            last = self.seen.logs[-1] if self.seen.logs else ""
            yield Check("state", FAIL, f"{mode}; {last}", "docs: troubleshooting, the sensor")
        else:
            yield Check("state", PASS, mode)
        hot = celsius(s["temperature"])
        yield Check(
            "temperature",
            WARN if hot > _HOT_C else PASS,
            f"{hot:.1f} °C",
            "it drifts: calibrate warm" if hot > _HOT_C else "",
        )
        yield Check(
            "memory",
            PASS if s["heap"] > 8192 else WARN,
            f"{s['heap']} bytes free",
            "" if s["heap"] > 8192 else "switch the black box off",
        )
        if s["bus_khz"] < 400:
            yield Check(
                "bus speed",
                WARN,
                f"slowed to {s['bus_khz']} kHz: {s['bus_errors']} errors so far",
                "shorter wires, stronger pull-ups (2 kΩ)",
            )

    def _jitter(self) -> Check:
        samples = self.seen.samples
        steps = [
            (one["time"] - before["time"]) % 2**32
            for (tick, before), (next_tick, one) in pairwise(samples)
            if next_tick == tick + 1
        ]
        if len(steps) < 20 or not self.seen.statuses:
            return Check("sampling", SKIP, "no samples come", "ASK_START, or send_samples on")
        learned = self.seen.statuses[-1]["period"] / 256
        nominal = 1e9 / max(self.seen.hello["rate"], 1)
        spread = float(np.std(steps))
        found = f"period {learned:.1f} µs ({learned / nominal - 1:+.2%}), stamps ± {spread:.1f} µs"
        lost = sum(one["lost"] for _tick, one in samples)
        if abs(learned / nominal - 1) > _CLOCK_SHARE:
            return Check("sampling", FAIL, found, "the sensor's clock is off: another sensor")
        if lost or spread > _JITTER_SHARE * nominal:
            return Check(
                "sampling",
                WARN,
                f"{found}, {lost} samples lost",
                '"sampling": "fifo" loses none to flash; look at the bus',
            )
        return Check("sampling", PASS, found)

    def _clipping(self) -> Check:
        clipped = messages.CLIPPED_ACC | messages.CLIPPED_GYRO
        count = sum(bool(one["flags"] & clipped) for _tick, one in self.seen.samples)
        total = self.seen.statuses[-1]["clipped"] if self.seen.statuses else count
        if total:
            return Check(
                "clipping",
                WARN,
                f"{total} samples at full scale so far",
                "a softer mount; some at each step do no harm",
            )
        return Check("clipping", PASS, "none")

    def _link(self) -> Check:
        seen = self.seen
        drops = 0
        if seen.statuses:
            last = seen.statuses[-1]
            drops = sum(last[f"dropped_{what}"] for what in ("samples", "poses", "others"))
        found = (
            f"{seen.frames} frames, {seen.damaged} damaged, {seen.lost} lost, "
            f"{drops} dropped by the board"
        )
        # The one that was under way when we joined is no fault.
        if seen.damaged > 1 or seen.lost:
            return Check("link", FAIL, found, "a shorter wire, common ground, another adapter")
        if drops:
            return Check("link", WARN, found, "send fewer poses (pose_every), or no samples")
        return Check("link", PASS, found)

    def _commands(self) -> Check:
        """The way to the board: what it heard damaged since we are here."""
        if len(self.seen.statuses) < 2:
            return Check("commands", SKIP, "too little was heard")
        first, last = self.seen.statuses[0], self.seen.statuses[-1]
        bad = last["bad_commands"] - first["bad_commands"]
        if bad:
            return Check(
                "commands",
                FAIL,
                f"{bad} came damaged to the board",
                "its RX: wire, ground, and nobody else sending",
            )
        return Check("commands", PASS, "all were heard")

    def _trust(self) -> Check:
        found = complaints(self.seen.flags)
        if found:
            return Check("pose", WARN, ", ".join(found), "stand still and start anew")
        return Check("pose", PASS, "no complaint")

    def _flash(self) -> Check:
        self._talk.ask(messages.ASK_FILES, 0)
        answer = self._talk.answer(messages.FILE, _ANSWER_S)
        if answer is None:
            return Check("flash", SKIP, "the board has no black box", '"blackbox": "stop"')
        file = unpack(answer)
        found = f"{file['free']} bytes free, {file['count']} files"
        if self.seen.statuses and self.seen.statuses[-1]["log_lost"]:
            return Check("flash", FAIL, f"{found}; frames were lost", "solenav download --erase")
        if file["free"] < _FREE_WARN:
            return Check("flash", WARN, found, "solenav download --erase")
        return Check("flash", PASS, found)

    def _bus(self, wished: bool) -> Iterator[Check]:
        mode = self.seen.statuses[-1]["mode"] if self.seen.statuses else messages.FAULT
        walking = mode in (messages.RUNNING, messages.RESUMING)
        if walking and not wished:
            yield Check("bus", SKIP, "a walk is going on", "--bus tests it, and ends the walk")
            return
        sampling = mode != messages.IDLE
        if sampling:
            self._tell(messages.ASK_STOP)
        try:
            for khz in (400, 100):
                yield self._bus_at(khz)
        finally:
            if sampling:
                self._tell(messages.ASK_START)

    def _tell(self, kind: int) -> None:
        """Whether it does that is its own affair: with a fault it may not be able to."""
        with suppress(Refused):
            self._talk.asked(kind)

    def _bus_at(self, khz: int) -> Check:
        self._talk.ask(messages.ASK_BUS_TEST, khz, _READS)
        answer = self._talk.answer(messages.BUS_TEST, 2 * _ANSWER_S)
        if answer is not None:
            return _bus_verdict(unpack(answer))
        return Check(f"bus at {khz} kHz", FAIL, "the board didn't answer", "look at the link first")


def _bus_verdict(found: dict[str, Any]) -> Check:
    name = f"bus at {found['khz']} kHz"
    text = f"{found['errors']} errors in {found['reads']} reads"
    share = found["errors"] / max(found["reads"], 1)
    if share == 0:
        return Check(name, PASS, text)
    remedy = "pull-ups near 2 kΩ, SDA and SCL each twisted with ground, a shorter cable"
    return Check(name, WARN if share <= _BUS_SHARE else FAIL, text, remedy)


def _parameters(values: array[int] | None) -> Check:
    if values is None:
        return Check("parameters", FAIL, "PARAMS came incomplete", "look at the link first")
    try:
        parameters.checked(list(values))
    except SolenavError as error:
        return Check("parameters", FAIL, error.message, error.remedy)
    rate = values[messages.NAMES.index("RATE_MHZ")] / 1000
    other = [
        name
        for name, value, usual in zip(messages.NAMES, values, PARAMS, strict=True)
        if value != usual
    ]
    own = f", not the defaults: {', '.join(other[:6])}" if other else ", all defaults"
    more = f" and {len(other) - 6} more" if len(other) > 6 else ""
    return Check("parameters", PASS, f"sound, {rate:g} Hz{own}{more}")


def _self_test(failed: int) -> Check:
    if not failed:
        return Check("core", PASS, "every kernel gives the known bits")
    name = core_test(failed)
    return Check("core", FAIL, f"self-test {name} fails: it won't navigate", "solenav flash")


def _sensor(kind: int) -> Check:
    name = messages.SENSORS[min(kind, len(messages.SENSORS) - 1)]
    if name == "MPU-9150":
        return Check("sensor", PASS, name)
    if name == "none":
        return Check("sensor", FAIL, "none was found", "VCC, GND, SDA, SCL; AD0 to GND")
    return Check("sensor", WARN, f"{name}: no magnetometer, so no magnetic heading")


def _sensor_test(bits: int) -> Check:
    failed = failed_sensors(bits)
    if failed:
        return Check("sensor test", FAIL, f"{', '.join(failed)} failed", "another sensor")
    if bits & messages.NOT_TESTED:
        return Check("sensor test", WARN, "not run: it was moved", "lie it still and restart")
    return Check("sensor test", PASS, "accelerometer, gyro, magnetometer within their limits")
