"""Networks that remember: their gradients, and that they are fitted as they run."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from tests.runtime.streams import trained

from truejoint.errors import CalibrationError
from truejoint.estimators.network import recurrent, temporal_convolution
from truejoint.estimators.network.backpropagation import convolution_gradient, recurrent_gradient
from truejoint.estimators.network.sequence import RecurrentNetwork, TemporalConvolution, step_rows

SMALL = RecurrentNetwork(units=5, period=0.005, window=16, epochs=3)
CONVOLUTION = TemporalConvolution(layers=3, units=5, period=0.005, window=16, epochs=3)
ALL = [SMALL, clone(SMALL).set_params(cell="long_short_term"), CONVOLUTION]


def delayed(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Features, and targets that only the rows before tell."""
    X = np.random.default_rng(seed).normal(size=(n, 2))
    return X, np.column_stack([3.0 + np.roll(X[:, 0], 1), 0.1 * np.roll(X[:, 1], 2)])


def slopes(weights, loss):
    """Differences of a loss over some of the weights, and the places of these."""
    for name, weight in weights.items():
        for i in range(0, weight.size, 5):
            start, sides = weight.flat[i], []
            for h in (1e-6, -1e-6):
                weight.flat[i] = start + h
                sides.append(loss())
            weight.flat[i] = start
            yield name, i, (sides[0] - sides[1]) / 2e-6


def problem(family, params, seed: int):
    """Weights, and a batch of three histories with unknown targets."""
    rng = np.random.default_rng(seed)
    shapes = family.shapes(params | {"units": 4}, 3, 2)
    weights = {n: rng.normal(size=s) for n, s in shapes.items() if n.endswith(("weights", "bias"))}
    y = rng.normal(size=(9, 5, 2))
    y[rng.random((9, 5)) < 0.3] = np.nan
    history = np.sort(rng.integers(0, 3, (9, 5, 1)), axis=0) * 1.0
    return weights, [rng.normal(size=(9, 5, 3)), y, history]


@pytest.mark.parametrize(("cell", "size"), [("gated_unit", 4), ("long_short_term", 8)])
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000))
def test_gradient_is_the_slope_of_the_loss(cell, size, seed):
    weights, batch = problem(recurrent.FAMILY, SMALL.get_params() | {"cell": cell}, seed)
    state = np.random.default_rng(seed).normal(size=(5, size))
    gradient = recurrent_gradient(weights, batch, state, 0.01)[1]
    for name, i, slope in slopes(
        weights, lambda: recurrent_gradient(weights, batch, state, 0.01)[0]
    ):
        assert gradient[name].flat[i] == pytest.approx(slope, abs=1e-6, rel=1e-4)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000))
def test_gradient_of_convolutions_is_the_slope_of_the_loss(seed):
    weights, batch = problem(temporal_convolution.FAMILY, CONVOLUTION.get_params(), seed)
    gradient = convolution_gradient(weights, batch, 0.01)[1]
    places = list(slopes(weights, lambda: convolution_gradient(weights, batch, 0.01)[0]))
    near = [gradient[name].flat[i] == pytest.approx(slope, abs=1e-6, rel=1e-4)
            for name, i, slope in places]  # fmt: skip
    assert np.mean(near) > 0.98  # a unit may be switched by the difference itself


@pytest.mark.parametrize("cell", ["gated_unit", "long_short_term"])
def test_training_passes_the_states_of_the_row(cell):
    """Mean loss without a penalty, from the states of training, is the error of the predictions."""
    X, y = delayed(400)
    model = clone(SMALL).set_params(cell=cell).fit(X, y)
    state = np.zeros((1, 5 if cell == "gated_unit" else 10))
    loss = recurrent_gradient(weights_of(model), batch_of(model, X, y), state, 0.0)[0]
    assert loss == pytest.approx(loss_of(model, X, y), rel=1e-9)


def test_training_sees_what_the_row_of_convolutions_sees():
    X, y = delayed(400)
    model = clone(CONVOLUTION).fit(X, y)
    loss = convolution_gradient(weights_of(model), batch_of(model, X, y), 0.0)[0]
    assert loss == pytest.approx(loss_of(model, X, y), rel=1e-9)


def weights_of(model):
    return {n: a for n, a in model.arrays_.items() if n.endswith(("weights", "bias"))}


def batch_of(model, X, y):
    scaled = (X - model.mean_) * model.inverse_scale_
    targets = (y - model.target_mean_) / model.target_scale_
    return [scaled[:, None], targets[:, None], np.zeros((len(X), 1, 1))]


def loss_of(model, X, y) -> float:
    squares = (((y - model.predict(X)) / model.target_scale_) ** 2).mean(axis=0)
    return float(np.log(squares + 1e-6).mean())


@pytest.mark.parametrize(
    "model",
    [
        RecurrentNetwork(units=8, epochs=30),
        RecurrentNetwork(cell="long_short_term", units=8, epochs=25),
        TemporalConvolution(units=8, epochs=30, layers=6),
    ],
    ids=lambda model: model.name,
)
def test_it_learns_hysteresis(model):
    """A play operator on a motion of changing amplitude, which a line cannot follow."""
    t = np.arange(4000) * 0.02
    X = (np.sin(2.0 * t) * np.sin(0.31 * t))[:, None]
    y = np.zeros(4000)
    for i in range(1, 4000):
        y[i] = np.clip(y[i - 1], X[i, 0] - 0.3, X[i, 0] + 0.3)
    dt = np.full(1000, 0.02)
    model = clone(model).fit(X[:3000], y[:3000], dt=np.repeat(dt, 3))
    line = np.polynomial.Polynomial.fit(X[:3000, 0], y[:3000], 1)
    errors = model.predict(X[3000:], dt) - y[3000:], line(X[3000:, 0]) - y[3000:]
    assert np.std(errors[0]) < 0.85 * np.std(errors[1])  # as the worst of them
    assert model.loss_curve_[-1] < model.loss_curve_[0] - 1.0


@pytest.mark.parametrize("small", ALL, ids=lambda one: one.name)
def test_one_row_at_a_time_gives_the_bits_of_all(small):
    X, y = delayed(300)
    model = clone(small).fit(X, y)
    dt = model.time_steps(np.where(np.arange(300) % 70 == 0, 0.0, 0.004), 300)
    state = model.start()
    rows = [model.step(state, interval, row) for interval, row in zip(dt, X, strict=True)]
    assert np.array(rows).tobytes() == model.evaluate(X, dt).tobytes()
    again = type(model).from_data(model.data, 2, 2)
    assert again.evaluate(X, dt).tobytes() == model.evaluate(X, dt).tobytes()


@pytest.mark.parametrize("small", ALL, ids=lambda one: one.name)
def test_a_history_starts_anew(small):
    X, y = delayed(300)
    model = clone(small).fit(X, y)
    dt = np.where(np.arange(300) == 100, 0.0, 0.005)
    whole = model.predict(X, dt)
    np.testing.assert_array_equal(whole[100:], model.predict(X[100:]))
    assert not np.allclose(whole[100:105], model.predict(X)[100:105])


@pytest.mark.parametrize("small", ALL, ids=lambda one: one.name)
def test_unknown_targets_are_seen_but_not_fitted(small):
    X, y = delayed(600)
    y[::3] = np.nan
    other = X.copy()
    other[::3] += 1.0
    model = clone(small).fit(X, y)
    assert np.isfinite(model.predict(X)).all()
    assert model.predict(X).tobytes() != clone(small).fit(other, y).predict(X).tobytes()


def test_a_row_of_each_period_is_trained_on_one_with_a_target_where_there_is_one():
    dt = np.where(np.arange(100) == 0, 0.0, 0.005)
    known = np.arange(100) % 5 == 1
    rows = step_rows(dt, known, 0.02)
    np.testing.assert_array_equal(rows // 4, np.arange(25))
    assert known[rows].sum() == 20  # all of them: no period holds two
    np.testing.assert_array_equal(step_rows(dt, np.ones(100, bool), 0.02), np.arange(0, 100, 4))


@pytest.mark.parametrize("small", ALL, ids=lambda one: one.name)
def test_seed_decides_the_network(small):
    X, y = delayed(300)

    def predict(seed):
        return clone(small).set_params(random_state=seed).fit(X, y).predict(X).tobytes()

    assert predict(1) == predict(1)
    assert predict(1) != predict(2)


@pytest.mark.parametrize("small", ALL, ids=lambda one: one.name)
def test_a_constant_target_and_a_constant_feature(small):
    X, y = delayed(300)
    X[:, 1], y[:, 1] = 0.1, -4.0
    model = clone(small).fit(X, y)
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
