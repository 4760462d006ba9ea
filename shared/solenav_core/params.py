"""Every tunable of the core: its place, its Q-format, its meaning.

A parameter set is one `array('i')` in this order. The values at a given sample rate come from
SI units by `solenav.parameters` on the host; `tables.defaults` holds them for 200 Hz, made by
`tools/tables/`. "Ticks" are samples.
"""

PARAM_FIELDS = (
    ("RATE_MHZ", "mHz", "nominal sample rate; the core itself uses only DT"),
    ("ACC_SCALE", "Q22 m/s²/count", "accelerometer scale"),
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
    ("STEP_SWING", "ticks", "shortest swing of a step"),
    ("STEP_STANCE", "ticks", "shortest stance of a step"),
    ("SEED", "", "seed of the particles' random numbers, not 0"),
)

NAMES = tuple([field[0] for field in PARAM_FIELDS])
