"""Each estimator keeps scikit-learn's contract and ours."""

from unittest.mock import patch

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.preprocessing import PolynomialFeatures
from sklearn.utils.estimator_checks import parametrize_with_checks
from tests.refusals import refused

from truejoint.estimators import (
    JointRegressor,
    NeuralNetwork,
    Polynomial,
    estimator_names,
    get_estimator,
    registry,
)
from truejoint.estimators.base import shared_fits

QUICK = [
    Polynomial(0),
    Polynomial(1),
    Polynomial(),
    Polynomial(degree=3),
    NeuralNetwork(hidden_layer_sizes=(7,), epochs=20),
    NeuralNetwork(hidden_layer_sizes=(6, 5, 4), epochs=3),
]
KEY = str


def of_rows_alone() -> list[JointRegressor]:
    """One registered estimator of each class that takes any features, and each row by itself."""
    known = [get_estimator(name) for name in reversed(estimator_names())]
    free = [e for e in known if not e.family.remembers and e.family.inputs is None]
    for estimator in free:
        small = {"hidden_layer_sizes": (20,), "epochs": 60, "points": 60}
        estimator.set_params(**{k: v for k, v in small.items() if k in estimator.get_params()})
    return list({type(estimator): estimator for estimator in free}.values())


@pytest.mark.parametrize("estimator", QUICK, ids=KEY)
def test_an_unknown_value_leaves_the_others_of_its_row(estimator: JointRegressor) -> None:
    assert estimator.partial
    rng = np.random.default_rng(0)
    X = rng.normal(size=(400, 3))
    y = np.column_stack([X @ [1.0, 2.0, 0.0], 1.0 + X[:, 0]]) + 0.1 * rng.normal(size=(400, 2))
    partly = y.copy()
    partly[::7, 0] = np.nan
    both, known = clone(estimator).fit(X, partly).predict(X), ~np.isnan(partly[:, 0])
    assert np.isfinite(both).all()
    if not isinstance(estimator, NeuralNetwork):  # whose outputs share hidden units
        first = clone(estimator).fit(X[known], y[known, :1]).predict(X)
        second = clone(estimator).fit(X, y[:, 1:]).predict(X)
        np.testing.assert_allclose(both, np.hstack([first, second]), atol=1e-9)
    refused("known in no row", clone(estimator).fit, X, np.full((400, 2), np.nan))


@parametrize_with_checks(of_rows_alone())
def test_scikit_learn_contract(estimator, check):
    with patch.dict(registry.BOOSTED, max_iter=20):
        check(estimator)


@pytest.fixture
def data():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 4)) * [1.0, 1e-3, 50.0, 1.0] + [0.0, 7.0, -100.0, 1.0]
    y = np.column_stack([X[:, 0] - 0.02 * X[:, 2], X[:, 0] ** 2, np.full(300, 3.0)])
    return X, y + rng.normal(0, 0.01, y.shape)


@pytest.mark.parametrize("estimator", QUICK, ids=KEY)
def test_constant_feature_has_no_weight(estimator, data):
    X, y = data
    X = np.column_stack([X, np.full(len(X), 0.1)])
    fitted = clone(estimator).fit(X, y)
    moved = X.copy()
    moved[:, 4] = 1e6
    assert np.isfinite(fitted.predict(X)).all()
    assert fitted.predict(moved).tobytes() == fitted.predict(X).tobytes()


@pytest.mark.parametrize("estimator", QUICK, ids=KEY)
def test_progress_ends_at_one(estimator, data):
    seen: list[float] = []
    clone(estimator).fit(*data, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_polynomial_is_the_least_squares_solution(degree, data):
    X, y = data
    scaled = (X - X.mean(axis=0)) / X.std(axis=0)
    design = PolynomialFeatures(degree).fit_transform(scaled)
    expected = design @ np.linalg.lstsq(design, y, rcond=None)[0]
    np.testing.assert_allclose(Polynomial(degree).fit(X, y).predict(X), expected, atol=1e-9)


def test_blocks_of_rows_do_not_change_the_fit(monkeypatch, data):
    X, y = data
    whole = Polynomial().fit(X, y)
    monkeypatch.setattr("truejoint.estimators.polynomial.learn._BLOCK", 17)
    np.testing.assert_allclose(Polynomial().fit(X, y).coef_, whole.coef_, atol=1e-10)


def test_copies_of_a_feature_share_its_weight(data):
    X, y = data
    twice = np.column_stack([X, 3.0 * X[:, 0] + 2.0])
    model = Polynomial(1).fit(twice, y)
    np.testing.assert_allclose(model.predict(twice), Polynomial(1).fit(X, y).predict(X))
    np.testing.assert_allclose(model.coef_[0], model.coef_[4], rtol=1e-6)


def test_fewer_rows_than_terms_still_interpolate():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(6, 4)), rng.normal(size=6)
    np.testing.assert_allclose(Polynomial().fit(X, y).predict(X), y, atol=1e-9)


def test_too_many_terms_are_refused():
    rng = np.random.default_rng(0)
    refused("more than 4000", Polynomial().fit, rng.normal(size=(10, 100)), np.arange(10.0))


def test_what_was_fitted_to_the_same_rows_is_not_fitted_again(monkeypatch):
    X, learn, learnt = np.linspace(-1.0, 1.0, 200)[:, None], Polynomial._learn, []
    monkeypatch.setattr(
        Polynomial, "_learn", lambda self, *rows: learnt.append(self.degree) or learn(self, *rows)
    )
    for degree, y in ((2, X[:, 0] ** 2), (2, X[:, 0] ** 2), (2, X**2), (1, X**2), (2, X)):
        apart = Polynomial(degree).fit(X, y).predict(X)
        with shared_fits():
            _, again = (Polynomial(degree).fit(X, y) for _ in range(2))
        np.testing.assert_array_equal(again.predict(X), apart)
    assert learnt == [2] * 6 + [1] * 2 + [2] * 2
    with shared_fits():
        shapes = [Polynomial(2).fit(X, y).predict(X).shape for y in (X[:, 0], X)]
    assert shapes == [(200,), (200, 1)]
