"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""

EXPECTED = (
    2279644532,  # mulshift
    4097084411,  # mulsat
    1767760620,  # div
    2298712170,  # isqrt
    2073671718,  # clamp
    2072313140,  # azimuth
    2806992484,  # turn
    2441089057,  # to_nav
    1113126313,  # propagate
    13784218,  # recentre
    2365730680,  # full speed
    1456205779,  # push
    2330029399,  # slower
    4252131224,  # detect
    4014090776,  # grow
    473091461,  # shrink
    4017793324,  # head
    2354317157,  # align
    3514587234,  # roots
    94088458,  # ratio
    584058994,  # feed_back
    1391597328,  # weigh
    3958177590,  # update
    1276406377,  # stood
    919863231,  # tick
)
