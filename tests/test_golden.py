"""The core computes today what it computed when its outcomes were committed.

If it is meant to compute something else, run `python tests/golden/make.py "why"`.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from golden import make


def none(lines: list[str]) -> None:
    assert not lines, "\n".join(["the core's outcome changed:", *lines])


@pytest.mark.parametrize("engine", ["pure", "fast"])
def test_the_core_makes_of_the_torture_walks_what_it_made(engine: str) -> None:
    none(make.differences(make.committed()["torture"], make.torture_outcomes(engine)))


def test_the_core_makes_of_the_recordings_what_it_made(data: Path) -> None:
    none(make.differences(make.committed()["recordings"], make.recording_outcomes()))


def test_the_outcomes_are_committed_with_their_reason() -> None:
    newest = make.REASONS.read_text(encoding="utf-8").removeprefix(make.HEAD).strip()
    first, _, reason = newest.partition("`: ")
    assert first == f"- `{make.fingerprint()}", "run python tests/golden/make.py with a reason"
    assert len(reason.split("\n", 1)[0]) > 10


def test_a_change_is_told_by_input_and_field() -> None:
    walk = {"steps": 3, "lock-outs": 0}
    assert make.differences({"walk": walk}, {"walk": {**walk, "steps": 4}}) == [
        "walk: steps: was 3, is 4"
    ]
    assert make.differences({"walk": walk}, {}) == [
        "walk: steps: was 3, is nothing",
        "walk: lock-outs: was 0, is nothing",
    ]


def test_the_torture_walks_visit_new_states_all_along() -> None:
    found = make.torture_outcomes("fast")
    assert all(len(set(run["digests"])) == len(run["digests"]) for run in found.values())
