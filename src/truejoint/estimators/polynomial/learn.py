"""Fixed offset, linear and polynomial regression: peng2024, II-C."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truejoint.array_types import Array, Integers
from truejoint.estimators import registry
from truejoint.estimators.adapting import changes
from truejoint.estimators.base import Arrays, JointRegressor, Progress, apart, standardisation
from truejoint.estimators.family import Family
from truejoint.estimators.polynomial import offset
from truejoint.estimators.polynomial import run as polynomial

ROWS_PER_COEFFICIENT: Final = 10  # for each joint; with fewer rows, a fit fits the noise

_BLOCK: Final = 2048  # rows that are held at a time as polynomial terms
_RANK_TOLERANCE: Final = 1e-10


class FixedOffset(JointRegressor):
    """Mean of the target, whatever the features.

    Examples
    --------
    >>> FixedOffset().fit([[0.0], [1.0]], [1.0, 2.0]).predict([[5.0]])
    array([1.5])
    """

    family: ClassVar[Family] = offset.FAMILY
    partial: ClassVar[bool] = True

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        progress(1.0)
        return {"offset": np.hstack([y[rows, own].mean(axis=0) for rows, own in apart(y)])}

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags

    def adapted(self, X: Array, y: Array, dt: Array) -> tuple[Self, Array]:
        """Fitted copy with the mean of the new rows."""
        own = self.with_arrays({"offset": y[self._known(y)].mean(axis=0)})
        return own, np.zeros(y.shape[1])


class TermsRegressor(JointRegressor):
    """What is linear in products of scaled features, and can be adapted to new rows."""

    @abstractmethod
    def factors(self, n_features: int) -> Integers:
        """Features that each term multiplies (n_terms, ...), `n_features` for none."""

    def adapted(self, X: Array, y: Array, dt: Array) -> tuple[Self, Array]:
        """Fitted copy, as `JointRegressor.adapted` says."""
        known = self._known(y)
        scaled = (X[known] - self.arrays_["mean"]) * self.arrays_["inverse_scale"]
        terms = polynomial_design(scaled, self.factors(X.shape[1]))
        slopes, offset, penalties = changes(terms, y[known] - self.evaluate(X[known]))
        own = {
            "coef": self.arrays_["coef"] + slopes,
            "intercept": self.arrays_["intercept"] + offset,
        }
        return self.with_arrays(own), penalties


class Raw(FixedOffset):
    """No correction: a fixed offset of 0, of the error.

    Examples
    --------
    >>> Raw().fit([[0.0], [1.0]], [1.0, 2.0]).predict([[5.0]])
    array([0.])
    """

    @property
    def name(self) -> str:
        """Name in tables."""
        return registry.RAW

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        progress(1.0)
        return {"offset": np.zeros(y.shape[1])}


@dataclass(eq=False, repr=False)
class PolynomialRegressor(TermsRegressor):
    """Least squares on all products of up to `degree` features: peng2024, II-C, at degree 2.

    Terms that the data do not tell apart (a constant channel, two copies of a signal) share the
    smallest coefficients that fit; the intercept stays outside of that.

    Parameters
    ----------
    degree : int
        Highest total degree of a term, 1 to 5.

    Examples
    --------
    >>> X = np.linspace(-1.0, 1.0, 50)[:, None]
    >>> PolynomialRegressor().fit(X, X[:, 0] ** 2).predict([[0.5]]).round(6)
    array([0.25])
    """

    family: ClassVar[Family] = polynomial.FAMILY
    partial: ClassVar[bool] = True
    degree: int = 2

    def minimum_rows(self, n_features: int) -> int:
        """Ten rows for each coefficient of a joint."""
        n_terms = polynomial.count_terms(n_features, int(self.degree))
        return ROWS_PER_COEFFICIENT * (n_terms + 1)

    def factors(self, n_features: int) -> Integers:
        """Features that each term multiplies (n_terms, degree)."""
        return polynomial.polynomial_factors(n_features, int(self.degree))

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        mean, inverse_scale = standardisation(X)
        factors = self.factors(X.shape[1])
        scaled = (X - mean) * inverse_scale

        parts = apart(y)

        def blocks(done: int) -> Iterator[tuple[Array, Array]]:
            known, own = parts[done]
            inputs, targets = scaled[known], y[known, own]
            for start in range(0, len(inputs), _BLOCK):
                rows = slice(start, start + _BLOCK)
                yield polynomial_design(inputs[rows], factors), targets[rows]
                progress((done + min(start + _BLOCK, len(inputs)) / len(inputs)) / len(parts))

        coef, intercept = zip(*(least_squares(blocks(k)) for k in range(len(parts))), strict=True)
        return {
            "mean": mean, "inverse_scale": inverse_scale, "coef": np.hstack(coef),
            "intercept": np.hstack(intercept),
        }  # fmt: skip


@dataclass(eq=False, repr=False)
class LinearRegressor(PolynomialRegressor):
    """Linear least squares with intercept: peng2024, II-C.

    Examples
    --------
    >>> X = np.linspace(0.0, 1.0, 30)[:, None]
    >>> LinearRegressor().fit(X, 2.0 * X[:, 0] + 1.0).predict([[3.0]]).round(6)
    array([7.])
    """

    degree: int = 1


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
