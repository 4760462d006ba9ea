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
    3710810892,  # grow
    3186488804,  # shrink
    4038083073,  # head
    342667929,  # level
    3419774014,  # align
    1796889372,  # settle
    3983984602,  # roots
    589120301,  # ratio
    374533230,  # feed_back
    3023811724,  # observe
    3698677099,  # adapt
    2228765630,  # weigh
    809098236,  # update
    2932946187,  # stood
    2528015552,  # tick
)
