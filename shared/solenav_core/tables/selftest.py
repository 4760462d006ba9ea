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
    42654537,  # grow
    4030280480,  # shrink
    200701663,  # head
    1772963513,  # level
    731724097,  # align
    2243542930,  # settle
    3696096636,  # roots
    2925239759,  # ratio
    3269875808,  # feed_back
    3118022708,  # observe
    3020285947,  # adapt
    3061646494,  # weigh
    3631048189,  # update
    2371661300,  # stood
    2145327083,  # tick
)
