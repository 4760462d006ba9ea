"""Every tunable of the core: its place, its Q-format, its meaning.

A parameter set is one `array('i')` in this order. The values at a given sample rate come from
SI units by `solenav.parameters` on the host; `tables.defaults` holds them for 200 Hz, made by
`tools/tables/`. "Ticks" are samples.
"""

PARAM_FIELDS = (
    ("RATE_MHZ", "mHz", "nominal sample rate; the core itself uses only DT"),
    ("ACC_XX", "Q22 m/s²/count", "accelerometer matrix: x of x"),
    ("ACC_XY", "Q22 m/s²/count", "accelerometer matrix: x of y"),
    ("ACC_XZ", "Q22 m/s²/count", "accelerometer matrix: x of z"),
    ("ACC_YX", "Q22 m/s²/count", "accelerometer matrix: y of x"),
    ("ACC_YY", "Q22 m/s²/count", "accelerometer matrix: y of y"),
    ("ACC_YZ", "Q22 m/s²/count", "accelerometer matrix: y of z"),
    ("ACC_ZX", "Q22 m/s²/count", "accelerometer matrix: z of x"),
    ("ACC_ZY", "Q22 m/s²/count", "accelerometer matrix: z of y"),
    ("ACC_ZZ", "Q22 m/s²/count", "accelerometer matrix: z of z"),
    ("ACC_BX", "Q20 m/s²", "accelerometer bias, after the matrix"),
    ("ACC_BY", "Q20 m/s²", "accelerometer bias, after the matrix"),
    ("ACC_BZ", "Q20 m/s²", "accelerometer bias, after the matrix"),
    ("GYRO_XX", "Q14", "gyro matrix: x of x"),
    ("GYRO_XY", "Q14", "gyro matrix: x of y"),
    ("GYRO_XZ", "Q14", "gyro matrix: x of z"),
    ("GYRO_YX", "Q14", "gyro matrix: y of x"),
    ("GYRO_YY", "Q14", "gyro matrix: y of y"),
    ("GYRO_YZ", "Q14", "gyro matrix: y of z"),
    ("GYRO_ZX", "Q14", "gyro matrix: z of x"),
    ("GYRO_ZY", "Q14", "gyro matrix: z of y"),
    ("GYRO_ZZ", "Q14", "gyro matrix: z of z"),
    ("GYRO_BX", "Q20 counts", "gyro bias, after the matrix"),
    ("GYRO_BY", "Q20 counts", "gyro bias, after the matrix"),
    ("GYRO_BZ", "Q20 counts", "gyro bias, after the matrix"),
    ("MAG_XX", "Q12", "magnetometer matrix (soft iron): x of x"),
    ("MAG_XY", "Q12", "magnetometer matrix (soft iron): x of y"),
    ("MAG_XZ", "Q12", "magnetometer matrix (soft iron): x of z"),
    ("MAG_YX", "Q12", "magnetometer matrix (soft iron): y of x"),
    ("MAG_YY", "Q12", "magnetometer matrix (soft iron): y of y"),
    ("MAG_YZ", "Q12", "magnetometer matrix (soft iron): y of z"),
    ("MAG_ZX", "Q12", "magnetometer matrix (soft iron): z of x"),
    ("MAG_ZY", "Q12", "magnetometer matrix (soft iron): z of y"),
    ("MAG_ZZ", "Q12", "magnetometer matrix (soft iron): z of z"),
    ("MAG_BX", "Q4 counts", "magnetometer bias (hard iron), after the matrix"),
    ("MAG_BY", "Q4 counts", "magnetometer bias (hard iron), after the matrix"),
    ("MAG_BZ", "Q4 counts", "magnetometer bias (hard iron), after the matrix"),
    ("MOUNT_R", "", "sensor axis that is the body's right: +-1 x, +-2 y, +-3 z; 0: to be found"),
    ("MOUNT_F", "", "front axis, likewise"),
    ("MOUNT_U", "", "up axis, likewise"),
    ("HALF_ANGLE", "Q42 rad/count", "half the angle that one count turns in one tick"),
    ("DT", "Q30 s", "sample period"),
    ("YAW_W", "Q30", "initial heading: scalar part of the rotation about Up"),
    ("YAW_Z", "Q30", "initial heading: Up part of the rotation about Up"),
    ("ALIGN_TICKS", "ticks", "length of the static start"),
    ("ALIGN_MIN", "ticks", "shortest static start, where motion cuts it short"),
    ("ALIGN_ACC", "counts", "largest deviation that counts as still"),
    ("ALIGN_RATE", "counts", "largest deviation that counts as still"),
    ("BIAS_MAX", "counts", "largest gyro bias that the static start accepts"),
    ("ACC_MIN", "Q7 m/s²", "C1: |a| above this"),
    ("ACC_MAX", "Q7 m/s²", "C1: |a| below this"),
    ("RATE_MAX", "Q2 counts", "C2: |rate| below this"),
    ("VAR_MAX", "Q14 (m/s²)²", "C3: sum of squared deviations of |a| over the window below this"),
    ("WINDOW", "ticks", "C3: window length, at most 31"),
    (
        "DETECTOR",
        "",
        "stance by 0: C1 to C3; 1: GLRT, one threshold; 2: GLRT, the motion's threshold",
    ),
    ("GLRT_WINDOW", "ticks", "GLRT: window length, at most 31"),
    ("GLRT_ACC", "Q17", "GLRT: T, Q5, for each Q12 (m/s²)² of the window's sum"),
    ("GLRT_RATE", "Q17", "GLRT: T, Q5, for each (2 counts)² of the window's sum"),
    ("GLRT_MAX", "Q5", "GLRT: T below this where the motion is unknown or doesn't matter"),
    ("GLRT_STILL", "Q5", "GLRT: T below this, standing"),
    ("GLRT_WALK", "Q5", "GLRT: T below this, walking"),
    ("GLRT_RUN", "Q5", "GLRT: T below this, running"),
    ("GLRT_UP", "Q5", "GLRT: T below this, on stairs upwards"),
    ("GLRT_DOWN", "Q5", "GLRT: T below this, on stairs downwards"),
    ("MOTION_STRIDE", "ticks", "between samples of a window, which has 128; 0: no motion is told"),
    ("MOTION_SHARE", "Q8", "a motion with a smaller share of the vote is unknown"),
    ("MOTION_HOLD", "windows", "so many in a row change the motion"),
    ("UNREST_RATE", "Q24", "T: share of the squared rate, in Q8 per (2 counts)²"),
    ("UNREST_ACC", "Q24", "T: share of the squared deviation of |a| from g, Q8 per Q14 (m/s²)²"),
    ("UNREST_GROWTH", "Q30", "growth of the least T on each tick"),
    ("UNREST_MAX", "Q8", "a sample with more unrest observes nothing"),
    ("UNREST_SURE", "Q8", "a sample with more unrest doesn't judge the filter"),
    ("STILL_RATE", "Q2 counts", "zero angular rate: |rate| below this"),
    ("STILL_TICKS", "ticks", "zero angular rate: for longer than this"),
    ("STILL_GAIN", "Q22", "zero angular rate: share of the rate taken into the bias on each tick"),
    ("GAMMA", "Q30 m/s", "g dt: velocity per tick and radian of tilt"),
    ("GAMMA2", "Q30 (m/s)²", "(g dt)²"),
    ("Q_VV_H", "Q26 (m/s)²", "velocity noise added to E and N on each tick"),
    ("Q_VV_U", "Q26 (m/s)²", "velocity noise added to U on each tick"),
    ("STRIKE", "Q22", "noise added to U, Q26 (m/s)² per Q8 (m/s²)² of a tick's change of force"),
    ("Q_TT", "Q30 rad²", "tilt noise added on each tick"),
    ("FREEZE_TICKS", "ticks", "the covariance stops growing after so long a swing"),
    ("P_VV_0", "Q26 (m/s)²", "variance of the velocity after the static start"),
    ("P_TT_0", "Q30 rad²", "variance of the tilt after the static start and after H1"),
    ("R", "Q24 (m/s)²", "observation noise of zero velocity"),
    ("LIKELIHOOD", "Q11 s/m", "1 / sqrt(2 ln2 R): velocity error to root of log2 weight"),
    ("M2_MAX", "Q10", "m² above this is inconsistent with zero velocity"),
    ("LOG_FLOOR", "Q16", "least log2 weight"),
    ("M_A", "Q14", "least threshold M_a"),
    ("M_B", "Q14", "largest threshold M_b"),
    ("K_E", "Q14", "threshold's growth K_e"),
    ("K", "Q14", "H2: a particle is heavy above this weight"),
    ("HEAVY_MIN", "particles", "H2: draw anew with fewer heavy particles than this"),
    ("LOCKOUT_TICKS", "ticks", "M saturates when inconsistent for longer than this"),
    ("LOCKOUT_MIN", "stance ticks", "and for at least so many stance ticks"),
    ("P_VV_H1", "Q26 (m/s)²", "variance of the velocity after H1"),
    ("BRIDGE_TICKS", "ticks", "most lost samples that don't spoil the pose"),
    ("RESUME_TICKS", "ticks", "stance that levels the foot where navigation goes on"),
    ("RESUME_ACC", "counts", "largest deviation in it"),
    ("RESUME_RATE", "counts", "largest deviation in it, and largest mean rate less the bias"),
    ("MAG_GAIN", "Q30 rad", "half the turn for an error of one in 2**16 of a turn; 0: none"),
    ("MAG_BIAS_GAIN", "Q24 counts", "change of the gyro bias for the same error"),
    ("MAG_NORM_TOL", "Q8", "a reading further from the reference's strength is refused"),
    ("MAG_DIP_TOL", "Q8", "or from its vertical part, by this share of the strength"),
    ("MAG_ERR_MAX", "2**16 a turn", "an error counts for no more than this"),
    ("MAG_ALIGN", "", "1: initial heading from the magnetometer"),
    ("DECLINATION", "2**16 a turn", "azimuth of magnetic North, clockwise from true North"),
    ("STEP_SWING", "ticks", "shortest swing of a step"),
    ("STEP_STANCE", "ticks", "shortest stance of a step"),
    ("SEED", "", "seed of the particles' random numbers, not 0"),
)

NAMES = tuple([field[0] for field in PARAM_FIELDS])

_AXES = ("MOUNT_R", "MOUNT_F", "MOUNT_U")


def conflict(params):
    """What is wrong between parameters each of which is in range, and what to do; or None."""
    found = {NAMES[i]: params[i] for i in range(len(NAMES))}
    # Rounding may take the two an ulp past a unit.
    if found["YAW_W"] ** 2 + found["YAW_Z"] ** 2 > (2**30 + 1) ** 2:
        return (
            "YAW_W and YAW_Z are no rotation: their squares sum to more than 1",
            "make them the cosine and sine of half the initial heading, times 2**30",
        )
    right, front, up = [found[name] for name in _AXES]
    if right or front or up:
        if sorted((abs(right), abs(front), abs(up))) != [1, 2, 3]:
            return (
                "MOUNT_R, MOUNT_F and MOUNT_U name an axis twice or not at all",
                "give each of the sensor's axes once (1 x, 2 y, 3 z, negative turned round)"
                ", or all 0",
            )
        # Right times front is up, or down in a mirror; each swap and each sign turns that round.
        order = (abs(right), abs(front), abs(up)) in ((1, 2, 3), (2, 3, 1), (3, 1, 2))
        if (right * front * up > 0) != order:
            return ("MOUNT_R, MOUNT_F and MOUNT_U are left-handed", "turn one of the axes round")
    if found["STILL_RATE"] * found["STILL_GAIN"] >= 2**25:
        return (
            "STILL_RATE and STILL_GAIN together overflow the core's word",
            "lower the still rate or lengthen the still time constant",
        )
    return None


_PER_TICK = ("HALF_ANGLE", "GAMMA")


def retimed(params, base, period_q8):
    """`base`, made for the sample rate in its RATE_MHZ, for samples every `period_q8` / 256 µs.

    Into `params`, an array of the same length. What follows the period exactly is scaled: RATE_MHZ,
    DT, HALF_ANGLE, GAMMA, GAMMA2. What only counts samples or noise stays: a clock is off by a few
    per cent. Products pass 31 bits: not for the tick.
    """
    for i in range(len(base)):
        params[i] = base[i]
    rate = base[NAMES.index("RATE_MHZ")]
    # The period over the nominal one is period_q8 * rate / one.
    one = 256 * 10**9
    ratio = period_q8 * rate
    params[NAMES.index("RATE_MHZ")] = (one + period_q8 // 2) // period_q8
    params[NAMES.index("DT")] = ((period_q8 << 23) // 10**6 + 1) >> 1
    for name in _PER_TICK:
        at = NAMES.index(name)
        params[at] = (base[at] * ratio + one // 2) // one
    at = NAMES.index("GAMMA2")
    params[at] = (base[at] * ratio * ratio + one * one // 2) // (one * one)
