"""The loop: samples into the core, messages out, commands in."""

from time import ticks_diff, ticks_ms, ticks_us

import config
import machine
import reports
from blackbox import BlackBox
from bus import Bus
from download import Download
from link import Link
from mpu9150 import Mpu9150, SensorError
from sampler import Sampler

from solenav_core import messages, navigator, selftest
from solenav_core.framing import HEADER
from solenav_core.layout import STATE_FIELDS, offsets
from solenav_core.params import NAMES
from solenav_core.tables.lookup import TABLES
from solenav_core.tables.selftest import EXPECTED

_INFO, _WARNING, _ERROR = 0, 1, 2
_TICK = offsets(STATE_FIELDS)["TICK"]
_MODE = offsets(STATE_FIELDS)["MODE"]
_RATE = NAMES.index("RATE_MHZ")


class Application:
    """Everything between the board's pins and the core.

    `settings`, `params`, `problems` are what `config.load` returned.
    """

    def __init__(self, board, settings, params, problems):
        rate = params[_RATE]
        self.link = Link(board.uart)
        self.sensor = Mpu9150(Bus(board))
        self.sampler = Sampler(self.sensor, board.ready, rate)
        self.params = params
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
        # fmt: off
        self.blackbox = BlackBox(
            self.link, settings["blackbox"], settings["blackbox_samples"], self.second,
            self.describe,
        )
        # fmt: on
        self.with_samples = settings["blackbox_samples"]
        self.download = Download(self.link, self.blackbox)
        self.worst = 0
        self.complaint = ""
        self.failed_test = selftest.first_failure(EXPECTED)
        self.beat = ticks_ms()
        self.commands = {
            messages.ASK_HELLO: self.announce,
            messages.ASK_START: self.start,
            messages.ASK_STOP: self.stop,
            messages.ASK_SNAPSHOT: self.ask_snapshot,
        }
        self.commands.update(self.download.commands)

    def run(self):
        """For ever."""
        if self.failed_test:
            self.announce()
            self.refuse()
        else:
            try:
                self.wake()
            except SensorError as error:
                self.announce()
                self.fail(error)
        for problem in self.problems:
            self.log(_ERROR, problem)
        while True:
            tick = self.state[_TICK]
            command = self.link.receive(tick)
            if command:
                self.obey(command)
            waiting = False
            if self.mode == messages.ALIGNING or self.mode == messages.RUNNING:
                try:
                    waiting = self.sampler.ready()
                    if waiting and self.sampler.read():
                        self.advance()
                except SensorError as error:
                    self.fail(error)
            elif ticks_diff(ticks_ms(), self.beat) >= 1000:
                self.rest()
            self.link.pump()
            if not (waiting or self.download.step(tick) or self.blackbox.step(tick)):
                machine.idle()

    def advance(self):
        """One sample through the core, and the messages that it gives rise to."""
        state = self.state
        began = ticks_us()
        events = navigator.tick(state, self.params, self.work, TABLES, self.sampler.sample)
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
        if events & navigator.LOCKED_OUT:
            self.log(_WARNING, "zero velocity taken for granted: the filter had been locked out")

    def rest(self):
        """Once a second without samples: tell the host, try a failed sensor again."""
        self.beat = ticks_ms()
        self.sampler.keep_time()
        if self.mode == messages.FAULT and not self.failed_test:
            try:
                self.retry()
            except SensorError as error:
                self.fail(error)
        self.status()

    def retry(self):
        """Go on where sampling broke off; SensorError where the sensor still fails."""
        if self.wanted and self.state[_TICK]:
            self.sampler.resume()
            self.mode = messages.RUNNING if self.state[_MODE] else messages.ALIGNING
        else:
            self.wake()
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

    def wake(self):
        """Find the sensor, say who is here, sample if wanted. SensorError."""
        self.sensor.wake()
        self.announce()
        if not self.wanted:
            self.sensor.sleep()
            self.mode = messages.IDLE
            return
        rate = self.sampler.start()
        self.mode = messages.ALIGNING
        nominal = self.params[_RATE]
        if abs(rate - nominal) * 100 > nominal:
            self.log(
                _WARNING,
                "the sensor's nearest rate is %d mHz, the parameters are for %d" % (rate, nominal),
            )

    def obey(self, command):
        """Carry out a command, then acknowledge it."""
        action = self.commands.get(command)
        result = messages.UNKNOWN
        if self.failed_test and command in (messages.ASK_START, messages.ASK_STOP):
            result = messages.REFUSED
        elif action:
            try:
                result = action() or messages.DONE
            except SensorError as error:
                self.fail(error)
                result = messages.REFUSED
        self.link.acknowledge(result, self.state[_TICK])

    def announce(self):
        tick = self.state[_TICK]
        # fmt: off
        reports.hello(
            self.link, tick, self.params, self.pose_every, self.sensor.kind, self.board.name,
            self.build, self.failed_test, self.sensor.test,
        )
        # fmt: on
        reports.parameters(self.link, tick, self.params)

    def describe(self):
        """What a file of the black box begins with."""
        self.announce()
        if self.with_samples:
            self.ask_snapshot()

    def start(self):
        """A fresh static start."""
        navigator.reset(self.state)
        self.wanted = True
        self.wake()

    def stop(self):
        """Idle. A sensor that doesn't answer is no reason to go on."""
        self.wanted = False
        self.mode = messages.IDLE
        self.beat = ticks_ms()
        try:
            self.sampler.stop()
        except SensorError as error:
            self.log(_WARNING, str(error))

    def ask_snapshot(self):
        """With the next tick; at once where none is to come."""
        if self.mode == messages.ALIGNING or self.mode == messages.RUNNING:
            self.snapshot_asked = True
        else:
            reports.snapshot(self.link, self.state[_TICK], self.state)

    def status(self):
        temperature = self.sensor.temperature()
        # fmt: off
        reports.status(
            self.link, self.state[_TICK], self.mode, self.sampler, temperature, self.worst
        )
        # fmt: on

    def log(self, level, text):
        reports.log(self.link, self.state[_TICK], level, text)
