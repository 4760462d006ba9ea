"""Where every word of the navigator lives: state, work area, sample and tables.

The navigator's whole memory is four `array('i')`. Each has a list of fields here, in order:
``(name, words, stage, format)``; the offset of a field is the sum of the words before it. The
stage names the module that owns the field; the format gives unit and Q-format (``Q24 m/s``
holds metres per second times 2**24).

Kernels can't read these names (viper needs constants of their own module), so each kernel
module repeats the offsets that it uses as ``_S_NAME = const(...)``; `tools/tables/constants.py`
writes those lines from here and a test compares them.
"""

PARTICLES = 100
CELL_M = 4096  # a position is so many metres a cell, and POS inside it
WINDOW_MAX = 31  # 31 squared deviations of 13 bits are the most that fit one word
FEATURES = 56  # of a window; as many sums make them, see features.py
CLASSES = 5  # that the forest tells apart; the motion is one more, 0 for unknown

STATE_FIELDS = (
    ("TICK", 1, "navigator", "samples processed"),
    ("MODE", 1, "navigator", "0 aligning, 1 navigating"),
    ("SATURATED", 1, "navigator", "ticks on which the velocity hit its limit"),
    ("LAST", 6, "navigator", "FORCE and RATE of the last sample"),
    ("GAPS", 1, "navigator", "holes in the samples that were too long to bridge"),
    ("RESUMED", 1, "navigator", "times that navigation went on from before a hole or a restart"),
    ("AL_COUNT", 1, "align", "still samples so far"),
    ("AL_DONE", 1, "align", "1 once no better static start is looked for"),
    ("AL_BEST", 1, "align", "ticks of the static start in use"),
    ("AL_RESTARTS", 1, "align", "stretches of stillness that motion ended"),
    ("AL_PEAK_ACC", 1, "align", "counts, largest deviation from the first still sample"),
    ("AL_PEAK_RATE", 1, "align", "counts"),
    ("AL_REF", 6, "align", "counts, first still sample: ax ay az gx gy gz"),
    ("AL_SUM", 6, "align", "counts, sum of the still samples"),
    ("AL_MAG", 3, "align", "counts, sum of the magnetometer's readings"),
    ("AL_MAG_COUNT", 1, "align", "how many they are"),
    ("MOUNT", 3, "calibration", "sensor axes that are right, front, up: +-1 x, +-2 y, +-3 z"),
    ("STANCE", 1, "detector", "0 swing, 1 stance"),
    ("ACC_NORM", 1, "detector", "Q7 m/s², |a| of this sample"),
    ("STILL_TICKS", 1, "detector", "consecutive ticks below the still-rate limit"),
    ("RING_HEAD", 1, "detector", "index of the next entry"),
    ("RING_FILL", 1, "detector", "entries in use"),
    ("RING", WINDOW_MAX, "detector", "Q7 m/s², |a| of the last samples, limited to 64 m/s²"),
    ("STILLEST", 1, "detector", "Q12, least T of late, at least 1"),
    ("GLRT", 1, "detector", "Q5, T of the GLRT detector's window, at most 2**20"),
    ("GLRT_HEAD", 1, "detector", "index of the next entry in its ring"),
    ("GLRT_FILL", 1, "detector", "entries in use"),
    ("GLRT_SUM", 3, "detector", "Q6 m/s², sum of the forces in the window"),
    ("GLRT_SQUARES", 3, "detector", "Q12 (m/s²)², sum of their squares"),
    ("GLRT_TURN", 1, "detector", "(2 counts)², sum of the squared rates"),
    ("GLRT_RING", 4 * WINDOW_MAX, "detector", "force, Q6 m/s², and squared rate, sample by sample"),
    ("STRIDE", 1, "features", "MOTION_STRIDE of the blocks in use"),
    ("PAUSE", 1, "features", "ticks to the next sample"),
    ("BLOCK_FILL", 1, "features", "samples in the open block"),
    ("BLOCK_SLOT", 1, "features", "which of the three it is"),
    ("BLOCKS", 1, "features", "closed blocks that follow on each other, at most 2"),
    (
        "STAGE",
        1,
        "features",
        "what is next for the last window: 0 and 1 a group, then eight trees each; 255 done",
    ),
    ("SUMS", 3 * FEATURES, "features", "three blocks; the oldest turns into features"),
    ("SCORE", CLASSES, "forest", "weights of the trees asked so far"),
    ("VOTE", CLASSES, "forest", "the windows' scores, each counting half as much as the next"),
    ("RIVAL", 1, "forest", "what the last windows were taken for"),
    ("RIVAL_WINDOWS", 1, "forest", "how many of them in a row"),
    ("MOTION", 1, "forest", "0 unknown, 1 still, 2 walk, 3 run, 4 upstairs, 5 downstairs"),
    ("ATT", 4, "strapdown", "Q30, body to ENU, scalar first"),
    ("VEL", 3, "strapdown", "Q24 m/s, ENU"),
    ("POS", 3, "strapdown", "Q18 m, ENU, inside the cell"),
    ("CELL", 3, "strapdown", "cells of 4096 m; position = 4096 cell + POS / 2**18"),
    ("BIAS", 3, "strapdown", "Q20 counts, gyro bias"),
    ("GRAVITY", 1, "strapdown", "Q20 m/s²"),
    ("P_VV", 3, "covariance", "Q26 (m/s)², E N U"),
    ("P_PV", 3, "covariance", "Q24 m²/s"),
    ("P_PP", 3, "covariance", "Q24 m², since the last step; reported, not fed back"),
    ("P_VT", 2, "covariance", "Q28 rad m/s; for E the tilt about N, for N the one about -E"),
    ("P_PT", 2, "covariance", "Q28 rad m"),
    ("P_TT", 2, "covariance", "Q30 rad²"),
    ("DP_VV", 3, "covariance", "Q26 (m/s)², growth of P_VV on this tick"),
    ("SWING_TICKS", 1, "covariance", "ticks since the last stance tick"),
    ("RNG", 2, "particles", "xorshift32, upper and lower 16 bits"),
    ("OBSERVED", 1, "particles", "1 if the last tick observed zero velocity"),
    ("INCONSISTENT", 1, "particles", "t: consecutive samples inconsistent with zero velocity"),
    ("SINCE_CONSISTENT", 1, "particles", "ticks since the last consistent sample"),
    ("M2", 1, "particles", "Q10, normalised innovation squared m²"),
    ("THRESHOLD", 1, "particles", "Q14, adaptive threshold M"),
    ("N_EFF", 1, "particles", "Q8, effective sample size"),
    ("RESAMPLED", 1, "particles", "secondary resamplings so far"),
    ("LOCKOUTS", 1, "particles", "times that H1 accepted zero velocity"),
    ("LOG_W", PARTICLES, "particles", "Q16, log2 of the weight, largest 0"),
    ("REACH", 3, "particles", "Q16 m/s, no particle is further from 0, E N U"),
    ("X", 3 * PARTICLES, "particles", "Q16 m/s, error of the INS velocity: all E, all N, all U"),
    ("POS_LAST", 3, "steps", "Q18 m, position at the last stance tick"),
    ("POS_REF", 3, "steps", "Q18 m, position at the end of the stance before this one"),
    ("POS_STEP", 3, "steps", "Q18 m, where the last step ended"),
    ("HEADING_STEP", 1, "steps", "2**16 a turn, heading there"),
    ("HEADING_LAST", 1, "steps", "2**16 a turn, heading of the foot as it stood last"),
    ("TICK_STEP", 1, "steps", "tick of the last step's end"),
    ("STANCE_TICKS", 1, "steps", "stance ticks since the last real swing"),
    ("STEPPING", 1, "steps", "0 first stance, 1 swung since the last step, 2 step counted"),
    ("STEPS", 1, "steps", "steps (strides of this foot)"),
    ("DISTANCE", 1, "steps", "Q10 m, sum of the horizontal step lengths"),
    ("STEP_MOVE", 3, "steps", "Q18 m, displacement of the last step, ENU"),
    ("STEP_TURN", 1, "steps", "2**16 a turn, heading change of the last step, clockwise"),
    ("STEP_TICKS", 1, "steps", "ticks that the last step took"),
    ("STEP_VAR", 3, "steps", "Q24 m², P_PP at the last stance tick: variance of the displacement"),
    ("MAG_NORM", 1, "heading", "Q4 counts, strength of the reference field; 0: there is none"),
    ("MAG_UP", 1, "heading", "Q4 counts, its vertical part"),
    ("MAG_AZ", 1, "heading", "2**16 a turn, its azimuth in ENU"),
    ("MAG_USED", 1, "heading", "readings that steered"),
    ("MAG_REFUSED", 1, "heading", "readings that were not of the reference field"),
)

# Not part of the state: written and read within one tick.
WORK_FIELDS = (
    ("NAV", 3, "strapdown", "Q20, a vector turned into ENU"),
    ("FORCE", 3, "calibration", "Q20 m/s², specific force, body"),
    ("RATE", 3, "calibration", "Q8 counts, rate less bias, body"),
    ("FIELD", 3, "calibration", "Q4 counts, magnetic field, body"),
    ("UNREST", 1, "detector", "Q8, u: T of this sample over the least of late"),
    ("SIGNAL", 5, "features", "what goes into the sums: a vector, its length, a velocity"),
    ("ERR", 3, "particles", "Q24 m/s, estimated velocity error d"),
    ("VAR", 3, "particles", "s² in units of the spread's scale"),
    ("SCALE", 3, "particles", "right shift from Q16 m/s to a scale on which sums of squares fit"),
    ("ROOT", 3, "particles", "Q16 m/s, square root of P_VV or its growth, E N U"),
    ("NOISE", 1, "particles", "Q23 (m/s)², observation noise of this sample, at most 8"),
    ("GAIN", 1, "particles", "likelihood gain"),
    ("GAIN_SHIFT", 1, "particles", "right shift of the error before the gain"),
    ("GAIN_EXTRA", 1, "particles", "how much of it only makes room"),
    ("SUM_W", 1, "particles", "Q14"),
    ("SUM", 3, "particles", "weighted sum of the proposals on their scale"),
    ("SUM2", 3, "particles", "and of their squares"),
    ("HEAVY", 1, "particles", "particles with a weight over K"),
    ("PROPOSAL", 3 * PARTICLES, "particles", "Q16 m/s, x': all E, all N, all U"),
    ("WEIGHT", PARTICLES, "particles", "Q14, largest 1"),
)

SAMPLE_FIELDS = (
    ("ACC", 3, "", "counts, right front up of the sensor"),
    ("GYRO", 3, "", "counts"),
    ("MAG", 3, "", "counts, in the accelerometer's axes"),
    ("FLAGS", 1, "", "of the message SAMPLE, and 256 times the samples lost before this one"),
)

TABLE_FIELDS = (
    ("EXP2", 257, "", "Q15, 2**(-i/256)"),
    ("ATAN", 16, "", "2**16 a turn, atan(2**-i), eight more bits of fraction"),
    (
        "GAUSS",
        3 * PARTICLES,
        "",
        "Q11, whitened standard normal vectors: all E, all N, all U",
    ),
    ("FOREST", 1, "", "number of trees; the rest of the forest follows, see forest.py"),
)


def offsets(fields):
    """Map each field's name to its first word."""
    out = {}
    at = 0
    for name, words, _stage, _format in fields:
        out[name] = at
        at += words
    return out


def size(fields):
    """Words that the fields take together."""
    return sum([words for _name, words, _stage, _format in fields])


def locate(fields, index):
    """Name the word at `index`: ``(stage, "VEL[1]")``."""
    at = 0
    for name, words, stage, _format in fields:
        if index < at + words:
            return stage, name if words == 1 else "%s[%d]" % (name, index - at)  # noqa: UP031
        at += words
    raise IndexError(index)
