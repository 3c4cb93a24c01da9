"""Linear in the inputs and in products of some of them with the first ones: interaction terms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Params, Shape, integer
from truejoint.estimators.polynomial.run import MAX_TERMS, linear_shapes, pack_terms, polynomial_row
from truejoint.layout import Memory

_PARAMETERS: Final = "first", "crossed", "squared", "by_squares"


def interaction_factors(
    n_features: int, first: int, crossed: int, squared: int = 0, by_squares: int | None = None
) -> Integers:
    """Features that each term (n_terms, 2 or 3) multiplies, filled up with `n_features`.

    Every feature by itself, then each of the first `crossed` times each of the `first`, once. Then
    each of the first `by_squares`, by default `crossed`, times the square of each of the first
    `squared`.
    """
    alone = [(i, n_features) for i in range(n_features)]
    products = [(i, j) for j in range(first) for i in range(j, crossed)]
    factors = np.array(alone + products, dtype=np.int64)
    if not squared:
        return factors
    filled = np.column_stack([factors, np.full(len(factors), n_features)])
    cubes = [(i, j, j) for j in range(squared)
             for i in range(crossed if by_squares is None else by_squares)]  # fmt: skip
    return np.vstack([filled, np.array(cubes, dtype=np.int64)])


def _factors(params: Params, n_features: int) -> Integers:
    first, crossed, squared, by_squares = (int(params[name]) for name in _PARAMETERS)
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
    return linear_shapes(n_features, len(_factors(params, n_features)), n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, _n: int) -> Memory:
    return pack_terms(arrays, _factors(params, n_features))


FAMILY: Final = Family(
    "polynomial.interactions",
    rules={name: integer(0, MAX_TERMS) for name in _PARAMETERS},
    shapes=_shapes,
    pack=_pack,
    row=polynomial_row,
)
