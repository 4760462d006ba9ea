"""Simulated `time`: a clock in µs that passes by waiting, with events to come.

The tick and sleep functions that MicroPython has on microcontrollers. Work of the processor takes
no time, except that each look at the clock takes 1 µs, so that every busy loop ends. After a
reset `now` goes on while the tick counts start from 0 again, as the processor's do.

For the rest of the board: `at` calls a function at a time, `advance` lets time pass, `hold_off`
lets it pass with interrupts disabled, `end` ends the process as a reset does.
"""

import time as _wall

try:
    from collections.abc import Callable
except ImportError:  # MicroPython: annotations are never evaluated there
    pass

_PERIOD = 1 << 30  # at which tick counts wrap on 32-bit microcontrollers
_NEVER = 1 << 60
_CLOCK = 1_609_459_200  # s: where the rp2's clock starts at each boot, 2021

_now = 0
_booted = 0
_events: list[tuple[int, Callable[[], None]]] = []  # the next one last
_next = _NEVER
_happened = False  # an interrupt since the last wait
_held = 0  # how often interrupts are disabled
_pending: list[Callable[[], None]] = []
_started = -1  # wall clock (µs) at simulated 0 where simulated time follows it
_code = -1  # exit code of a process that has ended


def follow_wall_clock() -> None:
    """From now on simulated time is never ahead of the wall clock."""
    global _started
    _started = _wall.time_ns() // 1000 - _now


def clear(now_us: int = 0) -> None:
    """No events, no interrupts to come; the clock at `now_us`."""
    global _now, _booted, _next, _happened, _held, _code
    _now = now_us
    _booted = now_us
    _events.clear()
    _next = _NEVER
    _happened = False
    _held = 0
    _pending.clear()
    _code = -1


def boot() -> None:
    """The processor starts: tick counts are 0."""
    global _booted
    _booted = _now


def now() -> int:
    """µs since the board was first switched on; unlike the tick counts it doesn't wrap."""
    return _now


def at(time_us: int, event: Callable[[], None]) -> None:
    """Call `event` once when `time_us` has come."""
    global _next
    i = len(_events)
    while i and _events[i - 1][0] <= time_us:
        i -= 1
    _events.insert(i, (time_us, event))
    _next = _events[-1][0]


def due() -> int:
    """When the next event comes, in µs; later than any other time where there is none."""
    return _next


def wait(most_us: int) -> None:
    """Until the next event, or for `most_us`."""
    global _happened
    advance(min(max(0, _next - _now), most_us))
    _happened = False


def woken() -> bool:
    """Whether an interrupt came since the last wait; asked once, it is forgotten."""
    global _happened
    happened = _happened
    _happened = False
    return happened


def interrupt(handler: Callable[[], None]) -> None:
    """Wake the processor and call `handler`; once, when they are enabled, however often it came."""
    global _happened
    _happened = True
    if not _held:
        handler()
    elif handler not in _pending:
        _pending.append(handler)


def disable() -> int:
    """Interrupts wait; returns what `enable` takes."""
    global _held
    _held += 1
    return _held - 1


def enable(state: int) -> None:
    """Back to before `disable`; interrupts that waited come now."""
    global _held
    _held = state
    while not _held and _pending:
        _pending.pop(0)()


def hold_off(us: int) -> None:
    """Time passes with interrupts disabled."""
    state = disable()
    advance(us)
    enable(state)


def end(code: int) -> None:
    """The processor stops here: SystemExit, again at whatever the program still tries."""
    global _code
    _code = code
    raise SystemExit(code)


def check() -> None:
    """SystemExit where the processor has stopped."""
    if _code >= 0:
        raise SystemExit(_code)


def advance(us: int) -> None:
    """Let time pass; the events of that time happen, each with the clock at its own time."""
    global _now, _next
    target = _now + us
    if _next > target and _code < 0 and _started < 0:
        _now = target
        return
    check()
    while _next <= target:
        time_us, event = _events.pop()
        _next = _events[-1][0] if _events else _NEVER
        _now = max(_now, time_us)
        event()
    _now = max(_now, target)
    if _started >= 0:
        ahead = _now - (_wall.time_ns() // 1000 - _started)
        if ahead > 1000:
            _wall.sleep_us(ahead)


def time() -> int:
    """s, of a clock that nobody has set."""
    return _CLOCK + (_now - _booted) // 1_000_000


def ticks_us() -> int:
    value = (_now - _booted) % _PERIOD
    advance(1)
    return value


def ticks_ms() -> int:
    value = (_now - _booted) // 1000 % _PERIOD
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
