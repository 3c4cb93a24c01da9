"""Polynomials of the features, from a constant on (peng2024, II-C), and chosen products."""

import math
from collections.abc import Iterable, Mapping
from itertools import combinations_with_replacement
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Shape
from truejoint.estimators.rules import Params, integer, one_of
from truejoint.layout import Layout, Memory
from truejoint.products import layer, padded, standardise

MAX_DEGREE: Final = 5
MAX_TERMS: Final = 4000
"""Most terms of a polynomial: 88 features at degree 2."""
INTERACTIONS: Final = "first", "crossed", "squared", "by_squares"
"""Parameters of the products of a ridge regression, see `interaction_factors`."""

LAYOUT: Final = Layout().declare(__package__, "polynomial")
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
        for i in range(m.factors.shape[0]):
            product = m.scaled[m.factors[i, 0]]
            for j in range(1, m.factors.shape[1]):
                product *= m.scaled[m.factors[i, j]]
            terms[i] = product
    layer(terms, m.coef, m.intercept, m.total)
    copy(m.total, out, out.shape[0])


def polynomial_factors(n_features: int, degree: int) -> Integers:
    """Features that each term multiplies (n_terms, degree), filled up with `n_features`."""
    orders = range(1, degree + 1)
    terms = [t for order in orders for t in combinations_with_replacement(range(n_features), order)]
    return _filled(terms, degree, n_features)


def interaction_factors(
    n_features: int, first: int, crossed: int, squared: int = 0, by_squares: int = 0
) -> Integers:
    """Features that each term (n_terms, 2 or 3) multiplies, filled up with `n_features`.

    Every feature by itself, then each of the first `crossed` times each of the `first`, once. Then
    each of the first `by_squares` times the square of each of the first `squared`.
    """
    alone = [(i,) for i in range(n_features)]
    products = [(i, j) for j in range(first) for i in range(j, crossed)]
    cubes = [(i, j, j) for j in range(squared) for i in range(by_squares)]
    return _filled([*alone, *products, *cubes], 3 if squared else 2, n_features)


def _filled(terms: Iterable[tuple[int, ...]], order: int, n_features: int) -> Integers:
    rows = [(*term, *(n_features,) * (order - len(term))) for term in terms]
    return np.array(rows, dtype=np.int64).reshape(-1, order)


def of_degree(degree: int) -> Params:
    """Give the parameters of a polynomial of all products up to a degree."""
    return {"degree": degree, "ridge": False, **dict.fromkeys(INTERACTIONS, 0)}


def factors_of(params: Params, n_features: int) -> Integers:
    """Features that each term multiplies (n_terms, order), `n_features` for none.

    Raises CalibrationError for more terms than there may be, or products of features not there.
    """
    if not params["ridge"]:
        degree = int(params["degree"])
        n_terms = math.comb(n_features + degree, degree) - 1
        if n_terms > MAX_TERMS:
            raise CalibrationError(
                f"a polynomial of degree {degree} in {n_features} features has {n_terms} "
                f"terms, more than {MAX_TERMS}; choose fewer features"
            )
        return polynomial_factors(n_features, max(degree, 1))[:n_terms]
    first, crossed, squared, by_squares = (int(params[name]) for name in INTERACTIONS)
    n_products = first * crossed + squared * by_squares
    fits = max(first, squared, by_squares) <= crossed <= n_features
    if not fits or n_products > MAX_TERMS:
        raise CalibrationError(
            f"interactions of the first {crossed} features with {first}, and the squares of "
            f"{squared}, are asked for; it must be at most {n_features}, as many or more than "
            f"those, and {MAX_TERMS} products"
        )
    return interaction_factors(n_features, first, crossed, squared, by_squares)


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    return {
        "mean": (n_features,),
        "inverse_scale": (n_features,),
        "coef": (len(factors_of(params, n_features)), n_outputs),
        "intercept": (n_outputs,),
    }


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, _n: int) -> Memory:
    factors, coef = factors_of(params, n_features), padded(arrays["coef"])
    return LAYOUT.pack(
        **{**arrays, "coef": coef, "intercept": padded(arrays["intercept"])},
        factors=factors,
        scaled=np.append(np.zeros(n_features), 1.0),
    )


FAMILY: Final = Family(
    "polynomial",
    rules={
        "degree": integer(0, MAX_DEGREE),
        "ridge": one_of(False, True),
        **{name: integer(0, MAX_TERMS) for name in INTERACTIONS},
    },
    shapes=_shapes,
    pack=_pack,
    row=polynomial_row,
    # A constant is the offset of an error.
    specialise=lambda params: (
        {} if params["degree"] or params["ridge"] else {"targets": ("error",)}
    ),
)
