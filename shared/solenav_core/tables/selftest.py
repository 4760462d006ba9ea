"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""

EXPECTED = (
    2279644532,  # mulshift
    4097084411,  # mulsat
    2549993320,  # div
    1501789533,  # isqrt
    3575841464,  # clamp
    1056304096,  # azimuth
    3027496242,  # turn
    1692259826,  # to_nav
    3150525917,  # propagate
    3896498010,  # recentre
    3195236008,  # full speed
    387045602,  # push
    203279627,  # slower
    4209057515,  # unrest
    3208944001,  # detect
    3855987095,  # grow
    1712233223,  # shrink
    51049016,  # head
    338849876,  # level
    772507508,  # align
    529334593,  # roots
    608664636,  # ratio
    309280187,  # feed_back
    1277302901,  # observe
    454814035,  # adapt
    497753195,  # weigh
    603874450,  # update
    4230690669,  # stood
    3259048684,  # tick
)
