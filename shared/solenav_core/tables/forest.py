"""The forest that tells motions apart, as words (forest.py): none yet, so that all is unknown."""

FOREST = b"\x00\x00\x00\x00"
