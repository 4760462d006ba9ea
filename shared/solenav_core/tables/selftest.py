"""CRCs of the power-up self-test. Written by tools/tables/selftest.py: do not edit."""

EXPECTED = (
    2279644532,  # mulshift
    4097084411,  # mulsat
    2549993320,  # div
    1501789533,  # isqrt
    3575841464,  # clamp
    1056304096,  # azimuth
    761548782,  # turn
    211428604,  # to_nav
    2725587939,  # condition
    2176900066,  # steer
    4212343270,  # propagate
    2055865173,  # recentre
    1935532804,  # full speed
    3741242421,  # push
    1376448615,  # slower
    2658781899,  # unrest
    1988079499,  # detect
    3388358364,  # grow
    2136442180,  # shrink
    886593106,  # head
    3017137241,  # level
    280019027,  # align
    770466833,  # settle
    2338124254,  # roots
    1587386778,  # ratio
    3137137066,  # feed_back
    3548458509,  # observe
    106487773,  # adapt
    2335376611,  # weigh
    843225300,  # update
    1126043089,  # stood
    3883245729,  # tick
)
