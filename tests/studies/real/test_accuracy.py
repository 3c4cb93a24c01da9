import numpy as np
import pytest
from pandas import DataFrame

from truejoint import calibrate, evaluate
from truejoint.calibration import cross_interval
from truejoint.errors import CalibrationError, RecordingError, StudyError
from truejoint.evaluation.evaluate import split_sides
from truejoint.recordings.datasets import DATASETS, locate, read_dataset
from truejoint.studies import run_study, write_study
from truejoint.studies.real.accuracy import HWANG, judge
from truejoint.studies.rows import select
from truejoint.tables import fixed

KUKA = "kuka_kr300_dual_encoder"
DVRK = "dvrk_psm_berkeley"


@pytest.fixture
def here():
    for name in (KUKA, DVRK):
        try:
            locate(name)
        except RecordingError as error:
            pytest.skip(str(error))


@pytest.mark.usefixtures("here")
def test_numbers_are_those_of_an_evaluation(tmp_path):
    result = run_study("real", {"datasets": KUKA, "estimators": "linear,ukf_elastic"})
    split = DATASETS[KUKA].split()
    training, testing = split_sides(read_dataset(KUKA, split.files), DATASETS[KUKA], split)
    model = calibrate(training, "linear", features=DATASETS[KUKA].features)
    evaluation = evaluate(model, testing)
    for method in ("linear", "offset", "raw"):
        expected = [evaluation.score(method, joint).rmse for joint in model.joints]
        found = select(result.rows, method=method).rmse.tolist()
        assert found == pytest.approx(expected, rel=1e-9)
    text = result.summary.tables[0].markdown()
    assert "axis1 [deg]" in text
    assert "MIT" in text
    # A filter of a jaw has not what it reads here, which costs it its numbers alone.
    assert f"ukf_elastic on {KUKA}: " in text
    row = next(line for line in text.splitlines() if "axis1" in line)
    assert row.endswith(f" {fixed(np.nan, 3)} |")
    assert write_study(result, tmp_path)[-1].suffix == ".png"


@pytest.mark.usefixtures("here")
def test_where_no_estimator_refuses_none_is_named():
    result = run_study("real", {"datasets": KUKA, "estimators": "linear"})
    assert "refus" not in result.summary.tables[0].markdown()


@pytest.mark.usefixtures("here")
def test_coverage_is_that_of_an_evaluation_and_a_zero_is_found_anew():
    split, how = DATASETS[KUKA].split(), {"dataset": KUKA, "estimator": "linear", "seeds": [0]}
    training, testing = split_sides(read_dataset(KUKA, split.files), DATASETS[KUKA], split)
    model = cross_interval(training, "linear", features=DATASETS[KUKA].features)
    inside = []
    for recording in testing:
        _, least, most = model.correct_with_interval(recording, 0.9)
        truth = recording.columns("truth", model.joints)
        inside.append((least <= truth) & (truth <= most))
    rows = DataFrame(judge(**how, split=split.name, interval="cross"))
    found = select(rows, method="linear").set_index("joint").coverage
    assert found[list(model.joints)].tolist() == pytest.approx(np.concatenate(inside).mean(axis=0))
    assert 0.5 < found.min() < 1.0
    moved = DataFrame(judge(**how, split=split.name, rezero_s=1.0))
    assert (
        select(moved, method="linear").rmse.to_numpy() != select(rows, method="linear").rmse
    ).all()
    (refused,) = judge(**how, split=split.name, zero="recording")  # of one recording
    assert "zero" in refused["refused"]
    with pytest.raises(StudyError, match="interval"):
        run_study("real", {"datasets": KUKA, "interval": "often"})


@pytest.mark.usefixtures("here")
def test_hwangs_split_learns_from_both_motions():
    rows = DataFrame(judge(DVRK, HWANG, "linear", [0]))
    linear, offset = (select(rows, method=name).rmse.to_numpy() for name in ("linear", "offset"))
    assert len(linear) == 6
    assert (linear[:3] < offset[:3]).all()


def test_recordings_that_are_not_here_are_named(monkeypatch, tmp_path):
    monkeypatch.setattr("truejoint.recordings.datasets.store.data_folders", lambda: [tmp_path])
    with pytest.raises(StudyError, match="truejoint datasets kuka_kr300_dual_encoder --fetch"):
        run_study("real", {"datasets": KUKA})


@pytest.mark.usefixtures("here")
def test_the_automatic_choice_is_judged_like_an_estimator(monkeypatch):
    def calibrate(_training, model, **_how):
        raise CalibrationError(f"{model} was asked for")

    monkeypatch.setattr("truejoint.studies.real.accuracy.calibrate", calibrate)
    assert judge(KUKA, DATASETS[KUKA].split().name, "auto", [0]) == [
        {"refused": "auto was asked for"}
    ]
