"""The ridge: its products, penalties chosen on what is left out, rows far off, what is refused."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn import linear_model
from sklearn.linear_model import Ridge
from sklearn.preprocessing import StandardScaler

from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData, evaluate
from truejoint.estimators.polynomial.learn import (
    BLOCKS,
    PENALTIES,
    Polynomial,
    cross_validated,
    levels,
)
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
    cubes = interaction_factors(3, 1, 2, 1, 2).tolist()
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


def table(seed: int = 0, n: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Terms (n, 4), two of them alike, and two outputs: one they tell, one they hardly do."""
    rng = np.random.default_rng(seed)
    terms = rng.normal(size=(n, 4)) * [1.0, 3.0, 0.1, 1.0] + 2.0
    terms[:, 3] = terms[:, 0] + 0.01 * terms[:, 3]
    outputs = np.column_stack([terms[:, 0] - terms[:, 1], 0.05 * terms[:, 2]])
    return terms, outputs + rng.normal(size=(n, 2)) * [0.1, 1.0]


def test_it_is_the_ridge_regression_that_errs_least_on_the_blocks():
    terms, outputs = table()
    blocks = np.array_split(np.arange(len(terms)), 3)
    sums = np.column_stack([np.ones(len(terms)), terms, outputs])
    products = np.array([sums[rows].T @ sums[rows] for rows in blocks])
    weights = [np.array([1.0, 1.0, 0.3, 1.0]), np.array([1.0, 1.0, 0.0, 1.0])]
    found = cross_validated(products, weights)

    def errs(own: np.ndarray, penalty: float) -> np.ndarray:
        left = np.zeros(2)
        for hidden in blocks:
            seen = np.setdiff1d(np.arange(len(terms)), hidden)
            scaler = StandardScaler().fit(terms[seen])
            model = Ridge(penalty * len(seen)).fit(scaler.transform(terms[seen]) * own,
                                                   outputs[seen])  # fmt: skip
            predicted = model.predict(scaler.transform(terms[hidden]) * own)
            left += ((outputs[hidden] - predicted) ** 2).sum(axis=0)
        return left

    every = np.array([[errs(own, penalty) for penalty in PENALTIES] for own in weights])
    np.testing.assert_allclose(found.errors, every.min(axis=(0, 1)))
    for j in range(2):
        own, penalty = np.unravel_index(every[..., j].argmin(), every.shape[:2])
        assert (found.weights[j], found.penalties[j]) == (own, PENALTIES[penalty])
    chosen = weights[found.weights[0]]
    scaler = StandardScaler().fit(terms)
    whole = Ridge(found.penalties[0] * len(terms))
    whole.fit(scaler.transform(terms) * chosen, outputs[:, 0])
    predicted = np.column_stack([np.ones(len(terms)), terms]) @ found.coefficients[:, 0]
    np.testing.assert_allclose(predicted, whole.predict(scaler.transform(terms) * chosen))


def test_what_lies_together_is_left_out_together():
    loads = np.repeat([0.4, 0.1, 0.7], [4, 5, 5])
    noisy = loads + 0.05 * np.random.default_rng(0).uniform(-1.0, 1.0, 14)
    assert [set(loads[part]) for part in levels(noisy)] == [{0.1}, {0.4}, {0.7}]
    assert [set(loads[part]) for part in levels(loads)] == [{0.1}, {0.4}, {0.7}]


def test_many_levels_are_left_out_by_neighbours():
    loads = np.repeat(np.arange(10.0), 4)
    found = levels(loads + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, 40))
    assert [sorted(set(loads[part])) for part in found] == [[k, k + 1.0] for k in range(0, 10, 2)]


@pytest.mark.parametrize(
    "values",
    [np.array([0.0, 1.0, 50.0, 50.1, 50.2, 50.3, 50.4, 50.5]), np.arange(8.0), np.zeros(8)],
)
def test_what_makes_no_levels_is_left_out_by_size(values):
    found = levels(values)
    assert np.concatenate(found).tolist() == list(range(len(values)))
    assert {len(part) for part in found} == {1, 2}


@given(arrays(float, st.integers(1, 30), elements=st.floats(-1e3, 1e3)))
def test_all_are_left_out_once(values):
    found = levels(values)
    assert sorted(np.concatenate(found).tolist()) == list(range(len(values)))
    assert len(found) <= BLOCKS
    assert all(values[a].max() <= values[b].min() for a, b in pairwise(found))
