"""Messages that aren't packed from the navigator's state alone: each function sends one."""

import gc
import sys
from binascii import crc32
from struct import pack_into

import machine
import uctypes
from bus import FAST, SLOW

from solenav_core.compat import const, micropython, ptr8, ptr32
from solenav_core.framing import HEADER, PAYLOAD_MAX
from solenav_core.messages import (
    BUS_TEST,
    FORMATS,
    HELLO,
    LOG,
    PARAMS,
    SAMPLE,
    SCHEMA,
    SIZES,
    SNAPSHOT,
    STATUS,
)
from solenav_core.navigator import forest_hash
from solenav_core.params import NAMES

_RATE = NAMES.index("RATE_MHZ")
_PAYLOAD = const(6)  # framing.HEADER
_READINGS = const(9)


@micropython.viper
def pack_sample(frame: ptr8, sample: ptr32, low: int, high: int, temperature: int) -> int:
    """SAMPLE's payload into the frame; its end. Time in halves: above 2**30 it is an object.

    By hand, as there is one on every tick: `pack_into` takes five times as long.
    """
    at = _PAYLOAD
    i = -2
    while i <= _READINGS + 1:
        value = temperature
        if i == -2:
            value = low
        elif i == -1:
            value = high
        elif i < _READINGS:
            value = sample[i]
        elif i > _READINGS:
            value = sample[_READINGS]  # flags, and how many were lost
        frame[at] = value & 255
        frame[at + 1] = (value >> 8) & 255
        at = at + 2
        i = i + 1
    return at


def hello(link, tick, params, tables, pose_every, sensor, board, build, failed_test):
    """Who is speaking. `build` is (hash, version) of the files on the board."""
    version = ".".join([str(n) for n in sys.implementation.version[:3]])
    text = "%s; %s; MicroPython %s" % (board, build[1], version)
    # fmt: off
    pack_into(
        FORMATS[HELLO], link.frame, HEADER, SCHEMA, build[0], crc32(params), forest_hash(tables),
        params[_RATE], pose_every, sensor.kind, machine.reset_cause() & 255, failed_test,
        sensor.test,
    )
    # fmt: on
    link.send(HELLO, tick, _append(link.frame, HEADER + SIZES[HELLO], text))


def parameters(link, tick, params):
    """Every parameter as the core has it."""
    _fragments(link, PARAMS, tick, params)


def sample(link, tick, sampler, temperature):
    """The sample that the tick was made from."""
    end = pack_sample(link.frame, sampler.sample, sampler.time_low, sampler.time_high, temperature)
    link.send(SAMPLE, tick, end)


def snapshot(link, tick, state):
    """The whole state, in as many frames as it takes."""
    _fragments(link, SNAPSHOT, tick, state)


def status(link, tick, mode, motion, sampler, temperature, worst):
    """Counters. Collects garbage first, so that the heap figure is what is really free."""
    gc.collect()
    dropped = link.outbox.dropped
    box = link.blackbox
    # fmt: off
    pack_into(
        FORMATS[STATUS], link.frame, HEADER, mode, motion, sampler.samples, sampler.overruns,
        sampler.gaps, sampler.lost_samples, sampler.spikes, sampler.fifo_overflows,
        sampler.bus_errors, sampler.recoveries, SLOW if sampler.slow else FAST, sampler.clipped,
        dropped[0], dropped[1], dropped[2], link.damaged, link.refused, box.logged, box.lost,
        temperature, sampler.period(), worst, gc.mem_free(),
    )
    # fmt: on
    link.send(STATUS, tick, HEADER + SIZES[STATUS])


def bus_test(link, tick, khz, reads, errors):
    """What a test of the sensor's bus found."""
    pack_into(FORMATS[BUS_TEST], link.frame, HEADER, khz, reads, errors)
    link.send(BUS_TEST, tick, HEADER + SIZES[BUS_TEST])


def log(link, tick, level, text):
    """A line for a person; `level` is an index into `messages.LEVELS`."""
    link.frame[HEADER] = level
    link.send(LOG, tick, _append(link.frame, HEADER + SIZES[LOG], text))


def _fragments(link, kind, tick, words):
    total = 4 * len(words)
    # The array's own bytes: copying word by word would take longer than a sample period.
    data = uctypes.bytearray_at(uctypes.addressof(words), total)
    at = HEADER + SIZES[kind]
    most = HEADER + PAYLOAD_MAX - at
    for offset in range(0, total, most):
        size = min(most, total - offset)
        pack_into(FORMATS[kind], link.frame, HEADER, offset, total)
        link.frame[at : at + size] = data[offset : offset + size]
        link.send(kind, tick, at + size)


def _append(frame, at, text):
    """Text up to the longest payload; its end."""
    data = text.encode()[: HEADER + PAYLOAD_MAX - at]
    frame[at : at + len(data)] = data
    return at + len(data)
