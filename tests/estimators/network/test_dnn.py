"""The network's loss, its gradient and its training against independent computations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit
from sklearn.neural_network import MLPRegressor

from truejoint.errors import CalibrationError
from truejoint.estimators import NeuralNetwork
from truejoint.estimators.network.learn import EPSILON, Layers, effective_batch, loss_and_gradient

SIZES = (4, 6, 5, 3)


def problem(n: int, seed: int = 0) -> tuple[Layers, np.ndarray, np.ndarray]:
    rng = np.random.RandomState(seed)
    layers = Layers(SIZES, np.float64).drawn(rng)
    layers.flat[:] += rng.normal(0, 0.3, layers.flat.shape)
    return layers, rng.normal(size=(n, 4)), rng.normal(size=(n, 3))


def forward(layers: Layers, X: np.ndarray) -> np.ndarray:
    """Output computed on its own, unit by unit."""
    a = X
    for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        z = np.einsum("ni,iu->nu", a, weight) + bias
        a = z if i == len(layers.weights) - 1 else expit(z)
    return a


def keras_loss(layers: Layers, X: np.ndarray, y: np.ndarray, decay: float) -> float:
    penalty = sum(float((weight**2).sum()) for weight in layers.weights)
    return float(((forward(layers, X) - y) ** 2).mean()) + decay * penalty


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 40), st.floats(0.0, 0.1), st.integers(0, 100))
def test_gradient_is_the_slope_of_the_loss(n, decay, seed):
    layers, X, y = problem(n, seed)
    gradient = Layers(SIZES, np.float64)
    loss = loss_and_gradient(layers, X, y, decay, gradient)
    assert loss == pytest.approx(keras_loss(layers, X, y, decay), rel=1e-12)
    for i in range(0, layers.flat.size, 7):
        start, sides = layers.flat[i], []
        for h in (1e-5, -1e-5):
            layers.flat[i] = start + h
            sides.append(keras_loss(layers, X, y, decay))
        layers.flat[i] = start
        assert gradient.flat[i] == pytest.approx((sides[0] - sides[1]) / 2e-5, abs=1e-8, rel=1e-6)


def test_an_unknown_target_counts_as_one_that_is_met():
    layers, X, y = problem(20)
    met, unknown = y.copy(), y.copy()
    met[:5, 1], unknown[:5, 1] = forward(layers, X)[:5, 1], np.nan
    expected, found = (Layers(SIZES, np.float64) for _ in range(2))
    loss = loss_and_gradient(layers, X, met, 0.01, expected)
    assert loss_and_gradient(layers, X, unknown, 0.01, found) == pytest.approx(loss, rel=1e-12)
    np.testing.assert_allclose(found.flat, expected.flat, atol=1e-12)


@pytest.mark.parametrize("n", [64, 70])
def test_training_is_that_of_scikit_learn(n):
    """Same start, same order of rows, converted penalty and epsilon: the same weights."""
    layers, X, y = problem(n)
    batch, decay, epochs = 16, 0.01, 12
    theirs = MLPRegressor(
        hidden_layer_sizes=SIZES[1:-1], activation="logistic", alpha=decay * 3 * batch,
        batch_size=batch, shuffle=False, learning_rate_init=1e-2, epsilon=1.5 * EPSILON,
        random_state=0, n_iter_no_change=10**6,
    )  # fmt: skip
    theirs.partial_fit(X[:batch], y[:batch])  # to have the arrays; start and optimiser are set anew
    for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        theirs.coefs_[i][:], theirs.intercepts_[i][:] = weight, bias
    del theirs._optimizer
    whole = n - n % batch
    for _ in range(epochs):
        theirs.set_params(alpha=decay * 3 * batch, batch_size=batch)
        theirs.partial_fit(X[:whole], y[:whole])
        if whole < n:  # alpha depends on the rows of a batch, so the last one has its own
            theirs.set_params(alpha=decay * 3 * (n - whole), batch_size=n - whole)
            theirs.partial_fit(X[whole:], y[whole:])
    _train(layers, X, y, batch, decay, epochs)
    for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        np.testing.assert_allclose(weight, theirs.coefs_[i], atol=1e-9)
        np.testing.assert_allclose(bias, theirs.intercepts_[i], atol=1e-9)


class _InOrder(np.random.RandomState):
    """Leaves rows as they are."""

    def permutation(self, x):
        return np.arange(x)


def _train(layers, X, y, batch, decay, epochs):
    network = NeuralNetwork(weight_decay=decay, learning_rate=1e-2, batch_size=batch)
    list(network.train(layers, X, y, epochs, _InOrder(0)))


def test_network_predicts_its_own_layers_in_double_precision():
    rng = np.random.default_rng(0)
    X, y = rng.normal(2.0, 3.0, (500, 4)), rng.normal(5.0, 0.1, (500, 3))
    model = NeuralNetwork(hidden_layer_sizes=(6, 5), epochs=5).fit(X, y)
    layers = Layers(SIZES, np.float64)
    for i in range(3):
        layers.weights[i][:] = getattr(model, f"weight_{i}_")
        layers.biases[i][:] = getattr(model, f"bias_{i}_")
    scaled = (X - X.mean(axis=0)) / X.std(axis=0)
    expected = y.mean(axis=0) + y.std(axis=0) * forward(layers, scaled)
    np.testing.assert_allclose(model.predict(X), expected, rtol=0, atol=1e-12)


def test_few_rows_get_smaller_batches():
    assert effective_batch(30_000, 1024) == 1024
    assert effective_batch(9_900, 1024) == 1024
    assert effective_batch(4_000, 1024) == 500
    assert effective_batch(40, 1024) == 32
    assert effective_batch(40, 8) == 8


def test_divergence_is_refused():
    layers, X, y = problem(32)
    with (
        pytest.raises(CalibrationError, match="diverged in epoch 1 of 3"),
        np.errstate(all="ignore"),
    ):
        _train(layers, X * 1e200, y * 1e200, 8, 0.0, 3)
