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
    2231339393,  # summarise
    3010003356,  # classify
    4001634298,  # grow
    942425223,  # shrink
    1768475122,  # head
    3511427057,  # level
    2420583645,  # align
    2089611348,  # settle
    4147568318,  # roots
    2520793287,  # ratio
    3675525378,  # feed_back
    365966522,  # observe
    3475278213,  # adapt
    2417064118,  # weigh
    2596333761,  # update
    2277750216,  # stood
    3297459178,  # tick
)
