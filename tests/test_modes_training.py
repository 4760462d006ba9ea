"""The forest of motions: grown, judged and shipped; thresholds for each motion."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli import refused, solenav

from solenav import forests, importing, mpu9150
from solenav.engines.windows import windows
from solenav.errors import SolenavError
from solenav.sim.scenario import simulate
from solenav_core.layout import FEATURES

pytest.importorskip("numba")
pytest.importorskip("scipy")
pytest.importorskip("sklearn")

from solenav import tuning
from solenav.modes import thresholds, training
from solenav.modes.labels import MODES
from solenav.modes.training import Examples, Growth, Judgement

DATA = Path(__file__).parents[2] / "shared" / "data"
LABELLED = Path(__file__).parents[1] / "tools" / "studies" / "labelled.py"


@pytest.fixture(scope="module")
def course() -> Examples:
    """A person on a course whom the shipped forest hasn't met."""
    return training.from_recording(simulate("modes", seed=77))


def test_the_shipped_forest_knows_the_motions_of_a_stranger(course: Examples) -> None:
    found = training.judge(training.shipped(), [course])
    assert found.windows > 100
    assert found.right > 0.9
    assert all(recall is not None and recall > 0.8 for recall in found.recall.values())
    held = training.judge_held([course])
    assert held.windows == found.windows
    assert held.right > 0.85


def test_what_is_judged_is_what_the_core_says() -> None:
    recording = simulate("run", seed=5)
    counts = mpu9150.to_counts(recording.accel, recording.gyro).counts
    found = windows(counts, importing.parameters_of(recording))
    ours = forests.scores(training.shipped(), found.features.astype(np.int64))
    np.testing.assert_array_equal(ours, found.score)


def test_a_tree_says_the_same_in_the_core_as_in_scikit_learn() -> None:
    rng = np.random.default_rng(1)
    features = rng.integers(-300, 300, (400, FEATURES))
    mode = (features[:, 3] > 17).astype(np.int64) * 2 + (features[:, 40] <= -5)
    data = [Examples("made up", "made up", features, mode, np.zeros_like(mode))]
    words = training.train(data, Growth(trees=1, depth=8, leaf=1))
    from sklearn.ensemble import RandomForestClassifier

    theirs = RandomForestClassifier(
        1,
        criterion="entropy",
        max_depth=8,
        min_samples_leaf=1,
        class_weight="balanced",
        random_state=1,
    ).fit(features, mode)
    other = rng.integers(-300, 300, (400, FEATURES))
    ours = forests.scores(words, other)
    sure = ours.max(axis=1) == 63  # elsewhere rounding may decide between equals
    assert sure.mean() > 0.5
    np.testing.assert_array_equal(ours.argmax(axis=1)[sure], theirs.predict(other)[sure])


def test_leaving_out_is_by_walk_not_by_foot(course: Examples) -> None:
    half = len(course) // 2
    one = replace(
        course,
        name="walk_left",
        features=course.features[:half],
        mode=course.mode[:half],
        held=course.held[:half],
    )
    groups = [training._group(name) for name in ("walk_left", "walk_right", "walk-left", "walk")]
    assert set(groups) == {"walk"}
    found = training.leave_out([one], Growth(trees=4), always=[course])
    assert found.windows == half
    assert found.right > 0.95


def test_a_forest_of_one_motion_is_refused(course: Examples) -> None:
    walking = course.mode == MODES.index("walk")
    alone = replace(course, features=course.features[walking], mode=course.mode[walking])
    with pytest.raises(SolenavError, match="no two motions"):
        training.train([alone])
    with pytest.raises(SolenavError, match="too few for 2000 folds"):
        training.cross_validate([course], Growth(), 2000)


def test_an_unknown_motion_is_wrong() -> None:
    mode = np.array([0, 1, 1])
    held = np.array([1, 2, 0])
    found = training.judge_held([Examples("", "", np.zeros((3, FEATURES), int), mode, held)])
    assert found == Judgement(found.confusion)
    assert found.right == pytest.approx(2 / 3)
    assert found.confusion[1, -1] == 1


def test_train_evaluate_and_export(tmp_path: Path) -> None:
    walk = tmp_path / "course.solcap"
    importing.to_capture(simulate("modes", seed=78), walk)
    forest = tmp_path / "m.forest"
    done = solenav("modes", "train", "--simulated", "1", walk, "-o", forest, "--json")
    assert done.returncode == 0, done.stderr
    about = json.loads(done.stdout)
    assert about["trained_on"] == ["course"] and about["simulated"] == 1
    assert set(about["judgements"]) == {
        "10 folds of windows",
        "recordings left out",
        "simulated walks alone",
    }
    figure = tmp_path / "c.png"
    done = solenav("modes", "evaluate", walk, "--forest", forest, "--figure", figure, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["judgements"]["each window"]["right"] > 0.97
    assert figure.stat().st_size > 10_000
    table = tmp_path / "forest.py"
    assert solenav("modes", "export", forest, "-o", table).returncode == 0
    written = runpy.run_path(str(table))["FOREST"]
    assert forests.from_bytes(written) == forests.load(forest)
    assert "Trained on 1 recordings and 1 people" in table.read_text()


def test_what_is_no_forest_and_what_has_no_labels_is_refused(tmp_path: Path) -> None:
    bad = tmp_path / "bad.forest"
    bad.write_bytes(b"abc")
    refused(solenav("modes", "export", bad, "-o", tmp_path / "t.py"), 2, "bad.forest", "no forest")
    walk = tmp_path / "walk.solcap"
    importing.to_capture(simulate("loop", rate_hz=50), walk)
    walk.with_suffix(".modes.csv").unlink()
    refused(solenav("modes", "evaluate", walk), 2, "no labels of motion", "walk.modes.csv")
    refused(solenav("modes", "evaluate"), 2, "nothing to judge by")
    refused(solenav("modes", "train", "-o", tmp_path / "m.forest"), 2, "no two motions")


def test_a_threshold_lies_between_the_two_lowest_minima() -> None:
    walks = [tuning.from_recording(simulate("modes", seed=79, rate_hz=100))]
    report = thresholds.tune(walks, jobs=1)
    found = {one.mode: one for one in report.thresholds}
    assert list(found) == list(MODES)
    assert found["still"].value == report.settings.glrt_still
    assert "no gait cycle" in found["still"].why
    for mode in ("walk", "run"):
        one = found[mode]
        assert one.lowest is not None and one.second is not None
        assert 0.99 * one.lowest <= one.value <= 1.01 * one.second
        assert one.errors_m[one.swept.index(one.value)] == min(one.errors_m)
    assert report.settings.detector == 2
    params = report.config()["params"]
    assert params["DETECTOR"] == 2 and params["GLRT_WALK"] == round(found["walk"].value * 32)


def test_tune_modes_writes_a_configuration(tmp_path: Path) -> None:
    walk = tmp_path / "run.solcap"
    importing.to_capture(simulate("run", seed=80, rate_hz=100), walk)
    chosen = tmp_path / "config.json"
    done = solenav("tune", walk, "--modes", "-o", chosen, "--jobs", "1")
    assert done.returncode == 0, done.stderr
    assert "no recording has it" in done.stdout
    assert json.loads(chosen.read_text())["params"]["DETECTOR"] == 2


@pytest.mark.skipif(not DATA.is_dir(), reason="the public recordings aren't here")
def test_the_forest_knows_real_stairs_and_running(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(LABELLED.parent)
    from labelled import labelled

    known = [
        training.from_recording(recording)
        for name, recording in labelled(DATA)
        if "stair" in name or "_35_" in name or "_34_" in name
    ]
    found = training.judge(training.shipped(), known)
    assert found.right > 0.97
    assert all(recall is not None and recall > 0.9 for recall in found.recall.values())
