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
    2373298079,  # classify
    1583432452,  # grow
    3601095243,  # shrink
    1164783445,  # head
    3656706671,  # level
    3246637951,  # align
    3804716392,  # settle
    1611154326,  # roots
    1723415161,  # ratio
    1793439389,  # feed_back
    3758556669,  # observe
    1287906951,  # adapt
    2136127861,  # weigh
    1475586200,  # update
    674365523,  # stood
    2504496820,  # tick
)
