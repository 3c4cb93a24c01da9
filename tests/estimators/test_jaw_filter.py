from __future__ import annotations

import numpy as np
import pytest
from tests.estimators.conftest import Pair, columns, rms_deg, steps, target
from truejoint.models.jaw_families import READINGS

from truejoint.errors import CalibrationError
from truejoint.estimators.jaw_filter import CompensatedJawFilter, JawFilter

OBSERVED = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def fitted(pair: Pair, model: JawFilter) -> JawFilter:
    run = pair.calibration
    return model.fit(columns(run, model.inputs), target(run), steps=steps(run))


def test_filter_is_a_kalman_filter(pair):
    """(12) is linear, so (15)-(23) must give what an ordinary Kalman filter gives."""
    model = fitted(pair, JawFilter())
    run = pair.verification
    X, dt = columns(run, model.inputs), 5e-3
    mechanics = model.mechanics
    density = mechanics.noise_density(model.jaw_friction, model.slider_friction, 5e-3)
    transition, gain, noise = mechanics.discrete(density, dt)
    sensor = np.diag([model.displacement_noise, model.speed_noise]) ** 2
    x, covariance = mechanics.at_rest(*X[0]), model._spread()
    expected = np.empty(len(X))
    for k, (_motor, reset) in enumerate(X):
        seen = OBSERVED[:1] if k == 0 else OBSERVED
        z = [reset] if k == 0 else [reset, (reset - X[k - 1, 1]) / dt]
        if k:
            x = transition @ x + gain[:, 0] * X[k - 1, 0]
            covariance = transition @ covariance @ transition.T + noise
        own = sensor[: len(z), : len(z)]
        kalman = covariance @ seen.T @ np.linalg.inv(seen @ covariance @ seen.T + own)
        x = x + kalman @ (z - seen @ x)
        rest = np.eye(4) - kalman @ seen
        covariance = rest @ covariance @ rest.T + kalman @ own @ kalman.T
        expected[k] = x[0]
    regular = np.full(len(X), dt)
    regular[0] = 0.0
    assert np.abs(model.filtered(X, regular) - expected).max() < 1e-9


@pytest.mark.parametrize("lambda_", [-1.0, 3.0])
def test_lambda_has_no_effect(pair, lambda_):
    run = pair.verification
    X = columns(run, ("motor/jaw", "cable/reset"))[:2000]
    reference = fitted(pair, JawFilter(lambda_=0.5)).evaluate(X)
    assert np.abs(fitted(pair, JawFilter(lambda_=lambda_)).evaluate(X) - reference).max() < 1e-9


def test_readings_of_26(pair):
    """Subtracted at the output and in the loop over g agree; as printed, the error doubles."""
    run = pair.verification
    error = {}
    for reading in READINGS:
        model = fitted(pair, CompensatedJawFilter(reading=reading))
        error[reading] = rms_deg(model.predict(columns(run, model.inputs), steps(run)), run)
    bare = rms_deg(
        fitted(pair, JawFilter()).predict(columns(run, ("motor/jaw", "cable/reset"))), run
    )
    assert error["output"] < 0.15
    assert error["scaled"] == pytest.approx(error["output"], abs=0.002)
    assert error["output"] < error["signed"] < 0.2
    assert error["literal"] > 1.5 * bare
    assert model.loop_gain_[0] == pytest.approx(0.942, abs=0.005)


@pytest.mark.parametrize("reading", READINGS)
def test_steps_give_the_bits_of_the_whole(pair, reading):
    model = fitted(pair, CompensatedJawFilter(reading=reading))
    run = pair.verification
    rows = slice(0, 400)
    X, intervals = columns(run, model.inputs)[rows], steps(run)[rows]
    intervals[[150, 151]] = 0.0, 0.011  # a new history, then a longer step
    whole = model.evaluate(X, intervals)
    state = model.start()
    online = [model.step(state, dt, row) for dt, row in zip(intervals, X, strict=True)]
    assert np.array_equal(np.array(online), whole)


@pytest.mark.parametrize(("jitter", "bound"), [(1e-4, 0.15), (1e-3, 0.3)])
def test_steps_of_varying_length_are_followed(pair, jitter, bound):
    """The undamped model minds jitter: a fiftieth of a step does no harm, a fifth doubles it."""
    model = fitted(pair, CompensatedJawFilter())
    run = pair.verification
    t = run.t + np.random.default_rng(0).uniform(-jitter, jitter, len(run.t))
    X = np.column_stack([np.interp(t, run.t, c) for c in columns(run, model.inputs).T])
    estimate = model.predict(X, np.diff(t, prepend=t[0]))
    assert rms_deg(estimate, run) < bound


def test_a_jump_of_the_encoder_is_survived(pair):
    model = fitted(pair, CompensatedJawFilter())
    X = columns(pair.verification, model.inputs)[:3000].copy()
    usual = model.predict(X)
    X[1000:1003, 1] += 1.0  # a metre
    X[1500:1600, 1] = X[1500, 1]
    broken = model.predict(X)
    assert np.isfinite(broken).all()
    assert np.abs(broken - usual)[2000:].max() < 1e-6


@pytest.mark.parametrize(
    "model",
    [
        JawFilter(drive_stiffness=0.0),
        JawFilter(lambda_=-4.0),
        JawFilter(slider_mass=float("nan")),
        CompensatedJawFilter(reading="added"),
        CompensatedJawFilter(fit_method="newton"),
    ],
)
def test_wrong_parameters_are_refused(pair, model):
    with pytest.raises(CalibrationError):
        fitted(pair, model)
