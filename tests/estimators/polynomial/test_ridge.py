"""The ridge: its products, its penalties, rows that it is not fitted to, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn import linear_model
from sklearn.preprocessing import StandardScaler

from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData, evaluate
from truejoint.estimators.polynomial.learn import PENALTIES, Polynomial
from truejoint.estimators.polynomial.run import FAMILY, interaction_factors


def test_ridge_tells_its_error_on_blocks_that_it_did_not_see():
    rng = np.random.default_rng(1)
    X = rng.normal(size=(1000, 3))
    y = np.column_stack([X[:, 0] + 0.1 * rng.normal(size=1000), rng.normal(size=1000)])
    model = Polynomial(ridge=True).fit(X, y)
    left = []
    for block in np.array_split(np.arange(1000), 5):
        seen = np.setdiff1d(np.arange(1000), block)
        line = Polynomial(1).fit(X[seen], y[seen, 0])
        left.append(line.predict(X[block]) - y[block, 0])
    expected = np.sqrt(np.mean(np.square(left))) / y[:, 0].std()
    np.testing.assert_allclose(model.errors_, [expected, 1.0], rtol=0.02)


def test_without_penalty_ridge_is_least_squares_and_noise_makes_it_larger():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(400, 30))
    noise = rng.normal(size=400)
    y = np.column_stack([X[:, 0] * X[:, 1] + 2.0 * X[:, 3], noise])
    model = Polynomial(ridge=True, first=2, crossed=2).fit(X, y)
    assert model.penalties_.tolist() == [PENALTIES[0], PENALTIES[-1]]
    assert model.shares_[0] == 1.0
    np.testing.assert_allclose(model.predict(X)[:, 0], y[:, 0], atol=1e-5)
    assert np.std(model.predict(X)[:, 1]) < 0.1 * np.std(noise)


def bursts(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features, two outputs, of which one is far off in `count` rows where a feature is large."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(600, 8))
    y = X @ rng.normal(size=(8, 2)) + 0.1 * rng.normal(size=(600, 2))
    off = np.argsort(X[:, 0])[len(X) - count :]
    y[off, 1] += 5.0
    return X, y, np.setdiff1d(np.arange(len(X)), off)


def test_ridge_is_not_fitted_to_a_few_rows_that_are_far_off():
    X, y, kept = bursts(12)
    model = Polynomial(ridge=True, first=0, trimmed=True).fit(X, y)
    every = np.arange(len(X))
    for j, rows in enumerate((every, kept)):
        scaler = StandardScaler().fit(X[rows])
        peer = linear_model.Ridge(len(X[rows]) * model.penalties_[j])
        peer.fit(scaler.transform(X[rows]), y[rows, j])
        expected = peer.predict(scaler.transform(X))
        np.testing.assert_allclose(model.predict(X)[:, j], expected, rtol=0, atol=1e-8)


def test_a_feature_that_only_rows_far_off_have_is_not_learnt():
    X, y, kept = bursts(6)
    X[kept, 1] = 0.0
    model = Polynomial(ridge=True, first=0, trimmed=True).fit(X, y)
    assert model.coef_[1, 1] == 0.0
    assert model.coef_[1, 0] != 0.0


def test_many_rows_that_are_far_off_are_no_exceptions():
    X, y, _ = bursts(60)
    ridge = Polynomial(ridge=True, first=0)
    model, plain = (ridge.set_params(trimmed=t).fit(X, y).predict(X) for t in (True, False))
    np.testing.assert_array_equal(model, plain)


def test_progress_goes_on_to_the_end():
    told: list[float] = []
    X, y, _ = bursts(0)
    Polynomial(ridge=True, first=2, crossed=2).fit(X, y, told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_what_is_no_number_of_features_is_refused():
    X = np.random.default_rng(0).normal(size=(200, 2))
    for name in ("first", "crossed", "squared"):
        with pytest.raises(CalibrationError, match=f"{name} is 'two'; it must be an integer"):
            Polynomial(ridge=True, **{name: "two"}).fit(X, X[:, 0])


RIDGE = {"degree": 2, "ridge": True, "squared": 0, "by_squares": 0}


def test_each_product_of_crossed_and_first_features_is_there_once():
    factors = interaction_factors(4, 2, 3).tolist()
    assert factors == [[0, 4], [1, 4], [2, 4], [3, 4], [0, 0], [1, 0], [2, 0], [1, 1], [2, 1]]
    assert interaction_factors(2, 0, 0).tolist() == [[0, 2], [1, 2]]
    cubes = interaction_factors(3, 1, 2, 1).tolist()
    few = interaction_factors(3, 1, 2, 1, 1).tolist()
    assert few == cubes[:-1]
    assert cubes == [[0, 3, 3], [1, 3, 3], [2, 3, 3], [0, 0, 3], [1, 0, 3], [0, 0, 0], [1, 0, 0]]


@pytest.mark.parametrize("squared", [0, 1])
def test_a_row_is_linear_in_the_scaled_features_and_their_products(squared):
    rng, n_outputs = np.random.default_rng(squared), 2
    params = {**RIDGE, "first": 1, "crossed": 2, "squared": squared, "by_squares": 2 * squared}
    shapes = FAMILY.shapes(params, 3, n_outputs)
    arrays = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    X = rng.normal(size=(20, 3))
    memory = FAMILY.memory(EstimatorData("polynomial", params, arrays), 3, n_outputs)
    a, b, c = ((X - arrays["mean"]) * arrays["inverse_scale"]).T
    terms = np.column_stack([a, b, c, a * a, a * b, *[a * a * a, b * a * a][: 2 * squared]])
    expected = terms @ arrays["coef"] + arrays["intercept"]
    found = evaluate(FAMILY, memory, X, np.zeros(20), n_outputs)
    np.testing.assert_allclose(found, expected, rtol=1e-11)


@pytest.mark.parametrize(("first", "crossed"), [(2, 1), (1, 4), (4000, 4000)])
def test_more_than_there_are_is_refused(first, crossed):
    with pytest.raises(CalibrationError, match=f"first {crossed} features with {first}"):
        FAMILY.shapes({**RIDGE, "first": first, "crossed": crossed}, 3, 1)
