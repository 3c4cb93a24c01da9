"""The rows of the networks that remember against forward passes computed on their own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit

from truejoint.estimators.family import EstimatorData, Family, evaluate
from truejoint.estimators.network import run as network
from truejoint.estimators.network.run import is_update

K = 3
PARAMS = {
    "units": 5, "period": 0.02, "weight_decay": 1.0, "learning_rate": 0.01,
    "window": 8, "batch_size": 4, "epochs": 1, "random_state": 0,
}  # fmt: skip


def fitted(family: Family, n_outputs: int = 2, seed: int = 0, **params: int) -> EstimatorData:
    rng = np.random.default_rng(seed)
    params = PARAMS | params
    arrays = {
        name: 0.5 * rng.normal(size=shape)
        for name, shape in family.shapes(params, K, n_outputs).items()
    }
    return EstimatorData(family.name, params, arrays)


def convolved(layers: int = 3, **params: int) -> EstimatorData:
    return fitted(network.TCN, layers=layers, **params)


def predict(data: EstimatorData, X: np.ndarray, dt: np.ndarray) -> np.ndarray:
    family, n_outputs = data.kind, len(data.arrays["output_bias"])
    family.check(data, K, n_outputs)
    return evaluate(family, family.memory(data, K, n_outputs), X, dt, n_outputs)


def gru(ours: np.ndarray, theirs: np.ndarray, before: np.ndarray, a) -> np.ndarray:
    """As in the paper but for the reset gate after the product."""
    keep, reset = np.split(expit(ours + theirs)[: 2 * len(before)], 2)
    drive, inner = ours[2 * len(before) :], theirs[2 * len(before) :] + a["state_bias"]
    return keep * before + (1.0 - keep) * np.tanh(drive + reset * inner)


def forward(data: EstimatorData, X: np.ndarray, updates: np.ndarray, fresh: np.ndarray):
    """Unit by unit."""
    a, units = data.arrays, data.params["units"]
    state, out = np.zeros(units), []
    scaled = (X - a["mean"]) * a["inverse_scale"]
    for x, is_kept, is_fresh in zip(scaled, updates, fresh, strict=True):
        state = np.zeros(units) if is_fresh else state
        ours, theirs = x @ a["input_weights"] + a["input_bias"], state @ a["state_weights"]
        new = gru(ours, theirs, state, a)
        output = np.concatenate([new, x]) @ a["output_weights"] + a["output_bias"]
        out.append(a["target_mean"] + a["target_scale"] * output)
        state = new if is_kept else state
    return np.array(out)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 9), st.integers(1, 5), st.integers(0, 99))
def test_the_recurrent_row_is_the_forward_pass(units, n_outputs, seed):
    rng = np.random.default_rng(seed)
    data = fitted(network.GRU, n_outputs, seed, units=units)
    X = rng.normal(size=(40, K))
    fresh = np.arange(40) % 17 == 0
    dt = np.where(fresh, 0.0, 0.033)  # slower than the period: each row updates the state
    expected = forward(data, X, np.ones(40, bool), fresh)
    np.testing.assert_allclose(predict(data, X, dt), expected, rtol=0, atol=1e-11)


def test_rows_between_updates_leave_no_trace():
    data, X = fitted(network.GRU), np.random.default_rng(0).normal(size=(60, K))
    dt = np.where(np.arange(60) == 0, 0.0, 0.005)
    updates = np.arange(60) % 4 == 0
    expected = forward(data, X, updates, np.arange(60) == 0)
    np.testing.assert_allclose(predict(data, X, dt), expected, rtol=0, atol=1e-11)
    other = np.where(updates[:, None], X, 7.0)
    np.testing.assert_array_equal(predict(data, other, dt)[updates], predict(data, X, dt)[updates])


@pytest.mark.parametrize("rate", [30.0, 60.0, 100.0, 250.0, 1000.0])
def test_jitter_of_the_clock_does_not_decide_what_updates(rate):
    rng = np.random.default_rng(0)
    counts, elapsed, count = [], 0.0, 0
    for dt in rng.uniform(0.98, 1.02, 2000) / rate:
        elapsed, count = elapsed + dt, count + 1
        if is_update(dt, elapsed, 0.02):
            counts.append(count)
            elapsed, count = 0.0, 0
    assert set(counts) == {max(1, round(0.02 * rate))}


def test_a_large_input_saturates_the_gates():
    data = fitted(network.GRU)
    X = np.array([[1e9, -1e9, 1e9]] * 3)
    assert np.isfinite(predict(data, X, np.array([0.0, 0.1, 0.1]))).all()


def history(data: EstimatorData, X: np.ndarray) -> np.ndarray:
    """Outputs of one history, layer after layer over all of its rows."""
    a = data.arrays
    scaled = (X - a["mean"]) * a["inverse_scale"]
    given = scaled @ a["input_weights"] + a["input_bias"]
    layers = len(a["layer_bias"])
    squares = (np.split(a[name], layers) for name in ("now_weights", "past_weights"))
    for i, (now, past) in enumerate(zip(*squares, strict=True)):
        before = np.vstack([np.zeros((2**i, given.shape[1])), given])[: len(given)]
        given = given + np.maximum(given @ now + before @ past + a["layer_bias"][i], 0.0)
    output = np.hstack([given, scaled]) @ a["output_weights"] + a["output_bias"]
    return a["target_mean"] + a["target_scale"] * output


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 4), st.integers(1, 9), st.integers(1, 5), st.integers(0, 99))
def test_the_row_of_convolutions_is_the_forward_pass(layers, units, n_outputs, seed):
    data = convolved(layers, units=units, n_outputs=n_outputs, seed=seed)
    X = np.random.default_rng(seed).normal(size=(50, K))
    dt = np.where(np.arange(50) % 30 == 0, 0.0, 0.033)
    expected = np.vstack([history(data, X[:30]), history(data, X[30:])])
    np.testing.assert_allclose(predict(data, X, dt), expected, rtol=0, atol=1e-9)


def test_rows_between_are_predicted_as_the_next_that_is_kept_and_leave_no_trace():
    data, X = convolved(), np.random.default_rng(0).normal(size=(60, K))
    dt = np.where(np.arange(60) == 0, 0.0, 0.005)
    found, kept = predict(data, X, dt), X[::4]
    np.testing.assert_allclose(found[::4], history(data, kept), rtol=0, atol=1e-9)
    between = history(data, np.vstack([kept[:8], X[30]]))[-1]  # 7 and a half periods
    np.testing.assert_allclose(found[30], between, rtol=0, atol=1e-9)
