"""The filter of an elastic joint with trees: what they see and learn, and both in the loop."""

from dataclasses import replace
from statistics import NormalDist
from unittest.mock import patch

import numpy as np
import pytest
from tests.estimators.motor_side.test_motor_side import estimate, fit, recording, rows
from tests.runtime.registered import model as registered
from tests.runtime.streams import OneByOne, ready

from truejoint import calibrate
from truejoint.cli.correct import correct_rows
from truejoint.errors import CalibrationError
from truejoint.estimators import ElasticJointFilter, ElasticJointHybrid, Polynomial, Stack, registry
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.motor_side import run as elastic_joint
from truejoint.features.feature_set import time_steps

ELEMENTS = 2


def rippled(seeds):
    """Rows of a jaw whose angle and torque ripple over the driver's angle, as no cubic does."""
    X, y, dt, _ = rows(seeds, seconds=12.0)
    return X, y + [0.004, 0.006] * np.sin(30.0 * X[:, :1]), dt


@pytest.fixture(scope="module")
def fitted():
    X, y, dt = rippled(range(6))
    with patch.dict(registry.BOOSTED, max_iter=40):
        return fit(ElasticJointHybrid(elements=ELEMENTS), X, y, dt)


def filter_of(model):
    """Give the filter within."""
    shapes = elastic_joint.FAMILY.shapes(model.model_params(), 2, 1)
    filtered = {name: model.arrays_[name] for name in shapes}
    params = {name: model.model_params()[name] for name in elastic_joint.FAMILY.rules}
    return ElasticJointFilter.from_data(EstimatorData("motor_side", params, filtered), 2, 1)


def test_it_is_the_filter_and_trees_on_plays_states_and_its_output(fitted):
    X, _, dt = rippled([20])
    dt[400] = 0.0
    alone = filter_of(fitted)
    whole, told = fitted.evaluate(X, dt), alone.evaluate(X, dt)
    found = estimate(fitted, X, dt)
    n_plays = 2 * (
        1 + sum(len(fitted.fitted_params_[name]) for name in ("plays", "time_constants"))
    )
    assert fitted.arrays_["0/mean"].shape == (n_plays + ELEMENTS + 2 + 1,)
    np.testing.assert_array_equal(found.load, estimate(alone, X, dt).load)
    np.testing.assert_array_equal(whole, found.angle[:, :1])
    assert np.ptp(whole - told) > 1e-3


def test_trees_learn_what_the_filters_responses_lack(fitted):
    X, y, dt = rippled(range(30, 34))
    for left, without in zip(
        *((estimate(one, X, dt).angle - y).std(axis=0) for one in (fitted, filter_of(fitted))),
        strict=True,
    ):
        assert left < 0.7 * without


def test_the_loop_tells_the_torque_of_the_whole_record(fitted):
    X, _, dt = rippled([20])
    X, dt = X[:300], dt[:300]
    state, told = OneByOne(fitted), []
    for row, step in zip(X, dt, strict=True):
        state.step(step, row)
        told.append(state.memory.view("torque")[0])
    np.testing.assert_array_equal(told, estimate(fitted, X, dt).angle[:, 1])


def test_a_mean_tells_the_torque_of_its_member(fitted):
    recordings = [recording(seed) for seed in range(4)]
    members = ElasticJointHybrid(elements=ELEMENTS), Polynomial(1)
    with patch.dict(registry.BOOSTED, max_iter=10):
        mean = Stack((Stack(members, ((0.9,), (0.1,))),), ((1.0,),))
        model = calibrate(recordings[:3], mean, fit_rate=25.0)
    unseen = recordings[3]
    trace = ready(model).run(unseen)
    hybrid = model.model.members_[0].members_[0]
    X = model.feature_set.compute(unseen, model.gap_limit)
    told = estimate(hybrid, X, time_steps(unseen.t, model.gap_limit))
    np.testing.assert_allclose(trace.beside["torque"][:, 0], told.angle[:, 1], atol=1e-9)


def test_a_model_sees_the_plays_that_it_was_fitted_to(fitted, monkeypatch):
    X, _, dt = rippled([20])
    whole = fitted.evaluate(X, dt)
    others = {"plays": (0.3, 0.4), "time_constants": (0.1,)}
    monkeypatch.setattr(
        ElasticJointHybrid, "fitted_params", {**ElasticJointHybrid.fitted_params, **others}
    )
    again = ElasticJointHybrid.from_data(fitted.data, 2, 1)
    np.testing.assert_array_equal(again.evaluate(X, dt), whole)
    without = {n: v for n, v in fitted.model_params().items() if n != "plays"}
    with pytest.raises(CalibrationError, match=r"it needs .*'plays'"):
        ElasticJointHybrid.from_data(replace(fitted.data, params=without), 2, 1)


def test_the_loop_and_a_table_tell_the_torque_of_recordings():
    calibration = registered("ukf_elastic")
    unseen = recording(50)
    corrected = calibration.correct(unseen)
    error = corrected - unseen.columns("truth", ("jaw",))
    raw = unseen.error(("jaw",))
    assert error.std() < 0.1 * raw.std()
    trace, model = ready(calibration).run(unseen), calibration.model
    X = calibration.feature_set.compute(unseen, calibration.gap_limit)
    told = estimate(model, X, time_steps(unseen.t, calibration.gap_limit))
    value, half_width = trace.beside["torque"].T
    np.testing.assert_allclose(value, told.angle[:, 1], rtol=0.0, atol=1e-12)
    by_level = NormalDist().inv_cdf(0.95) * told.angle_deviation[:, 1]
    np.testing.assert_allclose(half_width, by_level, rtol=1e-9)
    off = np.abs(value - unseen.column("truth_effort/jaw"))
    assert off.std() < 1.5e-3
    assert 0.7 < np.mean(off < half_width) <= 1.0
    table = correct_rows(calibration, unseen, None)
    np.testing.assert_array_equal(table["torque/jaw"], value)
    np.testing.assert_array_equal(table["torque_half_width/jaw"], half_width)
