"""What every registered estimator keeps: one row, from which everything else follows."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.utils.estimator_checks import (
    check_get_params_invariance,
    check_no_attributes_set_in_init,
    check_set_params,
)
from tests.refusals import refused
from tests.runtime.registered import fit, in_loop, model, training, unseen
from tests.runtime.streams import stepped

from truejoint.calibration import Calibration, read_calibration, with_interval, write_calibration
from truejoint.errors import CalibrationError
from truejoint.estimators import estimator_names, get_estimator
from truejoint.estimators.family import find_family
from truejoint.estimators.jaw.learn import JawEstimator
from truejoint.estimators.wrapped import class_of
from truejoint.evaluation import part_by_time
from truejoint.features.feature_set import time_steps
from truejoint.recordings import Recording

WRONG = (None, "nonsense", -7.5, float("nan"), 1e300, True, (), ("nonsense",), [-1.0])


def rows(name: str, count: int = 400) -> tuple[Calibration, np.ndarray, np.ndarray]:
    """Calibration, and features (n, k) and time steps (n,) of rows with two more restarts."""
    calibration, recording = model(name), unseen(name).rows(np.arange(count))
    X = calibration.feature_set.compute(recording, calibration.gap_limit)
    dt = time_steps(np.array(recording.t), calibration.gap_limit)
    dt[[count // 3, count // 2]] = 0.0
    dt[count // 2 + 1] *= 1.3  # a longer step
    return calibration, X, dt


@pytest.mark.parametrize("name", in_loop())
def test_single_rows_give_the_bits_of_all_rows_and_remember_as_the_family_says(name):
    calibration, X, dt = rows(name)
    estimator = calibration.model
    whole = estimator.evaluate(X, dt)
    single, widths = stepped(estimator, X, dt)
    np.testing.assert_array_equal(single, whole)
    assert np.isfinite(whole).all()
    assert np.isinf(widths).all()  # what a row states of itself is the corrector's wish
    alone = estimator.evaluate(X, np.zeros(len(X)))
    assert np.array_equal(alone, whole) != estimator.family.remembers


@pytest.mark.parametrize("name", estimator_names())
def test_it_survives_its_data_and_its_file(name, tmp_path):
    calibration, X, dt = rows(name)
    made = calibration.model
    expected = made.evaluate(X, dt)
    again = class_of(made.family.name).from_data(made.data, X.shape[1], len(calibration.joints))
    np.testing.assert_array_equal(again.evaluate(X, dt), expected)
    write_calibration(calibration, tmp_path / "model.safetensors")
    read = read_calibration(tmp_path / "model.safetensors")
    assert read.estimator == name
    assert read.target == ("position" if isinstance(made, JawEstimator) else calibration.target)
    assert dict(read.model.model_params()) == dict(made.model_params())
    np.testing.assert_array_equal(read.model.evaluate(X, dt), expected)


@pytest.mark.parametrize("name", estimator_names())
def test_a_recording_that_does_not_suit_is_refused_in_one_line(name):
    calibration, recording = model(name), unseen(name)
    lacking = calibration.signals[-1]
    without = Recording(
        recording.table.drop(columns=lacking),
        {column: unit for column, unit in recording.units.items() if column != lacking},
        recording.provenance,
    )
    refused(f"lacks {lacking}, which the calibration needs", calibration.correct, without)
    slow = recording.rows(np.arange(0, len(recording), 3))
    if calibration.model.family.counts_samples:
        refused("has a row every .* training every", calibration.correct, slow)
    else:
        assert np.isfinite(calibration.correct(slow)).all()
    sparse = recording.rows(np.arange(0, len(recording), 12))  # each row after a gap
    if calibration.looks_back:
        refused("training every", calibration.correct, sparse)
    else:
        assert np.isfinite(calibration.correct(sparse)).all()
    few = [one.rows(np.arange(5)) for one in training(name)]
    refused("in the training rows|rows with truth", fit, name, few)


@pytest.mark.parametrize("name", estimator_names())
def test_another_number_of_features_or_joints_is_refused(name):
    fitted = model(name).model
    k, n = fitted.n_features_in_, fitted.n_outputs_
    if fitted.family.inputs:
        refused("features, in the order of", type(fitted).from_data, fitted.data, k + 1, n)
    refused("estimates|it must be", type(fitted).from_data, fitted.data, k, n + 2)


@pytest.mark.parametrize("name", estimator_names())
def test_a_parameter_out_of_its_rule_is_refused_by_name_and_rule(name):
    family, params = get_estimator(name).family, get_estimator(name).model_params()
    family.check_params(params)
    for parameter, rule in family.rules.items():
        wrong = [value for value in WRONG if not rule.holds(value)]
        assert len(wrong) > len(WRONG) // 2
        refused(f" parameter {parameter} is .*; it must be ", family.check_params,
                {**params, parameter: wrong[0]})  # fmt: skip
    for parameter, rule in get_estimator(name).training.items():
        for value in (value for value in WRONG if not rule.holds(value)):
            wrong = get_estimator(name).set_params(**{parameter: value})
            refused(f" parameter {parameter} is .*; it must be ", wrong.check_params)


@pytest.mark.parametrize("name", estimator_names())
def test_name_family_and_class_lead_to_each_other(name):
    estimator = get_estimator(name)
    family = estimator.family
    assert estimator.name == name
    assert class_of(family.name) is type(estimator)
    assert find_family(family.name).row is family.row
    assert find_family(family.name).name == family.name
    assert type(estimator).from_params(estimator.model_params()).name == name
    with suppress(CalibrationError):  # no family is called as an estimator of another
        assert find_family(name) is family
    for check in (check_no_attributes_set_in_init, check_get_params_invariance, check_set_params):
        check(name, estimator)
    assert clone(estimator).family == family


@pytest.mark.parametrize("name", ["dnn", "gru", "ukf_friction", "hybrid_cables"])
def test_an_interval_holds_on_what_it_is_not_made_of(name):
    calibration, recording = model(name), unseen(name)
    other = replace(recording, provenance=replace(recording.provenance, session="unseen"))
    parts = [part_by_time(other, k / 18, (k + 1) / 18) for k in range(18)]
    stated, errors, shares = with_interval(calibration, parts[::2]), [], []
    for one in parts[::2]:
        widening = 1.0 + stated.interval.growth * calibration.range_excess(one)
        error = np.abs(one.columns("truth", calibration.joints) - calibration.correct(one))
        errors.append(error / widening[:, None])
    largest = np.nanmax(np.concatenate(errors), axis=0)  # 90 % of nine trajectories
    np.testing.assert_allclose(stated.interval.half_width(0.9), largest, rtol=1e-9)
    for part in parts[1::4]:
        _, lower, upper = stated.correct_with_interval(part)
        truth = part.columns("truth", stated.joints)
        shares.append(((lower <= truth) & (truth <= upper)).mean(axis=0))
    assert (np.mean(shares, axis=0) > 0.8).all()
