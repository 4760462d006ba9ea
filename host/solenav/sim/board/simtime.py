"""Simulated `time`: a clock in µs that passes by waiting, with one event to come.

The tick and sleep functions that MicroPython has on microcontrollers. Work of the processor takes
no time, except that each look at the clock takes 1 µs, so that every busy loop ends.
"""

import time as _wall

try:
    from collections.abc import Callable
except ImportError:  # MicroPython: annotations are never evaluated there
    pass

_PERIOD = 1 << 30  # at which tick counts wrap on 32-bit microcontrollers
_NEVER = 1 << 60

_now = 0
_due = _NEVER
_event: Callable[[], None] | None = None
_happened = False  # an event since the last wait
_started = -1  # wall clock (µs) at simulated 0 where simulated time follows it


def follow_wall_clock() -> None:
    """From now on simulated time is never ahead of the wall clock."""
    global _started
    _started = _wall.time_ns() // 1000 - _now


def now() -> int:
    """µs since the start; unlike the tick counts it doesn't wrap."""
    return _now


def at(time_us: int, event: Callable[[], None]) -> None:
    """Call `event` when `time_us` has come; there is never more than one to come."""
    global _due, _event
    _due = max(time_us, _now)
    _event = event


def wait(most_us: int) -> None:
    """Until the event, or for `most_us`."""
    global _happened
    advance(min(_due - _now, most_us))
    _happened = False


def woken() -> bool:
    """Whether an event came since the last wait; asked once, it is forgotten."""
    global _happened
    happened = _happened
    _happened = False
    return happened


def advance(us: int) -> None:
    """Let time pass; the events of that time happen, each with the clock at its own time."""
    global _now, _due, _happened
    target = _now + us
    while _due <= target:
        _now = max(_now, _due)
        _due = _NEVER
        _happened = True
        if _event is not None:
            _event()
    _now = max(_now, target)
    if _started >= 0:
        ahead = _now - (_wall.time_ns() // 1000 - _started)
        if ahead > 1000:
            _wall.sleep_us(ahead)


def ticks_us() -> int:
    value = _now % _PERIOD
    advance(1)
    return value


def ticks_ms() -> int:
    value = _now // 1000 % _PERIOD
    advance(1)
    return value


def ticks_add(ticks: int, delta: int) -> int:
    return (ticks + delta) % _PERIOD


def ticks_diff(end: int, start: int) -> int:
    """Signed: right where the two are less than half a period apart."""
    half = _PERIOD // 2
    return (end - start + half) % _PERIOD - half


def sleep_us(us: int) -> None:
    advance(us)


def sleep_ms(ms: int) -> None:
    advance(1000 * ms)


def sleep(seconds: float) -> None:
    advance(round(1_000_000 * seconds))
