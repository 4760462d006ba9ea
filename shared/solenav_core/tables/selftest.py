"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""

EXPECTED = (
    2279644532,  # mulshift
    4097084411,  # mulsat
    1767760620,  # div
    2298712170,  # isqrt
    2073671718,  # clamp
    2072313140,  # azimuth
    1635549360,  # turn
    2147115239,  # to_nav
    873089551,  # propagate
    2934486712,  # recentre
    1521799987,  # full speed
    4241409012,  # push
    892399243,  # slower
    2293752013,  # detect
    3436055431,  # grow
    1579061229,  # shrink
    115863054,  # head
    1322425245,  # align
    1571216236,  # roots
    6463407,  # ratio
    151011472,  # feed_back
    3475244727,  # weigh
    3368939771,  # update
    3805906931,  # stood
    2480681801,  # tick
)
