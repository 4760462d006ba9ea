"""Default parameters at 200 Hz. Written by tools/tables/defaults.py: do not edit."""

from array import array

PARAMS = array(
    "i",
    [
        200000,  # RATE_MHZ
        20084,  # ACC_SCALE
        11701279,  # HALF_ANGLE
        5368709,  # DT
        1073741823,  # YAW_W
        0,  # YAW_Z
        200,  # ALIGN_TICKS
        40,  # ALIGN_MIN
        104,  # ALIGN_ACC
        57,  # ALIGN_RATE
        820,  # BIAS_MAX
        960,  # ACC_MIN
        1549,  # ACC_MAX
        6560,  # RATE_MAX
        1474560,  # VAR_MAX
        10,  # WINDOW
        2555007,  # UNREST_RATE
        2139951,  # UNREST_ACC
        5368709,  # UNREST_GROWTH
        7936,  # UNREST_MAX
        1792,  # UNREST_SURE
        52,  # STILL_RATE
        100,  # STILL_TICKS
        10486,  # STILL_GAIN
        52649051,  # GAMMA
        2581554,  # GAMMA2
        5033,  # Q_VV_H
        6711,  # Q_VV_U
        107,  # Q_TT
        2000,  # FREEZE_TICKS
        6711,  # P_VV_0
        1288490,  # P_TT_0
        83886,  # R
        24599,  # LIKELIHOOD
        2048,  # M2_MAX
        -1512775,  # LOG_FLOOR
        1638,  # M_A
        8192,  # M_B
        6554,  # K_E
        8192,  # K
        50,  # HEAVY_MIN
        200,  # LOCKOUT_TICKS
        5,  # LOCKOUT_MIN
        671089,  # P_VV_H1
        30,  # STEP_SWING
        8,  # STEP_STANCE
        1,  # SEED
    ],
)
