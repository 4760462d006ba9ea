"""Motion modes: labels beside a capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solenav import importing, mpu9150
from solenav.capture import load
from solenav.engines.traced import trace
from solenav.errors import SolenavError
from solenav.modes import labels
from solenav.modes.labels import MODES, Label
from solenav.parameters import Settings
from solenav.sim.imu import IDEAL
from solenav.sim.scenario import simulate


@given(st.lists(st.tuples(st.floats(0.01, 100), st.floats(0, 10), st.sampled_from(MODES))))
def test_labels_come_back_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, parts: list[tuple[float, float, str]]
) -> None:
    at, wanted = 0.0, []
    for length, gap, mode in parts:
        start, end = round(at + gap, 2), round(at + gap + length + 0.01, 2)
        wanted.append(Label(start, end, mode))
        at = end
    capture = tmp_path_factory.mktemp("labels") / "walk.solcap"
    labels.write(capture, wanted)
    assert list(labels.read(capture)) == wanted


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no table of motion modes"),
        ("mode,start_s,end_s\n", "no table of motion modes"),
        ("start_s,end_s,mode\n1,2,fly\n", "line 2: there is no mode 'fly'"),
        ("start_s,end_s,mode\n1,x,walk\n", "line 2: not two times and a mode"),
        ("start_s,end_s,mode\n1,2\n", "line 2: not two times and a mode"),
        ("start_s,end_s,mode\n1,2,walk,run\n", "line 2: 4 cells"),
        ("start_s,end_s,mode\n2,1,walk\n", "line 2: 2 to 1 s ends before it begins"),
        ("start_s,end_s,mode\n1,inf,walk\n", "line 2: 1 to inf s"),
        ("start_s,end_s,mode\n1,3,walk\n2,4,run\n", "line 3: 2 to 4 s"),
    ],
)
def test_a_damaged_table_of_labels_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    capture = tmp_path / "walk.solcap"
    labels.labels_path(capture).write_text(text)
    with pytest.raises(SolenavError, match=r"walk\.modes\.csv") as caught:
        labels.read(capture)
    assert complaint in caught.value.message
    assert caught.value.remedy


def test_a_simulated_capture_has_its_labels_beside_it(tmp_path: Path) -> None:
    recording = simulate("run", rate_hz=100, duration_s=None)
    importing.to_capture(recording, tmp_path / "run.solcap")
    found = load(tmp_path / "run.solcap").modes
    assert [label.mode for label in found] == ["still", "run", "still"]
    assert found[1].start_s == pytest.approx(recording.modes[1].start_s, abs=1e-3)


@pytest.mark.parametrize(("first", "then"), [(130.0, -110.0), (110.0, -130.0)])
def test_an_impulse_that_is_missed_in_a_strike_costs_little_height(
    first: float, then: float
) -> None:
    recording = simulate("stairs", errors=IDEAL)
    assert recording.truth is not None and recording.truth.stance is not None
    landings = np.flatnonzero(np.diff(recording.truth.stance.astype(int)) > 0)
    # Two samples of a strike, 60 ms before the foot stands, that don't make up for each other.
    recording.accel[landings - 12, 2] += first
    recording.accel[landings - 11, 2] += then
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts

    def height(settings: Settings) -> float:
        return abs(trace(counts, importing.parameters_of(recording, settings)).position[-1, 2])

    without = height(Settings(strike_noise=0.0))
    assert without > 0.5
    assert height(Settings()) < 0.25 * without
