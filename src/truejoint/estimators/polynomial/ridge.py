"""Ridge regression on features and products of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.estimators.base import Arrays, Progress, scaling
from truejoint.estimators.cross_validation import (
    PENALTIES,
    PenalisedFit,
    blocks,
    cross_validated,
    penalised,
)
from truejoint.estimators.family import Family, Params, Rule, number, one_of, optional
from truejoint.estimators.polynomial import interactions
from truejoint.estimators.polynomial.learn import TermsRegressor, polynomial_design

MOST_PRODUCTS: Final = 600
"""Terms that are products, at most."""
SHARES: Final = (0.0, 0.3, 1.0)
"""Sizes tried of terms that are products, beside the others: less is penalised more."""

_CHUNK: Final = 4096  # rows that are held at a time as terms
_FAR: Final = 6.0  # standard deviations, beyond which a row is not fitted to
_NORMAL: Final = 0.6745  # median of a normal error's size, over its standard deviation
_MOST_FAR: Final = 0.05  # share of the rows that may be; more of them are no exceptions
_ROUNDS: Final = 5


@dataclass(eq=False, repr=False)
class Ridge(TermsRegressor):
    """Ridge regression on features and products of them, its penalties cross-validated.

    For each output by itself, a penalty and how much more products are penalised are those of the
    least mean square on five parts of the rows that are left out in turn: blocks on end, or, where
    `dt` tells of fewer than five histories, a block of each.

    Parameters
    ----------
    first : int, optional
        Of the features, by which each of the first `crossed` is multiplied; by default all, or
        none where that makes more than 600 products.
    crossed : int, optional
        Features that are multiplied, `first` or more; by default as many as `first`.
    squared : int, optional
        Of the features, by whose squares they are multiplied too; by default none.
    by_squares : int, optional
        Features that squares multiply; by default as many as `crossed`.
    penalty : float, optional
        On the squared coefficients of terms of variance 1; by default cross-validated.
    trimmed : bool
        Whether it is fitted again without rows in which it errs by more than six standard
        deviations (by the median's size), where these are a twentieth at most. They are left to
        what learns the residual: a roll is ill conditioned where the wrist is bent by a right
        angle, and a few such rows bend the model everywhere.

    Attributes
    ----------
    penalties_ : ndarray, shape (n_outputs,)
        Chosen of `truejoint.estimators.cross_validation.PENALTIES`.
    shares_ : ndarray, shape (n_outputs,)
        Chosen of `SHARES`.
    errors_ : ndarray, shape (n_outputs,)
        Root mean square on the blocks that were left out, in standard deviations of the target.

    Examples
    --------
    >>> X = np.random.default_rng(0).normal(size=(500, 2))
    >>> Ridge().fit(X, X[:, 0] * X[:, 1]).predict([[2.0, 0.5]]).round(2)
    array([1.])
    """

    family: ClassVar[Family] = interactions.FAMILY
    training: ClassVar[Mapping[str, Rule]] = {
        "trimmed": one_of(False, True), "penalty": optional(number(0.0, 1e12))
    }  # fmt: skip
    first: int | None = None
    crossed: int | None = None
    squared: int = 0
    trimmed: bool = False
    by_squares: int | None = None
    penalty: float | None = None

    def model_params(self) -> Params:
        """Parameters of the family: by default, the numbers for what it is fitted to."""
        k = int(vars(self).get("n_features_in_", 0))
        usual = k if k * (k + 1) // 2 <= MOST_PRODUCTS else 0
        first = usual if self.first is None else self.first
        crossed = first if self.crossed is None else self.crossed
        by_squares = crossed if self.by_squares is None else self.by_squares
        sizes = {"first": first, "crossed": crossed, "squared": self.squared}
        return {**sizes, "by_squares": by_squares if self.squared else 0}

    def minimum_rows(self, n_features: int) -> int:
        """Two rows for each input, which the penalty makes enough."""
        return max(100, 2 * n_features)

    def factors(self, n_features: int) -> Integers:
        """Features that each term multiplies (n_terms, 2), or 3 where there are `squared`."""
        return interactions.interaction_factors(n_features, **self.model_params())

    @property
    def _penalties(self) -> tuple[float, ...]:
        return PENALTIES if self.penalty is None else (float(self.penalty),)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        factors = self.factors(X.shape[1])
        scales = scaling(X, y)
        mean, inverse_scale = scales["mean"], scales["inverse_scale"]
        scaled = (X - mean) * inverse_scale
        targets = (y - scales["target_mean"]) / scales["target_scale"]
        products = np.array([_products(scaled[b], targets[b], factors) for b in blocks(dt)])
        is_product = factors[:, 1] < X.shape[1]
        shares = SHARES if is_product.any() and self.penalty is None else SHARES[-1:]
        weights = [np.where(is_product, share, 1.0) for share in shares]
        found = cross_validated(products, weights, progress, self._penalties)
        self.shares_, self.penalties_ = np.array(shares)[found.weights], found.penalties
        self.errors_ = np.sqrt(np.maximum(found.errors, 0.0) / len(X))
        table = found.coefficients
        if self.trimmed:
            own = np.array(weights)[found.weights]
            table = _without_far(scaled, targets, factors, products.sum(axis=0), own, found)
        table = table * scales["target_scale"]
        return {
            "mean": mean,
            "inverse_scale": inverse_scale,
            "coef": np.ascontiguousarray(table[1:]),
            "intercept": table[0] + scales["target_mean"],
        }


def _products(scaled: Array, y: Array, factors: Integers) -> Array:
    """Give sums (m, m) of products of every two of: 1, the terms, the targets."""
    width = 1 + len(factors) + y.shape[1]
    total = np.zeros((width, width))
    for start in range(0, len(scaled), _CHUNK):
        rows = slice(start, start + _CHUNK)
        terms = polynomial_design(scaled[rows], factors)
        table = np.column_stack([np.ones(len(terms)), terms, y[rows]])
        total += table.T @ table
    return total


def _without_far(
    scaled: Array, y: Array, factors: Integers, products: Array, weights: Array, fit: PenalisedFit
) -> Array:
    """Coefficients (1 + n_terms, n_outputs), each output fitted again without rows far off.

    `products` (m, m) are the sums of `_products` over all rows, `weights` (n_outputs, n_terms)
    those of the terms; penalties stay.
    """
    table, n_terms = fit.coefficients.copy(), len(factors)
    before = np.zeros(y.shape, dtype=bool)
    for _ in range(_ROUNDS):
        left = np.abs(y - _linear(scaled, factors, table))
        far = left > _FAR / _NORMAL * np.median(left, axis=0)
        far &= far.mean(axis=0) <= _MOST_FAR
        for j in np.flatnonzero((far != before).any(axis=0)):
            rows = np.flatnonzero(far[:, j])
            kept = products - _products(scaled[rows], y[rows], factors)
            places = [*range(1 + n_terms), 1 + n_terms + j]
            table[:, j] = penalised(kept[np.ix_(places, places)], weights[j], fit.penalties[j])
        if (far == before).all():
            break
        before = far
    return table


def _linear(scaled: Array, factors: Integers, table: Array) -> Array:
    """Values (n, n_outputs) of coefficients (1 + n_terms, n_outputs), the constants first."""
    chunks = (scaled[i : i + _CHUNK] for i in range(0, len(scaled), _CHUNK))
    values = [table[0] + polynomial_design(own, factors) @ table[1:] for own in chunks]
    return np.concatenate(values)
