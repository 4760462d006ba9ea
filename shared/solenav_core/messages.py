"""The message schema: what goes over the wire, packed and unpacked on both sides from here.

Each message is ``(type, name, when, fields)``, each field ``(name, struct code, count, format,
meaning)``; code ``*`` is bytes up to the payload's end. Numbers are little-endian integers in
the core's own formats. Sensor and navigator messages go from the board to the host; commands,
from 0x40 on, the other way, each answered by an ACK with its seq.
"""

from array import array
from struct import calcsize, pack_into

from solenav_core.compat import const, micropython, ptr8, ptr32
from solenav_core.framing import crc16
from solenav_core.layout import STATE_FIELDS, offsets
from solenav_core.navigator import digest
from solenav_core.params import NAMES

HELLO = 0x01
PARAMS = 0x02
ALIGN = 0x03
SAMPLE = 0x04
POSE = 0x05
STEP = 0x06
SNAPSHOT = 0x07
STATUS = 0x08
LOG = 0x09
ACK = 0x0A
FILE = 0x0B
FILE_DATA = 0x0C
FILE_CHECK = 0x0D
BUS_TEST = 0x0E
INJECTED = 0x0F

ASK_HELLO = 0x40
ASK_START = 0x41
ASK_STOP = 0x42
ASK_SNAPSHOT = 0x43
ASK_LISTEN = 0x44
ASK_FILES = 0x45
ASK_DATA = 0x46
ASK_CHECK = 0x47
ASK_ERASE = 0x48
ASK_BUS_TEST = 0x49
ASK_INJECT = 0x4A
ASK_PARAM = 0x4B
INJECT = 0x4C
ASK_FOREST = 0x4D

# SAMPLE flags
CLIPPED_ACC = 1
CLIPPED_GYRO = 2
GAP_BEFORE = 4
MAG_NEW = 8
MAG_BAD = 16

LOST_MAX = 127  # what SAMPLE says of lost samples stops here

# POSE flags
IN_STANCE = 1
NAVIGATING = 2
FROZEN = 4  # so long without stance that the covariance stopped growing
SATURATED = 8  # the velocity has been at its limit since the static start
# Since the static start more samples were lost than can be bridged, or the filter was locked out
# (which no walk of the recordings does): the pose may be off by metres.
GAP = 16
RESUMED = 32  # position and heading go on from before a long gap or a restart

# STATUS modes
IDLE, ALIGNING, RUNNING, FAULT, RESUMING = 0, 1, 2, 3, 4

# ACK results
DONE, REPEATED, UNKNOWN, REFUSED = 0, 1, 2, 3
UNANSWERED = -1  # on the board: another message is the answer

NOT_TESTED = 128  # HELLO's sensor_test

LEVELS = ("info", "warning", "error")

SENSORS = ("none", "MPU-6050", "MPU-9150")

_MOTION = "0 unknown, 1 still, 2 walk, 3 run, 4 upstairs, 5 downstairs"

MESSAGES = (
    (
        HELLO,
        "HELLO",
        "at boot and when asked for",
        (
            ("schema", "H", 1, "", "hash of the message schema: the seed of all other CRCs"),
            ("build", "I", 1, "", "hash of firmware and core files"),
            ("params", "I", 1, "", "CRC-32 of the parameters"),
            ("forest", "I", 1, "", "CRC-32 of the forest that tells motions apart"),
            ("rate", "I", 1, "mHz", "nominal sample rate"),
            ("pose_every", "H", 1, "ticks", "a POSE on every so many ticks"),
            ("sensor", "B", 1, "", "0 none, 1 MPU-6050, 2 MPU-9150"),
            ("boot_reason", "B", 1, "", "machine.reset_cause()"),
            ("self_test", "B", 1, "", "of the core: 0 passed, else the failed test, from 1"),
            (
                "sensor_test",
                "B",
                1,
                "",
                "of the sensor: 1 accelerometer failed, 2 gyro, 4 magnetometer, 128 not run",
            ),
            ("text", "*", 0, "UTF-8", "board; firmware version; MicroPython"),
        ),
    ),
    (
        PARAMS,
        "PARAMS",
        "after HELLO and on change, in fragments; they hold from the next tick on",
        (
            ("offset", "H", 1, "bytes", "where the fragment goes"),
            ("total", "H", 1, "bytes", "size of all parameters"),
            ("data", "*", 0, "", "every parameter, in the order of the core's list, 4 bytes each"),
        ),
    ),
    (
        ALIGN,
        "ALIGN",
        "when a static start is taken; a better one may follow before the first step",
        (
            ("attitude", "i", 4, "Q30", "body to ENU, scalar first"),
            ("bias", "i", 3, "Q20 counts", "gyro bias"),
            ("gravity", "i", 1, "Q20 m/s²", "mean specific force"),
            ("ticks", "i", 1, "ticks", "still samples used"),
            ("restarts", "i", 1, "", "stretches of stillness that motion ended"),
            ("peak_acc", "i", 1, "counts", "largest deviation from the first still sample"),
            ("peak_rate", "i", 1, "counts", "largest deviation from the first still sample"),
            ("digest", "I", 1, "", "CRC-32 of the state"),
        ),
    ),
    (
        SAMPLE,
        "SAMPLE",
        "on every tick",
        (
            ("time", "I", 1, "µs", "board time of the sample, wraps at 2**32"),
            ("acc", "h", 3, "counts", "accelerometer, 2048 a g"),
            ("gyro", "h", 3, "counts", "gyro, 16.4 a °/s"),
            ("mag", "h", 3, "0.3 µT", "magnetometer's last reading, axes of the accelerometer"),
            ("temperature", "h", 1, "1/340 °C", "die temperature less 35 °C"),
            (
                "flags",
                "B",
                1,
                "",
                "1 accelerometer clipped, 2 gyro clipped, 4 gap before, 8 magnetometer read anew, "
                "16 its reading was unsound",
            ),
            ("lost", "B", 1, "", "samples lost just before this one, at most 127"),
        ),
    ),
    (
        POSE,
        "POSE",
        "on every pose_every-th tick once aligned",
        (
            ("position", "i", 3, "Q18 m", "ENU, inside the cell"),
            ("cell", "b", 3, "4096 m", "ENU; position = 4096 cell + position"),
            ("velocity", "i", 3, "Q24 m/s", "ENU"),
            ("attitude", "i", 4, "Q30", "body to ENU, scalar first"),
            (
                "flags",
                "B",
                1,
                "",
                "1 stance, 2 navigating, 4 covariance frozen, 8 saturated, 16 gap, 32 resumed",
            ),
            ("motion", "B", 1, "", _MOTION),
            ("threshold", "H", 1, "Q14", "adaptive threshold M"),
            ("n_eff", "H", 1, "Q8", "effective sample size"),
            ("m2", "I", 1, "Q10", "normalised innovation squared"),
            ("acc_norm", "H", 1, "Q7 m/s²", "specific force magnitude"),
            ("resampled", "I", 1, "", "secondary resamplings so far"),
            ("steps", "H", 1, "", "steps so far, modulo 2**16"),
            ("distance", "I", 1, "Q10 m", "sum of the step lengths"),
            ("digest", "I", 1, "", "CRC-32 of the state"),
        ),
    ),
    (
        STEP,
        "STEP",
        "at the end of each stance that is a step",
        (
            ("displacement", "i", 3, "Q18 m", "ENU, since the last step"),
            ("turn", "h", 1, "2**16 a turn", "heading change since the last step, clockwise"),
            ("heading", "h", 1, "2**16 a turn", "azimuth of the foot, clockwise from North"),
            ("variance", "i", 3, "Q24 m²", "of the displacement, E N U"),
            ("ticks", "I", 1, "ticks", "since the last step"),
            ("steps", "I", 1, "", "steps so far"),
            ("distance", "I", 1, "Q10 m", "sum of the step lengths"),
            ("digest", "I", 1, "", "CRC-32 of the state"),
        ),
    ),
    (
        SNAPSHOT,
        "SNAPSHOT",
        "every 10 s and when asked for, in fragments of one tick",
        (
            ("offset", "H", 1, "bytes", "where the fragment goes"),
            ("total", "H", 1, "bytes", "size of the whole state"),
            ("data", "*", 0, "", "the state's bytes"),
        ),
    ),
    (
        STATUS,
        "STATUS",
        "every second",
        (
            ("mode", "B", 1, "", "0 idle, 1 aligning, 2 navigating, 3 fault, 4 resuming"),
            ("motion", "B", 1, "", _MOTION),
            ("samples", "I", 1, "", "samples read since start"),
            ("overruns", "I", 1, "", "samples that came before the last one was read"),
            ("gaps", "I", 1, "", "times that samples were lost"),
            ("lost", "I", 1, "", "samples lost in them"),
            ("spikes", "I", 1, "", "samples dropped for an impossible jump"),
            ("fifo_overflows", "I", 1, "", "times that the sensor's FIFO ran over"),
            ("bus_errors", "I", 1, "", "failed I2C transfers"),
            ("recoveries", "I", 1, "", "sensor set up anew"),
            ("bus_khz", "H", 1, "kHz", "clock of the sensor's bus"),
            ("clipped", "I", 1, "", "samples at full scale"),
            ("dropped_samples", "I", 1, "", "SAMPLE frames that the UART had no room for"),
            ("dropped_poses", "I", 1, "", "POSE frames, likewise"),
            ("dropped_others", "I", 1, "", "other frames, likewise"),
            ("bad_commands", "I", 1, "", "damaged frames received"),
            ("refused_commands", "I", 1, "", "commands over the limit of their rate"),
            ("logged", "I", 1, "bytes", "in the black box since power-up"),
            ("log_lost", "I", 1, "", "frames that the black box had no room for"),
            ("temperature", "h", 1, "1/340 °C", "die temperature less 35 °C"),
            ("period", "I", 1, "Q8 µs", "learned sample period"),
            ("worst", "I", 1, "µs", "longest tick of the core so far"),
            ("heap", "I", 1, "bytes", "free heap"),
        ),
    ),
    (
        LOG,
        "LOG",
        "on events",
        (
            ("level", "B", 1, "", "0 info, 1 warning, 2 error"),
            ("text", "*", 0, "UTF-8", "what happened"),
        ),
    ),
    (
        ACK,
        "ACK",
        "after each command",
        (
            ("command", "B", 1, "", "its type"),
            ("command_seq", "B", 1, "", "its seq"),
            ("result", "B", 1, "", "0 done, 1 done before, 2 unknown, 3 refused"),
        ),
    ),
    (
        FILE,
        "FILE",
        "for each file of the black box when asked for; with a count of 0 where there is none",
        (
            ("index", "H", 1, "", "its place in the list, oldest first"),
            ("count", "H", 1, "", "files in all"),
            ("number", "I", 1, "", "its name; grows from file to file"),
            ("size", "I", 1, "bytes", "of the file"),
            ("free", "I", 1, "bytes", "left for the black box, less what it keeps in reserve"),
            ("longest", "I", 1, "µs", "the black box's longest flash access since power-up"),
        ),
    ),
    (
        FILE_DATA,
        "FILE_DATA",
        "a piece of a file, when asked for",
        (
            ("number", "I", 1, "", "the file"),
            ("offset", "I", 1, "bytes", "where the piece goes"),
            ("data", "*", 0, "", "the file's bytes: frames, as on the wire"),
        ),
    ),
    (
        FILE_CHECK,
        "FILE_CHECK",
        "when asked for and computed",
        (
            ("number", "I", 1, "", "the file"),
            ("size", "I", 1, "bytes", "of the file"),
            ("crc", "I", 1, "", "CRC-32 of the whole file"),
        ),
    ),
    (
        BUS_TEST,
        "BUS_TEST",
        "when asked for and done",
        (
            ("khz", "H", 1, "kHz", "clock of the sensor's bus during the test"),
            ("reads", "H", 1, "", "one-byte reads of the sensor's identity"),
            ("errors", "H", 1, "", "of them failed or gave another value"),
        ),
    ),
    (
        INJECTED,
        "INJECTED",
        "after each INJECT; its tick is the last one that the core ran",
        (("digest", "I", 1, "", "CRC-32 of the state"),),
    ),
    (ASK_HELLO, "ASK_HELLO", "command: send HELLO and PARAMS", ()),
    (ASK_START, "ASK_START", "command: start afresh with a static start", ()),
    (ASK_STOP, "ASK_STOP", "command: stop sampling", ()),
    (ASK_SNAPSHOT, "ASK_SNAPSHOT", "command: send a SNAPSHOT after the next tick", ()),
    (
        ASK_LISTEN,
        "ASK_LISTEN",
        "command: somebody listens; without it for 5 s the black box records",
        (),
    ),
    (
        ASK_FILES,
        "ASK_FILES",
        "command: send FILE for each file from an index on",
        (("index", "H", 1, "", "of the first"),),
    ),
    (
        ASK_DATA,
        "ASK_DATA",
        "command: send a stretch of a file as FILE_DATA; ends one asked for before",
        (
            ("number", "I", 1, "", "the file"),
            ("offset", "I", 1, "bytes", "from where"),
            ("length", "I", 1, "bytes", "how much, at most to its end"),
        ),
    ),
    (
        ASK_CHECK,
        "ASK_CHECK",
        "command: compute and send FILE_CHECK",
        (("number", "I", 1, "", "the file"),),
    ),
    (
        ASK_ERASE,
        "ASK_ERASE",
        "command: erase a file; refused unless its last FILE_CHECK said the same",
        (
            ("number", "I", 1, "", "the file"),
            ("size", "I", 1, "bytes", "of the file"),
            ("crc", "I", 1, "", "CRC-32 of the whole file"),
        ),
    ),
    (
        ASK_BUS_TEST,
        "ASK_BUS_TEST",
        "command: read the sensor's identity again and again; refused while sampling",
        (
            ("khz", "H", 1, "kHz", "clock, 100 or 400"),
            ("reads", "H", 1, "", "how often, at most 500; it ends after 20 errors"),
        ),
    ),
    (
        ASK_INJECT,
        "ASK_INJECT",
        "command: a fresh run on samples of INJECT, or the end of it; silence for 5 s ends it, too",
        (("begin", "B", 1, "", "1 begin, 0 end"),),
    ),
    (
        ASK_PARAM,
        "ASK_PARAM",
        "command: a parameter of the injected run; holds from its next tick on",
        (
            ("index", "H", 1, "", "in the core's list"),
            ("value", "i", 1, "", "within the core's limits"),
        ),
    ),
    (
        INJECT,
        "INJECT",
        "command: one sample; answered by INJECTED and not by ACK",
        (
            ("before", "I", 1, "", "ticks of the run before this sample; another is left out"),
            ("sample", "h", 10, "", "the core's words: force, rate, field, flags and lost"),
        ),
    ),
    (
        ASK_FOREST,
        "ASK_FOREST",
        "command: a piece of another forest, in order; whole, it is checked and kept in flash; "
        "refused while sampling and where it is none; a total of 0: back to the shipped one",
        (
            ("offset", "H", 1, "words", "where the piece goes"),
            ("total", "H", 1, "words", "size of the forest"),
            ("words", "i", 12, "", "of the last piece those past the total don't count"),
        ),
    ),
)

# Types whose frames every version can read: they carry the standard CRC seed.
OPEN = (HELLO, ACK, ASK_HELLO)


def form(fields):
    """The `struct` format of a message's fields, without trailing bytes."""
    return "<" + "".join(
        ["%d%s" % (n, c) if n > 1 else c for _f, c, n, _q, _m in fields if c != "*"]
    )


FORMATS = {kind: form(fields) for kind, _name, _when, fields in MESSAGES}
SIZES = {kind: calcsize(FORMATS[kind]) for kind in FORMATS}


def schema_hash():
    """CRC-16 of everything that sender and receiver must agree on."""
    seed = 0xFFFF
    for kind, name, _when, fields in MESSAGES:
        for part in [str(kind), name] + [f[0] + f[1] + str(f[2]) + f[3] for f in fields]:
            data = part.encode()
            seed = crc16(data, 0, len(data), seed)
    for name in list(NAMES) + [f[0] + str(f[1]) for f in STATE_FIELDS]:
        data = name.encode()
        seed = crc16(data, 0, len(data), seed)
    return seed


SCHEMA = schema_hash()

_AT = offsets(STATE_FIELDS)
_ALIGN = _AT["ATT"], _AT["BIAS"], _AT["GRAVITY"], _AT["AL_BEST"]
# POSE's flags, for `pose`.
_FROZEN = const(4)
_SATURATED = const(8)
_GAP = const(16)
_RESUMED = const(32)
# What `pose` makes the payload of: words of the state for the flags, how many fields, and of each
# its word and its bytes; 0: the flags' own place.
_POSE_FLAGS = ("STANCE", "MODE", "SWING_TICKS", "SATURATED", "GAPS", "LOCKOUTS", "RESUMED")
_POSE_FIELDS = (("POS", 3, 4), ("CELL", 3, 1), ("VEL", 3, 4), ("ATT", 4, 4), ("STANCE", 1, 0))
_POSE_FIELDS += (("MOTION", 1, 1), ("THRESHOLD", 1, 2), ("N_EFF", 1, 2), ("M2", 1, 4))
_POSE_FIELDS += (("ACC_NORM", 1, 2), ("RESAMPLED", 1, 4), ("STEPS", 1, 2), ("DISTANCE", 1, 4))
_PLACES = [(_AT[name] + i, size) for name, words, size in _POSE_FIELDS for i in range(words)]
_POSE = [_AT[name] for name in _POSE_FLAGS] + [len(_PLACES)]
_POSE = array("i", _POSE + [n for place in _PLACES for n in place])
_FREEZE = NAMES.index("FREEZE_TICKS")
_STEP = ("STEP_MOVE", "STEP_TURN", "HEADING_LAST", "STEP_VAR", "STEP_TICKS", "STEPS", "DISTANCE")
_STEP = [_AT[name] for name in _STEP]


def pack_align(buf, at, s):
    """The ALIGN payload of state `s` into buf[at:]; its end."""
    q, b, g, n = _ALIGN
    # fmt: off
    pack_into(
        FORMATS[ALIGN], buf, at, s[q], s[q + 1], s[q + 2], s[q + 3], s[b], s[b + 1], s[b + 2],
        s[g], s[n], s[n + 1], s[n + 2], s[n + 3], digest(s),
    )
    # fmt: on
    return at + SIZES[ALIGN]


def pack_pose(buf, at, s, params):
    """The POSE payload of state `s` into buf[at:]; its end."""
    return pose(buf, at, s, _POSE, params[_FREEZE], digest(s))


@micropython.viper
def pose(buf: ptr8, at: int, s: ptr32, plan: ptr32, freeze: int, crc: int) -> int:
    """`pack_pose`, for a Pico, which took 0.13 ms of each tick to pack so many numbers."""
    flags = s[plan[0]] | (s[plan[1]] << 1)
    if s[plan[2]] > freeze:
        flags = flags | _FROZEN
    if s[plan[3]]:
        flags = flags | _SATURATED
    if s[plan[4]] or s[plan[5]]:
        flags = flags | _GAP
    if s[plan[6]]:
        flags = flags | _RESUMED
    i = 8
    last = i + 2 * plan[7]
    while i <= last:
        value = crc
        size = 4
        if i < last:
            value = s[plan[i]]
            size = plan[i + 1]
        if size == 1:
            # Beyond 520 km the flag of saturation has long been set.
            if value > 127:
                value = 127
            if value < -128:
                value = -128
        if size == 0:
            value = flags
            size = 1
        while size > 0:
            buf[at] = value & 255
            value = value >> 8
            at = at + 1
            size = size - 1
        i = i + 2
    return at


def pack_step(buf, at, s):
    """The STEP payload of state `s` into buf[at:]; its end."""
    d, turn, heading, var, ticks, steps, distance = _STEP
    # fmt: off
    pack_into(
        FORMATS[STEP], buf, at, s[d], s[d + 1], s[d + 2], s[turn], s[heading],
        s[var], s[var + 1], s[var + 2], s[ticks], s[steps], s[distance], digest(s),
    )
    # fmt: on
    return at + SIZES[STEP]
