"""Messages that aren't packed from the navigator's state alone: each function sends one."""

import gc
import sys
from binascii import crc32
from struct import pack_into

import machine
import uctypes

from solenav_core.framing import HEADER, PAYLOAD_MAX
from solenav_core.messages import (
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
from solenav_core.params import NAMES

_RATE = NAMES.index("RATE_MHZ")


def hello(link, tick, params, pose_every, kind, board, build, failed_test):
    """Who is speaking. `build` is (hash, version) of the files on the board."""
    version = ".".join([str(n) for n in sys.implementation.version[:3]])
    text = "%s; %s; MicroPython %s" % (board, build[1], version)
    # fmt: off
    pack_into(
        FORMATS[HELLO], link.frame, HEADER, SCHEMA, build[0], crc32(params), params[_RATE],
        pose_every, kind, machine.reset_cause() & 255, failed_test,
    )
    # fmt: on
    link.send(HELLO, tick, _append(link.frame, HEADER + SIZES[HELLO], text))


def parameters(link, tick, params):
    """Every parameter as the core has it."""
    pack_into(FORMATS[PARAMS], link.frame, HEADER, *params)
    link.send(PARAMS, tick, HEADER + SIZES[PARAMS])


def sample(link, tick, sampler, temperature):
    """The sample that the tick was made from."""
    m = sampler.sample
    # fmt: off
    pack_into(
        FORMATS[SAMPLE], link.frame, HEADER, sampler.time, m[0], m[1], m[2], m[3], m[4], m[5],
        temperature, sampler.flags,
    )
    # fmt: on
    link.send(SAMPLE, tick, HEADER + SIZES[SAMPLE])


def snapshot(link, tick, state):
    """The whole state, in as many frames as it takes."""
    total = 4 * len(state)
    # The array's own bytes: copying word by word would take longer than a sample period.
    data = uctypes.bytearray_at(uctypes.addressof(state), total)
    at = HEADER + SIZES[SNAPSHOT]
    most = HEADER + PAYLOAD_MAX - at
    for offset in range(0, total, most):
        size = min(most, total - offset)
        pack_into(FORMATS[SNAPSHOT], link.frame, HEADER, offset, total)
        link.frame[at : at + size] = data[offset : offset + size]
        link.send(SNAPSHOT, tick, at + size)


def status(link, tick, mode, sampler, worst):
    """Counters. Collects garbage first, so that the heap figure is what is really free."""
    gc.collect()
    dropped = link.outbox.dropped
    # fmt: off
    pack_into(
        FORMATS[STATUS], link.frame, HEADER, mode, sampler.samples, sampler.overruns,
        sampler.gaps, sampler.bus_errors, sampler.recoveries, sampler.clipped, dropped[0],
        dropped[1], dropped[2], link.damaged, sampler.period(), worst, gc.mem_free(),
    )
    # fmt: on
    link.send(STATUS, tick, HEADER + SIZES[STATUS])


def log(link, tick, level, text):
    """A line for a person; `level` is an index into `messages.LEVELS`."""
    link.frame[HEADER] = level
    link.send(LOG, tick, _append(link.frame, HEADER + SIZES[LOG], text))


def _append(frame, at, text):
    """Text up to the longest payload; its end."""
    data = text.encode()[: HEADER + PAYLOAD_MAX - at]
    frame[at : at + len(data)] = data
    return at + len(data)
