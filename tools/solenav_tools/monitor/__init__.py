"""Watching boards live.

`watch` reads them, `live` knows them; `terminal`, `window` and `web` show them.
"""
