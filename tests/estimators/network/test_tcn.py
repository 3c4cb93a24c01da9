"""The row of the temporal convolution network against a forward pass computed on its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truejoint.estimators.family import EstimatorData, evaluate
from truejoint.estimators.network.tcn import FAMILY

K = 3
PARAMS = {
    "period": 0.02, "weight_decay": 1.0, "learning_rate": 0.01, "window": 8, "batch_size": 4,
    "epochs": 1, "random_state": 0,
}  # fmt: skip


def fitted(layers: int = 3, units: int = 5, n_outputs: int = 2, seed: int = 0) -> EstimatorData:
    rng = np.random.default_rng(seed)
    params = PARAMS | {"layers": layers, "units": units}
    shapes = FAMILY.shapes(params, K, n_outputs)
    arrays = {name: 0.5 * rng.normal(size=shape) for name, shape in shapes.items()}
    return EstimatorData(FAMILY.name, params, arrays)


def predict(data: EstimatorData, X: np.ndarray, dt: np.ndarray) -> np.ndarray:
    n_outputs = len(data.arrays["output_bias"])
    FAMILY.check(data, K, n_outputs)
    return evaluate(FAMILY, FAMILY.memory(data, K, n_outputs), X, dt, n_outputs)


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
def test_row_is_the_forward_pass(layers, units, n_outputs, seed):
    data = fitted(layers, units, n_outputs, seed)
    X = np.random.default_rng(seed).normal(size=(50, K))
    dt = np.where(np.arange(50) % 30 == 0, 0.0, 0.033)
    expected = np.vstack([history(data, X[:30]), history(data, X[30:])])
    np.testing.assert_allclose(predict(data, X, dt), expected, rtol=0, atol=1e-9)


def test_rows_between_are_predicted_as_the_next_that_is_kept_and_leave_no_trace():
    data, X = fitted(), np.random.default_rng(0).normal(size=(60, K))
    dt = np.where(np.arange(60) == 0, 0.0, 0.005)
    found, kept = predict(data, X, dt), X[::4]
    np.testing.assert_allclose(found[::4], history(data, kept), rtol=0, atol=1e-9)
    between = history(data, np.vstack([kept[:8], X[30]]))[-1]  # 7 and a half periods
    np.testing.assert_allclose(found[30], between, rtol=0, atol=1e-9)


@pytest.mark.parametrize("layers", [1, 4])
def test_it_looks_back_as_far_as_its_layers_and_no_further(layers):
    data, X = fitted(layers), np.random.default_rng(1).normal(size=(40, K))
    dt = np.where(np.arange(40) == 0, 0.0, 0.033)
    other = X.copy()
    other[3] += 1.0
    changed = (predict(data, X, dt) != predict(data, other, dt)).any(axis=1)
    last = np.flatnonzero(changed).max()
    assert last <= 3 + 2**layers - 1
    assert last > 3
