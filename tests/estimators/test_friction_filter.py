from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimators.conftest import columns, fitted, rms_deg, steps

from truejoint.errors import CalibrationError
from truejoint.estimators import FrictionFilter, FrictionSmoother, friction_filter
from truejoint.models.friction_filter import DEGREE
from truejoint.recordings.forceps import record_forceps
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen


@pytest.fixture(scope="module")
def model(pair):
    return fitted(pair, FrictionFilter())


def test_without_sliding_it_is_a_kalman_filter(pair, model, monkeypatch):
    """Elements that do not reach their ends are linear: an ordinary Kalman filter must agree."""
    widths = np.array(model.widths) * 5e3
    params = {**model.model_params(), "widths": tuple(widths.tolist())}
    wide = FrictionFilter.from_data(replace(model.data, params=params), 2, 1)
    prior = np.zeros(5), np.diag([1e-6] * 4 + [1e-8])
    monkeypatch.setattr(friction_filter, "friction_prior", lambda _elements: prior)
    X = columns(pair.verification, wide)[:1500]
    dt = steps(pair.verification)[:1500]
    n = len(widths)
    x, covariance = prior
    weights = np.append(wide.drive_[1 + DEGREE :], -1.0 / (wide.drive_stiffness * wide.jaw_radius))
    noise = wide.misfit_[0] ** 2 * max(wide.error_time / wide.dt_[0], 1.0)
    drift = np.append(np.full(n, wide.friction_drift**2), wide.load_drift**2)
    loads = np.empty(len(X))
    for k, (motor, reset) in enumerate(X):
        moved = reset - X[k - 1, 1] if k else 0.0
        x = x + np.append(moved / widths, 0.0)
        covariance = covariance + np.diag(drift) * dt[k]
        place = reset * wide.scale_[0]
        expected = wide.drive_[0] + wide.drive_[1 : 1 + DEGREE] @ place ** np.arange(1, DEGREE + 1)
        innovation = motor * wide.wheel_radius / wide.gear_ratio - expected - weights @ x
        gain = covariance @ weights / (weights @ covariance @ weights + noise)
        x = x + gain * innovation
        covariance = covariance - np.outer(gain, weights @ covariance)
        loads[k] = x[-1]
    assert np.abs(wide.states(X, dt).load - loads).max() < 1e-8


def test_angle_and_load_under_a_weight(pair, model):
    for test in (LoadTest(0.2, "opposing"), LoadTest(0.2, "along")):
        run = record_forceps(specimen("B"), test, seed=3)
        still = run.t >= test.phases["IV"][0]
        states = model.states(columns(run, model), steps(run))
        error = np.degrees((states.angle - run.column("truth/jaw"))[still])
        assert np.sqrt(np.mean(error**2)) < 0.15
        true = run.column("truth_load/jaw")[still].mean()
        assert states.load[still].mean() / true == pytest.approx(1.1, abs=0.45)
    assert rms_deg(
        model.predict(columns(pair.verification, model)), pair.verification
    ) < 0.05  # fmt: skip


def test_smoothing_agrees_at_the_end_and_is_surer_before(pair, model):
    run = pair.verification
    X, dt = columns(run, model)[:3000], steps(run)[:3000]
    filtered, smoothed = model.states(X, dt), model.states(X, dt, smoothed=True)
    assert smoothed.load[-1] == pytest.approx(filtered.load[-1], abs=1e-9)
    assert (smoothed.load_deviation[:-1] <= filtered.load_deviation[:-1] * (1 + 1e-6)).all()
    assert smoothed.load_deviation[1500] < 0.95 * filtered.load_deviation[1500]


def test_smoothed_estimator_is_not_for_a_loop(pair):
    model = fitted(pair, FrictionSmoother())
    assert model.family.row is None
    with pytest.raises(CalibrationError, match="uses later rows"):
        model.start()


def test_garbage_leaves_it_finite(pair, model):
    rng = np.random.default_rng(0)
    X = rng.normal(0.0, 1.0, (2000, 2)) * [100.0, 1.0]
    X[1000:] = columns(pair.verification, model)[1000:2000]
    states = model.states(X, steps(pair.verification)[:2000])
    assert np.isfinite(states.angle).all()
    assert np.isfinite(states.load).all()


@pytest.mark.parametrize(
    "broken",
    [{"widths": ()}, {"widths": (0.0,)}, {"drive_stiffness": -1.0}, {"load_drift": float("inf")}],
)
def test_wrong_parameters_are_refused(pair, broken):
    with pytest.raises(CalibrationError):
        fitted(pair, FrictionFilter(**broken))
