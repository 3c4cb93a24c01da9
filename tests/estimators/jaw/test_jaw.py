"""The jaw's estimators behind `calibrate`, and what they refuse."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from tests.refusals import refused

from truejoint.calibration import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators import get_estimator
from truejoint.recordings import Recording
from truejoint.robots.cable_mechanism import Forceps


def test_history_starts_anew_after_a_gap(pair, registered):
    verification, model = pair.verification, registered("play_reset")
    rows = np.concatenate([np.arange(2000), np.arange(6000, 8000)])
    part = verification.rows(rows)
    whole = model.correct(part)
    again = model.correct(verification.rows(np.arange(6000, 8000)))
    assert np.array_equal(whole[2000:], again)


def test_rows_without_truth_are_seen_but_not_fitted_to(pair, registered):
    calibration, verification = pair.recordings()
    hole = changed(calibration, "truth/jaw", lambda y: np.where(np.arange(len(y)) % 2, np.nan, y))
    full = registered("play_reset").correct(verification)
    half = calibrate(hole, "play_reset").correct(verification)
    assert 0.0 < np.abs(full - half).max() < np.radians(0.05)
    thin = calibrate(calibration, "play_reset", fit_rate=20.0).correct(verification)
    assert np.abs(full - thin).max() < np.radians(0.1)


def changed(recording: Recording, name: str, change) -> Recording:
    columns = {c: np.array(recording.table[c]) for c in recording.table.columns}
    columns[name] = change(columns[name])
    return Recording.from_columns(columns, recording.provenance, dict(recording.units))


def one_way(recording: Recording) -> Recording:
    jaw = recording.column("truth/jaw")
    top, bottom = int(np.argmax(jaw[3000:])) + 3000, int(np.argmin(jaw[:3000]))
    return recording.rows(np.arange(min(top, bottom), max(top, bottom)))


def loaded(recording: Recording) -> Recording:
    return dataclasses.replace(
        recording, provenance=dataclasses.replace(recording.provenance, load=0.1)
    )


def with_reset(change) -> Callable[[Recording], Recording]:
    return lambda recording: changed(recording, "cable/reset", change)


@pytest.mark.parametrize(
    ("spoil", "name", "said"),
    [
        (one_way, "ukf_compensated", r"reverses [01] times"),
        (with_reset(lambda x: np.where(np.arange(len(x)) > 7000, x[7000], x)), "ukf_compensated",
         "stands still"),
        (with_reset(np.zeros_like), "ukf_compensated", "never change"),
        (with_reset(lambda x: x + 1e-3 * (np.arange(len(x)) > 5000)), "play_gated", "jumps"),
        (loaded, "play_reset", "100 g on the jaw"),
    ],
)  # fmt: skip
def test_a_recording_that_shows_no_friction_of_a_free_jaw_is_refused(pair, spoil, name, said):
    refused(said, calibrate, spoil(pair.calibration), name)


def test_wrong_columns_and_targets_are_refused(pair):
    recording = pair.recordings()[0]
    refused("takes 2 features", calibrate, recording, "ukf", features=["cable/reset"])
    refused("use target 'position'", calibrate, recording, "ukf", target="error")
    model = get_estimator("play_reset")
    with pytest.raises(
        CalibrationError, match="takes 1 features, in the order of cable/reset; 2 are given"
    ):
        model.fit(np.zeros((500, 2)), np.zeros(500))
    with pytest.raises(ValueError, match="X contains NaN"):
        model.fit(np.where(np.arange(500) == 3, np.nan, 1.0)[:, None], np.zeros(500))
    refused("not negative", model.fit, np.ones((500, 1)), np.zeros(500), dt=np.full(500, -1.0))


def test_what_the_recording_says_of_the_mechanism_reaches_the_estimator(pair):
    recording = pair.recordings()[0]

    def stating(**values):
        mechanism = Forceps(**values).mechanism()
        return dataclasses.replace(
            recording,
            robot=dataclasses.replace(recording.robot, mechanism=mechanism, transmission=None),
        )

    told = calibrate(stating(gear_ratio=40.0), "ukf").model
    assert (told.gear_ratio, told.jaw_radius) == (40.0, 4e-3)
    # It moves the estimate as much as saying it to the estimator does, which has the last word.
    X = np.column_stack([recording.column("motor/jaw"), recording.column("cable/reset")])
    said = calibrate(stating(), get_estimator("ukf").set_params(gear_ratio=40.0)).model
    assert np.array_equal(told.evaluate(X), said.evaluate(X))
    stubborn = get_estimator("ukf").set_params(gear_ratio=30.0)
    assert calibrate(stating(gear_ratio=40.0), stubborn).model.gear_ratio == 30.0
    refused("2 different mechanisms", calibrate, [stating(gear_ratio=40.0), recording], "ukf")
    with pytest.raises(CalibrationError, match=r"gear_ratio is 0[.]5; it must be a number from 1"):
        calibrate(stating(gear_ratio=0.5), "ukf")


@pytest.mark.parametrize(("name", "column"), [("ukf", "reset"), ("lsm", "drive")])
def test_a_sensor_that_is_not_installed_is_refused(pair, name, column):
    recording = pair.recordings()[0]
    left = {c: np.array(v) for c, v in recording.table.items() if c != f"cable/{column}"}
    without = Recording.from_columns(left, recording.provenance)
    refused(f"no cable/{column}; {name} reads .*install", calibrate, without, name)


def test_a_filter_is_refused_at_another_rate(pair, registered):
    slow = pair.verification.rows(np.arange(0, len(pair.verification), 4))
    with pytest.raises(CalibrationError, match=r"a row every 0\.02 s, training every 0\.005 s"):
        registered("ukf_compensated").correct(slow)
    registered("play_gated").correct(slow)  # knows no rate
