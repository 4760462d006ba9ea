"""A recording played to a sensor, on the recording's own clock."""

from solenav.sim.board import simtime
from solenav.sim.board.feed import Feed
from solenav.sim.board.mpu9150_registers import Mpu9150

try:
    from collections.abc import Callable
except ImportError:  # MicroPython: annotations are never evaluated there
    pass


class Playback:
    """The recording's clock starts when the sensor is first set to sample, and never stops.

    What it holds for times when the sensor sleeps is lost, as on a foot. Before it starts an
    awake sensor measures what the first record says, dithered, at the rate that it is set to.
    `rise` is called when INT goes up, `started` when the clock starts. `over` is True from the
    last record on.

    For faults: `factor` is the sensor's sample spacing against the recording's (what it measures
    is interpolated from then on), `changes` are called with the values (a list) and the
    recording's time.
    """

    def __init__(
        self,
        sensor: Mpu9150,
        feed: Feed,
        rise: Callable[[], None],
        started: Callable[[], None] = lambda: None,
    ) -> None:
        self.over = False
        self.start = -1
        self.factor = 1.0
        self.changes: list[Callable[[list[int], int], None]] = []
        self._sensor = sensor
        self._feed = feed
        self._rise = rise
        self._started = started
        self._time = -1
        self._values: tuple[int, ...] = ()
        self._after: tuple[int, tuple[int, ...]] | None = None  # next record, with a clock off
        self._spacing = 0
        self._ticking = False  # before the start
        self._ticks = 0
        self._take()

    @property
    def elapsed(self) -> int:
        """µs of the recording; -1 before it starts."""
        return simtime.now() - self.start if self.start >= 0 else -1

    def look(self) -> None:
        """After every write to the sensor: it may have been set to sample."""
        if self.start >= 0:
            return
        if self._sensor.sampling:
            self.start = simtime.now()
            self._schedule()
            self._started()
        elif self._sensor.running and not self._ticking:
            self._ticking = True
            simtime.at(simtime.now() + self._sensor.period_us, self._tick)

    def save(self) -> list:
        """What `load` needs to go on after a restart of the processor."""
        return [self.start] + self._feed.place()

    def load(self, saved: list) -> None:
        self.start = saved[0]
        if self.start >= 0:
            self._feed.seek(saved[1:])
            self._take()
            self._schedule()

    def _take(self) -> None:
        self._time = self._feed.next()
        self._values = self._feed.values
        self.over = self._time < 0

    def _schedule(self) -> None:
        if not self.over:
            simtime.at(self.start + self._time, self._sample)

    def _sample(self) -> None:
        values = self._values
        if self.changes:
            altered = list(values)
            for change in self.changes:
                change(altered, self._time)
            values = tuple(altered)
        if self._sensor.sample(values):
            self._rise()
        if self.factor != 1.0 or self._after:
            self._step()
        else:
            self._take()
        self._schedule()

    def _step(self) -> None:
        """The next sample of a sensor whose clock is off."""
        before = self._time, self._values
        if self._after is None:
            self._after = self._record()
            self._spacing = self._after[0] - before[0] if self._after else 0
        due = before[0] + round(self._spacing * self.factor)
        while self._after and self._after[0] < due:
            before = self._after
            self._after = self._record()
        if not self._after:
            self.over = True
            return
        span = self._after[0] - before[0]
        part = due - before[0]
        pairs = zip(before[1], self._after[1])
        self._values = tuple([a + ((b - a) * part + span // 2) // span for a, b in pairs])
        self._time = due

    def _record(self):
        time = self._feed.next()
        return None if time < 0 else (time, self._feed.values)

    def _tick(self) -> None:
        """A sample before the recording starts."""
        self._ticking = False
        if self.start >= 0 or not self._sensor.running or self.over:
            return
        self._ticks += 1
        dither = self._ticks % 3 - 1
        first = self._values
        values = [v + dither for v in first[:7]]
        if self._sensor.sample(tuple(values) + tuple(first[7:])):
            self._rise()
        self._ticking = True
        simtime.at(simtime.now() + self._sensor.period_us, self._tick)
