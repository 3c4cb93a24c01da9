"""The Gaussian process: its likelihood, its kernel, and what it does far from its rows."""

import numpy as np
import pytest
from scipy.optimize import check_grad
from scipy.stats import multivariate_normal
from sklearn.base import clone
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from truejoint.estimators.gp import learn as gaussian_process
from truejoint.estimators.gp.learn import GaussianProcess, Kernel, likeliest_kernel, unlikelihood
from truejoint.estimators.gp.run import to_bells


def waves(n: int = 150, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, 3) of which the last tells nothing, and a target that is not linear in them."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(n, 3))
    y = np.sin(2.0 * X[:, 0]) + 0.3 * X[:, 1] ** 2
    return X, (y - y.mean()) / y.std() + noise * rng.normal(size=n)


def test_lengths_tell_which_features_matter_and_the_noise_is_found():
    found = likeliest_kernel(*waves(), np.zeros(150))
    first, second, idle = found.inverse_lengths
    assert first > second > 10.0 * idle
    assert 1e-4 < found.noise < 0.05
    assert found.zero == 0.0


def histories(zeros: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of one curve in histories of as many zeros, in which they are in other places of it."""
    X = np.concatenate([np.linspace(k, k + 4.0, 60) for k in range(len(zeros))])[:, None]
    dt = np.where(np.arange(len(X)) % 60 == 0, 0.0, 1.0)
    noise = np.random.default_rng(1).normal(0.0, 0.02, len(X))
    return X, np.sin(X[:, 0]) + np.repeat(zeros, 60) + noise, dt


def test_the_likelihood_is_that_of_the_normal_distribution_and_has_its_gradient():
    """Without zeros of histories, and with them."""
    X, y = waves(40)
    together = np.equal.outer(np.arange(40) // 10, np.arange(40) // 10).astype(float)
    kernel = ConstantKernel(1.3) * RBF([0.7, 2.0, 30.0])
    for zeros, extra in (((), ()), ((0.4,), (together,))):
        theta = np.log([0.7, 2.0, 30.0, 1.3, 0.02, *zeros])
        covariance = kernel(X) + 0.02 * np.eye(40) + sum(zeros) * together
        value = unlikelihood(theta, X, y, *extra)[0]
        assert value == pytest.approx(-multivariate_normal(cov=covariance).logpdf(y), rel=1e-9)
        pair = (lambda t, k=k, e=extra: unlikelihood(t, X, y, *e)[k] for k in (0, 1))
        assert check_grad(*pair, theta) < 1e-3


def test_it_predicts_what_is_common_to_the_histories():
    """The mean of the exact process whose kernel has a part of each history, without that part."""
    X, y, dt = histories([0.4, -0.3, 0.1, -0.2])
    X, y = np.column_stack([X, np.sin(3.0 * X)]), np.column_stack([y, y + 2.0 * np.cos(X[:, 0])])
    model = GaussianProcess(points=len(X)).fit(X, y, dt=dt)
    scaled, history = (X - X.mean(axis=0)) / X.std(axis=0), np.cumsum(dt == 0.0)
    together = np.equal.outer(history, history)
    for j, column in enumerate(y.T):
        target = (column - column.mean()) / column.std()
        found = likeliest_kernel(scaled, target, history)
        bells = RBF(1.0)(scaled * found.inverse_lengths)
        covariance = bells + found.noise * np.eye(len(X)) + found.zero * together
        expected = column.mean() + column.std() * bells @ np.linalg.solve(covariance, target)
        np.testing.assert_allclose(model.predict(X)[:, j], expected, atol=1e-3)


def test_zeros_of_histories_do_not_bend_what_is_learnt():
    X, y, dt = histories([0.4, -0.3, 0.1, -0.2])
    between = np.linspace(1.0, 6.0, 101)

    def bent(model: GaussianProcess) -> float:
        return float(np.std(model.predict(between[:, None]) - np.sin(between)))

    model = GaussianProcess(points=60)
    told, untold = bent(clone(model).fit(X, y, dt=dt)), bent(clone(model).fit(X, y))
    assert told < 0.06
    assert told < 0.5 * untold


@pytest.mark.parametrize("width", [1e-2, 1e-3])
def test_bells_of_which_the_zeros_take_nearly_all_are_fitted(monkeypatch, width):
    """What is nearly a line, with histories of their own zeros: the normal equations cancel."""
    kernel = Kernel(np.full(2, width), noise=1e-9, zero=1e-2)
    monkeypatch.setattr(gaussian_process, "likeliest_kernel", lambda *_: kernel)
    X = np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 2))
    dt = np.where(np.arange(len(X)) % 500, 0.01, 0.0)
    model = GaussianProcess(points=200).fit(X, X[:, 0], dt=dt)
    assert np.std(model.predict(X) - X[:, 0]) < 1e-3 * np.std(X[:, 0])


def test_a_bell_is_the_exponential_and_ends_at_nothing():
    squares = np.concatenate([np.linspace(0.0, 90.0, 10_001), [1e3, 1e300, np.inf]])
    bells = squares.copy()
    to_bells(bells)
    np.testing.assert_allclose(bells, np.exp(-0.5 * squares), rtol=0.0, atol=1e-15)
    assert bells[0] == 1.0
    assert (bells >= 0.0).all()
    assert (bells[squares >= 80.0] == 0.0).all()


def test_a_feature_that_never_changes_is_not_learnt_of_and_far_away_the_mean_is_predicted():
    X, y = waves()
    X = np.column_stack([X, np.full(len(X), 3.0)])
    model = GaussianProcess(points=50).fit(X, y)
    moved = X + np.array([0.0, 0.0, 0.0, 5.0])
    np.testing.assert_array_equal(model.predict(X), model.predict(moved))
    np.testing.assert_allclose(model.predict(X + 1e4), y.mean(), atol=1e-9)
    constant = GaussianProcess(points=20).fit(np.ones((150, 2)), y)
    np.testing.assert_allclose(constant.predict(np.ones((1, 2))), y.mean(), atol=0.1)
