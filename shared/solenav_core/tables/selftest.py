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
    3665576027,  # classify
    318026837,  # grow
    2888855028,  # shrink
    581103718,  # head
    573346267,  # level
    2332788731,  # align
    4174508746,  # settle
    2997127900,  # roots
    2835113593,  # ratio
    3287613323,  # feed_back
    312933423,  # observe
    704512441,  # adapt
    4136886377,  # weigh
    3116476385,  # update
    1006881539,  # stood
    1395728802,  # tick
)
