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
    3959881782,  # head
    146179252,  # align
    1154527657,  # roots
    2236939688,  # ratio
    4010941437,  # feed_back
    2312226710,  # weigh
    1517850605,  # update
    1946910735,  # stood
    920339255,  # tick
)
