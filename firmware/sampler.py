"""When to read the sensor: data-ready interrupts, time stamps, lost samples, bus errors."""

from time import ticks_diff, ticks_us

from machine import Pin
from mpu9150 import SensorError

from solenav_core.compat import const
from solenav_core.navigator import new_sample

_GAP_BEFORE = const(4)  # messages.GAP_BEFORE
_LOST_MAX = const(127)  # messages.LOST_MAX
_I_FLAGS = const(9)
_FAILURES_MAX = const(3)
_SILENT_PERIODS = const(10)
_FRACTION = const(14)  # bits of the learned period: 20 ms still fit a small int
_GAIN = const(6)  # each difference moves the learned period by 1/64


class Sampler:
    """Reads one sample per data-ready pulse; counts everything that goes wrong.

    After `read` has returned True: `sample` (counts), `time` (µs, modulo 2**32), `flags` (those
    of SAMPLE). Nothing is allocated per sample while `time` is below 2**30.
    """

    def __init__(self, sensor, pin, rate_mhz):
        self.sample = new_sample()
        self.time = 0
        self.flags = 0
        self.samples = 0
        self.overruns = 0
        self.gaps = 0
        self.lost = 0
        self.bus_errors = 0
        self.recoveries = 0
        self.clipped = 0
        self._sensor = sensor
        self._pin = pin
        self._rate_mhz = rate_mhz
        self._period = (1_000_000_000 << _FRACTION) // rate_mhz
        self._count = 0  # pulses, modulo 2**16
        self._stamp = 0  # ticks_us of the last pulse
        self._seen = 0  # pulses whose sample was read or lost
        self._last = ticks_us()
        self._failures = 0
        self._gap = False
        self._missing = 0  # samples lost since the last good one
        # Made once: a bound method made per call would be allocated anew.
        self._handler = self._on_pulse

    def start(self):
        """Sample afresh; the sensor must be awake. Returns its rate in mHz; SensorError."""
        self.samples = 0
        self._gap = False
        self._missing = 0
        return self._run()

    def resume(self):
        """Set the sensor up anew and go on, with a gap. SensorError where that fails."""
        self._sensor.wake()
        self._run()
        self.recoveries += 1
        self._gap = True

    def stop(self):
        """Put the sensor to sleep. SensorError where it doesn't answer."""
        self._pin.irq(handler=None)
        self._sensor.sleep()

    def ready(self):
        """Whether a sample waits. SensorError after ten sample periods without a pulse."""
        if self._count != self._seen:
            return True
        if ticks_diff(ticks_us(), self._last) > _SILENT_PERIODS * (self._period >> _FRACTION):
            raise SensorError("no data-ready pulse for ten sample periods: check the INT wire")
        return False

    def read(self):
        """Take the waiting sample; False where it was lost on the bus.

        A failed transfer is tried once more. After three failures in a row the sensor is set up
        anew; SensorError where that fails.
        """
        count = self._count
        stamp = self._stamp
        if count != self._count:
            # A pulse came between the two loads: both now belong to it.
            count = self._count
            stamp = self._stamp
        fresh = (count - self._seen) & 0xFFFF
        self._seen = count
        elapsed = self._pass_time(stamp)
        if fresh > 1:
            self.overruns += fresh - 1
            self._missing += fresh - 1
            self._gap = True
        elif self.samples and not self._gap:
            self._period += ((elapsed << _FRACTION) - self._period) >> _GAIN
        if not self._transfer():
            self._missing += 1
            self._gap = True
            return False
        self.samples += 1
        if self.flags:
            self.clipped += 1
        if self._gap:
            self.flags |= _GAP_BEFORE
            self.gaps += 1
            self.lost += self._missing
        self.sample[_I_FLAGS] = self.flags | (min(self._missing, _LOST_MAX) << 8)
        self._gap = False
        self._missing = 0
        return True

    def period(self):
        """The learned sample period, Q8 µs."""
        return self._period >> (_FRACTION - 8)

    def keep_time(self):
        """Without samples: call this at least every few minutes, or `time` loses a wrap."""
        self._pass_time(ticks_us())

    def _run(self):
        self._failures = 0
        self._seen = self._count
        self._pass_time(ticks_us())
        # Hard: the time stamp must not wait for the interpreter.
        self._pin.irq(handler=self._handler, trigger=Pin.IRQ_RISING, hard=True)
        return self._sensor.sample(self._rate_mhz)

    def _on_pulse(self, _pin):
        self._stamp = ticks_us()
        self._count = (self._count + 1) & 0xFFFF

    def _pass_time(self, stamp):
        elapsed = ticks_diff(stamp, self._last)
        self._last = stamp
        self.time = (self.time + elapsed) & 0xFFFFFFFF
        return elapsed

    def _transfer(self):
        for _ in range(2):
            try:
                self.flags = self._sensor.read(self.sample)
                self._failures = 0
                return True
            except OSError:
                self.bus_errors += 1
                self._failures += 1
            if self._failures >= _FAILURES_MAX:
                self.resume()
                break
        return False
