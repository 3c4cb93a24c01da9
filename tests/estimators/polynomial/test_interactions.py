"""Interaction terms: which there are, and what they give."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData, evaluate
from truejoint.estimators.polynomial.run import FAMILY, interaction_factors

RIDGE = {"degree": 2, "ridge": True}


def test_each_product_of_crossed_and_first_features_is_there_once():
    factors = interaction_factors(4, 2, 3).tolist()
    assert factors == [[0, 4], [1, 4], [2, 4], [3, 4], [0, 0], [1, 0], [2, 0], [1, 1], [2, 1]]
    assert interaction_factors(2, 0, 0).tolist() == [[0, 2], [1, 2]]
    cubes = interaction_factors(3, 1, 2, 1).tolist()
    few = interaction_factors(3, 1, 2, 1, 1).tolist()
    assert few == cubes[:-1]
    assert cubes == [[0, 3, 3], [1, 3, 3], [2, 3, 3], [0, 0, 3], [1, 0, 3], [0, 0, 0], [1, 0, 0]]


def test_a_row_is_linear_in_the_scaled_features_and_their_products():
    rng = np.random.default_rng(0)
    shapes = FAMILY.shapes({**RIDGE, "first": 1, "crossed": 2, "squared": 0, "by_squares": 0}, 3, 2)
    arrays = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    X = rng.normal(size=(20, 3))
    data = EstimatorData(
        "polynomial", {**RIDGE, "first": 1, "crossed": 2, "squared": 0, "by_squares": 0}, arrays
    )
    found = evaluate(FAMILY, FAMILY.memory(data, 3, 2), X, np.zeros(20), 2)
    a, b, c = ((X - arrays["mean"]) * arrays["inverse_scale"]).T
    terms = np.column_stack([a, b, c, a * a, a * b])
    np.testing.assert_allclose(found, terms @ arrays["coef"] + arrays["intercept"], rtol=1e-12)


def test_squares_multiply_too():
    rng = np.random.default_rng(1)
    params = {**RIDGE, "first": 1, "crossed": 2, "squared": 1, "by_squares": 2}
    arrays = {name: rng.normal(size=shape) for name, shape in FAMILY.shapes(params, 2, 1).items()}
    X = rng.normal(size=(20, 2))
    memory = FAMILY.memory(EstimatorData("polynomial", params, arrays), 2, 1)
    found = evaluate(FAMILY, memory, X, np.zeros(20), 1)
    a, b = ((X - arrays["mean"]) * arrays["inverse_scale"]).T
    terms = np.column_stack([a, b, a * a, a * b, a * a * a, b * a * a])
    np.testing.assert_allclose(found, terms @ arrays["coef"] + arrays["intercept"], rtol=1e-12)


@pytest.mark.parametrize(("first", "crossed"), [(2, 1), (1, 4), (4000, 4000)])
def test_more_than_there_are_is_refused(first, crossed):
    with pytest.raises(CalibrationError, match=f"first {crossed} features with {first}"):
        FAMILY.shapes(
            {**RIDGE, "first": first, "crossed": crossed, "squared": 0, "by_squares": 0}, 3, 1
        )
