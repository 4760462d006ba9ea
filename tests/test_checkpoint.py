"""The run saved in flash: what survives a torn write, what is gone on with, how flash lasts."""

from __future__ import annotations

import subprocess
from array import array
from pathlib import Path
from types import ModuleType
from typing import Any

import device
import pytest

from solenav_core import layout, navigator
from solenav_tools.micropython import find_micropython
from solenav_tools.staging import stage

AT = layout.offsets(layout.STATE_FIELDS)
SECOND = 200
EVERY = 10 * SECOND
PERIOD = 5000 * 256


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The firmware's module, in an empty flash."""
    monkeypatch.chdir(tmp_path)
    return device.load("checkpoint")[0]


def walked(steps: int, tick: int = 5000) -> array[int]:
    """A run after so many steps."""
    state = navigator.new_state()
    values = {"TICK": tick, "MODE": 1, "STANCE": 1, "GRAVITY": 9 << 20, "STEPS": steps}
    for name, value in values.items():
        state[AT[name]] = value
    for i in range(3):
        state[AT["POS"] + i] = 1000 * steps + i
    return state


def boot(module: ModuleType, identity: int = 7, every: int = EVERY) -> Any:
    """What the firmware sees of the flash when it starts."""
    return module.Checkpoint(identity, every, SECOND)


def test_a_run_that_was_cut_off_is_gone_on_with(module: ModuleType) -> None:
    assert not boot(module).cut_off()
    boot(module).save(walked(12), PERIOD + 1)
    found = boot(module)
    assert found.cut_off() and not found.objection()
    assert found.period == PERIOD + 1
    state = navigator.new_state()
    found.restore(state)
    was = walked(12)
    assert state[AT["POS"] : AT["POS"] + 3] == was[AT["POS"] : AT["POS"] + 3]
    assert (state[AT["STEPS"]], state[AT["RESUMED"]], state[AT["MODE"]]) == (12, 1, 0)


def test_its_ticks_are_past_all_that_it_can_have_had(module: ModuleType) -> None:
    """As the host takes a tick that comes again for another run."""
    boot(module).save(walked(12), PERIOD)
    last = 5000
    for _ in range(3):
        state = navigator.new_state()
        found = boot(module)
        found.restore(state)
        assert state[AT["TICK"]] > last
        # It gets as far as just before its next record, which may wait for a stance.
        state[AT["STANCE"]] = 0
        last = state[AT["TICK"]] + EVERY + SECOND
        state[AT["TICK"]] = last
        assert not found.due(state)


def test_after_an_orderly_stop_nothing_is_gone_on_with(module: ModuleType) -> None:
    running = boot(module)
    running.save(walked(12), PERIOD)
    running.close(walked(13), PERIOD)
    assert not boot(module).cut_off()


def test_nothing_is_written_where_there_is_nothing_to_say(
    module: ModuleType, tmp_path: Path
) -> None:
    idle = boot(module)
    idle.save(navigator.new_state(), PERIOD)
    idle.close(navigator.new_state(), PERIOD)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("case", "why"),
    [
        ("other firmware", "parameters or firmware are others now"),
        ("no step", "no step had been made"),
        ("thrice", "tried 3 times"),
    ],
)
def test_a_run_that_is_no_use_is_refused(module: ModuleType, case: str, why: str) -> None:
    boot(module).save(walked(0 if case == "no step" else 12), PERIOD)
    if case == "thrice":
        for _ in range(3):
            found = boot(module)
            assert not found.objection()
            found.restore(navigator.new_state())
    found = boot(module, 8 if case == "other firmware" else 7)
    assert found.cut_off() and why in found.objection()


def test_a_run_that_gets_further_may_be_cut_off_again_and_again(module: ModuleType) -> None:
    for steps in range(1, 9):
        running = boot(module)
        running.restore(navigator.new_state())
        running.save(walked(steps), PERIOD)
        assert not boot(module).objection()


def test_it_waits_for_a_stance_but_not_for_ever(module: ModuleType) -> None:
    running = boot(module)
    state = walked(3, EVERY - 1)
    assert not running.due(state)
    state[AT["TICK"]] = EVERY
    assert running.due(state)
    state[AT["STANCE"]] = 0
    assert not running.due(state)
    state[AT["TICK"]] = EVERY + 2 * SECOND
    assert running.due(state)
    running.save(state, PERIOD)
    assert not running.due(state)
    assert not boot(module, every=0).due(walked(3, 10 * EVERY))


def test_a_write_torn_at_any_byte_leaves_the_one_before(module: ModuleType, tmp_path: Path) -> None:
    running = boot(module)
    for steps in (1, 2, 3):
        running.save(walked(steps), PERIOD)
    before = {path: path.read_bytes() for path in map(tmp_path.joinpath, module.FILES)}
    running.save(walked(4), PERIOD)
    ((torn, whole),) = [
        (path, path.read_bytes()) for path, data in before.items() if data != path.read_bytes()
    ]
    for size in range(len(whole) + 1):
        for rest in (b"", before[torn][size:], bytes(len(whole) - size)):
            torn.write_bytes(whole[:size] + rest)
            found = boot(module)
            assert found.cut_off()
            state = navigator.new_state()
            navigator.load(state, found._words, 0)
            sound = whole[:size] + rest == whole
            assert state[AT["STEPS"]] == 3 + sound, (size, rest)
            # What comes next mustn't overwrite the only sound record.
            assert module.FILES[1 - found._slot] != torn.name or not sound


def test_a_flash_that_refuses_costs_only_what_it_refused(
    module: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    running = boot(module)
    running.save(walked(1), PERIOD)
    full = tmp_path / "nowhere"
    with monkeypatch.context() as patch:
        patch.setattr(module, "FILES", tuple(str(full / name) for name in module.FILES))
        for steps in (2, 3, 4):
            with pytest.raises(OSError):
                running.save(walked(steps), PERIOD)
    assert boot(module)._steps == 1
    running.save(walked(5), PERIOD)
    assert boot(module)._steps == 5


# A Pico's flash in RAM, with its own file system on it.
FLASH = """
import os
import sys

sys.path[:] = [""]
import vfs
from checkpoint import Checkpoint
from solenav_core import layout, navigator

AT = layout.offsets(layout.STATE_FIELDS)
state = navigator.new_state()
state[AT["GRAVITY"]] = 1
BLOCKS = 64


class Flash:
    def __init__(self):
        self.data = bytearray(4096 * BLOCKS)
        self.erases = [0] * BLOCKS
        self.left = -1  # accesses until the power goes

    def power(self):
        if self.left == 0:
            raise OSError(5)
        self.left -= 1

    def readblocks(self, block, buffer, offset=0):
        at = 4096 * block + offset
        buffer[:] = self.data[at : at + len(buffer)]

    def writeblocks(self, block, buffer, offset=0):
        at = 4096 * block + offset
        if self.left == 0:
            # Half of it has arrived.
            half = len(buffer) // 2
            self.data[at : at + half] = buffer[:half]
        self.power()
        self.data[at : at + len(buffer)] = buffer

    def ioctl(self, what, block):
        if what == 4:
            return BLOCKS
        if what == 5:
            return 4096
        if what == 6:
            self.power()
            self.erases[block] += 1
            self.data[4096 * block : 4096 * (block + 1)] = bytes([255]) * 4096
        return 0


def mount():
    vfs.mount(vfs.VfsLfs2(flash, progsize=256), "/flash")
    os.chdir("/flash")


def unmount():
    os.chdir("/")
    vfs.umount("/flash")


flash = Flash()
vfs.VfsLfs2.mkfs(flash, progsize=256)
mount()
for i in range(12):
    with open("module%d.py" % i, "w") as file:
        file.write("x" * 3000)

"""

POWER_CUTS = """
running = Checkpoint(7, 2000, 200)
for steps in range(1, 600):
    state[AT["STEPS"]] = steps
    flash.left = steps % 7
    cut = False
    try:
        running.save(state, 0)
    except OSError:
        cut = True
    unmount()
    flash.left = -1
    mount()
    running = Checkpoint(7, 2000, 200)
    found = running._steps
    print("=", steps, found, cut)
"""

WEAR = """
running = Checkpoint(7, 2000, 200)
flash.erases = [0] * BLOCKS
for steps in range(1, 5001):
    state[AT["STEPS"]] = steps
    running.save(state, 0)
print("=", sum(flash.erases), max(flash.erases))
"""


def on_flash(folder: Path, script: str) -> list[list[str]]:
    """What the script prints, on MicroPython with that flash."""
    stage(folder, {})
    (folder / "script.py").write_text(FLASH + script)
    ran = subprocess.run(
        [find_micropython(), "script.py"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    # The file system prints what it mends.
    return [line.split()[1:] for line in ran.stdout.splitlines() if line.startswith("= ")]


def test_a_power_cut_at_any_flash_access_leaves_a_record(tmp_path: Path) -> None:
    """On the file system that a Pico has, remounted after each."""
    last = 0
    cuts = 0
    for steps, found, cut in on_flash(tmp_path, POWER_CUTS):
        if cut == "True":
            cuts += 1
            assert int(found) in (last, int(steps))
        else:
            assert found == steps
        last = int(found)
    assert cuts > 50


def test_flash_outlasts_whoever_wears_it(tmp_path: Path) -> None:
    """A block of flash takes 100,000 erasures; at 10 s a checkpoint, five years of walking."""
    ((total, most),) = on_flash(tmp_path, WEAR)
    assert int(total) < 5000 / 10
    assert int(most) <= 101  # then the file system moves on to another block
