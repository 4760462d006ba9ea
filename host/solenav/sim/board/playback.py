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

    What it holds for times when the sensor sleeps is lost, as on a foot. `rise` is called when
    INT goes up. `nacks`: times (from, to) in µs of the recording during which nothing on the bus
    answers. `over` is True from the last record on.
    """

    def __init__(
        self, sensor: Mpu9150, feed: Feed, rise: Callable[[], None], nacks: list[tuple[int, int]]
    ) -> None:
        self.over = False
        self._sensor = sensor
        self._feed = feed
        self._rise = rise
        self._nacks = nacks
        self._start = -1

    def look(self) -> None:
        """After every write to the sensor: it may have been set to sample."""
        if self._start < 0 and self._sensor.sampling:
            self._start = simtime.now()
            self._schedule()

    def silent(self) -> bool:
        """Whether the bus is disturbed now."""
        if self._start < 0:
            return False
        elapsed = simtime.now() - self._start
        for begin, end in self._nacks:
            if begin <= elapsed < end:
                return True
        return False

    def _schedule(self) -> None:
        time = self._feed.next()
        if time < 0:
            self.over = True
        else:
            simtime.at(self._start + time, self._sample)

    def _sample(self) -> None:
        if self._sensor.sample(self._feed.values):
            self._rise()
        self._schedule()
