"""The loop: samples into the core, messages out, commands in."""

from array import array
from binascii import crc32
from time import ticks_diff, ticks_ms, ticks_us

import config
import machine
import reports
from bus import Bus
from checkpoint import Checkpoint
from link import Link
from mpu9150 import Mpu9150, SensorError
from sampler import Sampler
from supervisor import Clock, Supervisor, Watchdog

from solenav_core import messages, navigator, selftest
from solenav_core.framing import HEADER
from solenav_core.layout import SAMPLE_FIELDS, STATE_FIELDS, offsets
from solenav_core.params import NAMES
from solenav_core.tables.lookup import TABLES
from solenav_core.tables.selftest import EXPECTED

_INFO, _WARNING, _ERROR = 0, 1, 2
_AT = offsets(STATE_FIELDS)
_TICK = _AT["TICK"]
_MODE = _AT["MODE"]
_RESUMED = _AT["RESUMED"]
_STEPS = _AT["STEPS"]
_FLAGS = offsets(SAMPLE_FIELDS)["FLAGS"]
_RATE = NAMES.index("RATE_MHZ")
_BRIDGE = NAMES.index("BRIDGE_TICKS")


class Application:
    """Everything between the board's pins and the core.

    `settings`, `params`, `problems` are what `config.load` returned.
    """

    def __init__(self, board, settings, params, problems):
        rate = params[_RATE]
        self.settings = settings
        self.link = Link(board.uart)
        self.bus = Bus(board)
        self.sensor = Mpu9150(self.bus)
        # fmt: off
        self.sampler = Sampler(
            self.sensor, board.ready, rate, settings["sampling"] == "fifo", settings["dlpf"],
            settings["compass"],
        )
        # fmt: on
        self.supervisor = Supervisor(self.bus, self.sampler)
        self.watchdog = Watchdog(settings["watchdog"])
        self.clock = Clock(params)
        self.params = self.clock.params
        self.state = navigator.new_state()
        self.work = navigator.new_work()
        self.board = board
        self.build = config.build()
        self.problems = problems
        self.send_samples = settings["send_samples"]
        self.pose_every = settings["pose_every"]
        self.second = max(1, (rate + 500) // 1000)  # ticks
        self.snapshot_ticks = settings["snapshot_s"] * self.second
        self.wanted = settings["autostart"]
        self.mode = messages.IDLE
        self.snapshot_asked = False
        self.worst = 0
        self.complaint = ""
        # The run as it was when the sensor's registers were last seen to be right.
        self.sure = array("i", bytes(4 * navigator.SAVED))
        self.sure_tick = 0
        identity = crc32(params) ^ self.build[0]
        self.checkpoint = Checkpoint(identity, settings["checkpoint_s"] * self.second, self.second)
        self.unsaved = False
        self.failed_test = selftest.first_failure(EXPECTED)
        self.beat = ticks_ms()
        self.commands = {
            messages.ASK_HELLO: self.announce,
            messages.ASK_START: self.start,
            messages.ASK_STOP: self.stop,
            messages.ASK_SNAPSHOT: self.ask_snapshot,
        }

    def run(self):
        """For ever."""
        if self.failed_test:
            self.announce()
            self.refuse()
        else:
            self.boot()
        for problem in self.problems:
            self.log(_ERROR, problem)
        while True:
            command = self.link.receive(self.state[_TICK])
            if command:
                self.obey(command)
            waiting = False
            if self.sampling():
                waiting = self.turn()
            elif ticks_diff(ticks_ms(), self.beat) >= 1000:
                self.rest()
            self.link.pump()
            if not waiting:
                if self.checkpoint.due(self.state):
                    self.save(self.checkpoint.save)
                machine.idle()

    def boot(self):
        """Go on with a run that was cut off, else start or wait, as the settings say."""
        going_on = self.take_up()
        try:
            self.wake(not going_on)
        except SensorError as error:
            self.announce()
            self.fail(error)
        if going_on:
            reports.snapshot(self.link, self.state[_TICK], self.state)
            self.log(_WARNING, "going on after a restart, from step %d" % self.state[_STEPS])

    def take_up(self):
        """Whether a run was cut off by this boot and has now been taken up again."""
        if not self.checkpoint.cut_off():
            return False
        why = self.checkpoint.objection()
        wish = self.settings["resume"]
        if wish == "never" or (wish == "watchdog" and machine.reset_cause() != machine.WDT_RESET):
            why = "resume in config.json is %s" % wish
        if why:
            self.log(_INFO, "not going on with the run before: " + why)
            self.save(self.checkpoint.close)
            return False
        self.wanted = True
        self.save(self.restore)
        return True

    def restore(self, state, _period):
        self.clock.set(self.checkpoint.restore(state))

    def sampling(self):
        """Whether samples are expected now."""
        return self.mode != messages.IDLE and self.mode != messages.FAULT

    def turn(self):
        """A sample, if one waits; whether one did."""
        try:
            waiting = self.sampler.ready()
            if waiting and self.sampler.read():
                self.watchdog.feed()
                self.advance()
            return waiting
        except SensorError as error:
            self.mend(error)
        return True

    def advance(self):
        """One sample through the core, and the messages that it gives rise to."""
        state = self.state
        sample = self.sampler.sample
        if state[_MODE] and sample[_FLAGS] >> 8 > self.params[_BRIDGE]:
            navigator.resume(state)
            self.broken_off()
        began = ticks_us()
        events = navigator.tick(state, self.params, self.work, TABLES, sample)
        spent = ticks_diff(ticks_us(), began)
        if spent > self.worst:
            self.worst = spent
        link = self.link
        tick = state[_TICK]
        if self.complaint:
            self.recovered()
        if self.send_samples:
            reports.sample(link, tick, self.sampler, self.sensor.temperature())
        if events & navigator.ALIGNED:
            self.mode = messages.RUNNING
            link.send(messages.ALIGN, tick, messages.pack_align(link.frame, HEADER, state))
        if events & navigator.STEP:
            link.send(messages.STEP, tick, messages.pack_step(link.frame, HEADER, state))
        if state[_MODE] and self.pose_every and tick % self.pose_every == 0:
            end = messages.pack_pose(link.frame, HEADER, state, self.params)
            link.send(messages.POSE, tick, end)
        due = self.snapshot_ticks and tick % self.snapshot_ticks == 0
        if due or self.snapshot_asked:
            self.snapshot_asked = False
            reports.snapshot(link, tick, state)
        if tick % self.second == 0:
            self.status()
            self.check()
        if events & navigator.LOCKED_OUT:
            self.log(_WARNING, "zero velocity taken for granted: the filter had been locked out")
        if self.clock.learned(self.sampler):
            # They hold from the next tick on.
            reports.parameters(link, tick, self.params)

    def broken_off(self):
        """The core has been told to go on after a gap: so must whoever follows it."""
        self.mode = self.expected()
        reports.snapshot(self.link, self.state[_TICK], self.state)

    def expected(self):
        """The mode in which samples leave the core as it is now."""
        if self.state[_MODE]:
            return messages.RUNNING
        return messages.RESUMING if self.state[_RESUMED] else messages.ALIGNING

    def check(self):
        """Once a second: is the sensor still set up as it was? The core must not take wrong scales.

        If not, the run goes back to where that was last sure, and on from there with a gap.
        """
        state = self.state
        try:
            sound = self.sensor.check()
        except OSError:
            return  # the bus: the sampler meets it as well, and knows what to do
        if sound:
            navigator.save(state, self.sure)
            self.sure_tick = state[_TICK]
            return
        self.log(_WARNING, "the sensor's registers had changed: set up anew, check its supply")
        navigator.load(state, self.sure, state[_TICK] - self.sure_tick)
        self.broken_off()
        self.mend(None)

    def mend(self, error):
        """Get samples flowing again after a failure."""
        try:
            self.supervisor.mend(error)
        except SensorError as last:
            self.fail(last)

    def rest(self):
        """Once a second without samples: tell the host, try a failed sensor again."""
        self.beat = ticks_ms()
        self.sampler.keep_time()
        if self.mode == messages.FAULT and not self.failed_test:
            try:
                self.supervisor.retry(self.retry)
            except SensorError as error:
                self.fail(error)
        self.watchdog.feed()
        self.status()

    def retry(self):
        """Go on where sampling broke off; SensorError where the sensor still fails."""
        if self.wanted and self.state[_TICK]:
            self.sampler.resume()
            self.mode = self.expected()
        else:
            self.wake(True)
            if not self.wanted:
                self.recovered()

    def recovered(self):
        self.log(_INFO, "the sensor works again")
        self.complaint = ""

    def refuse(self):
        """This machine computes the core wrongly: no pose is better than a wrong one."""
        self.wanted = False
        self.mode = messages.FAULT
        name = selftest.TESTS[self.failed_test - 1][0]
        self.log(_ERROR, "self-test %s failed: not navigating; flash the firmware anew" % name)

    def fail(self, error):
        """The sensor is out: say so once, and go on trying."""
        self.mode = messages.FAULT
        self.beat = ticks_ms()
        if str(error) != self.complaint:
            self.complaint = str(error)
            self.log(_ERROR, self.complaint)

    def wake(self, test):
        """Find the sensor, say who is here, sample if wanted. SensorError.

        `test`: with the sensor's self-test, for which it has to be still.
        """
        self.sensor.wake(test)
        self.announce()
        if not self.wanted:
            self.sensor.sleep()
            self.mode = messages.IDLE
            return
        rate = self.sampler.start()
        self.clock.restart()
        self.mode = self.expected()
        nominal = self.params[_RATE]
        if abs(rate - nominal) * 100 > nominal:
            self.log(
                _WARNING,
                "the sensor's nearest rate is %d mHz, the parameters are for %d" % (rate, nominal),
            )
