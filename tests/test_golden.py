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


def test_of_an_input_s_digests_the_first_that_differs_is_told() -> None:
    before = {"walk": {"digests": ["01", "02", "03", "04"]}}
    now = {"walk": {"digests": ["01", "02", "13", "14"]}}
    assert make.differences(before, now) == [
        'walk: digest 3, to tick 300: was "03", is "13"',
    ]


def test_outcomes_edited_by_hand_still_get_their_reason(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes, reasons = tmp_path / "outcomes.json", tmp_path / "REASONS.md"
    outcomes.write_bytes(make.OUTCOMES.read_bytes() + b"\n")
    reasons.write_bytes(make.REASONS.read_bytes())
    monkeypatch.setattr(make, "OUTCOMES", outcomes)
    monkeypatch.setattr(make, "REASONS", reasons)
    monkeypatch.setattr("sys.argv", ["make.py", "written", "by", "hand"])
    assert make.newest() != make.fingerprint()
    make.main()
    assert make.newest() == make.fingerprint()
    assert "`: written by hand\n" in reasons.read_text(encoding="utf-8")


def test_the_torture_walks_visit_new_states_all_along() -> None:
    found = make.torture_outcomes("fast")
    assert all(len(set(run["digests"])) == len(run["digests"]) for run in found.values())
