"""Captures in other formats and back, `cat`, and recordings of anybody's own."""

from __future__ import annotations

import csv
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from cli import SOLENAV, refused, solenav
from hypothesis import given, settings
from hypothesis import strategies as st

from solenav import capture as captures
from solenav import datasets, exporting, importing, replaying
from solenav.capture import CaptureWriter
from solenav.capture.file import read_records
from solenav.errors import SolenavError
from solenav.exporting import csv_tables
from solenav.link import NAMES, Frame, FrameReader, encode
from solenav.link.units import UNITS, in_units
from solenav.sim.scenario import simulate
from solenav.verification import verify
from solenav_core import messages


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replayed walk of 25 s with truth."""
    folder = tmp_path_factory.mktemp("export")
    importing.to_capture(simulate("loop", seed=3, rate_hz=100.0).first(25.0), folder / "w.solcap")
    path = folder / "run.solcap"
    replaying.replay(captures.load(folder / "w.solcap"), path, engine="fast", pose_every=4)
    return path


def stream(path: Path) -> bytes:
    return b"".join(data for _arrival, data in read_records(path))


def frames(path: Path) -> list[Frame]:
    return [item for item in FrameReader().feed(stream(path)) if isinstance(item, Frame)]


def test_csv_and_back_gives_every_byte_again(run: Path, tmp_path: Path) -> None:
    folder, again = tmp_path / "tables", tmp_path / "again.solcap"
    assert solenav("export", run, "--to", "csv", "-o", folder).returncode == 0
    done = solenav("import", folder, "--format", "solenav-csv", "-o", again)
    assert done.returncode == 0, done.stderr
    assert stream(again) == stream(run)
    assert verify(captures.load(again), "fast").verified


def test_csv_has_units_beside_the_integers(run: Path, tmp_path: Path) -> None:
    exporting.export(run, "csv", tmp_path)
    with (tmp_path / "POSE.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert int(rows[-1]["position_0"]) / 2**18 == float(rows[-1]["position_0 [m]"])
    with (tmp_path / "SAMPLE.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    assert float(first["acc_2 [m/s²]"]) == pytest.approx(int(first["acc_2"]) / 2048 * 9.80665)
    assert float(first["temperature [°C]"]) == int(first["temperature"]) / 340 + 35


@given(
    contents=st.lists(
        st.tuples(
            st.sampled_from(sorted(NAMES)),
            st.integers(0, 255),
            st.integers(0, 2**32 - 1),
            st.binary(max_size=150),
        ),
        min_size=1,
        max_size=20,
    )
)
@settings(max_examples=60, deadline=None)
def test_any_frames_survive_csv(
    contents: list[tuple[int, int, int, bytes]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("any")
    path = folder / "any.solcap"
    with CaptureWriter(path) as writer:
        for i, (kind, seq, tick, noise) in enumerate(contents):
            size = messages.SIZES[kind]
            payload = noise[:size].ljust(size, b"\x80")
            if kind in (messages.HELLO,):
                payload = messages.SCHEMA.to_bytes(2, "little") + payload[2:]
            open_ended = any(code == "*" for _n, code, *_rest in link_fields(kind))
            writer.write(i * 0.1, encode(kind, seq, tick, payload + noise[size:] * open_ended))
    exporting.export(path, "csv", folder / "tables")
    csv_tables.read(folder / "tables", folder / "again.solcap")
    assert stream(folder / "again.solcap") == stream(path)


def link_fields(kind: int) -> list[tuple[str, str, int, str, str]]:
    return next(fields for number, _name, _when, fields in messages.MESSAGES if number == kind)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda rows: rows[0].pop(), "no column"),
        (lambda rows: rows[1].pop(), "line 2: "),
        (lambda rows: rows[1].__setitem__(3, "x"), "line 2: seq, tick, order or arrival_s"),
        (lambda rows: rows[2].__setitem__(3, "-1"), "line 3: seq, tick, order or arrival_s"),
        (lambda rows: rows[1].__setitem__(5, "9999999999"), "line 2: position_1"),
        (lambda rows: rows.append(list(rows[1])), "two frames have the order"),
    ],
)
def test_a_damaged_table_is_refused_by_line_and_column(
    run: Path, tmp_path: Path, change: object, says: str
) -> None:
    exporting.export(run, "csv", tmp_path)
    path = tmp_path / "POSE.csv"
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    # Only what is read again: the columns without a unit.
    kept = [i for i, name in enumerate(rows[0]) if "[" not in name]
    rows = [[row[i] for i in kept] for row in rows]
    change(rows)  # type: ignore[operator]
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    with pytest.raises(SolenavError) as error:
        csv_tables.read(tmp_path, tmp_path / "again.solcap")
    assert says in error.value.message and error.value.remedy


def test_evo_reads_the_tum_poses(run: Path, tmp_path: Path) -> None:
    from evo.tools import file_interface

    written = exporting.export(run, "tum", tmp_path / "run.tum")
    poses = file_interface.read_tum_trajectory_file(tmp_path / "run.tum")
    truth = file_interface.read_tum_trajectory_file(tmp_path / "run.truth.tum")
    assert poses.check()[0] and truth.check()[0]
    source = captures.load(run)
    np.testing.assert_allclose(poses.positions_xyz[-1], source.positions()[-1], atol=1e-8)
    assert poses.num_poses == written.items == len(source.poses)


def test_mcap_has_foxglove_s_schemas_and_every_pose(run: Path, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    exporting.export(run, "mcap", tmp_path / "run.mcap")
    seen: dict[str, list[tuple[int, dict[str, object]]]] = {}
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None and channel.message_encoding == "json"
            content = json.loads(message.data)
            promised = json.loads(schema.data)["properties"]
            assert set(content) == set(promised), channel.topic
            seen.setdefault(channel.topic, []).append((message.log_time, content))
    source = captures.load(run)
    assert len(seen["/pose"]) == len(seen["/state"]) == len(seen["/tf"]) == len(source.poses)
    assert len(seen["/imu"]) == len(source.samples)
    assert len(seen["/step"]) == len(source.steps) > 5
    for messages_of_topic in seen.values():
        times = [stamp for stamp, _content in messages_of_topic]
        assert times == sorted(times)
    last = seen["/pose"][-1][1]["pose"]
    assert isinstance(last, dict)
    np.testing.assert_allclose(list(last["position"].values()), source.positions()[-1])
    turn = np.array([last["orientation"][axis] for axis in "wxyz"])
    np.testing.assert_allclose(turn, source.poses.rows["attitude"][-1] / 2**30)
    assert seen["/path"][0][1]["frame_id"] == seen["/truth/path"][0][1]["frame_id"] == "enu"


def test_parquet_has_the_columns_of_the_csv_and_their_units(run: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as tables

    exporting.export(run, "csv", tmp_path / "csv")
    exporting.export(run, "parquet", tmp_path / "parquet")
    for path in sorted((tmp_path / "csv").glob("*.csv")):
        table = tables.read_table(tmp_path / "parquet" / f"{path.stem}.parquet")
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        assert table.column_names == list(rows[0])
        assert table.num_rows == len(rows)
        assert [str(value) for value in table["tick"].to_pylist()] == [r["tick"] for r in rows]
    pose = tables.read_schema(tmp_path / "parquet" / "POSE.parquet")
    assert pose.field("velocity_0 [m/s]").metadata[b"unit"] == b"m/s"
    assert pose.metadata[b"schema"] == f"{messages.SCHEMA:04x}".encode()


def test_what_a_format_cannot_hold_is_said(run: Path, tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt.solcap"
    data = bytearray(run.read_bytes())
    data[len(data) // 2] ^= 0xFF
    spoilt.write_bytes(data)
    done = solenav("export", spoilt, "--to", "tum")
    assert done.returncode == 0
    assert "damaged frames" in done.stderr and "velocity" in done.stderr
    assert (tmp_path / "spoilt.tum").exists()


def test_bad_wishes_are_refused(run: Path, tmp_path: Path) -> None:
    refused(solenav("export", run, "--to", "tum", "-o", tmp_path / "x.txt"), 2, ".tum")
    refused(solenav("export", tmp_path / "no.solcap", "--to", "csv"), 2, "no.solcap")
    walk = run.with_name("w.solcap")
    refused(solenav("export", walk, "--to", "mcap", "-o", tmp_path / "w.mcap"), 2, "has no poses")
    (tmp_path / "file").write_text("")
    refused(solenav("export", run, "--to", "csv", "-o", tmp_path / "file"), 1, "can't write")
    refused(solenav("import", tmp_path, "--format", "solenav-csv"), 2, "no folder with")


def test_every_field_has_a_unit_or_is_a_count() -> None:
    for kind, name, _when, fields in messages.MESSAGES:
        for field, _code, _count, form, _meaning in fields:
            unit = UNITS[kind][field]
            plain = form in ("", "ticks", "bytes", "words", "UTF-8")
            assert bool(unit.name) != plain, f"{name}.{field}: {form!r} is {unit}"


def test_cat_prints_a_line_of_json_a_message(run: Path) -> None:
    done = solenav("cat", run)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(line["message"], line["tick"], line["seq"]) for line in lines] == [
        (NAMES[f.kind], f.tick, f.seq) for f in frames(run)
    ]
    pose = next(f for f in frames(run) if f.kind == messages.POSE)
    printed = next(line for line in lines if line["message"] == "POSE")
    assert printed["velocity"] == in_units(pose)["velocity"]


def test_cat_takes_what_it_is_asked_for(run: Path) -> None:
    lines = [
        json.loads(line)
        for line in solenav("cat", run, "--only", "pose,step", "--raw").stdout.splitlines()
    ]
    assert {line["message"] for line in lines} == {"POSE", "STEP"}
    pose = captures.load(run).poses.rows[0]
    assert lines[0]["position"] == pose["position"].tolist()
    refused(solenav("cat", run, "--only", "pose,stepp"), 2, "STEPP", "POSE")
    refused(solenav("cat", "/dev/nothing"), 2, "/dev/nothing")


def test_cat_tells_damage_when_asked(run: Path, tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt.solcap"
    data = bytearray(run.read_bytes())
    data[len(data) // 2] ^= 0xFF
    spoilt.write_bytes(data)
    assert '"damaged"' not in solenav("cat", spoilt).stdout
    assert '"damaged"' in solenav("cat", spoilt, "--damaged").stdout


def test_cat_ends_quietly_when_its_reader_has_had_enough(run: Path) -> None:
    done = subprocess.run(
        f"{SOLENAV} cat {run} | head -1", shell=True, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0 and done.stderr == ""
    assert json.loads(done.stdout)["message"] == "HELLO"


def own_recording(path: Path, header: str, factor: tuple[float, float, float]) -> None:
    """The simulated walk as a person's own table, in units so many times smaller than SI's."""
    walk = simulate("stand", rate_hz=100.0, duration_s=3.0)
    table = np.column_stack(
        [walk.time_s * factor[0], walk.accel * factor[1], walk.gyro * factor[2]]
    )
    lines = [header, *(",".join(repr(value) for value in row) for row in table.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("t_s,ax_mps2,ay_mps2,az_mps2,gx_rad_s,gy_rad_s,gz_rad_s", (1, 1, 1)),
        ("Time [ms],Ax [g],Ay [g],Az [g],Gx [°/s],Gy [°/s],Gz [°/s]", (1e3, 1 / 9.80665, 57.29578)),
        ("t us,ax mg,ay mg,az mg,gx dps,gy dps,gz dps", (1e6, 1e3 / 9.80665, 57.29578)),
    ],
)
def test_a_table_of_ones_own_is_read_in_its_units(
    tmp_path: Path, header: str, factor: tuple[float, float, float]
) -> None:
    own_recording(tmp_path / "own.csv", header, factor)
    found = datasets.read(tmp_path / "own.csv", "csv")
    walk = simulate("stand", rate_hz=100.0, duration_s=3.0)
    np.testing.assert_allclose(found.accel, walk.accel, atol=1e-6)
    np.testing.assert_allclose(found.gyro, walk.gyro, atol=1e-6)
    assert found.rate_hz == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("t_s,ax_g,ay_g,az_g,gx_dps,gy_dps", "no column gz"),
        ("t_s,ax,ay_g,az_g,gx_dps,gy_dps,gz_dps", "'ax' has no unit"),
        ("t_s,ax_lb,ay_g,az_g,gx_dps,gy_dps,gz_dps", "'ax_lb' has an unknown unit"),
    ],
)
def test_a_table_without_a_unit_is_refused(tmp_path: Path, header: str, says: str) -> None:
    own_recording(tmp_path / "own.csv", header, (1, 1, 1))
    refused(solenav("import", tmp_path / "own.csv", "-f", "csv"), 2, says)


def test_batch_verifies_all_and_a_bad_capture_is_a_row(run: Path, tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    for name in ("a", "deep/b"):
        (tmp_path / f"{name}.solcap").write_bytes(run.read_bytes())
    good = solenav("batch", tmp_path, "--json")
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["verified"] == 2
    (tmp_path / "c.solcap").write_bytes(b"no capture at all")
    done = solenav("batch", tmp_path, "-o", tmp_path / "table.csv", "--jobs", "2")
    assert done.returncode == 1
    assert "2 of 3 verified" in done.stdout
    with (tmp_path / "table.csv").open(newline="") as file:
        rows = {Path(row["capture"]).name: row for row in csv.DictReader(file)}
    assert rows["a.solcap"]["verified"] == "True" and rows["c.solcap"]["verified"] == ""
    assert "no solenav capture" in rows["c.solcap"]["problem"]
    assert float(rows["b.solcap"]["distance_m"]) > 5
    refused(solenav("batch", tmp_path / "none"), 2, "no folder")
    (tmp_path / "empty").mkdir()
    refused(solenav("batch", tmp_path / "empty"), 2, "no capture")


def test_batch_on_a_cluster_gives_the_same_rows(run: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    for name in ("a", "b"):
        (tmp_path / f"{name}.solcap").write_bytes(run.read_bytes())
    (tmp_path / "c.solcap").write_bytes(b"no capture at all")
    here = solenav("batch", tmp_path, "--json", "--jobs", "1")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    ) as cluster:
        there = solenav("batch", tmp_path, "--json", "--dask", cluster.scheduler_address)
    assert there.returncode == here.returncode == 1, there.stderr
    rows = [json.loads(done.stdout)["captures"] for done in (here, there)]
    assert rows[0] == rows[1] and len(rows[0]) == 3


def test_info_tells_of_several_captures(run: Path) -> None:
    walk = run.with_name("w.solcap")
    found = json.loads(solenav("info", run, walk, "--json").stdout)
    assert [Path(facts["capture"]).name for facts in found] == ["run.solcap", "w.solcap"]
    source = captures.load(run)
    poses = found[0]["poses"]
    assert poses["count"] == poses["flagged"]["navigating"] == len(source.poses)
    assert poses["flagged"]["stance"] == int(
        (source.poses.rows["flags"] & messages.IN_STANCE).sum()
    )
    assert poses["flagged"]["gap"] == 0 and found[0]["starts"] == 1
    assert found[0]["samples"]["temperature_c"] == [25.0, 25.0]
