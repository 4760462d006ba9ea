"""A tick's cost on the Cortex-M0+ stays within the budget and doesn't creep up."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from solenav import mpu9150
from solenav.engines.device_form import kernel_modules
from solenav.engines.thumb import ThumbEngine
from solenav.engines.thumb.accounting import DIVISION, VIPER_CALL
from solenav.parameters import Settings, to_integers
from solenav.sim.scenario import simulate
from solenav_core import navigator

ROOT = Path(__file__).parents[1]
COMMITTED = json.loads((ROOT / "docs" / "cycles.json").read_text(encoding="utf-8"))
# Cycles at 125 MHz, calls included: 0.5 ms, 1.5 ms and 2 ms of a 5 ms period.
BUDGET = {"swing": 60_000, "stance": 190_000, "worst": 250_000}


@pytest.fixture(scope="module")
def measured() -> Any:
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "bench" / "cycles.py", "--json"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("kind", BUDGET)
def test_a_tick_is_within_its_budget(kind: str, measured: Any) -> None:
    assert measured["ticks"][kind]["cycles"] <= BUDGET[kind]


@pytest.mark.parametrize("kind", BUDGET)
def test_a_tick_costs_no_more_than_committed(kind: str, measured: Any) -> None:
    """A rise of over 2 % fails; `python tools/bench/cycles.py --write` keeps new figures."""
    now, then = (figures["ticks"][kind]["cycles"] for figures in (measured, COMMITTED))
    assert now <= 1.02 * then, f"{kind}: {now} cycles, {then} committed"


def test_the_machine_code_is_no_larger_than_committed(measured: Any) -> None:
    now, then = (sum(figures["mpy_bytes"].values()) for figures in (measured, COMMITTED))
    assert now <= 1.02 * then


def test_no_tick_allocates(measured: Any) -> None:
    assert all(tick["boxed"] == 0 for tick in measured["ticks"].values())


def test_every_kernel_is_small_enough_for_older_emitters(measured: Any) -> None:
    """About 4 KB: longer branches than that were broken once."""
    too_large = {k: size for k, size in measured["kernel_bytes"].items() if size > 4600}
    assert not too_large


def test_a_window_of_motion_is_within_its_budget() -> None:
    """Features, forest and their calls, over all the ticks between one window and the next."""
    walk = simulate("modes", seed=301)
    counts = mpu9150.to_counts(walk.accel, walk.gyro).counts
    engine = ThumbEngine(to_integers(Settings(), walk.rate_hz), kernel_modules())
    engine.advance(counts[:300])
    start = next(label.start_s for label in walk.modes if label.mode == "run")
    moving = counts[int((start - 2.0) * walk.rate_hz) :]
    row, _ = engine.advance(moving, mask=navigator.CLASSIFIED)
    for _ in range(3):
        engine.program.clear()
        row, events = engine.advance(moving, row, mask=navigator.CLASSIFIED)
        assert events & navigator.CLASSIFIED
        kernels = [
            kernel
            for kernel in engine.cycles().kernels
            if kernel.name in ("features.summarise", "forest.classify")
        ]
        assert len(kernels) == 2
        calls = sum(kernel.calls for kernel in kernels) * VIPER_CALL
        divisions = sum(kernel.divisions for kernel in kernels) * DIVISION
        assert sum(kernel.cycles for kernel in kernels) + calls + divisions <= 25_000
