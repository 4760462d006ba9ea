"""What every command has in common: versions, quiet, completion, colours, one's own settings."""

from __future__ import annotations

import json
import os
import pty
import subprocess
from pathlib import Path

import pytest
from cli import SOLENAV, refused, solenav

from solenav import capture
from solenav.errors import SolenavError
from solenav.parameters import named
from solenav_tools import settings

WALK = ("simulate", "stand", "--duration", "2", "-o")


def test_the_version_names_the_wire_schema_and_where_settings_are_looked_for() -> None:
    done = solenav("--version")
    assert done.returncode == 0
    assert "wire schema" in done.stdout
    assert settings.NAME in done.stdout


@pytest.mark.parametrize("place", ["before", "after"])
def test_quiet_says_nothing_of_a_success_and_leaves_json(tmp_path: Path, place: str) -> None:
    out = tmp_path / "walk.solcap"
    arguments = [*WALK, out]
    quiet = ["-q", *arguments] if place == "before" else [*arguments, "--quiet"]
    done = solenav(*quiet)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert json.loads(solenav("-q", "info", out, "--json").stdout)["samples"]


def test_quiet_leaves_errors(tmp_path: Path) -> None:
    refused(solenav("verify", tmp_path / "none.solcap", "-q"), 2, "none.solcap")


def test_a_shell_completes_commands() -> None:
    environment = {**os.environ, "_SOLENAV_COMPLETE": "complete_bash"}
    environment |= {"COMP_WORDS": "solenav down", "COMP_CWORD": "1"}
    done = subprocess.run([SOLENAV], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["download"]


def _on_a_terminal(no_color: bool) -> bytes:
    """What an error looks like on a terminal."""
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"} | {"TERM": "xterm"}
    if no_color:
        environment["NO_COLOR"] = "1"
    above, below = pty.openpty()
    with os.fdopen(below, "wb") as end:
        subprocess.run([SOLENAV, "info", "none.solcap"], env=environment, stdout=end, stderr=end)
    text = os.read(above, 10_000)
    os.close(above)
    return text


def test_colours_are_for_terminals_that_want_them(tmp_path: Path) -> None:
    coloured, plain = b"\x1b[1;31m", _on_a_terminal(no_color=True)
    assert coloured in _on_a_terminal(no_color=False)
    assert b"error:" in plain and b"\x1b[1;31m" not in plain
    assert "\x1b" not in solenav("info", tmp_path / "none.solcap").stderr


def test_parameters_of_the_settings_go_into_a_capture(tmp_path: Path) -> None:
    (tmp_path / settings.NAME).write_text("[parameters]\naccel_max = 13\nseed = 7\n")
    assert solenav(*WALK, "walk.solcap", cwd=tmp_path).returncode == 0
    plain = solenav("--settings", "/dev/null", *WALK, "plain.solcap", cwd=tmp_path)
    assert plain.returncode == 0
    chosen, default = (
        named(capture.load(tmp_path / name).params[0][1])
        for name in ("walk.solcap", "plain.solcap")
    )
    assert {n for n in chosen if chosen[n] != default[n]} == {"ACC_MAX", "SEED"}
    assert chosen["SEED"] == 7


def test_ports_have_names(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'default_port = "right"\n'
        '[ports.right]\ndevice = "/dev/ttyUSB7"\nbaud = 115200\ncolour = "green"\n'
    )
    found = settings.load(file)
    assert found.default_port == "right"
    assert found.port("right") == settings.PortSettings("/dev/ttyUSB7", 115200, "green")
    assert found.port("/dev/ttyACM0") == settings.PortSettings("/dev/ttyACM0")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("port = [", "no TOML"),
        ("[prots.right]\n", "there is no prots"),
        ("default_port = 3\n", "default_port can't be 3"),
        ("ports = 3\n", "ports can't be 3"),
        ("[ports]\nright = 3\n", "ports.right can't be 3"),
        ("[ports.right]\nbaud = 9600\n", "ports.right.device can't be None"),
        ('[ports.right]\ndevice = "a"\nbaud = true\n', "ports.right.baud can't be True"),
        ('[ports.right]\ndevice = "a"\ncolour = "gren"\n', "ports.right.colour can't be 'gren'"),
        ("[parameters]\nacel_max = 3\n", "there is no parameters.acel_max"),
        ('[parameters]\naccel_max = "3"\n', "parameters.accel_max can't be '3'"),
        ("[parameters]\nlockout_min = 2.5\n", "parameters.lockout_min can't be 2.5"),
        ("[parameters]\nmagnetometer_start = 1\n", "parameters.magnetometer_start can't be 1"),
        ("[parameters]\ncalibration = 1\n", "there is no parameters.calibration"),
    ],
)
def test_settings_with_a_mistake_are_refused_by_file_and_key(
    tmp_path: Path, text: str, says: str
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(SolenavError) as error:
        settings.load(file)
    assert str(file) in error.value.message and says in error.value.message
    assert error.value.remedy


def test_a_command_tells_a_mistake_in_the_settings(tmp_path: Path) -> None:
    (tmp_path / settings.NAME).write_text("[parameters]\naccel_mx = 13\n")
    done = solenav(*WALK, "walk.solcap", cwd=tmp_path)
    refused(done, 2, "there is no parameters.accel_mx", "accel_max?")
    refused(solenav("--settings", "none.toml", *WALK, "w.solcap", cwd=tmp_path), 2, "none.toml")


def test_a_port_s_name_stands_for_it_in_every_command(tmp_path: Path) -> None:
    (tmp_path / settings.NAME).write_text('[ports.foot]\ndevice = "/dev/ttyNOSUCH9"\n')
    for command in (["record", "foot"], ["download", "foot"], ["monitor", "foot"], ["cat", "foot"]):
        done = solenav(*command, cwd=tmp_path)
        refused(done, 2, "there is no port /dev/ttyNOSUCH9")


def test_without_a_port_the_default_is_taken_or_asked_for(tmp_path: Path) -> None:
    (tmp_path / settings.NAME).write_text('default_port = "/dev/ttyNOSUCH8"\n')
    for command in ("record", "download", "monitor"):
        refused(solenav(command, cwd=tmp_path), 2, "there is no port /dev/ttyNOSUCH8")


def test_a_shell_completes_the_names_of_ports(tmp_path: Path) -> None:
    (tmp_path / settings.NAME).write_text('[ports.foot]\ndevice = "/dev/ttyUSB0"\n')
    environment = {**os.environ, "_SOLENAV_COMPLETE": "complete_bash"}
    environment |= {"COMP_WORDS": "solenav record fo", "COMP_CWORD": "2"}
    done = subprocess.run([SOLENAV], env=environment, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.split() == ["foot"]
