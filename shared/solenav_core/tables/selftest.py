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
    188239733,  # grow
    1610291724,  # shrink
    2599928150,  # head
    873108842,  # level
    3221198179,  # align
    3490478476,  # settle
    2925899054,  # roots
    3915977424,  # ratio
    3653311522,  # feed_back
    3686482555,  # observe
    1884568402,  # adapt
    1655234283,  # weigh
    10785165,  # update
    1599204349,  # stood
    68786247,  # tick
)
