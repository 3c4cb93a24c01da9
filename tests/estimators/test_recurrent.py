"""The recurrent network: its gradient, and that it is fitted as it runs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.runtime.streams import trained

from truejoint.errors import CalibrationError
from truejoint.estimators.recurrent import RecurrentNetwork, loss_and_gradient, step_rows
from truejoint.models import recurrent

SMALL = RecurrentNetwork(units=5, period=0.005, window=16, epochs=3)


def delayed(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Features, and targets that only the rows before tell."""
    X = np.random.default_rng(seed).normal(size=(n, 2))
    return X, np.column_stack([3.0 + np.roll(X[:, 0], 1), 0.1 * np.roll(X[:, 1], 2)])


def problem(seed: int):
    """Weights, batch with unknown targets, restarts and rows between updates, and a state."""
    rng = np.random.default_rng(seed)
    shapes = recurrent.FAMILY.shapes(SMALL.get_params() | {"units": 4}, 3, 2)
    weights = {n: rng.normal(size=s) for n, s in shapes.items() if n.endswith(("weights", "bias"))}
    y = rng.normal(size=(7, 5, 2))
    y[rng.random((7, 5)) < 0.3] = np.nan
    goes_on, updates = ((rng.random((7, 5, 1)) < share) * 1.0 for share in (0.8, 0.6))
    return weights, [rng.normal(size=(7, 5, 3)), y, goes_on, updates], rng.normal(size=(5, 4))


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_gradient_is_the_slope_of_the_loss(seed):
    weights, batch, state = problem(seed)
    gradient = loss_and_gradient(weights, batch, state, 0.01)[1]
    for name, weight in weights.items():
        assert gradient[name].shape == weight.shape
        for i in range(0, weight.size, 5):
            start, sides = weight.flat[i], []
            for h in (1e-5, -1e-5):
                weight.flat[i] = start + h
                sides.append(loss_and_gradient(weights, batch, state, 0.01)[0])
            weight.flat[i] = start
            slope = (sides[0] - sides[1]) / 2e-5
            assert gradient[name].flat[i] == pytest.approx(slope, abs=1e-7, rel=1e-5)


def test_training_passes_the_states_of_the_row():
    """Mean loss without a penalty, from the states of training, is the error of the predictions."""
    X, y = delayed(400)
    model = SMALL.fit(X, y)
    scaled = (X - model.mean_) * model.inverse_scale_
    targets = (y - model.target_mean_) / model.target_scale_
    ones = np.ones((400, 1, 1))
    batch = [scaled[:, None], targets[:, None], ones, ones]
    loss = loss_and_gradient(model.arrays_, batch, np.zeros((1, 5)), 0.0)[0]
    squares = (((y - model.predict(X)) / model.target_scale_) ** 2).mean(axis=0)
    assert loss == pytest.approx(float(np.log(squares + 1e-6).mean()), rel=1e-9)


def test_it_learns_hysteresis():
    """A play operator on a motion of changing amplitude, which a line cannot follow."""
    t = np.arange(4000) * 0.02
    X = (np.sin(2.0 * t) * np.sin(0.31 * t))[:, None]
    y = np.zeros(4000)
    for i in range(1, 4000):
        y[i] = np.clip(y[i - 1], X[i, 0] - 0.3, X[i, 0] + 0.3)
    dt = np.full(1000, 0.02)
    model = RecurrentNetwork(units=8, epochs=30).fit(X[:3000], y[:3000], dt=np.repeat(dt, 3))
    line = np.polynomial.Polynomial.fit(X[:3000, 0], y[:3000], 1)
    errors = model.predict(X[3000:], dt) - y[3000:], line(X[3000:, 0]) - y[3000:]
    assert np.std(errors[0]) < 0.6 * np.std(errors[1])
    assert model.loss_curve_[-1] < model.loss_curve_[0] - 1.0


def test_one_row_at_a_time_gives_the_bits_of_all():
    X, y = delayed(300)
    model = SMALL.fit(X, y)
    dt = model.time_steps(np.where(np.arange(300) % 70 == 0, 0.0, 0.004), 300)
    state = model.start()
    rows = [model.step(state, interval, row) for interval, row in zip(dt, X, strict=True)]
    assert np.array(rows).tobytes() == model.evaluate(X, dt).tobytes()
    again = type(model).from_data(model.data, 2, 2)
    assert again.evaluate(X, dt).tobytes() == model.evaluate(X, dt).tobytes()


def test_a_history_starts_anew():
    X, y = delayed(300)
    model = SMALL.fit(X, y)
    dt = np.where(np.arange(300) == 100, 0.0, 0.005)
    whole = model.predict(X, dt)
    np.testing.assert_array_equal(whole[100:], model.predict(X[100:]))
    assert not np.allclose(whole[100:105], model.predict(X)[100:105])


def test_unknown_targets_are_seen_but_not_fitted():
    X, y = delayed(600)
    y[::3] = np.nan
    other = X.copy()
    other[::3] += 1.0
    model = SMALL.fit(X, y)
    assert np.isfinite(model.predict(X)).all()
    assert model.predict(X).tobytes() != SMALL.fit(other, y).predict(X).tobytes()


def test_targets_between_updates_are_fitted_to():
    dt = np.where(np.arange(100) == 0, 0.0, 0.005)
    rows, updates = step_rows(dt, np.arange(100) % 5 == 1, 0.02)
    assert set(np.arange(0, 100, 4)) == set(rows[updates])
    between = rows[~updates]
    assert len(between) == 15
    assert (between % 5 == 1).all()
    every, only = step_rows(dt, np.ones(100, bool), 0.02)
    np.testing.assert_array_equal(every, np.arange(0, 100, 4))
    assert only.all()


def test_seed_decides_the_network():
    X, y = delayed(300)

    def predict(seed):
        return SMALL.set_params(random_state=seed).fit(X, y).predict(X).tobytes()

    assert predict(1) == predict(1)
    assert predict(1) != predict(2)
    SMALL.set_params(random_state=0)


def test_a_constant_target_and_a_constant_feature():
    X, y = delayed(300)
    X[:, 1], y[:, 1] = 0.1, -4.0
    model = SMALL.fit(X, y)
    moved = np.column_stack([X[:, 0], np.full(300, 1e6)])
    assert model.predict(moved).tobytes() == model.predict(X).tobytes()
    np.testing.assert_allclose(model.predict(X)[:, 1], -4.0, atol=0.1)


@pytest.mark.parametrize("dt", [0.0, 0.005])
def test_too_few_rows_for_a_history_are_refused(dt):
    X, y = delayed(300)
    steps = np.where(np.arange(300) % 10 == 0, 0.0, dt)
    with pytest.raises(CalibrationError, match=r"^gru: too few rows for a history: the longest"):
        SMALL.fit(X, y, dt=steps)


def test_targets_that_are_all_unknown_are_refused():
    X, y = delayed(300)
    with pytest.raises(CalibrationError, match="0 have a target"):
        SMALL.fit(X, np.full_like(y, np.nan))


@pytest.mark.parametrize("target", ["error", "position"])
def test_it_calibrates_any_joints_to_either_target(target):
    calibration = trained(SMALL, target=target)
    assert calibration.target == target
    assert calibration.model.n_outputs_ == 2


def test_too_few_rows_are_refused():
    assert RecurrentNetwork().minimum_rows(4) == 1000
    assert RecurrentNetwork().minimum_rows(100) == 5000
