"""The training domain: what it observes, against a plain count, and its place in the file."""

import numpy as np
import pytest

from truejoint.calibration import calibrate
from truejoint.calibration.domain import (
    SMALLEST_VARIANCE,
    fit_training_domain,
    partners,
    resting_features,
)
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings import Provenance, Recording

SIGNALS = ("measured/elbow", "effort/elbow", "measured/roll")
NONE = np.zeros(3, dtype=bool)  # rests


def table(t, rows) -> Recording:
    columns = {"t": np.asarray(t, dtype=float)} | dict(
        zip(SIGNALS, np.transpose(rows), strict=True)
    )
    return Recording.from_columns(columns, Provenance("raven2", arm="left"), {"effort/elbow": "Nm"})


def test_partners_are_of_the_same_channel():
    assert partners(SIGNALS).tolist() == [1, 0, -1]
    three = ("measured/elbow", "effort/elbow", "velocity/elbow")
    assert partners(three).tolist() == [1, 2, 0]


def test_changes_and_standstill_as_counted_by_hand():
    rows = [
        [1.0, 0.0, 5.0],
        [1.0, 0.3, 5.0],  # the elbow stands still while its effort moves by 0.3,
        [1.0, -0.1, 5.0],  # then to 0.4 in all
        [1.5, -0.1, 5.0],
        [1.5, -0.1, 5.0],  # nothing moves for two rows
        [1.5, -0.1, 5.0],
        [9.0, 0.9, 5.0],  # after a gap: no change is counted
        [9.0, 0.9, 5.0],
    ]
    t = [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 7.0, 7.1]
    X, error = np.array(rows), np.array(rows)[:, :1]
    training_domain = fit_training_domain([table(t, rows)], SIGNALS, 1.0, X, error, NONE, ["elbow"])
    np.testing.assert_allclose(training_domain.signal_step, [0.5, 0.4, 0.0], rtol=1e-12)
    np.testing.assert_allclose(
        training_domain.signal_travel, [0.4 / 1.0, 0.5 / 8.0, 0.0], rtol=1e-12
    )
    assert training_domain.hold == pytest.approx(0.3, rel=1e-12)
    assert training_domain.dt == pytest.approx(0.1)
    np.testing.assert_array_equal(training_domain.signal_lower, [1.0, -0.1, 5.0])
    np.testing.assert_array_equal(training_domain.signal_upper, [9.0, 0.9, 5.0])
    assert (training_domain.error_lower[0], training_domain.error_upper[0]) == (1.0, 9.0)


def test_whitened_rows_are_uncorrelated(recording):
    calibration = calibrate(recording, "linear", joints=["elbow", "insertion"])
    training_domain = calibration.training_domain
    X = calibration.feature_set.compute(recording, calibration.gap_limit)
    white = (X - training_domain.feature_mean) @ training_domain.whitening.T
    covariance = white.T @ white / len(X)
    varies = np.diag(covariance) > 1e-6
    assert varies.sum() == 14  # two of the sixteen belong to the unused channel
    np.testing.assert_allclose(covariance, np.diag(varies.astype(float)), rtol=0, atol=1e-9)
    assert np.linalg.norm(white, axis=1).max() == training_domain.distance


def test_copies_of_a_feature_are_told_apart_but_not_without_end():
    rng = np.random.default_rng(0)
    x = rng.normal(size=500)
    X = np.column_stack([x, x, rng.normal(size=500)])
    rows = np.column_stack([x, rng.normal(size=(500, 2))])
    training_domain = fit_training_domain(
        [table(np.arange(500.0), rows)], SIGNALS, 2.0, X, X[:, :1], NONE, ["elbow"]
    )
    split = np.linalg.norm(training_domain.whitening @ [0.5, -0.5, 0.0])
    expected = np.sqrt(0.5) / x.std() / np.sqrt(SMALLEST_VARIANCE)
    assert split == pytest.approx(expected, rel=1e-6)


def test_where_a_joint_rests_is_no_matter_of_the_distance():
    rng = np.random.default_rng(0)
    elbow, effort = rng.uniform(-1.0, 1.0, (2, 500))
    X = np.column_stack([elbow, effort, 0.1 * elbow + 1e-4 * effort])  # cables drag the roll along
    training, names = [table(np.arange(500.0), X)], FeatureSet.parse(["rate(measured/roll, 0.1)"])
    units = {name: training[0].units[name] for name in SIGNALS}
    assert resting_features(training, names, ["elbow"], units).tolist() == [True]
    assert resting_features(training, names, ["elbow", "roll"], units).tolist() == [False]
    every = FeatureSet.parse(SIGNALS)
    resting = resting_features(training, every, ["elbow"], units)
    assert resting.tolist() == [False, False, True]
    domain = fit_training_domain(training, SIGNALS, 2.0, X, X[:, :1], resting, ["elbow"])
    alone = fit_training_domain(training, SIGNALS, 2.0, X[:, :2], X[:, :1], NONE[:2], ["elbow"])
    np.testing.assert_allclose(domain.whitening[:, 2], 0.0)
    assert domain.distance == pytest.approx(alone.distance)
