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
    699802000,  # unrest
    4285616219,  # detect
    553104100,  # grow
    3552550540,  # shrink
    3119000557,  # head
    3386837791,  # level
    2534135536,  # align
    2199187363,  # roots
    4035035023,  # ratio
    2052282227,  # feed_back
    2226158728,  # observe
    887283018,  # adapt
    3182782319,  # weigh
    1162210166,  # update
    2104473855,  # stood
    2358076924,  # tick
)
