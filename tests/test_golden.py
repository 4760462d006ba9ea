"""The core computes today what it computed when the golden digests were made.

If it is meant to compute something else, run `python tests/golden/make.py` and say why.
"""

from __future__ import annotations

import json

import pytest
from golden import make


@pytest.mark.parametrize("engine", ["pure", "fast"])
def test_the_core_has_not_changed(engine: str) -> None:
    assert make.digests(engine) == json.loads(make.TARGET.read_text(encoding="utf-8"))


def test_the_golden_runs_visit_the_core_s_branches() -> None:
    found = make.digests("fast")["200 Hz"]
    assert all(len(set(run)) == len(run) for run in found.values())
