"""Fixed offset, linear and polynomial regression (peng2024, II-C), and ridge regression."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truejoint.array_types import Array, Integers
from truejoint.estimators import registry
from truejoint.estimators.base import (
    Arrays,
    JointRegressor,
    Progress,
    apart,
    scaling,
    standardisation,
)
from truejoint.estimators.family import Family, Params, Rule, number, one_of, optional
from truejoint.estimators.polynomial.run import FAMILY, factors_of, of_degree
from truejoint.estimators.ridge import (
    PENALTIES,
    PenalisedFit,
    blocks,
    changes,
    cross_validated,
    solutions,
)

ROWS_PER_COEFFICIENT: Final = 10  # for each joint; with fewer rows, a fit fits the noise
MOST_PRODUCTS: Final = 600
"""Terms of a ridge regression that are products, at most."""
SHARES: Final = (0.0, 0.3, 1.0)
"""Sizes tried of terms that are products, beside the others: less is penalised more."""

_BLOCK: Final = 2048  # rows that are held at a time as polynomial terms
_RANK_TOLERANCE: Final = 1e-10
_CHUNK: Final = 4096  # the same, of a ridge regression
_FAR: Final = 6.0  # standard deviations, beyond which a row is not fitted to
_NORMAL: Final = 0.6745  # median of a normal error's size, over its standard deviation
_MOST_FAR: Final = 0.05  # share of the rows that may be; more of them are no exceptions
_ROUNDS: Final = 5


@dataclass(eq=False, repr=False)
class Polynomial(JointRegressor):
    """Least squares on all products of up to `degree` features, or a ridge regression.

    Peng2024, II-C, has the constant (`degree` 0), the linear (1) and the quadratic model (2). Terms
    that the data do not tell apart (a constant channel, two copies of a signal) share the smallest
    coefficients that fit; the intercept stays outside of that.

    A `ridge` regression has the features and products of some of them. For each output by itself, a
    penalty and how much more products are penalised are those of the least mean square on five
    parts of the rows that are left out in turn: blocks on end, or, where `dt` tells of fewer than
    five histories, a block of each.

    Parameters
    ----------
    degree : int
        Highest total degree of a term, 0 to 5; not of a ridge regression.
    ridge : bool
        Whether it is a ridge regression, which alone knows the other parameters.
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
        Of a ridge regression, chosen of `truejoint.estimators.ridge.PENALTIES`.
    shares_ : ndarray, shape (n_outputs,)
        The same of `SHARES`.
    errors_ : ndarray, shape (n_outputs,)
        Root mean square on the blocks that were left out, in standard deviations of the target.

    Examples
    --------
    >>> X = np.linspace(-1.0, 1.0, 50)[:, None]
    >>> Polynomial().fit(X, X[:, 0] ** 2).predict([[0.5]]).round(6)
    array([0.25])
    >>> Polynomial(0).fit(X, X[:, 0] + 2.0).predict([[0.5]]).round(6)
    array([2.])
    >>> X = np.random.default_rng(0).normal(size=(500, 2))
    >>> Polynomial(ridge=True).fit(X, X[:, 0] * X[:, 1]).predict([[2.0, 0.5]]).round(2)
    array([1.])
    """

    training: ClassVar[Mapping[str, Rule]] = {
        "trimmed": one_of(False, True), "penalty": optional(number(0.0, 1e12))
    }  # fmt: skip
    degree: int = 2
    ridge: bool = False
    first: int | None = None
    crossed: int | None = None
    squared: int = 0
    by_squares: int | None = None
    trimmed: bool = False
    penalty: float | None = None

    @property
    def family(self) -> Family:  # type: ignore[override]  # by a parameter
        """What runs it; a constant corrects an error alone."""
        return FAMILY.of(self.model_params())

    @property
    def partial(self) -> bool:  # type: ignore[override]  # by a parameter
        """Whether a target that is NaN is left out, and its row's others are not."""
        return not self.ridge

    def model_params(self) -> Params:
        """Parameters of the family: by default, the products for what it is fitted to."""
        if not self.ridge:
            return {**of_degree(self.degree), "ridge": self.ridge}
        k = int(vars(self).get("n_features_in_", 0))
        usual = k if k * (k + 1) // 2 <= MOST_PRODUCTS else 0
        first = usual if self.first is None else self.first
        crossed = first if self.crossed is None else self.crossed
        by_squares = crossed if self.by_squares is None else self.by_squares
        return {
            "degree": self.degree, "ridge": self.ridge, "first": first, "crossed": crossed,
            "squared": self.squared, "by_squares": by_squares if self.squared else 0,
        }  # fmt: skip

    def minimum_rows(self, n_features: int) -> int:
        """Ten rows for each coefficient of a joint, two for each input of a ridge regression."""
        if self.ridge:
            return max(100, 2 * n_features)
        return ROWS_PER_COEFFICIENT * math.comb(n_features + int(self.degree), int(self.degree))

    def adapted(self, X: Array, y: Array, dt: Array) -> tuple[Self, Array]:
        """Fitted copy, as `JointRegressor.adapted` says."""
        labelled = self._known(y)
        factors = factors_of(self.model_params(), X.shape[1])
        residuals = y[labelled] - self.evaluate(X[labelled])
        if not len(factors):
            arrays = {"intercept": self.arrays_["intercept"] + residuals.mean(axis=0)}
            return self.with_arrays(arrays), np.zeros(y.shape[1])
        scaled = (X[labelled] - self.arrays_["mean"]) * self.arrays_["inverse_scale"]
        terms = polynomial_design(scaled, factors)
        slopes, offset, penalties = changes(terms, residuals)
        arrays = {
            "coef": self.arrays_["coef"] + slopes,
            "intercept": self.arrays_["intercept"] + offset,
        }
        return self.with_arrays(arrays), penalties

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        factors = factors_of(self.model_params(), X.shape[1])
        if self.ridge:
            return self._learn_ridge(X, y, dt, factors, progress)
        mean, inverse_scale = standardisation(X)
        scaled, parts = (X - mean) * inverse_scale, apart(y)

        def blocks_of(part: int) -> Iterator[tuple[Array, Array]]:
            labelled, outputs = parts[part]
            inputs, targets = scaled[labelled], y[labelled, outputs]
            for start in range(0, len(inputs), _BLOCK):
                rows = slice(start, start + _BLOCK)
                yield polynomial_design(inputs[rows], factors), targets[rows]
                progress((part + min(start + _BLOCK, len(inputs)) / len(inputs)) / len(parts))

        if len(factors):
            fits = (least_squares(blocks_of(k)) for k in range(len(parts)))
            coef, intercept = map(np.hstack, zip(*fits, strict=True))
        else:
            coef = np.zeros((0, y.shape[1]))
            intercept = np.hstack([y[rows, outputs].mean(axis=0) for rows, outputs in parts])
            progress(1.0)
        return {
            "mean": mean, "inverse_scale": inverse_scale, "coef": coef, "intercept": intercept
        }  # fmt: skip

    def _learn_ridge(
        self, X: Array, y: Array, dt: Array, factors: Integers, progress: Progress
    ) -> Arrays:
        scales = scaling(X, y)
        mean, inverse_scale = scales["mean"], scales["inverse_scale"]
        scaled = (X - mean) * inverse_scale
        targets = (y - scales["target_mean"]) / scales["target_scale"]
        products = np.array([_products(scaled[b], targets[b], factors) for b in blocks(dt)])
        is_product = factors[:, 1] < X.shape[1]
        shares = SHARES if is_product.any() and self.penalty is None else SHARES[-1:]
        weights = [np.where(is_product, share, 1.0) for share in shares]
        penalties = PENALTIES if self.penalty is None else (float(self.penalty),)
        fit = cross_validated(products, weights, progress, penalties)
        self.shares_, self.penalties_ = np.array(shares)[fit.weights], fit.penalties
        self.errors_ = np.sqrt(np.maximum(fit.errors, 0.0) / len(X))
        table = fit.coefficients
        if self.trimmed:
            chosen = np.array(weights)[fit.weights]
            table = _without_far(scaled, targets, factors, products.sum(axis=0), chosen, fit)
        table = table * scales["target_scale"]
        return {
            "mean": mean,
            "inverse_scale": inverse_scale,
            "coef": np.ascontiguousarray(table[1:]),
            "intercept": table[0] + scales["target_mean"],
        }

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = self.degree == 0 and not self.ridge
        return tags


@dataclass(eq=False, repr=False)
class Raw(Polynomial):
    """No correction: a fixed offset of 0, of the error.

    Examples
    --------
    >>> Raw().fit([[0.0], [1.0]], [1.0, 2.0]).predict([[5.0]])
    array([0.])
    """

    degree: int = 0

    @property
    def name(self) -> str:
        """Name in tables."""
        return registry.RAW

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        arrays = super()._learn(X, y, dt, progress)
        return arrays | {"intercept": np.zeros(y.shape[1])}


def polynomial_design(scaled: Array, factors: NDArray[np.int64]) -> Array:
    """Terms (n, n_terms) of scaled features (n, k)."""
    with_one = np.column_stack([scaled, np.ones(len(scaled))])  # the last is the factor 1
    design = with_one[:, factors[:, 0]]
    for factor in factors.T[1:]:
        design *= with_one[:, factor]
    return design


def least_squares(blocks: Iterator[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Coefficients (m, n_outputs) and intercept (n_outputs,) of least squares over blocks of rows.

    Terms (n, m) and targets (n, n_outputs) of each block are folded into one triangular factor, so
    memory does not grow with their number; with a column of ones in front, the factor below its
    first row is that of the centred columns. Directions below 1e-10 of the strongest, columns of
    unit length, are left out (minimum norm).
    """
    factor: Array | None = None
    n_rows, m = 0, 0
    for terms, y in blocks:
        n_rows += len(terms)
        m = terms.shape[1]
        stack = np.column_stack([np.ones(len(terms)), terms, y])
        if factor is not None:
            stack = np.vstack([factor, stack])
        factor = np.asarray(np.linalg.qr(stack, mode="r"))
    assert factor is not None  # noqa: S101  # fit is never given zero rows
    centred = factor[1 : m + 1, 1 : m + 1]
    length = np.linalg.norm(centred, axis=0)
    varies = length > _RANK_TOLERANCE * math.sqrt(n_rows)  # of terms of order one
    inverse = np.divide(1.0, length, out=np.zeros(m), where=varies)
    coef, right = np.zeros((m, factor.shape[1] - m - 1)), factor[1 : m + 1, m + 1 :]
    if varies.any():
        solution = scipy.linalg.lstsq(centred * inverse, right, cond=_RANK_TOLERANCE)[0]
        coef = np.asarray(solution) * inverse[:, None]
    intercept = (factor[0, m + 1 :] - factor[0, 1 : m + 1] @ coef) / factor[0, 0]
    return np.ascontiguousarray(coef), intercept


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
        chunks = (scaled[i : i + _CHUNK] for i in range(0, len(scaled), _CHUNK))
        values = [table[0] + polynomial_design(rows, factors) @ table[1:] for rows in chunks]
        residuals = np.abs(y - np.concatenate(values))
        far = residuals > _FAR / _NORMAL * np.median(residuals, axis=0)
        far &= far.mean(axis=0) <= _MOST_FAR
        for j in np.flatnonzero((far != before).any(axis=0)):
            rows = np.flatnonzero(far[:, j])
            inliers = products - _products(scaled[rows], y[rows], factors)
            places = [*range(1 + n_terms), 1 + n_terms + j]
            inner = inliers[np.ix_(places, places)]
            table[:, j] = solutions(inner, weights[j], 1, (fit.penalties[j],))[0, :, 0]
        if (far == before).all():
            break
        before = far
    return table
