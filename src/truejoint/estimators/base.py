"""What every estimator has: scikit-learn's interface, and plain arrays for the model file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from truejoint.models.families import Shape, check_arrays, check_names
from truejoint.models.known_families import FAMILIES

Array = NDArray[np.float64]
Progress = Callable[[float], None]


class JointRegressor(RegressorMixin, BaseEstimator, ABC):  # type: ignore[misc]  # sklearn: untyped
    """Base of the estimators that see one row at a time and keep no history.

    What is learnt stands in plain float64 arrays (`to_arrays`), which together with the
    parameters (`get_params`) are the whole estimator: `from_arrays` restores it bit for bit.
    """

    family: ClassVar[str]
    """Name of the class in model files."""

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        return self.family

    def fit(self, X: ArrayLike, y: ArrayLike, progress: Progress | None = None) -> Self:
        """Fit to rows.

        Parameters
        ----------
        X : array_like, shape (n, k)
        y : array_like, shape (n,) or (n, n_outputs)
        progress : callable, optional
            Called with the fraction done, 0 to 1.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If a shape or a value is wrong, or a parameter breaks its rule.
        """
        self.check_params()
        inputs, targets = validate_data(
            self, X, y, dtype=np.float64, order="C", multi_output=True, y_numeric=True
        )
        targets = np.asarray(targets, dtype=np.float64)
        self.single_output_ = targets.ndim == 1
        # One thread: blocks of a few thousand rows are too small to share. Two threads on two busy
        # cores were 6 times slower than one for a polynomial and 12 times for a network.
        with threadpool_limits(1, user_api="blas"):
            self._fit(inputs, targets.reshape(len(targets), -1), progress or _no_progress)
        return self

    def predict(self, X: ArrayLike) -> Array:
        """Predict for rows.

        Parameters
        ----------
        X : array_like, shape (n, k)

        Returns
        -------
        ndarray, shape (n, n_outputs), or (n,) if it was fitted to a 1-D target
        """
        check_is_fitted(self)
        inputs = validate_data(self, X, dtype=np.float64, order="C", reset=False)
        outputs = self.evaluate(inputs)
        return outputs[:, 0] if self.single_output_ else outputs

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        return tags

    @abstractmethod
    def evaluate(self, X: Array) -> Array:
        """Predict (n, n_outputs) for finite, C-ordered rows `X` (n, k), without checks."""

    @abstractmethod
    def _fit(self, X: Array, y: Array, progress: Progress) -> None:
        """Fit to checked rows `X` (n, k) and `y` (n, n_outputs)."""

    def check_params(self) -> None:
        """Raise CalibrationError, naming the parameter and its rule, when one breaks it."""
        FAMILIES[self.family].check(self.get_params())

    def array_shapes(self, n_features: int, n_outputs: int) -> dict[str, Shape]:
        """Name and shape of each array of the fitted estimator; raises CalibrationError."""
        return FAMILIES[self.family].shapes(self.get_params(), n_features, n_outputs)

    @abstractmethod
    def minimum_rows(self, n_features: int) -> int:
        """Fewest rows that `calibrate` accepts to fit this estimator to."""

    @abstractmethod
    def to_arrays(self) -> dict[str, Array]:
        """Give what was learnt, by name."""

    @abstractmethod
    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        """Take over what `to_arrays` gave; shapes have been checked."""

    @classmethod
    def from_arrays(
        cls,
        params: Mapping[str, Any],
        arrays: Mapping[str, Array],
        *,
        n_features: int,
        n_outputs: int,
    ) -> Self:
        """Fitted estimator of its parameters and arrays.

        Parameters
        ----------
        params : mapping
            As `get_params` gave them.
        arrays : mapping of str to ndarray
            As `to_arrays` gave them.
        n_features, n_outputs : int

        Raises
        ------
        CalibrationError
            If a parameter is unknown, missing or out of its range, or an array is missing, left
            over, of another shape or not finite.
        """
        check_names(cls.family, params, set(cls().get_params()))
        estimator = cls(**params)
        estimator.check_params()
        check_arrays(cls.family, arrays, estimator.array_shapes(n_features, n_outputs))
        estimator.n_features_in_ = n_features
        estimator.n_outputs_ = n_outputs
        estimator.single_output_ = False
        estimator._set_arrays(arrays)
        return estimator


def standardisation(X: Array) -> tuple[Array, Array]:
    """Mean and inverse standard deviation (k,) of the columns of `X` (n, k).

    The inverse is 0 for a column that is constant: whatever it is later, it then has no weight.
    """
    mean = X.mean(axis=0)
    deviation = X.std(axis=0)
    inverse = np.zeros_like(mean)
    varies = ~constant_columns(X)
    inverse[varies] = 1.0 / deviation[varies]
    return mean, inverse


def constant_columns(X: Array) -> NDArray[np.bool_]:
    """Which columns (k,) of `X` (n, k) are constant but for rounding (1e-9 of their value)."""
    low, high = X.min(axis=0), X.max(axis=0)
    spread = high - low
    varies = (spread > 1e-9 * np.maximum(np.abs(low), np.abs(high))) & (spread > 1e-150)
    return np.asarray(~varies)


def _no_progress(_fraction: float) -> None:
    """Nobody watches."""
