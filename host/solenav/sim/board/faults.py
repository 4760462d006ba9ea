"""Everything that can go wrong on the simulated board, by script.

A script is a list of {"kind": ..., "at": µs of the recording, "for": µs, ...}; with "after" in
place of "at" the time counts from when the board was first switched on (the recording starts only
when the sensor samples). Kinds with their own keys, [default]:

    nack           nothing on the sensor's bus acknowledges; "every" [1] transfer, "above" [0] Hz
    stuck_sda      SDA held low until SCL was clocked "clocks" [9] times, or the time is over
    wrong_id       WHO_AM_I reads as "value" [0x70]
    frozen         the data registers stay as they are, data ready goes on; with "mends" [false]
                   a reset of the sensor ends it
    fifo_overflow  the processor stands still with interrupts disabled [1 s]
    hang           the processor stands still, interrupts are served [1 s]
    watchdog       the same, longer than any watchdog waits [20 s]
    clock          the sensor's samples come at "factor" times their spacing
    spike          "axis" (ax .. mz) reads as "value" [32767]; one sample without "for"
    bit_flip       "bit" [0] of "byte" [0] of the next "count" [1] reads that are so long
    bus_noise      a random bit of every "every" [50] transfer on the bus is inverted
    int_wire       the sensor's interrupts don't reach the processor
    register       the sensor's "register" gets the "value"
    reset          the sensor falls back to its reset state, asleep
    brown_out      the sensor without power [50 ms], then back in its reset state
    gone           the sensor unplugged [2 s], then back in its reset state
    temperature    changes by "degrees" over the time and stays, the gyro's bias by "gyro" [4, -3,
                   2] counts a degree
    self_test      no self-test response on "axes" [["gz"]]; "mag" is the AK8975's
    compass        the AK8975 doesn't answer
    magnet         "field" [x, y, z] in 0.3 µT counts is added
    uart_noise     random bytes on RX, "rate" [100] bytes a second
    uart_flood     RX at the line's full rate, of "data" (hexadecimal) or random
    power_cut      the whole board without power [1 s]; in place of "at": "operation" or "byte",
                   the n-th of the flash
    flash_full     nothing more finds room in the flash

"for" is the whole rest where no default is said. `seed` chooses random bytes.
"""

from binascii import unhexlify

from solenav.sim.board import flash, machine, simtime
from solenav.sim.board.ak8975_registers import NO_FIELD, QUIET_FIELD
from solenav.sim.board.feed import AXES

try:
    from typing import Any
except ImportError:  # MicroPython: annotations are never evaluated there
    pass

_REST = 1 << 50
_LINE_RATE = 46_080  # bytes a second at 460800 baud


def _nack(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    machine.bus.nack = fault if on else None


def _stuck_sda(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    machine.bus.held = fault.get("clocks", 9) if on else 0


def _wrong_id(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    world.sensor.identity = fault.get("value", 0x70) if on else 0x68


def _frozen(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    world.sensor.frozen = on
    world.sensor.mends = on and fault.get("mends", False)


def _stall(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    if on:
        simtime.hold_off(_length(fault))


def _hang(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    if on:
        simtime.advance(_length(fault))


def _clock(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    world.playback.factor = fault["factor"] if on else 1.0


def _spike(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    axis = AXES.index(fault.get("axis", "ax"))
    once = "for" not in fault

    def change(values: list[int], _time: int) -> None:
        values[axis] = fault.get("value", 32767)
        if once:
            world.alter(fault, None)

    world.alter(fault, change if on else None)


def _bit_flip(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    machine.bus.flip = fault if on else None


def _bus_noise(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    machine.bus.disturb(fault if on else None)


def _int_wire(_world: "World", _fault: "dict[str, Any]", on: bool) -> None:
    machine.cut_wire = on


def _register(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    if on:
        world.sensor.corrupt(fault["register"], fault["value"])


def _reset(world: "World", _fault: "dict[str, Any]", on: bool) -> None:
    if on and world.sensor.powered:
        world.sensor.reset()


def _gone(_world: "World", _fault: "dict[str, Any]", on: bool) -> None:
    machine.unplug(on)


def _temperature(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    if not on:
        return
    begin, length = fault["at"], _length(fault)
    gyro = fault.get("gyro", (4, -3, 2))

    def change(values: list[int], time: int) -> None:
        degrees = fault["degrees"] * min(time - begin, length) / length
        values[3] = _clip(values[3] + round(340 * degrees))
        for i in range(3):
            values[4 + i] = _clip(values[4 + i] + round(gyro[i] * degrees))

    world.alter(fault, change)


def _self_test(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    axes = fault.get("axes", ["gz"]) if on else []
    imu = ("ax", "ay", "az", "gx", "gy", "gz")
    world.sensor.failing = {imu.index(axis) for axis in axes if axis in imu}
    if world.sensor.compass:
        world.sensor.compass.failing = "mag" in axes


def _compass(world: "World", _fault: "dict[str, Any]", on: bool) -> None:
    if world.sensor.compass:
        world.sensor.compass.disabled = on


def _magnet(world: "World", fault: "dict[str, Any]", on: bool) -> None:
    def change(values: list[int], _time: int) -> None:
        if values[7] == NO_FIELD:
            values[7:10] = QUIET_FIELD
        for i in range(3):
            values[7 + i] = _clip(values[7 + i] + fault["field"][i])

    world.alter(fault, change if on else None)


def _uart(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    rate = fault.get("rate", 100 if fault["kind"] == "uart_noise" else _LINE_RATE)
    data = unhexlify(fault.get("data", ""))
    length = _length(fault)
    machine.inject(machine.Line(rate, length, data, fault.get("seed", 1)) if on else None)


def _power_cut(_world: "World", fault: "dict[str, Any]", on: bool) -> None:
    if on:
        machine.cut_power(_length(fault))


def _flash_full(_world: "World", _fault: "dict[str, Any]", on: bool) -> None:
    flash.full = on


# By kind: what sets it on and off, how long it lasts by default (0: it is over at once), whether
# the sensor must be there.
KINDS = {
    "nack": (_nack, _REST, False),
    "stuck_sda": (_stuck_sda, 0, False),
    "wrong_id": (_wrong_id, _REST, True),
    "frozen": (_frozen, _REST, True),
    "fifo_overflow": (_stall, 1_000_000, False),
    "hang": (_hang, 1_000_000, False),
    "watchdog": (_hang, 20_000_000, False),
    "clock": (_clock, _REST, True),
    "spike": (_spike, _REST, True),
    "bit_flip": (_bit_flip, _REST, False),
    "bus_noise": (_bus_noise, _REST, False),
    "int_wire": (_int_wire, _REST, False),
    "register": (_register, 0, True),
    "reset": (_reset, 0, True),
    "brown_out": (_gone, 50_000, True),
    "gone": (_gone, 2_000_000, True),
    "temperature": (_temperature, _REST, True),
    "self_test": (_self_test, _REST, True),
    "compass": (_compass, _REST, True),
    "magnet": (_magnet, _REST, True),
    "uart_noise": (_uart, _REST, False),
    "uart_flood": (_uart, _REST, False),
    "power_cut": (_power_cut, 1_000_000, False),
    "flash_full": (_flash_full, _REST, False),
}
_NEEDED = {
    "clock": ("factor",),
    "register": ("register", "value"),
    "temperature": ("at", "degrees"),
    "magnet": ("field",),
}
# They end by themselves.
_BRIEF = ("fifo_overflow", "hang", "watchdog", "register", "reset", "power_cut", "temperature")
_ONCE = (
    "stuck_sda", "fifo_overflow", "hang", "watchdog", "bit_flip", "register", "reset", "power_cut",
)  # fmt: skip


def problem(fault: "dict[str, Any]") -> str:
    """What is wrong with a fault of a script; empty if nothing is."""
    kind = fault.get("kind")
    if kind not in KINDS:
        return "there is no kind %r: %s" % (kind, ", ".join(sorted(KINDS)))
    times = ("at", "after", "operation", "byte") if kind == "power_cut" else ("at", "after")
    if sum(key in fault for key in times) != 1:
        return "%s needs one of %s" % (kind, ", ".join(times))
    for key in _NEEDED.get(kind, ()):
        if key not in fault:
            return "%s needs %s" % (kind, key)
    return ""


class World:
    """The board that a script acts on."""

    def __init__(self, script: "list[dict[str, Any]]", sensor: "Any", playback: "Any") -> None:
        self.sensor = sensor
        self.playback = playback
        self._script = script
        self._again = False
        self._active: dict[str, list[dict[str, Any]]] = {}
        self._changes: list[tuple[Any, Any]] = []
        machine.scripted = bool(script)

    def switch_on(self, again: bool = False) -> None:
        """Schedule what counts from the board's first power-up, and cuts at flash writes.

        `again`: this isn't the first life of the processor.
        """
        self._again = again
        self._schedule("after", 0)
        for fault in self._script:
            operation, byte = fault.get("operation", 0), fault.get("byte", 0)
            if fault["kind"] == "power_cut" and (operation or byte):
                flash.cut(operation, byte, lambda fault=fault: _power_cut(self, fault, True))
        simtime.advance(0)  # what is so from the beginning

    def start(self) -> None:
        """Schedule what counts from the recording's start."""
        self._schedule("at", self.playback.start)

    def alter(self, fault: "dict[str, Any]", change: "Any") -> None:
        """Change what the sensor measures; None: no more."""
        self._changes = [entry for entry in self._changes if entry[0] is not fault]
        if change:
            self._changes.append((fault, change))
        self.playback.changes = [entry[1] for entry in self._changes]

    def _schedule(self, key: str, origin: int) -> None:
        now = simtime.now()
        for fault in self._script:
            if key not in fault:
                continue
            kind = KINDS[fault["kind"]]
            if kind[2] and not self.sensor:
                continue
            begin = origin + fault[key]
            length = _length(fault)
            stays = fault["kind"] == "temperature"
            past = begin + length <= now or _once(fault)
            if self._again and begin <= now and past and not stays:
                continue
            simtime.at(max(begin, now), lambda fault=fault: self._begin(fault))
            if length and length < _REST and fault["kind"] not in _BRIEF:
                simtime.at(begin + length, lambda fault=fault: self._end(fault))

    def _begin(self, fault: "dict[str, Any]") -> None:
        if fault["kind"] not in _BRIEF and not (fault["kind"] == "spike" and "for" not in fault):
            self._active.setdefault(fault["kind"], []).append(fault)
        KINDS[fault["kind"]][0](self, fault, True)

    def _end(self, fault: "dict[str, Any]") -> None:
        """Off, unless another of its kind goes on."""
        others = self._active[fault["kind"]]
        others.remove(fault)
        KINDS[fault["kind"]][0](self, fault, False)
        if others:
            KINDS[fault["kind"]][0](self, others[-1], True)


def _length(fault: "dict[str, Any]") -> int:
    return fault.get("for", KINDS[fault["kind"]][1])


def _once(fault: "dict[str, Any]") -> bool:
    """Whether it acts when it begins only: one that began before a restart is past."""
    return fault["kind"] in _ONCE or (fault["kind"] == "spike" and "for" not in fault)


def _clip(value: int) -> int:
    return max(-32768, min(32767, value))
