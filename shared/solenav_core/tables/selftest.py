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
    1135447690,  # grow
    2629804681,  # shrink
    1519588808,  # head
    365266850,  # level
    1161700397,  # align
    1978687395,  # settle
    1874061482,  # roots
    4063043832,  # ratio
    3731458100,  # feed_back
    2372868606,  # observe
    4149992979,  # adapt
    595558527,  # weigh
    2355902164,  # update
    375200106,  # stood
    3564591869,  # tick
)
