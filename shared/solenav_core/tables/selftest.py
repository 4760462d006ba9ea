"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""

EXPECTED = (
    2279644532,  # mulshift
    4097084411,  # mulsat
    2549993320,  # div
    1501789533,  # isqrt
    3575841464,  # clamp
    1056304096,  # azimuth
    891481464,  # turn
    2323705938,  # to_nav
    3806240255,  # propagate
    306377049,  # recentre
    2987805792,  # full speed
    3211261750,  # push
    4292077777,  # slower
    2219607304,  # detect
    1962009549,  # grow
    67519090,  # shrink
    4242240851,  # head
    647951721,  # level
    1965668173,  # align
    2539744769,  # roots
    2636240702,  # ratio
    154492969,  # feed_back
    4166581573,  # observe
    215055410,  # adapt
    3820317041,  # weigh
    3242170267,  # update
    3616576198,  # stood
    2008249499,  # tick
)
