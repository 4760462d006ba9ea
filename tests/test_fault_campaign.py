"""The firmware through faults on the simulated board: a short campaign, judged as the long one.

`python tools/faults` runs the long one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tools" / "faults"))
import firmware

WALK = firmware.Walk()
SHORT = firmware.short_walk()


def run(case: firmware.Case, folder: Path, walk: firmware.Walk = WALK) -> firmware.Outcome:
    return firmware.run(walk, case, folder)


def test_without_faults_every_pose_is_the_host_core_s(tmp_path: Path) -> None:
    outcome = run(firmware.Case("none", ()), tmp_path)
    assert outcome.clean, outcome
    assert outcome.error_m == 0.0 and not outcome.flagged
    assert (outcome.lost, outcome.damaged, outcome.restarts) == (0, 0, [])


CASES = firmware.cases(7, len(firmware.KINDS))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.kind.replace(" ", "_"))
def test_every_kind_of_fault_ends_well(case: firmware.Case, tmp_path: Path) -> None:
    outcome = run(case, tmp_path)
    assert outcome.clean, outcome


def test_a_sensor_that_is_gone_for_good_is_a_clear_fault(tmp_path: Path) -> None:
    case = next(case for case in CASES if case.kind == "gone for good")
    outcome = run(case, tmp_path)
    assert any("no answer" in line for line in outcome.log)


def test_what_was_acknowledged_survives_power_cuts(tmp_path: Path) -> None:
    whole = run(firmware.Case("session", (), firmware.SESSION), tmp_path, SHORT)
    assert whole.clean and whole.operations > 100
    for operation in range(5, whole.operations, whole.operations // 6):
        outcome = run(firmware.cut_at(operation), tmp_path, SHORT)
        assert outcome.clean and outcome.restarts == ["power"], outcome


def test_a_silent_wrong_pose_would_be_seen(tmp_path: Path) -> None:
    """A walk whose counts aren't those of the reference: the judge must find it."""
    other = firmware.Walk()
    other.positions[2000:] += 3.0
    outcome = run(firmware.Case("none", ()), tmp_path, other)
    assert outcome.silent_m > 2.0 and not outcome.clean


def test_the_same_seed_gives_the_same_runs() -> None:
    assert firmware.cases(3, 60) == firmware.cases(3, 60)
    assert firmware.cases(3, 60) != firmware.cases(4, 60)
