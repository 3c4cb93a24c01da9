"""Polynomials of the features, of which a linear model is the simplest: peng2024, II-C."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations_with_replacement
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Params, Shape, integer
from truejoint.estimators.products import layer, padded, standardise
from truejoint.layout import Layout, Memory

MAX_DEGREE: Final = 5
MAX_TERMS: Final = 4000
"""Most terms of a polynomial: 88 features at degree 2."""

LAYOUT: Final = Layout()
LAYOUT.array("mean", "of each feature in training", "n_features")
LAYOUT.array("inverse_scale", "of each feature; 0 where it is not used", "n_features")
LAYOUT.array("intercept", "of each output", "columns")
LAYOUT.array("coef", "of each term, a row each", "n_terms", "columns")
LAYOUT.integers(
    "factors", "features that each term multiplies; k stands for 1", "n_terms", "degree"
)
LAYOUT.array("scaled", "features, then 1", "n_scaled")
LAYOUT.array("terms", "of one row", "n_terms")
LAYOUT.array("total", "of one row", "columns")
unpack = LAYOUT.unpacker()


@compiled
def polynomial_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict a polynomial of the scaled features."""
    m = unpack(numbers, memory)
    standardise(x, m.mean, m.inverse_scale, m.scaled)
    terms = m.scaled
    if m.degree > 1:
        terms = m.terms
        multiply(m.factors, m.scaled, terms)
    layer(terms, m.coef, m.intercept, m.total)
    copy(m.total, out, out.shape[0])


@compiled
def multiply(factors: Integers, scaled: Array, terms: Array) -> None:
    """Multiply, for each of the `terms` (n_terms,), its `factors` (n_terms, degree)."""
    for i in range(factors.shape[0]):
        product = scaled[factors[i, 0]]
        for j in range(1, factors.shape[1]):
            product *= scaled[factors[i, j]]
        terms[i] = product


def count_terms(n_features: int, degree: int) -> int:
    """Count the products of 1 to `degree` of `n_features` features."""
    return math.comb(n_features + degree, degree) - 1


def polynomial_factors(n_features: int, degree: int) -> Integers:
    """Features that each term multiplies (n_terms, degree), filled up with `n_features`."""
    terms = [
        (*term, *(n_features,) * (degree - order))
        for order in range(1, degree + 1)
        for term in combinations_with_replacement(range(n_features), order)
    ]
    return np.array(terms, dtype=np.int64).reshape(-1, degree)


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    degree = int(params["degree"])
    n_terms = count_terms(n_features, degree)
    if n_terms > MAX_TERMS:
        raise CalibrationError(
            f"a polynomial of degree {degree} in {n_features} features has {n_terms} "
            f"terms, more than {MAX_TERMS}; choose fewer features"
        )
    return linear_shapes(n_features, n_terms, n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, _n: int) -> Memory:
    return pack_terms(arrays, polynomial_factors(n_features, int(params["degree"])))


def linear_shapes(n_features: int, n_terms: int, n_outputs: int) -> dict[str, Shape]:
    """Shapes of the arrays of a model that is linear in `n_terms` products of features."""
    return {
        "mean": (n_features,),
        "inverse_scale": (n_features,),
        "coef": (n_terms, n_outputs),
        "intercept": (n_outputs,),
    }


def pack_terms(arrays: Mapping[str, Array], factors: Integers) -> Memory:
    """Memory of the row for the arrays of `linear_shapes` and `factors` (n_terms, degree)."""
    coef = padded(arrays["coef"])
    return LAYOUT.pack(
        **{**arrays, "coef": coef, "intercept": padded(arrays["intercept"][None])[0]},
        factors=factors,
        scaled=np.append(np.zeros(len(arrays["mean"])), 1.0),
        terms=np.zeros(len(factors)),
        total=np.zeros(coef.shape[1]),
    )


FAMILY: Final = Family(
    "polynomial",
    rules={"degree": integer(1, MAX_DEGREE)},
    shapes=_shapes,
    pack=_pack,
    row=polynomial_row,
)
