"""The command line: results, refusals, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli import refused, solenav

from solenav import capture, importing, link, replaying
from solenav.recording import Recording
from solenav_core import messages


@pytest.fixture(scope="module")
def short(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds of samples."""
    path = tmp_path_factory.mktemp("short") / "short.solcap"
    source = capture.load(walk)
    samples = replaying.samples_of(source)
    cut = replaying.Samples(*(getattr(samples, n)[:1000] for n in samples.__dataclass_fields__))
    replaying.write_samples(path, cut, source.params[0][1], text="test", notes={}, truth=None)
    return path


# The line from simulation to picture


def test_simulate_replay_verify_evaluate_plot(tmp_path: Path) -> None:
    steps = [
        ("simulate", "stand", "--duration", "8", "-o", "walk.solcap", "--seed", "5"),
        ("replay", "walk.solcap", "--engine", "fast", "-o", "run.solcap"),
        ("verify", "run.solcap", "--engine", "fast"),
        ("info", "run.solcap"),
        ("evaluate", "run.solcap", "--require-truth"),
        ("plot", "run.solcap", "-o", "run.png"),
    ]
    for step in steps:
        done = solenav(*step, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""  # no progress bar in a pipe
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_seed_simulates_the_same_file(tmp_path: Path) -> None:
    for name in ("a", "b"):
        solenav("simulate", "stand", "--duration", "3", "-o", f"{name}.solcap", cwd=tmp_path)
    assert (tmp_path / "a.solcap").read_bytes() == (tmp_path / "b.solcap").read_bytes()
    assert (tmp_path / "a.truth.csv").read_bytes() == (tmp_path / "b.truth.csv").read_bytes()


def test_sensor_errors_can_be_chosen(tmp_path: Path) -> None:
    for name, options in (("none", ["--errors", "ideal"]), ("bias", ["--gyro-bias", "5"])):
        arguments = ["simulate", "stand", "--duration", "3", "-o", f"{name}.solcap", *options]
        assert solenav(*arguments, cwd=tmp_path).returncode == 0
    ideal, biased = (
        capture.load(tmp_path / f"{name}.solcap").sample_counts for name in ("none", "bias")
    )
    assert np.ptp(ideal[:, :9], axis=0).max() == 0
    assert np.abs(biased[:, 3:6].mean(axis=0)).max() > 20


def test_the_magnetic_field_can_be_chosen(tmp_path: Path) -> None:
    fields = {}
    for name, options in (
        ("north", []),
        ("west", ["--declination", "-20"]),
        ("iron", ["--hard-iron", "50"]),
        ("inside", ["--indoors"]),
    ):
        arguments = ["simulate", "stand", "--duration", "3", "-o", f"{name}.solcap", *options]
        assert solenav(*arguments, cwd=tmp_path).returncode == 0
        fields[name] = capture.load(tmp_path / f"{name}.solcap").sample_counts[:, 6:9].mean(axis=0)
    right, front, up = fields["north"]
    assert abs(right) < front / 4 and up < -front
    assert fields["west"][0] < right - front / 4
    for name in ("iron", "inside"):
        assert np.linalg.norm(fields[name] - fields["north"]) > 1


@pytest.mark.parametrize("command", ["info", "verify", "evaluate"])
def test_results_come_as_json(command: str, replayed: Path) -> None:
    done = solenav(command, replayed, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    if command == "verify":
        assert result["verified"] is True and result["covered_ticks"] == 6000
    elif command == "info":
        assert result["samples"]["count"] == 6000
        assert result["samples"]["measured_rate_hz"] == 200.0
    else:
        assert result["truth"]["position_rmse_m"]["horizontal"] < 0.5


def test_replay_on_each_engine_gives_one_digest(short: Path, tmp_path: Path) -> None:
    digests = set()
    for engine in ("pure", "checked", "fast"):
        out = tmp_path / f"{engine}.solcap"
        done = solenav("replay", short, "--engine", engine, "-o", out, "--json")
        assert done.returncode == 0, done.stderr
        digests.add(json.loads(done.stdout)["digest"])
    assert len(digests) == 1


def test_verify_exits_1_and_names_the_difference(replayed: Path, tmp_path: Path) -> None:
    reader = link.FrameReader()
    bad = tmp_path / "bad.solcap"
    with capture.CaptureWriter(bad, flush=False) as writer:
        for arrival, data in capture.read_records(replayed):
            for frame in reader.feed(data):
                assert isinstance(frame, link.Frame)
                if frame.kind == messages.SAMPLE and frame.tick == 3000:
                    frame = frame._replace(payload=frame.payload[:-1] + b"\x01")
                    frame = frame._replace(payload=b"\0" * 4 + b"\x40\0" + frame.payload[6:])
                writer.write(arrival, link.encode(*frame))
    done = solenav("verify", bad)
    assert done.returncode == 1
    assert "DIFFERENT at tick 3000, stage" in done.stdout


def test_help_names_every_command() -> None:
    text = solenav("--help").stdout
    for name in ("simulate", "import", "replay", "run-firmware", "record", "monitor", "info"):
        assert name in text
    for name in ("verify", "plot", "evaluate"):
        assert name in text


# Bad input


@pytest.mark.parametrize("command", ["info", "verify", "evaluate", "plot", "replay"])
@pytest.mark.parametrize(
    ("content", "says"),
    [(None, "No such file"), (b"", "is empty"), (b"\x89PNG\r\n\x1a\n123", "no solenav capture")],
    ids=["missing", "empty", "png"],
)
def test_what_is_no_capture_is_refused(
    command: str, content: bytes | None, says: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / "x.solcap").write_bytes(content)
    output = {"plot": ["-o", "x.png"], "replay": ["-o", "y.solcap"]}.get(command, [])
    refused(solenav(command, "x.solcap", *output, cwd=tmp_path), 2, says)


def test_a_truncated_capture_is_used_as_far_as_it_goes(replayed: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.solcap"
    cut.write_bytes(replayed.read_bytes()[:400_003])
    done = solenav("info", cut)
    assert done.returncode == 0
    assert "ends inside a record" in done.stderr
    done = solenav("verify", cut, "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["covered_ticks"] > 2000


def test_damaged_frames_are_told_and_the_rest_is_verified(replayed: Path, tmp_path: Path) -> None:
    data = bytearray(replayed.read_bytes())
    data[200_000] ^= 0x10
    bad = tmp_path / "bad.solcap"
    bad.write_bytes(data)
    done = solenav("verify", bad)
    assert done.returncode == 0, done.stdout
    assert "damaged" in done.stderr
    assert "damaged" in solenav("info", bad).stderr


def test_another_schema_is_refused(tmp_path: Path) -> None:
    hello = bytearray(messages.SIZES[messages.HELLO])
    hello[:2] = (messages.SCHEMA ^ 1).to_bytes(2, "little")
    with capture.CaptureWriter(tmp_path / "x.solcap") as writer:
        writer.write(0.0, link.encode(messages.HELLO, 0, 0, bytes(hello) + b"Pico; 9.9.9"))
    for command in ("verify", "info", "evaluate"):
        done = solenav(command, "x.solcap", cwd=tmp_path)
        refused(done, 2, "firmware and host differ", "9.9.9", "install the host version")


def test_missing_truth_is_refused_where_it_is_needed(short: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.solcap"
    assert solenav("replay", short, "-o", run).returncode == 0
    assert solenav("evaluate", run).returncode == 0
    refused(solenav("evaluate", run, "--require-truth"), 2, "no truth")


def test_samples_alone_have_no_poses_to_evaluate_or_plot(short: Path, tmp_path: Path) -> None:
    refused(solenav("evaluate", short), 2, "no poses", "solenav replay")
    refused(solenav("plot", short, "-o", tmp_path / "x.png"), 2, "no poses")
    refused(solenav("verify", short), 2, "to compare with")


def test_never_standing_still_is_told_and_the_samples_are_kept(tmp_path: Path) -> None:
    n = 800
    rng = np.random.default_rng(1)
    recording = Recording(
        "restless",
        np.arange(n) / 200,
        rng.normal([0, 0, 9.8], 3, (n, 3)),
        rng.normal(0, 2, (n, 3)),
        200.0,
    )
    importing.to_capture(recording, tmp_path / "x.solcap")
    for command in ("replay", "run-firmware"):
        done = solenav(command, "x.solcap", "-o", f"{command}.solcap", cwd=tmp_path)
        refused(done, 1, "never stood still", "stand still for a second")
        assert len(capture.load(tmp_path / f"{command}.solcap").samples) == n


XIO_HEAD = (
    "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),"
    "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n"
)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (["0,0,0,0,0,0,1", "0.0025,nan,0,0,0,0,1", "0.005,0,0,0,0,0,1"], "NaN"),
        (["0,0,0,0,0,0,1", "0.005,0,0,0,0,0,1", "0.0025,0,0,0,0,0,1"], "time"),
        ([], "sample"),
    ],
    ids=["NaN", "time goes back", "no rows"],
)
def test_a_bad_recording_is_refused(rows: list[str], says: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(XIO_HEAD + "\n".join(rows) + "\n")
    done = solenav("import", "x.csv", "--format", "xio", "-o", "x.solcap", cwd=tmp_path)
    refused(done, 2)
    assert says.lower() in done.stderr.lower()
    assert not (tmp_path / "x.solcap").exists()


def test_a_recording_of_another_format_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.mat").write_bytes(b"\x89PNG")
    for format in ("llio", "openshoe", "pyshoe", "xio", "gaitmap"):
        done = solenav("import", "x.mat", "--format", format, "-o", "x.solcap", cwd=tmp_path)
        refused(done, 2, "x.mat")


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "line35", "-o", "x.solcap", "--rate", "5"),
        ("simulate", "stand", "-o", "x.solcap", "--duration", "0.1"),
        ("simulate", "line35", "-o", "x.csv"),
        ("simulate", "line35", "-o", "no/where/x.solcap"),
        ("run-firmware", "x.solcap"),
    ],
)
def test_bad_arguments_are_refused(arguments: tuple[str, ...], tmp_path: Path) -> None:
    refused(solenav(*arguments, cwd=tmp_path), 2)


def test_an_unknown_option_or_engine_is_a_usage_error(short: Path, tmp_path: Path) -> None:
    for arguments in (("verify", short, "--engine", "warp"), ("verify", short, "--nope")):
        done = solenav(*arguments, cwd=tmp_path)
        assert done.returncode == 2 and "Traceback" not in done.stderr
