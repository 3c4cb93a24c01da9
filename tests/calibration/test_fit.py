"""Calibrating: what is learnt, what is noted, what is refused."""

import json

import numpy as np
import pytest
from tests import refusals

from truejoint.calibration import calibrate
from truejoint.errors import RobotError
from truejoint.estimators import NeuralNetwork
from truejoint.recordings import Recording

JOINTS = ("shoulder", "elbow", "insertion")


def changed(recording: Recording, **columns) -> Recording:
    """Recording with columns replaced; ``truth__elbow=...`` is the column ``truth/elbow``."""
    named = {name.replace("__", "/"): values for name, values in columns.items()}
    return Recording(recording.table.assign(**named), recording.units, recording.provenance)


def without(recording: Recording, *columns: str) -> Recording:
    return Recording(
        recording.table.drop(columns=list(columns)), recording.units, recording.provenance
    )


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))


@pytest.mark.parametrize("target", ["error", "position"])
def test_polynomial_finds_the_error_of_a_recording_that_it_never_saw(build, target):
    calibration = calibrate([build(3000, 0), build(3000, 1)], "poly2", target=target)
    test = build(600, 2)
    assert calibration.joints == JOINTS
    residual = calibration.correct(test) - test.columns("truth", JOINTS)
    assert (rms(residual) < 3e-4).all()  # the noise of the truth is 1e-4
    offset = calibration.baselines["offset"].correct(test) - test.columns("truth", JOINTS)
    assert (rms(offset) > 5 * rms(residual)).all()
    np.testing.assert_allclose(
        calibration.predict_error(test),
        calibration.correct(test) - test.columns("measured", JOINTS),
    )


def test_gross_outliers_of_the_truth_are_left_out_and_counted(build):
    clean = build(3000, 0)
    rows = np.random.default_rng(1).choice(3000, 60, replace=False)
    truth = clean.column("truth/elbow").copy()
    truth[rows] += np.resize([0.5, -0.3], 60)
    fitted = calibrate([clean], "linear")
    assert fitted.metadata["outliers"] == 0
    robust = calibrate([changed(clean, truth__elbow=truth)], "linear")
    assert robust.metadata["outliers"] == robust.origin.sessions[0].outliers == 60
    assert robust.metadata["rows_without_truth"] == 0
    test = build(600, 2)
    np.testing.assert_allclose(robust.correct(test), fitted.correct(test), atol=2e-4)


def test_baselines_are_those_fitted_to_the_same_rows(build):
    recordings = [build(1200, 0), build(1200, 1)]
    network = NeuralNetwork(hidden_layer_sizes=(5,), epochs=2)
    carried = calibrate(recordings, network, target="position").baselines
    assert set(carried) == {"offset", "linear", "poly2"}
    test = build(200, 2)
    for name, baseline in carried.items():
        own = calibrate(recordings, name)
        assert baseline.estimator == name
        np.testing.assert_array_equal(baseline.correct(test), own.correct(test))


def test_metadata_says_where_it_comes_from(build):
    first, second = build(1200, 0), build(1300, 1, homing_id="h2")
    truth = second.column("truth/elbow").copy()
    truth[400:500] = np.nan
    second = changed(second, truth__elbow=truth)
    calibration = calibrate([first, second], "linear")
    metadata = calibration.metadata
    assert json.loads(json.dumps(metadata, allow_nan=False)) == metadata
    assert metadata["rows"] == 2400
    assert metadata["rows_without_truth"] == 100
    assert [s.rows for s in calibration.origin.sessions] == [1200, 1200]
    assert [s.source for s in calibration.origin.sessions] == ["synthetic-0", "synthetic-1"]
    assert calibration.origin.homing_ids == ("h1", "h2")
    assert metadata["unused_features"] == ["measured/unused", "effort/unused"]
    assert calibration.origin.baseline_notes == {}
    assert calibration.origin.sample_dt == pytest.approx(1 / 30, rel=0.02)
    other = calibrate([first, changed(second, truth__elbow=truth + 1e-9)], "linear")
    assert metadata["data_sha256"] != other.metadata["data_sha256"]


def test_weak_baseline_is_noted(build):
    notes = calibrate(build(400), "linear").origin.baseline_notes
    assert list(notes) == ["poly2"]
    assert "400 rows, though it needs 1200" in notes["poly2"]


def test_fit_rate_thins_the_rows_but_not_what_features_see(build):
    recording = build(1500, rate=30.0)
    every = calibrate(recording, "linear", features=["measured/elbow", "lag(measured/elbow, 1)"])
    thinned = calibrate(recording, "linear", features=every.feature_set, fit_rate=10.0)
    assert thinned.feature_set == every.feature_set
    assert every.metadata["rows"] == 1500
    assert thinned.metadata["rows"] == 500
    assert thinned.metadata["rows_without_truth"] == 0
    rows = every.feature_set.compute(recording)[::3]
    assert np.array_equal(thinned.lower, rows.min(axis=0))
    assert np.array_equal(thinned.upper, rows.max(axis=0))


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_fit_rate_must_be_a_rate(build, rate):
    refused("fit rate", build(1500), fit_rate=rate)


def test_seed_goes_to_the_estimator_that_has_one(build):
    recording = build(1100)
    network = NeuralNetwork(hidden_layer_sizes=(4,), epochs=2, random_state=7)
    assert calibrate(recording, network).model.random_state == 7
    assert calibrate(recording, network, random_state=3).model.random_state == 3
    assert network.random_state == 7
    assert calibrate(recording, "linear", random_state=3).estimator == "linear"


def test_progress_rises_to_one(build):
    seen: list[float] = []
    network = NeuralNetwork(hidden_layer_sizes=(4,), epochs=5)
    calibrate(build(1100), network, progress=seen.append)
    assert seen == sorted(seen)
    assert len(seen) == 6
    assert seen[-1] == 1.0


def test_joints_with_truth_are_calibrated_by_default(recording):
    calibration = calibrate(without(recording, "truth/elbow"), "linear")
    assert calibration.joints == ("shoulder", "insertion")


def refused(said: str, recordings, estimator="linear", **choices) -> None:
    refusals.refused(said, calibrate, recordings, estimator, **choices)


def test_recordings_that_do_not_belong_together_are_refused(build, recording):
    refused("no recordings", [])
    refused(
        r"synthetic-0 is of raven2 \(right arm\), synthetic-0 of raven2 \(left arm\)",
        [recording, build(1500, arm="right")],
    )
    units = {**recording.units, "effort/elbow": "N"}
    other = Recording(recording.table, units, recording.provenance)
    refused("'effort/elbow' is in N, in synthetic-0 in Nm", [recording, other])
    units = {**recording.units, "truth/elbow": "m"}
    other = Recording(recording.table, units, recording.provenance)
    refused("'truth/elbow' is in m, 'measured/elbow' in rad", other)


def test_missing_columns_are_named(recording):
    refused("no truth column of shoulder, elbow, insertion",
            without(recording, *(f"truth/{joint}" for joint in JOINTS)))  # fmt: skip
    refused(
        "lacks truth/elbow, which the calibration of elbow needs",
        without(recording, "truth/elbow"),
        joints=["elbow"],
    )
    refused("lacks truth/wrist", recording, joints=["wrist"])
    refused("lacks effort/wrist", [recording, without(recording, "effort/wrist")])
    refused("lacks current/elbow", recording, features=["measured/elbow", "current/elbow"])
    refused("lacks current/m0, .*, current/m11, 8 more, which the features need",
            recording, features=[f"current/m{i}" for i in range(20)])  # fmt: skip
    with pytest.raises(RobotError, match="no joint called 'thumb'"):
        calibrate(recording, "linear", joints=["thumb"])
    refused("no joints to correct", recording, joints=[])


def test_truth_that_stops_is_refused_where_it_stops(recording):
    truth = recording.column("truth/elbow").copy()
    truth[750:] = np.nan
    stop = recording.t[749]
    refused(f"truth/elbow.* missing from {stop:.2f} s to {recording.t[-1]:.2f} s, 50 %",
            changed(recording, truth__elbow=truth))  # fmt: skip
    refused("in none of 1500 rows", changed(recording, truth__elbow=np.full(1500, np.nan)))


def test_a_gap_in_the_rows_is_none_of_the_truth(build, recording):
    whole = recording.rows(np.r_[0:400, 1100:1500])  # 47 % of the time has no row at all
    assert calibrate(whole, "linear", features=["measured/elbow"]).metadata["rows"] == 800
    refused("2 rows with truth; linear with 14 features needs 150", build(2))


@pytest.mark.parametrize(
    ("estimator", "rows", "needed"),
    [("offset", 9, 10), ("linear", 149, 150), ("poly2", 1199, 1200), ("dnn", 299, 300)],
)
def test_too_few_rows_are_refused(build, estimator, rows, needed):
    refused(f"{rows} rows with truth; {estimator} with 14 features needs {needed}",
            build(rows), estimator)  # fmt: skip


def test_constant_feature_is_left_out_and_noted(build):
    stuck = changed(build(1500), effort__wrist=np.full(1500, 0.3))
    texts = ["measured/elbow", "effort/elbow", "effort/wrist", "rate(effort/wrist, 0.1)"]
    calibration = calibrate(stuck, "linear", features=texts, joints=["elbow"])
    assert calibration.metadata["unused_features"] == texts[2:]
    bare = calibrate(stuck, "linear", features=texts[:2], joints=["elbow"])
    moved = changed(stuck, effort__wrist=np.linspace(0.0, 0.4, 1500))
    for used in (stuck, moved):
        np.testing.assert_allclose(calibration.correct(used), bare.correct(used), atol=1e-12)


def test_constant_position_or_nothing_else_is_refused_and_rounding_is_no_change(recording):
    stuck = changed(recording, measured__elbow=np.full(1500, 0.3))
    refused("features measured/elbow never change", stuck)
    refused("features effort/wrist never change", changed(recording, effort__wrist=np.ones(1500)),
            features=["effort/wrist"])  # fmt: skip
    values = np.full(1500, 0.3)
    values[::2] = np.nextafter(0.3, 1)
    found = calibrate(changed(recording, effort__wrist=values), "linear").metadata
    assert "effort/wrist" in found["unused_features"]


def test_wrong_choices_are_refused(recording):
    refused("no estimator called 'svm'", recording, "svm")
    refused("target 'angle'", recording, target="angle")
    said = "offset cannot predict the position; use target 'error'"
    refused(said, recording, "offset", target="position")
    refused("0 features", recording, features=[])
    refused("is not '<quantity>/<channel>'", recording, features="elbow")
    refused("epochs is -1", recording, NeuralNetwork(epochs=-1))


def test_counted_samples_need_one_rate(build):
    refused("every 0.01", [build(1500), build(1500, rate=100.0)],
            features=["measured/elbow", "lag(measured/elbow, 2)"])  # fmt: skip
