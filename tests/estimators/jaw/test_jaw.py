"""The jaw's estimators behind `calibrate`, and what they refuse."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from tests.refusals import refused
from tests.runtime.registered import model as registered

from truejoint.calibration import calibrate
from truejoint.estimators import get_estimator
from truejoint.recordings import Recording
from truejoint.robots.cable_mechanism import Forceps


def test_rows_without_truth_are_seen_but_not_fitted_to(pair):
    calibration, verification = pair
    hole = changed(calibration, "truth/jaw", lambda y: np.where(np.arange(len(y)) % 2, np.nan, y))
    full = registered("play_reset").correct(verification)
    half = calibrate(hole, "play_reset").correct(verification)
    assert 0.0 < np.abs(full - half).max() < np.radians(0.05)


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
    recording = pair.calibration
    refused("takes 2 features", calibrate, recording, "ukf", features=["cable/reset"])
    refused("use target 'position'", calibrate, recording, "ukf", target="error")
    fit = get_estimator("play_reset").fit
    refused("takes 1 features, in the order of cable/reset; 2 are given", fit, np.zeros((500, 2)),
            np.zeros(500))  # fmt: skip
    refused("not negative", fit, np.ones((500, 1)), np.zeros(500), dt=np.full(500, -1.0))


def test_what_the_recording_says_of_the_mechanism_reaches_the_estimator(pair):
    recording = pair.calibration

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
    refused("gear_ratio is 0[.]5; it must be a number from 1", calibrate,
            stating(gear_ratio=0.5), "ukf")  # fmt: skip


@pytest.mark.parametrize(("name", "column"), [("ukf", "reset"), ("lsm", "drive")])
def test_a_sensor_that_is_not_installed_is_refused(pair, name, column):
    recording = pair.calibration
    left = {c: np.array(v) for c, v in recording.table.items() if c != f"cable/{column}"}
    without = Recording.from_columns(left, recording.provenance)
    refused(f"no cable/{column}; {name} reads .*install", calibrate, without, name)
