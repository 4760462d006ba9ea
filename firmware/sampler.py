"""When to read the sensor, and what to make of what goes wrong there.

Data-ready interrupts and time stamps, lost samples, spikes, frozen data, bus errors.
"""

from array import array
from errno import ETIMEDOUT
from time import ticks_add, ticks_diff, ticks_us

from bus import FAST, SLOW
from machine import Pin
from mpu9150 import SensorError

from solenav_core.compat import const, micropython, ptr32
from solenav_core.navigator import new_sample

# Of `messages`, for code that knows constants of its own file only.
_CLIPPED = const(3)
_GAP_BEFORE = const(4)
_FLAGS = const(63)
_SPIKE = const(32)  # no flag of SAMPLE
_LOST_MAX = const(127)

_ALIKE = const(256)  # mpu9150.ALIKE
_I_FLAGS = const(9)

# Failed transfers in a row after which the sensor is set up anew. The FIFO can wait: there the
# first is followed by another at once, the others by one with each pulse.
_FAILURES_MAX = const(3)
_FIFO_FAILURES_MAX = const(6)
_PROBES = const(20)  # reads of its identity that a bus must carry to be fast again
_ATTEMPTS_MAX = const(2)  # times that it is, without a sample in between
_SILENT_PERIODS = const(10)
_DOUBTED = const(3)  # samples in a row that are the one before; more of them are lost ones
_TRUSTED = const(3)  # different samples in a row after frozen ones
_PATIENCE = const(10)  # half seconds until a lost magnetometer is looked for again
_SPIKES_MAX = const(3)  # in a row; a fourth is no spike

_FRACTION = const(12)  # bits of the learned period: 256 ms still fit a small int
_INTERVALS_MAX = const(4096)
_INTERVALS_GOOD = const(64)
_SINCE_MAX = const(1 << 29)  # µs: longest time between samples that is told from a longer one
_SHORT = const(1 << 21)  # µs: in Q8 it fits a small int
_SILENCE_MIN = const(50_000)  # µs

# Time, in words: it passes by machine code, with each sample.
_SINCE = const(0)  # µs from the last sample, read or lost, to `_ticks`
_LOW = const(1)  # of the sample's time, 16 bits each
_HIGH = const(2)
_PERIOD = const(3)  # of samples, learned; µs, Q12
_REST = const(4)  # of it: what division left
_INTERVALS = const(5)  # that it rests on
_TIMES = const(6)

# Each failed transfer is worth so many good ones; above the limit the bus is slowed down.
_STRAIN = const(64)
_STRAIN_MAX = const(512)
_CALM = const(12000)  # samples without an error after which it may be fast again

# Jumps from sample to sample that no foot makes, in counts. Over all 30 foot recordings of
# ../shared/data (100 to 400 Hz; some of their sensors filter less than this one) the
# accelerometer jumps by up to 52905 (26 g) in one sample and the gyro by up to 19492
# (1190 °/s; 23774 in two). But what hits a foot moves all axes: no accelerometer axis
# jumped by more than 3729 beyond 16 times the next largest jump of that sample, no gyro axis
# by more than 48 (221 in two samples).
_GYRO_MAX = const(28000)
_ACC_LONE = const(8192)  # 4 g
_GYRO_LONE = const(1024)  # 62 °/s
_LONE = const(16)
# A gyro axis that goes and comes straight back, to within a quarter of the way: by up to 13487 on
# the recordings, by up to 4943 beyond four times what the other two moved, both on stairs and with
# a sensor that filters less; 9089 and 577 else.
_RETURN_MAX = const(16384)
_RETURN_LONE = const(6144)


@micropython.viper
def jumps(new: ptr32, old: ptr32) -> int:
    """1 where `new` is no sample that can follow `old`."""
    largest = 0
    second = 0
    which = 0
    i = 0
    while i < 6:
        jump = new[i] - old[i]
        if jump < 0:
            jump = 0 - jump
        if i > 2 and jump > _GYRO_MAX:
            return 1
        if jump > largest:
            second = largest
            largest = jump
            which = i
        elif jump > second:
            second = jump
        i = i + 1
    excess = largest - _LONE * second
    limit = _ACC_LONE
    if which > 2:
        limit = _GYRO_LONE
    if excess > limit:
        return 1
    return 0


@micropython.viper
def returned(new: ptr32, old: ptr32, before: ptr32) -> int:
    """1 where the gyro went and came back in `old` as no foot does: it was a spike."""
    i = 3
    while i < 6:
        there = old[i] - before[i]
        back = old[i] - new[i]
        apart = new[i] - before[i]
        if there < 0:
            there = 0 - there
            back = 0 - back
        if apart < 0:
            apart = 0 - apart
        if back < there:
            there = back
        if apart * 4 < there:
            other = 0
            j = 3
            while j < 6:
                if j != i:
                    jump = old[j] - before[j]
                    if jump < 0:
                        jump = 0 - jump
                    if jump > other:
                        other = jump
                    jump = old[j] - new[j]
                    if jump < 0:
                        jump = 0 - jump
                    if jump > other:
                        other = jump
                j = j + 1
            if there > _RETURN_MAX:
                return 1
            if there - 4 * other > _RETURN_LONE:
                return 1
        i = i + 1
    return 0


@micropython.viper
def adopt(new: ptr32, sample: ptr32, before: ptr32, flags: int) -> int:
    """The core's sample into `before`, the readings of `new` and the word of flags into it."""
    i = 0
    while i < _I_FLAGS:
        before[i] = sample[i]
        sample[i] = new[i]
        i = i + 1
    sample[_I_FLAGS] = flags
    return 0


@micropython.viper
def pass_time(times: ptr32, elapsed: int) -> int:
    """Let `elapsed` µs pass (at most 2**29); the time since the last sample."""
    since = times[_SINCE] + elapsed
    if since > _SINCE_MAX:
        since = _SINCE_MAX
    times[_SINCE] = since
    low = times[_LOW] + elapsed
    times[_LOW] = low & 0xFFFF
    times[_HIGH] = (times[_HIGH] + (low >> 16)) & 0xFFFF
    return since


@micropython.viper
def learn(times: ptr32, interval: int) -> int:
    """Running mean of the sample period: an interval counts 1/n, powers of two up to 1/4096.

    0 where a late stamp isn't taken.
    """
    period = times[_PERIOD]
    off = interval - (period >> _FRACTION)
    if off < 0:
        off = 0 - off
    if off > period >> (_FRACTION + 3):
        return 0
    n = times[_INTERVALS] + 1
    if n > _INTERVALS_MAX:
        n = _INTERVALS_MAX
    times[_INTERVALS] = n
    shift = 0
    while n > 1:
        n = n >> 1
        shift = shift + 1
    change = (interval << _FRACTION) - period + times[_REST]
    times[_PERIOD] = period + (change >> shift)
    times[_REST] = change & ((1 << shift) - 1)
    return 1


@micropython.viper
def follow(times: ptr32, elapsed: int, learning: int) -> int:
    """A sample has come `elapsed` µs later, the next one after the last."""
    since = int(pass_time(times, elapsed))
    if learning:
        int(learn(times, since))
    times[_SINCE] = 0
    return since


class Sampler:
    """Samples in their order, one a `read`; counts everything that goes wrong.

    After `read` has returned True: `sample` (the core's), `flags` (those of SAMPLE), `lost`
    (samples lost just before this one; the most that SAMPLE can say where the last was a spike),
    and its time (`time`; in halves `time_high`, `time_low`). Nothing is allocated per sample.

    With `fifo` the sensor's FIFO says which samples there are, and the pulses when they were;
    without, each pulse is a sample to be read before the next one.
    """

    def __init__(self, sensor, pin, rate_mhz, fifo=True, dlpf=1, compass=True):
        self.sample = new_sample()
        self.flags = 0
        self.lost = 0
        self.samples = 0
        self.overruns = 0
        self.gaps = 0
        self.lost_samples = 0
        self.recoveries = 0
        self.clipped = 0
        self.spikes = 0
        self.frozen = 0
        self.fifo_overflows = 0
        self.backlog = 0  # samples that wait in the FIFO behind the one read last
        self._sensor = sensor
        self._bus = sensor.bus
        self._pin = pin
        self._options = (rate_mhz, dlpf, fifo, compass)
        self._new = new_sample()
        self._before = new_sample()  # the sample before the last
        self._adjacent = 0  # samples since the last hole
        self._half_second = max(20, rate_mhz // 2000)  # samples
        self._patience_max = _PATIENCE * self._half_second
        self._alike_max = max(5, rate_mhz // 8000)  # 1/8 s
        self._count = 0  # pulses, modulo 2**16
        self._stamp = 0  # ticks_us of the last pulse
        self._seen = 0  # pulses that were looked at
        self._ticks = ticks_us()  # to which time has been counted
        self._times = array("i", bytes(4 * _TIMES))
        self._times[_PERIOD] = (1_000_000_000 << _FRACTION) // rate_mhz
        self._begun = False
        self._sure = False  # the last sample's time is that of its own pulse
        self._broken = False  # the FIFO doesn't go on where it ended: time tells what is lost
        self._suspect = 0  # samples that were in the FIFO when a transfer broke off
        self._suspected = 0  # pulses, then
        self._missing = 0  # samples lost since the last good one
        self._row = 0  # spikes among them, in a row
        self._doubtful = False  # the last good one may have been none
        self._alike = 0
        self._stuck = 0  # different samples still to come after frozen ones
        self._empty = 0
        self._failures = 0
        self._attempts = 0
        self._strain = 0
        self._errors = 0
        self._calm = 0
        self._patience = 0  # samples since something was made of the magnetometer's silence
        # Made once: a bound method made per call would be allocated anew.
        self._handler = self._on_pulse

    @property
    def time(self):
        """Of the sample, µs modulo 2**32. Allocates above 2**30; the halves don't."""
        return (self.time_high << 16) | self.time_low

    @property
    def time_high(self):
        return self._times[_HIGH]

    @property
    def time_low(self):
        return self._times[_LOW]

    @property
    def intervals(self):
        """That the learned period rests on."""
        return self._times[_INTERVALS]

    @property
    def bus_errors(self):
        return self._bus.errors

    @property
    def slow(self):
        """Whether the bus had to be slowed down."""
        return self._bus.khz != FAST

    def start(self):
        """Sample afresh; the sensor must be awake. Returns its rate in mHz; SensorError."""
        self.samples = 0
        self._adjacent = 0
        self._begun = False
        self._missing = 0
        self._row = 0
        self._attempts = 0
        return self._run()

    def resume(self):
        """Free the bus, set the sensor up anew and go on, with a gap.

        At the fast clock, then at the slow one, then once more after its power was cut where a
        pin can. SensorError where it fails all the same.
        """
        self._pin.irq(handler=None)
        bus = self._bus
        complaint = None
        for khz in (FAST, SLOW, 0):
            if not khz and not bus.power_cycle():
                break
            bus.open(khz or SLOW)
            try:
                self._sensor.wake()
                if bus.khz == SLOW:
                    self._try_fast()
                self._run()
            except SensorError as error:
                complaint = error
            else:
                self.recoveries += 1
                return
        raise complaint

    def stop(self):
        """Put the sensor to sleep. SensorError where it doesn't answer."""
        self._pin.irq(handler=None)
        self._sensor.sleep()

    def pulsed(self):
        """Whether a sample was announced that nobody has looked for."""
        return self._count != self._seen

    def ready(self):
        """Whether a sample may wait.

        After ten sample periods without a pulse the sensor is set up anew, twice; then SensorError.
        """
        if self.backlog or self._count != self._seen:
            return True
        silence = ticks_diff(ticks_us(), self._stamp)
        if silence > _SILENCE_MIN and silence > _SILENT_PERIODS * self._period():
            self._anew("no data-ready pulse for ten sample periods: check the INT wire")
        return False

    def read(self):
        """Take a sample; False where there is none that is new and sound.

        A failed transfer is tried again; after some failures in a row, or with data frozen to the
        bit for 1/8 s, the sensor is set up anew; SensorError where that fails or has been tried
        twice without a sample. A spike is dropped; so is every frozen sample but the first three.
        """
        # A call takes as long as a transfer's first bytes: what a sample only needs where something
        # goes wrong, is called only then.
        sensor = self._sensor
        bus = self._bus
        if bus.errors or bus.khz != FAST:
            self._watch_bus()
        try:
            flags = self._oldest() if sensor.fifo else self._newest()
        except OSError as error:
            self._fail(error.args[0] == ETIMEDOUT)
            return False
        if flags < 0:
            return False
        if (flags & _ALIKE or self._alike or self._stuck) and self._is_frozen(flags):
            return False
        sample = self.sample
        if jumps(self._new, sample):
            flags = self._without_spike(flags)
            if flags & _SPIKE:
                return False
        flags &= _FLAGS
        if flags & _CLIPPED:
            self.clipped += 1
        lost = self._missing
        if not lost and self._adjacent > 1 and returned(self._new, sample, self._before):
            # Only now it shows that the last sample was one; it is with the core already.
            self.spikes += 1
            self._doubtful = True
        self._adjacent += 1
        told = 0
        if lost or self._doubtful:
            flags |= _GAP_BEFORE
            told = _LOST_MAX if self._doubtful else min(lost, _LOST_MAX)
            self._doubtful = False
            self._adjacent = 1
            self.gaps += 1
            self.lost_samples += lost
            self._missing = 0
            self._row = 0
        adopt(self._new, sample, self._before, flags | (told << 8))
        self.flags = flags
        self.lost = max(lost, told) if told else 0
        self.samples += 1
        self._attempts = 0
        self._begun = True
        self._patience += 1
        if self._patience >= self._patience_max or sensor.compass.silent >= self._half_second:
            self._check_compass()
        return True

    def period(self):
        """The learned sample period, Q8 µs."""
        return self._times[_PERIOD] >> (_FRACTION - 8)

    def temperature(self):
        """Of the sample read last: 340 counts a °C, 0 at 35 °C."""
        return self._sensor.temperature()

    def keep_time(self):
        """Without samples: call this at least every few minutes, or `time` loses a wrap."""
        self._pass_time(ticks_diff(ticks_us(), self._ticks))

    def _run(self):
        self._failures = 0
        self._alike = 0
        self._empty = 0
        self._suspect = 0
        self._break_off()
        self.keep_time()
        self._stamp = self._ticks
        # Hard: the time stamp must not wait for the interpreter.
        self._pin.irq(handler=self._handler, trigger=Pin.IRQ_RISING, hard=True)
        rate_mhz, dlpf, fifo, compass = self._options
        rate = self._sensor.sample(rate_mhz, dlpf, fifo, compass)
        if self._count == self._seen:
            self._stamp = ticks_us()  # silence counts from here
        if not self.intervals:
            self._times[_PERIOD] = (1_000_000_000 << _FRACTION) // rate
        self._errors = self._bus.errors - self._sensor.compass.errors
        return rate

    def _try_fast(self):
        """It may have been the sensor that wasn't there at the fast clock, not the bus."""
        self._bus.open(FAST)
        for _ in range(_PROBES):
            if not self._sensor.answers():
                self._bus.open(SLOW)
                return

    def _break_off(self):
        """What the sensor has and what is known of it no longer fit."""
        self._seen = self._count
        self.backlog = 0
        self._sure = False
        self._broken = True

    def _on_pulse(self, _pin):
        self._stamp = ticks_us()
        self._count = (self._count + 1) & 0xFFFF

    def _newest(self):
        """The sample in the registers; its flags, or -1 where there was no pulse. OSError."""
        count = self._count
        stamp = self._stamp
        if count != self._count:
            # A pulse came between the two loads: both now belong to it.
            count = self._count
            stamp = self._stamp
        fresh = (count - self._seen) & 0xFFFF
        if fresh == 0:
            return -1
        self._seen = count
        self._pass_time(ticks_diff(stamp, self._ticks))
        missed = self._missing
        self._account(self._steps(fresh), True)
        self.overruns += self._missing - missed
        self._missing += 1  # until it is here
        try:
            flags = self._sensor.read(self._new)
        except OSError:
            self._failures += 1
            flags = self._sensor.read(self._new)
        self._missing -= 1
        self._failures = 0
        return flags

    def _oldest(self):
        """The oldest sample in the FIFO; its flags, or -1 where there is none. OSError."""
        sensor = self._sensor
        count = self._count
        waiting = sensor.waiting()
        stamp = self._stamp
        tries = 2
        while count != self._count and tries:
            # A pulse in between: the newest sample need not be that of the stamp.
            count = self._count
            waiting = sensor.waiting()
            stamp = self._stamp
            tries -= 1
        fresh = (count - self._seen) & 0xFFFF
        self._seen = count
        if self._suspect:
            if waiting != self._suspect + ((count - self._suspected) & 0xFFFF):
                waiting = min(waiting, -2)  # part of a sample may be gone
            self._suspect = 0
        if waiting < 0:
            if waiting == -1:
                self.fifo_overflows += 1
            self._break_off()
            self._rely_on(sensor.drop)
            self._lack(fresh)
            return -1
        if waiting == 0:
            self.backlog = 0
            self._lack(fresh)
            return -1
        try:
            flags = sensor.take(self._new)
        except OSError:
            self._suspect = waiting
            self._suspected = count
            raise
        self._failures = 0
        self._empty = 0
        self.backlog = waiting - 1
        own = waiting == 1 and fresh == 1
        if self._broken:
            self._broken = False
            elapsed = ticks_diff(stamp, self._ticks) - (waiting - 1) * self._period()
            self._pass_time(max(0, elapsed))
            self._account(self._steps(1), own)
            return flags
        # A stamp may be late, where interrupts had to wait, and then stand for many pulses: it
        # counts where it is surely this sample's own.
        elapsed = max(0, ticks_diff(stamp, self._ticks)) if own else self._period()
        self._ticks = ticks_add(self._ticks, elapsed)
        follow(self._times, elapsed, own and self._sure and self._begun)
        self._sure = own
        return flags

    def _period(self):
        """The learned sample period, in whole µs."""
        return self._times[_PERIOD] >> _FRACTION

    def _lack(self, fresh):
        """No sample in the FIFO, or parts of some, though there were pulses. SensorError."""
        if fresh:
            self._empty += 1
            if self._empty >= _SILENT_PERIODS:
                self._anew("the sensor's FIFO stays without samples: check its power")

    def _pass_time(self, elapsed):
        self._ticks = ticks_add(self._ticks, elapsed)
        pass_time(self._times, elapsed)

    def _steps(self, least):
        """Sample periods since the last sample: how many samples there were, this one included.

        A stamp may be late by most of a period, but not early. So time is rounded down, short of
        what the period is known to.
        """
        since = self._times[_SINCE]
        period = self._period()
        if since >= _SHORT:
            return max(since // period, least)
        exact = self.period()
        slack = exact >> 3
        if self.intervals >= _INTERVALS_GOOD:
            slack = (exact >> 6) + (since >> 3)  # 1/2048
        return max(((since << 8) + slack) // exact, least)

    def _account(self, steps, own):
        """A sample came `steps` periods after the last; `own`: at the time of its own pulse."""
        if not self._begun:
            steps = 1
        elif own and self._sure and steps == 1:
            learn(self._times, self._times[_SINCE])
        self._missing += steps - 1
        self._sure = own
        self._times[_SINCE] = 0

    def _is_frozen(self, flags):
        """Whether the sample is one of frozen data; then it is lost.

        Once they were frozen, it takes three different samples in a row to trust them again.
        """
        if not flags & _ALIKE:
            self._alike = 0
            if not self._stuck:
                return False
            self._stuck -= 1
        else:
            self._alike += 1
            if self._alike < self._alike_max:
                if self._stuck:
                    self._stuck = _TRUSTED
                elif self._alike <= _DOUBTED:
                    return False
            else:
                self._alike = 0
                self._stuck = _TRUSTED
                self.frozen += 1
                self._missing += 1
                self._anew("the sensor's data are frozen: check its power")
                return True
        self._missing += 1
        return True

    def _without_spike(self, flags):
        """The flags of a sample that jumps; _SPIKE where it is one, which is counted then."""
        if self._row == _SPIKES_MAX:
            # It is none of them that was the spike, but what they were held against.
            self._doubtful = True
        if not (self._begun and self._missing == self._row < _SPIKES_MAX):
            return flags
        if not self._sensor.fifo and self._count == self._seen:
            # It is still there: read once more, a bit may have been lost on the way only.
            try:
                healed = self._sensor.again(self._new)
                if self._count == self._seen and not jumps(self._new, self.sample):
                    return (flags & ~_CLIPPED) | (healed & _CLIPPED)
            except OSError:
                pass  # counted by the bus
        self.spikes += 1
        self._row += 1
        self._missing += 1
        return _SPIKE

    def _check_compass(self):
        """Find another way to a magnetometer that is silent, or one to it when it is back."""
        sensor = self._sensor
        lost = sensor.compass_is_lost(self._half_second)
        if not lost and self._patience < self._patience_max:
            return
        self._patience = 0
        if not (lost or sensor.compass_is_back()):
            return
        self._break_off()
        self._rely_on(sensor.reroute)

    def _watch_bus(self):
        """Slow it down where transfers fail too often, and speed it up again after a while."""
        bus = self._bus
        # A magnetometer that is gone is no fault of the bus.
        errors = bus.errors - self._sensor.compass.errors
        if errors != self._errors:
            self._strain += _STRAIN * (errors - self._errors)
            self._errors = errors
            self._calm = 0
            if self._strain > _STRAIN_MAX:
                self._strain = 0
                if bus.khz != SLOW:
                    bus.open(SLOW)
        elif self._strain:
            self._strain -= 1
        elif bus.khz != FAST:
            self._calm += 1
            if self._calm >= _CALM:
                self._calm = 0
                bus.open(FAST)

    def _fail(self, stuck):
        """A transfer failed; `stuck`: for a line that stays low, which won't pass by itself."""
        self._failures += 1
        most = _FAILURES_MAX
        if self._sensor.fifo:
            most = _FIFO_FAILURES_MAX
            self._seen = self._count
            self.backlog = 1 if self._failures == 1 else 0
        if self._failures >= most or stuck:
            self._failures = 0
            self._anew("the sensor's transfers fail: check SDA, SCL")

    def _rely_on(self, action):
        """Do what must not stay half done: else the sensor is set up anew."""
        try:
            action()
        except SensorError as error:
            self._anew(str(error))

    def _anew(self, why):
        """Set the sensor up anew; SensorError where that didn't help, or can't be done."""
        self._attempts += 1
        if self._attempts > _ATTEMPTS_MAX:
            raise SensorError(why)
        self.resume()
