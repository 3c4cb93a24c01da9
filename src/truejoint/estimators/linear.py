"""Fixed offset, linear and polynomial regression: peng2024, II-C."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Final

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truejoint.estimators.base import JointRegressor, Progress, standardisation
from truejoint.models import kernels
from truejoint.models.families import count_terms, polynomial_terms

Array = NDArray[np.float64]

ROWS_PER_COEFFICIENT: Final = 10
"""Rows that a fit must have for each coefficient per joint; fewer, and it fits the noise."""

_BLOCK: Final = 2048  # rows that are held at a time as polynomial terms
_RANK_TOLERANCE: Final = 1e-10


class FixedOffset(JointRegressor):
    """Mean of the target, whatever the features: the baseline of peng2024, II-C."""

    family: ClassVar[str] = "offset"

    def minimum_rows(self, n_features: int) -> int:  # noqa: ARG002  # one mean, whatever they are
        """Ten rows."""
        return ROWS_PER_COEFFICIENT

    def _fit(self, X: Array, y: Array, progress: Progress) -> None:  # noqa: ARG002  # y alone
        self.n_outputs_ = y.shape[1]
        self.offset_ = y.mean(axis=0)
        progress(1.0)

    def evaluate(self, X: Array) -> Array:
        """Offset (n, n_outputs) for every row of `X` (n, k)."""
        return np.tile(self.offset_, (len(X), 1))

    def to_arrays(self) -> dict[str, Array]:
        """Give the offset (n_outputs,)."""
        return {"offset": self.offset_}

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.offset_ = arrays["offset"]

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags


class _LeastSquares(JointRegressor):
    """Polynomial fitted by least squares on standardised features.

    Terms that the data do not tell apart (a constant channel, two copies of a signal) share the
    smallest coefficients that fit; the intercept stays outside of that.
    """

    @property
    @abstractmethod
    def _degree(self) -> int: ...

    def minimum_rows(self, n_features: int) -> int:
        """Ten rows for each coefficient of a joint."""
        return ROWS_PER_COEFFICIENT * count_terms(n_features, self._degree) + ROWS_PER_COEFFICIENT

    def _fit(self, X: Array, y: Array, progress: Progress) -> None:
        self.array_shapes(X.shape[1], y.shape[1])
        self.n_outputs_ = y.shape[1]
        self.mean_, self.inverse_scale_ = standardisation(X)
        self._terms = polynomial_terms(X.shape[1], self._degree)
        scaled = (X - self.mean_) * self.inverse_scale_
        blocks = (
            (polynomial_design(scaled[rows], self._terms), y[rows])
            for rows in _blocks(len(X), progress)
        )
        self.coef_, self.intercept_ = least_squares(blocks)

    def evaluate(self, X: Array) -> Array:
        """Predict (n, n_outputs) for finite, C-ordered rows `X` (n, k), without checks."""
        out = np.empty((len(X), self.n_outputs_))
        kernels.polynomial_rows(
            X, self.mean_, self.inverse_scale_, self._terms, self.coef_, self.intercept_, out
        )
        return out

    def to_arrays(self) -> dict[str, Array]:
        """Scaling (k,), coefficients (n_terms, n_outputs) and intercept (n_outputs,)."""
        return {
            "mean": self.mean_,
            "inverse_scale": self.inverse_scale_,
            "coef": self.coef_,
            "intercept": self.intercept_,
        }

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.mean_ = arrays["mean"]
        self.inverse_scale_ = arrays["inverse_scale"]
        self.coef_ = arrays["coef"]
        self.intercept_ = arrays["intercept"]
        self._terms = polynomial_terms(self.n_features_in_, self._degree)


class LinearRegressor(_LeastSquares):
    """Linear least squares with intercept: peng2024, II-C."""

    family: ClassVar[str] = "linear"

    @property
    def _degree(self) -> int:
        return 1


class PolynomialRegressor(_LeastSquares):
    """Least squares on all products of up to `degree` features: peng2024, II-C, at degree 2.

    Parameters
    ----------
    degree : int
        Highest total degree of a term, 1 to 5.
    """

    family: ClassVar[str] = "polynomial"

    def __init__(self, degree: int = 2) -> None:
        self.degree = degree

    @property
    def name(self) -> str:
        """``"poly2"`` for degree 2."""
        return f"poly{self.degree}"

    @property
    def _degree(self) -> int:
        return int(self.degree)


def polynomial_design(scaled: Array, terms: NDArray[np.int64]) -> Array:
    """Terms (n, n_terms) of scaled features (n, k)."""
    with_one = np.column_stack([scaled, np.ones(len(scaled))])  # index -1 finds the factor 1
    design = with_one[:, terms[:, 0]]
    for factor in terms.T[1:]:
        design *= with_one[:, factor]
    return design


def least_squares(blocks: Iterator[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Coefficients and intercept that minimise the squared error over blocks of rows.

    The rows are folded into one triangular factor block by block, so memory does not grow with
    their number. With a column of ones in front, the factor below its first row is that of the
    centred columns. Columns are scaled to unit length, and directions below 1e-10 of the
    strongest are left out (minimum norm).

    Parameters
    ----------
    blocks : iterator of (ndarray (n, m), ndarray (n, n_outputs))
        Terms and targets.

    Returns
    -------
    coef : ndarray, shape (m, n_outputs)
    intercept : ndarray, shape (n_outputs,)
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
    inverse = np.zeros(m)
    varies = length > _RANK_TOLERANCE * math.sqrt(n_rows)  # of terms of order one
    inverse[varies] = 1.0 / length[varies]
    coef = np.zeros((m, factor.shape[1] - m - 1))
    if varies.any():
        solution = scipy.linalg.lstsq(
            centred * inverse, factor[1 : m + 1, m + 1 :], cond=_RANK_TOLERANCE
        )
        coef = np.asarray(solution[0]) * inverse[:, None]
    intercept = (factor[0, m + 1 :] - factor[0, 1 : m + 1] @ coef) / factor[0, 0]
    return np.ascontiguousarray(coef), intercept


def _blocks(n: int, progress: Progress) -> Iterator[slice]:
    for start in range(0, n, _BLOCK):
        yield slice(start, start + _BLOCK)
        progress(min(start + _BLOCK, n) / n)
