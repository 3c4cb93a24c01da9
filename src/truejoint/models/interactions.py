"""Linear in the inputs and in products of some of them with the first ones: interaction terms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.layout import Memory
from truejoint.models.family import Family, Params, Shape, integer
from truejoint.models.polynomial import MAX_TERMS, linear_shapes, pack_terms, polynomial_row


def interaction_factors(n_features: int, first: int, crossed: int) -> Integers:
    """Features that each term (n_terms, 2) multiplies, filled up with `n_features`.

    Every feature by itself, then each of the first `crossed` times each of the `first`, once.
    """
    alone = [(i, n_features) for i in range(n_features)]
    products = [(i, j) for j in range(first) for i in range(j, crossed)]
    return np.array(alone + products, dtype=np.int64)


def _factors(params: Params, n_features: int) -> Integers:
    first, crossed = int(params["first"]), int(params["crossed"])
    if not first <= crossed <= n_features or first * crossed > MAX_TERMS:
        raise CalibrationError(
            f"interactions of the first {crossed} features with {first} are asked for; it must be "
            f"at most {n_features}, as many or more than those, and {MAX_TERMS} products"
        )
    return interaction_factors(n_features, first, crossed)


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    return linear_shapes(n_features, len(_factors(params, n_features)), n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, _n: int) -> Memory:
    return pack_terms(arrays, _factors(params, n_features))


FAMILY: Final = Family(
    "interactions",
    rules={"first": integer(0, MAX_TERMS), "crossed": integer(0, MAX_TERMS)},
    shapes=_shapes,
    pack=_pack,
    row=polynomial_row,
)
