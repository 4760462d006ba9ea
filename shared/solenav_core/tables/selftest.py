"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""

EXPECTED = (
    2279644532,  # mulshift
    4097084411,  # mulsat
    2549993320,  # div
    1501789533,  # isqrt
    3575841464,  # clamp
    1056304096,  # azimuth
    4049426349,  # turn
    785113015,  # to_nav
    3926747029,  # condition
    1173992216,  # steer
    3198617192,  # propagate
    1454964537,  # recentre
    3018620681,  # full speed
    2443618570,  # push
    2303257734,  # slower
    982498896,  # unrest
    1659655993,  # detect
    758938772,  # collect
    108775604,  # likelihood ratio
    2455747149,  # sense
    4178069827,  # observe motion
    3228366348,  # summarise
    3943195460,  # classify
    2786186757,  # grow
    4217961474,  # shrink
    2836143468,  # head
    4035120441,  # level
    1787207059,  # align
    3648050811,  # settle
    920689466,  # roots
    2365879023,  # ratio
    3703342356,  # feed_back
    1124364095,  # observe
    1210805444,  # adapt
    3519424034,  # weigh
    369643416,  # update
    3469690719,  # stood
    350615888,  # tick
)
