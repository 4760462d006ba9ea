"""Fixtures that several test files share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

from solenav import capture, importing, replaying
from solenav.sim.scenario import simulate

# The first call may compile; nothing here is timed.
# CI looks at the same examples each time, a person's machine at new ones.
settings.register_profile("solenav", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("solenav")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real recordings beside the checkout; skips where there is none."""
    folder = Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the recorded data (../shared/data) is not here")
    return folder


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of samples: 30 s of the closed loop, standing start and some strides."""
    recording = simulate("loop", seed=3).first(30.0)
    path = tmp_path_factory.mktemp("walk") / "walk.solcap"
    importing.to_capture(recording, path)
    return path


@pytest.fixture(scope="session")
def replayed(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The walk with everything that the firmware would have sent."""
    path = tmp_path_factory.mktemp("replayed") / "replayed.solcap"
    replaying.replay(capture.load(walk), path, engine="fast")
    return path


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which engines the matrix compared, so that a log shows what was proven."""
    found: dict[str, str] = {}
    for reports in terminalreporter.stats.values():
        for report in reports:
            # From the reports: with pytest-xdist the tests ran in other processes.
            for name, value in getattr(report, "user_properties", ()):
                if name == "matrix":
                    found[value[0]] = value[1]
    if found:
        ran = [engine for engine, reason in found.items() if not reason]
        skipped = [f"{engine} ({reason})" for engine, reason in found.items() if reason]
        parts = ["engines in the matrix: " + ", ".join(ran)]
        parts += ["skipped: " + ", ".join(skipped)] if skipped else []
        terminalreporter.write_line("; ".join(parts))
