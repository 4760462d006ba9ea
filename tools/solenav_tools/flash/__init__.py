"""Firmware onto a board: over its REPL, atomically, only what changed."""
