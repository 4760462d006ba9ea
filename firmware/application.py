"""The loop: samples into the core, messages out, commands in."""

import gc
from binascii import crc32
from struct import unpack_from
from time import ticks_diff, ticks_ms, ticks_us

import config
import forest_file
import machine
import reports
from blackbox import BlackBox
from bus import FAST, SLOW, Bus
from checkpoint import Checkpoint
from download import Download
from injection import Injection
from link import Link
from mpu9150 import Mpu9150, SensorError
from sampler import Sampler
from supervisor import Clock, Trust, Watchdog

from solenav_core import messages, navigator
from solenav_core.framing import HEADER
from solenav_core.layout import SAMPLE_FIELDS, STATE_FIELDS, offsets
from solenav_core.params import NAMES

_INFO, _WARNING, _ERROR = 0, 1, 2
_DOZES = 3
_RESTS = 30  # 10 ms, while nothing but a command is awaited
_POSES = 1  # in outbox.dropped
_BEHIND = 28  # samples that wait: the FIFO holds 46, and no pose is worth one
_CHECKS = 20  # of the sensor's settings, in a second: 1 ms each, of the bus and of the processor
_AT = offsets(STATE_FIELDS)
_TICK = _AT["TICK"]
_MODE = _AT["MODE"]
_RESUMED = _AT["RESUMED"]
_STEPS = _AT["STEPS"]
_MOTION = _AT["MOTION"]
_FLAGS = offsets(SAMPLE_FIELDS)["FLAGS"]
_RATE = NAMES.index("RATE_MHZ")
_OF_RUNS = messages.ASK_START, messages.ASK_STOP
_SAMPLING = messages.ALIGNING, messages.RUNNING, messages.RESUMING
_POSE = messages.POSE
_TOLD = navigator.ALIGNED | navigator.STEP | navigator.LOCKED_OUT
_tick = navigator.tick
_pack_pose = messages.pack_pose
_sample = reports.sample
_idle = machine.idle
_BRIDGE = NAMES.index("BRIDGE_TICKS")


class Application:
    """Everything between the board's pins and the core.

    `settings`, `params`, `tables`, `problems` are what `config.load` returned. `failed_test`: place
    and name of the core's self-test that failed on this machine; (0, "") for none.
    """

    def __init__(self, board, settings, params, tables, problems, failed_test=(0, "")):
        rate = params[_RATE]
        self.settings = settings
        self.board = board
        self.build = config.build()
        self.problems = problems
        self.link = Link(board.uart)
        self.sensor = Mpu9150(Bus(board))
        # fmt: off
        self.sampler = Sampler(
            self.sensor, board.ready, rate, settings["sampling"] == "fifo", settings["dlpf"],
            settings["compass"],
        )
        # fmt: on
        self.clock = Clock(params)
        self.params = self.clock.params
        self.state = navigator.new_state()
        self.work = navigator.new_work()
        self.tables = tables
        self.second = max(1, (rate + 500) // 1000)  # ticks
        self.snapshot_ticks = settings["snapshot_s"] * self.second
        self.check_ticks = max(1, self.second // _CHECKS)
        # So many the core still makes up for, flagged: in half a swing that is nearer to the truth
        # than starting from the next stance (README).
        self.bridge = 4 * params[_BRIDGE]
        self.send_samples = settings["send_samples"]
        self.pose_every = settings["pose_every"]
        self.wanted = settings["autostart"]
        self.mode = messages.IDLE
        self.snapshot_asked = False
        # fmt: off
        self.blackbox = BlackBox(
            self.link, settings["blackbox"], settings["blackbox_samples"], self.second,
            self.describe,
        )
        # fmt: on
        self.download = Download(self.link, self.blackbox)
        self.trust = Trust(self.sensor)
        self.watchdog = Watchdog(settings["watchdog"])
        every = settings["checkpoint_s"] * self.second
        self.checkpoint = Checkpoint(self.identity(), every, self.second)
        self.unsaved = False  # the last checkpoint could not be written
        self.worst = 0
        self.complaint = ""
        self.failed_test, self.failed_name = failed_test
        self.beat = ticks_ms()
        self.looked = -1  # tick after which there was nothing else to do
        self.commands = {
            messages.ASK_HELLO: self.announce,
            messages.ASK_START: self.start,
            messages.ASK_STOP: self.stop,
            messages.ASK_SNAPSHOT: self.ask_snapshot,
            messages.ASK_BUS_TEST: self.test_bus,
        }
        self.commands.update(self.download.commands)
        self.lent = False
        # fmt: off
        self.injection = Injection(
            self.link, self.state, self.params, self.work, self.tables, self.lend,
            self.take_back,
        )
        # fmt: on
        self.commands.update(self.injection.commands)
        self.commands.update(
            forest_file.Upload(self.link, self.idle, self.plant, self.log).commands
        )

    def run(self):
        """For ever."""
        if self.failed_test:
            self.announce()
            self.refuse()
        else:
            self.boot()
        # What the boot threw away fills the heap's start, which calls' frames need (main.py): a
        # sample took 11 ms until the first STATUS had this done.
        gc.collect()
        for problem in self.problems:
            self.log(_ERROR, problem)
        while True:
            tick = self.state[_TICK]
            command = self.link.receive(tick)
            if command:
                self.obey(command)
            waiting = False
            if self.mode in _SAMPLING:
                waiting = self.take()
            elif ticks_diff(ticks_ms(), self.beat) >= 1000:
                self.rest()
                if self.injection.watch():
                    self.log(_WARNING, "the host that injected samples fell silent")
            self.link.pump()
            if waiting:
                continue
            # While samples come, one look for work after each is enough, until there was some.
            if tick == self.looked and self.mode in _SAMPLING:
                self.doze()
            elif not self.spare(tick):
                self.looked = tick
                self.doze()

    def boot(self):
        """Go on with a run that was cut off; else start or wait, as the settings say."""
        going_on = self.reclaim()
        try:
            self.wake(not going_on)
        except SensorError as error:
            self.announce()
            self.fail(error)
        if going_on:
            self.log(_WARNING, "going on after a restart, from step %d" % self.state[_STEPS])
            self.show_state()

    def reclaim(self):
        """Take a run up again that this boot has cut off; whether there was one."""
        if not self.checkpoint.cut_off():
            return False
        wish = self.settings["resume"]
        if wish == "never" or (wish == "watchdog" and machine.reset_cause() != machine.WDT_RESET):
            why = "config.json has resume: " + wish
        else:
            why = self.checkpoint.objection()
        if why:
            self.log(_INFO, "not going on with the run before: " + why)
            self.end_run()
            return False
        self.wanted = True
        self.clock.set(self.checkpoint.period)
        self.keep(self.checkpoint.restore, self.state)
        return True

    def sampling(self):
        """Whether samples are to come."""
        return self.mode in _SAMPLING

    def take(self):
        """A sample, if one waits; whether one may have."""
        try:
            sampler = self.sampler
            waiting = sampler.ready()
            if waiting and sampler.read():
                self.advance()
            return waiting
        except SensorError as error:
            self.fail(error)
        return False

    def spare(self, tick):
        """What takes its time, one piece, now that no sample waits. False: nothing to do."""
        if self.sampling() and self.checkpoint.due(self.state):
            self.keep(self.checkpoint.save, self.state, self.sampler.period())
            return True
        return self.download.step(tick) or self.blackbox.step(tick)

    def doze(self):
        """Let the processor sleep: until an interrupt, or for a millisecond; longer at rest."""
        # An RP2040's first idle() sets an alarm, which is an event by itself; the third one sleeps.
        if self.mode in _SAMPLING:
            sampler = self.sampler
            for _ in range(_DOZES):
                if sampler.pulsed():
                    return
                _idle()
            return
        for _ in range(_RESTS):
            if self.link.waiting():
                return
            _idle()

    def advance(self):
        """One sample through the core, and the messages that it gives rise to."""
        state = self.state
        params = self.params
        sampler = self.sampler
        sample = sampler.sample
        if sample[_FLAGS] >> 8 > self.bridge and state[_MODE]:
            self.log(_WARNING, "%d samples lost: going on with the next stance" % sampler.lost)
            self.break_off()
        began = ticks_us()
        events = _tick(state, params, self.work, self.tables, sample)
        spent = ticks_diff(ticks_us(), began)
        if spent > self.worst:
            self.worst = spent
        link = self.link
        tick = state[_TICK]
        if self.complaint:
            self.recovered()
        if self.send_samples:
            _sample(link, tick, sampler, self.sensor.temperature())
        if events & _TOLD:
            self.tell(events, tick)
        every = self.pose_every
        if every and tick % every == 0 and state[_MODE]:
            if sampler.backlog < _BEHIND:
                link.send(_POSE, tick, _pack_pose(link.frame, HEADER, state, params))
            else:
                # Rather a pose too few than a sample.
                link.outbox.dropped[_POSES] += 1
        due = self.snapshot_ticks and tick % self.snapshot_ticks == 0
        if due or self.snapshot_asked:
            self.snapshot_asked = False
            reports.snapshot(link, tick, state)
        if self.clock.follow(sampler):
            # They hold from the next tick on.
            reports.parameters(link, tick, params)
        if tick % self.second == 0:
            self.watchdog.feed()
            self.status()
        if tick % self.check_ticks == 0 and not self.trust.keeps(state):
            self.distrust()

    def tell(self, events, tick):
        """What has happened on a tick."""
        link = self.link
        if events & navigator.ALIGNED:
            self.mode = messages.RUNNING
            link.send(messages.ALIGN, tick, messages.pack_align(link.frame, HEADER, self.state))
        if events & navigator.STEP:
            link.send(messages.STEP, tick, messages.pack_step(link.frame, HEADER, self.state))
        if events & navigator.LOCKED_OUT:
            self.log(_WARNING, "zero velocity taken for granted: the filter had been locked out")

    def break_off(self):
        """Navigation can't go on over a gap: it does with the next stance."""
        navigator.resume(self.state)
        self.show_state()

    def show_state(self):
        """The core goes on from another state: whoever follows it needs that."""
        if self.sampling():
            self.mode = self.expected()
        reports.snapshot(self.link, self.state[_TICK], self.state)
        self.status()

    def expected(self):
        """The mode in which samples leave the core as it is now."""
        if self.state[_MODE]:
            return messages.RUNNING
        return messages.RESUMING if self.state[_RESUMED] else messages.ALIGNING

    def distrust(self):
        """The samples of late were none: the run has gone back to before them, with a gap."""
        self.log(_WARNING, "the sensor had lost its settings: set up anew; check its supply")
        self.show_state()
        self.sampler.resume()

    def rest(self):
        """Once a second without samples: tell the host, try a failed sensor again."""
        self.beat = ticks_ms()
        self.sampler.keep_time()
        if self.mode == messages.FAULT and not self.failed_test:
            try:
                self.retry()
            except SensorError as error:
                self.fail(error)
        self.watchdog.feed()
        self.status()

    def retry(self):
        """Go on where sampling broke off; SensorError where the sensor still fails."""
        if self.wanted and self.state[_TICK]:
            self.sampler.resume()
            self.mode = self.expected()
            if self.mode == messages.RUNNING:
                self.break_off()
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
        self.log(
            _ERROR,
            "self-test %s failed: not navigating; flash the firmware anew" % self.failed_name,
        )

    def fail(self, error):
        """The sensor is out: say so once, and go on trying."""
        self.beat = ticks_ms()
        if str(error) != self.complaint:
            self.complaint = str(error)
            self.log(_ERROR, self.complaint)
        if self.mode != messages.FAULT:
            self.mode = messages.FAULT
            self.status()

    def wake(self, test):
        """Find the sensor, say who is here, sample if wanted. SensorError.

        `test`: with the sensor's self-test, for which it has to lie still.
        """
        self.sensor.wake(test)
        self.announce()
        if not self.wanted:
            self.sensor.sleep()
            self.mode = messages.IDLE
            return
        rate = self.sampler.start()
        self.clock.restart()
        self.trust.restart(self.state)
        self.mode = self.expected()
        nominal = self.params[_RATE]
        if abs(rate - nominal) * 10 > nominal:
            self.log(
                _WARNING,
                "the sensor's nearest rate is %d mHz, the parameters are for %d" % (rate, nominal),
            )

    def obey(self, command):
        """Carry out a command, then acknowledge it."""
        action = self.commands.get(command)
        result = messages.UNKNOWN
        if command in _OF_RUNS and (self.failed_test or self.injection.active):
            result = messages.REFUSED
        elif action:
            try:
                result = action() or messages.DONE
            except SensorError as error:
                self.fail(error)
                result = messages.REFUSED
        if result != messages.UNANSWERED:
            self.link.acknowledge(result, self.state[_TICK])

    def announce(self):
        tick = self.state[_TICK]
        # fmt: off
        reports.hello(
            self.link, tick, self.params, self.tables, self.pose_every, self.sensor,
            self.board.name, self.build, self.failed_test,
        )
        # fmt: on
        reports.parameters(self.link, tick, self.params)

    def describe(self):
        """What a file of the black box begins with."""
        self.announce()
        if self.settings["blackbox_samples"]:
            self.ask_snapshot()

    def start(self):
        """A fresh static start."""
        self.end_run()
        navigator.reset(self.state)
        self.wanted = True
        self.wake(True)

    def stop(self):
        """Idle. A sensor that doesn't answer is no reason to go on."""
        self.wanted = False
        self.mode = messages.IDLE
        self.beat = ticks_ms()
        self.end_run()
        try:
            self.sampler.stop()
        except SensorError as error:
            self.log(_WARNING, str(error))

    def lend(self):
        """The core is a host's for a while; nothing is sampled meanwhile."""
        self.lent = self.wanted
        self.wanted = False
        self.mode = messages.IDLE
        self.beat = ticks_ms()
        try:
            self.sampler.stop()
        except SensorError as error:
            self.log(_WARNING, str(error))

    def take_back(self):
        """Go on with the board's own run, as after a hole in its samples."""
        self.wanted = self.lent
        if self.failed_test:
            return
        try:
            self.wake(False)
        except SensorError as error:
            self.fail(error)
        if self.state[_MODE]:
            self.break_off()

    def idle(self):
        """Whether the core stands still: nothing is sampled or injected."""
        return not (self.wanted or self.injection.active)

    def plant(self, forest):
        """Another forest (None: the shipped one) from the next run on."""
        try:
            self.tables = forest_file.planted(self.tables, forest)
            self.injection.tables = self.tables
        except MemoryError:
            self.log(_ERROR, "no room for the forest beside another: it holds after a restart")
        self.checkpoint.identity = self.identity()
        self.announce()

    def identity(self):
        """Of all that must be the same for a run to be gone on with."""
        return crc32(self.clock.base) ^ self.build[0] ^ navigator.forest_hash(self.tables)

    def test_bus(self):
        """How well the sensor's bus carries a clock; only while nobody needs its samples."""
        khz, reads = unpack_from(messages.FORMATS[messages.ASK_BUS_TEST], self.link.command, HEADER)
        if self.wanted or khz not in (SLOW, FAST):
            return messages.REFUSED
        self.link.flush()
        done, errors = self.sensor.test_bus(khz, reads)
        reports.bus_test(self.link, self.state[_TICK], khz, done, errors)
        self.beat = ticks_ms()

    def end_run(self):
        """Nobody is to go on with it."""
        self.keep(self.checkpoint.close, self.state, self.sampler.period())

    def keep(self, write, *what):
        """Let the checkpoint write something down; a flash that refuses is told once."""
        try:
            write(*what)
            self.unsaved = False
        except OSError as error:
            if not self.unsaved:
                self.log(_WARNING, "can't save the run to flash: %s" % error)
            self.unsaved = True

    def ask_snapshot(self):
        """With the next tick; at once where none is to come."""
        if self.sampling():
            self.snapshot_asked = True
        else:
            reports.snapshot(self.link, self.state[_TICK], self.state)

    def status(self):
        temperature = self.sensor.temperature()
        # fmt: off
        reports.status(
            self.link, self.state[_TICK], self.mode, self.state[_MOTION], self.sampler, temperature,
            self.worst,
        )
        # fmt: on

    def log(self, level, text):
        reports.log(self.link, self.state[_TICK], level, text)
