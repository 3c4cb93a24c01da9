"""The filter of an elastic joint with trees: what they see, learn, and must not learn by heart."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.tree import DecisionTreeRegressor
from tests.estimators.motor_side.test_motor_side import fit, recording, rows
from tests.runtime.streams import OneByOne

from truejoint import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators import ElasticJointFilter, ElasticJointHybrid, Polynomial, Stack, registry
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.motor_side import run as elastic_joint
from truejoint.estimators.motor_side.learn import zeros
from truejoint.features.feature_set import time_steps
from truejoint.runtime import Corrector

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
    found = fitted.estimate(X, dt)
    n_plays = 2 * (
        1 + sum(len(fitted.fitted_params_[name]) for name in ("plays", "time_constants"))
    )
    assert fitted.arrays_["0/mean"].shape == (n_plays + ELEMENTS + 2 + 1,)
    np.testing.assert_array_equal(found.load, alone.estimate(X, dt).load)
    np.testing.assert_array_equal(whole, found.angle[:, :1])
    assert np.ptp(whole - told) > 1e-3


def test_trees_learn_what_the_filters_responses_lack(fitted):
    X, y, dt = rippled(range(30, 34))
    for left, without in zip(
        *((one.estimate(X, dt).angle - y).std(axis=0) for one in (fitted, filter_of(fitted))),
        strict=True,
    ):
        assert left < 0.7 * without


def test_the_torque_does_not_change_the_angle(fitted):
    X, y, dt = rippled(range(6))
    with patch.dict(registry.BOOSTED, max_iter=40):
        alone = clone(fitted).fit(X, y[:, :1], None, dt)
    X, _, dt = rippled([20])
    off = np.abs(alone.evaluate(X, dt) - fitted.evaluate(X, dt))
    assert (off < 1e-9).mean() > 0.99


def test_the_loop_tells_the_torque_of_the_whole_record(fitted):
    X, _, dt = rippled([20])
    X, dt = X[:300], dt[:300]
    state, told = OneByOne(fitted), []
    for row, step in zip(X, dt, strict=True):
        state.step(step, row)
        told.append(state.memory.view("torque")[0])
    np.testing.assert_array_equal(told, fitted.estimate(X, dt).angle[:, 1])


def test_trees_of_the_filter_do_not_smooth(fitted):
    X, _, dt = rippled([20])
    with pytest.raises(CalibrationError, match="smooth with ukf_elastic"):
        fitted.estimate(X, dt, smoothed=True)


def test_a_mean_tells_the_torque_of_its_member(fitted):
    recordings = [recording(seed) for seed in range(4)]
    members = ElasticJointHybrid(elements=ELEMENTS), Polynomial(1)
    with patch.dict(registry.BOOSTED, max_iter=10):
        mean = Stack((Stack(members, ((0.9,), (0.1,))),), ((1.0,),))
        model = calibrate(recordings[:3], mean, fit_rate=25.0)
    unseen = recordings[3]
    loop = Corrector(model)
    loop.set_homing(True)
    trace = loop.run(unseen)
    hybrid = model.model.members_[0].members_[0]
    X = model.feature_set.compute(unseen, model.gap_limit)
    told = hybrid.estimate(X, time_steps(unseen.t, model.gap_limit))
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


def tagged(seed, n=20, length=150):
    """Histories of a step in the first feature, each with a zero, told apart by the second."""
    rng = np.random.default_rng(seed)
    history = np.repeat(np.arange(n), length)
    own, tag = rng.normal(0.0, 0.3, n), rng.uniform(0.0, 1.0, n)
    x = rng.uniform(0.0, 1.0, n * length)
    y = (x > 0.5) + own[history] + 0.05 * rng.standard_normal(len(x))
    return np.column_stack([x, tag[history]]), y[:, None], history, own


@pytest.mark.parametrize("seed", range(3))
def test_zeros_are_not_learnt_by_heart(seed):
    X, y, history, own = tagged(seed)
    trees = DecisionTreeRegressor(min_samples_leaf=20, random_state=0)
    found = zeros(trees, X, y, history)
    by_history = found[:: len(X) // len(own), 0]
    assert np.ptp(found.reshape(len(own), -1), axis=1) == pytest.approx(0.0)
    assert np.corrcoef(by_history, own)[0, 1] > 0.5
    other, truth, *_ = tagged(seed + 50)
    by_heart, without = (
        np.mean((trees.fit(X, targets).predict(other) - truth[:, 0]) ** 2)
        for targets in (y, y - found)
    )
    assert without < by_heart


def test_what_each_history_alone_shows_is_no_zero():
    history = np.repeat(np.arange(8), 100)
    x = np.random.default_rng(0).uniform(0.0, 1.0, 800)
    X = np.column_stack([x, history])  # a load of its own
    y = (x + 2.0 * history)[:, None]
    trees = DecisionTreeRegressor(min_samples_leaf=5, random_state=0)
    assert not zeros(trees, X, y, history).any()
    few = history < 4
    assert not zeros(trees, X[few], y[few], history[few]).any()
