"""`import solenav`: a function for each command."""

from __future__ import annotations

import inspect
import itertools
import subprocess
import sys
import time
from binascii import crc32
from pathlib import Path

import pytest
from test_doctor import STILL

import solenav
from solenav.errors import SolenavError
from solenav.importing import to_capture
from solenav.modes.training import Growth
from solenav.sim.scenario import simulate
from solenav_tools.board import SimulatedBoard


def test_every_name_is_a_function_with_a_docstring() -> None:
    for name in solenav.__all__:
        function = getattr(solenav, name)
        assert inspect.isfunction(function), name
        assert inspect.getdoc(function), name
        assert name in dir(solenav)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    assert not hasattr(solenav, "verifi")


def test_a_submodule_does_not_hide_a_function() -> None:
    code = (
        "import solenav, solenav.verification, solenav.plotting, solenav.exporting;"
        "print(callable(solenav.verify), callable(solenav.plot), callable(solenav.export))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["True"] * 3, done.stderr


def test_a_notebook_loads_verifies_evaluates_and_draws(replayed: Path, tmp_path: Path) -> None:
    run = solenav.load(str(replayed))
    assert solenav.verify(run).verified
    assert solenav.evaluate(run).distance_m > 5
    assert solenav.info(run)["poses"]["count"] == len(run.poses)
    solenav.plot(run, str(tmp_path / "run.png"))
    assert (tmp_path / "run.png").stat().st_size > 10_000
    assert solenav.export(replayed, "tum", tmp_path / "run.tum").items == len(run.poses)
    assert solenav.batch([replayed], engine="fast")[0].verified


def test_a_notebook_reads_messages_one_by_one(replayed: Path) -> None:
    poses = list(solenav.cat(replayed, only=["pose"]))
    assert len(poses) == len(solenav.load(str(replayed)).poses)
    assert {"tick", "position", "attitude"} <= set(poses[0])
    wire = next(solenav.cat(replayed, only=["pose"], raw=True))
    assert all(isinstance(part, int) for part in wire["position"])


def test_a_notebook_trains_judges_ships_and_sends_a_forest(tmp_path: Path) -> None:
    to_capture(simulate("modes", seed=78).first(120.0), tmp_path / "course.solcap")
    course = solenav.load(tmp_path / "course.solcap")
    trained = solenav.train_forest(simulated=1, growth=Growth(trees=4))
    assert trained.judgements["10 folds of windows"].right > 0.9
    found = solenav.evaluate_forest([course], trained.words)
    assert found["each window"].right > 0.9 and found["motion held"].windows > 50
    trained.save(tmp_path / "own.forest")
    assert solenav.export_forest(tmp_path / "own.forest", tmp_path / "t.py") == trained.words
    assert "1 people on each simulated course" in (tmp_path / "t.py").read_text()
    with SimulatedBoard(STILL, {"autostart": False}, realtime=True) as board:
        sent = solenav.send_forest(board.port, trained.words)
    assert sent.has == crc32(trained.words) and not sent.shipped


def test_what_a_notebook_lacks_is_said(
    replayed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SOLENAV_UF2", raising=False)
    with pytest.raises(SolenavError, match=r"no MicroPython|isn't installed"):
        solenav.emulate(solenav.load(replayed), tmp_path / "out.solcap")
    with pytest.raises(SolenavError, match="no recordings"):
        solenav.tune_modes([])


def test_a_notebook_watches_lists_and_reads_a_live_board() -> None:
    with SimulatedBoard(STILL, realtime=True) as board:
        with solenav.monitor(board.port) as watches:
            end = time.monotonic() + 20
            live = watches[0].live
            while time.monotonic() < end and live.mode != "navigating":
                time.sleep(0.05)
            with watches[0].lock:
                assert live.as_dict()["mode"] == "navigating" and live.as_dict()["position"]
        assert solenav.download(board.port, only_list=True).free > 0
        names = {line["message"] for line in itertools.islice(solenav.cat(board.port), 40)}
        assert {"POSE", "SAMPLE"} <= names
