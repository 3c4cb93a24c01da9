"""Penalties chosen on what is left out, and what is left out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.linear_model import Ridge
from sklearn.preprocessing import StandardScaler

from truejoint.estimators.polynomial.learn import BLOCKS, PENALTIES, cross_validated, levels


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
