"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""

EXPECTED = (
    2279644532,  # mulshift
    4097084411,  # mulsat
    2549993320,  # div
    1501789533,  # isqrt
    3575841464,  # clamp
    1056304096,  # azimuth
    1583251828,  # turn
    2664994160,  # to_nav
    283144931,  # condition
    546895628,  # steer
    1110422528,  # propagate
    383319521,  # recentre
    1050738544,  # full speed
    3668008712,  # push
    2907433073,  # slower
    2408497859,  # unrest
    2143357774,  # detect
    421909193,  # grow
    3951079786,  # shrink
    1808881781,  # head
    1399040584,  # level
    3398616974,  # align
    2607042270,  # settle
    3219745149,  # roots
    4108898163,  # ratio
    137724599,  # feed_back
    4029421437,  # observe
    3108595516,  # adapt
    520111803,  # weigh
    3527616614,  # update
    2702453958,  # stood
    873539561,  # tick
)
