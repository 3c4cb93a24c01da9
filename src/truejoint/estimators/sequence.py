"""Estimators that see rows in the order of time and remember: filters, friction, hysteresis."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress
from truejoint.recordings import Recording

Array = NDArray[np.float64]

_REGULAR: Final = 5e-3  # [s], 200 Hz


def time_steps(t: Array, gap_limit: float) -> Array:
    """Time since the row before (n,) [s], 0 where a history starts: first row, and after gaps.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time stamps [s].
    gap_limit : float
        Time without a sample [s] after which the history starts anew.
    """
    steps = np.diff(t, prepend=t[:1])
    return np.where((steps > 0.0) & (steps <= gap_limit), steps, 0.0)


def regular_steps(n: int) -> Array:
    """Time steps (n,) [s] of one history whose rows are 5 ms apart."""
    steps = np.full(n, _REGULAR)
    steps[:1] = 0.0
    return steps


class SequenceRegressor(JointRegressor):
    """Base of the estimators whose output depends on the rows before.

    Rows are in the order of time. Beside them goes `steps` (n,): the time since the row before
    [s], 0 where the history starts anew. A target that is NaN is unknown: its row is seen, but
    not fitted to. What is predicted is the position, not the error of a measured one.
    """

    inputs: ClassVar[tuple[str, ...]]
    """Features that it takes, in the order of its columns."""
    counts_samples: ClassVar[bool] = False
    """Whether what was learnt belongs to one sample interval, within half."""
    causal: ClassVar[bool] = True
    """Whether a row's output depends on no later row, so that `step` works."""

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        progress: Progress | None = None,
        steps: ArrayLike | None = None,
    ) -> Self:
        """Fit to rows in the order of time.

        Parameters
        ----------
        X : array_like, shape (n, k)
            Columns as in `inputs`.
        y : array_like, shape (n,) or (n, 1)
            Positions, NaN where unknown.
        progress : callable, optional
            Called with the fraction done, 0 to 1.
        steps : array_like, shape (n,), optional
            Time since the row before [s], 0 where a history starts; rows 5 ms apart by default.

        Returns
        -------
        self

        Raises
        ------
        CalibrationError
            If a shape, a value or a parameter breaks its rule, or the rows cannot tell what is to
            be learnt.
        """
        self.check_params()
        rows = self._rows(X)
        targets = np.array(y, dtype=np.float64)
        self.single_output_ = targets.ndim == 1
        targets = targets.reshape(len(targets), -1) if targets.ndim else targets.reshape(0, 1)
        if len(targets) != len(rows) or np.isinf(targets).any():
            raise CalibrationError(
                f"{self.name}: y has shape {targets.shape} for {len(rows)} rows; give a finite "
                "position for each row, NaN where unknown"
            )
        self.n_features_in_ = rows.shape[1]
        self.n_outputs_ = targets.shape[1]
        intervals = _checked_steps(steps, len(rows), self.name)
        with threadpool_limits(1, user_api="blas"):
            self._fit_sequence(rows, targets, intervals, progress or (lambda _fraction: None))
        return self

    def predict(self, X: ArrayLike, steps: ArrayLike | None = None) -> Array:
        """Predict for rows in the order of time.

        Parameters
        ----------
        X : array_like, shape (n, k)
        steps : array_like, shape (n,), optional
            Time since the row before [s], 0 where a history starts; rows 5 ms apart by default.

        Returns
        -------
        ndarray, shape (n, n_outputs), or (n,) if it was fitted to a 1-D target
        """
        check_is_fitted(self)
        rows = self._rows(X)
        outputs = self.evaluate(rows, _checked_steps(steps, len(rows), self.name))
        return outputs[:, 0] if self.single_output_ else outputs

    def check_recordings(self, recordings: Sequence[Recording]) -> None:
        """Raise CalibrationError when recordings cannot serve to fit this estimator."""

    @abstractmethod
    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Predict (n, n_outputs) for finite, C-ordered rows `X` (n, k), without checks."""

    @abstractmethod
    def start(self) -> Any:
        """State before the first row, for `step`."""

    @abstractmethod
    def step(self, state: Any, interval: float, row: Array) -> Array:
        """Predict one row; the same bits as `evaluate` gives for all rows together.

        Parameters
        ----------
        state : object
            From `start`; changed in place.
        interval : float
            Time since the row before [s], 0 where the history starts.
        row : ndarray, shape (k,)
            Finite.

        Returns
        -------
        ndarray, shape (n_outputs,)
        """

    @abstractmethod
    def _fit_sequence(self, X: Array, y: Array, steps: Array, progress: Progress) -> None:
        """Fit to checked rows `X` (n, k), positions `y` (n, n_outputs) and `steps` (n,)."""

    def _fit(self, X: Array, y: Array, progress: Progress) -> None:
        self._fit_sequence(X, y, _checked_steps(None, len(X), self.name), progress)

    def _rows(self, X: ArrayLike) -> Array:
        rows = np.ascontiguousarray(X, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != len(self.inputs) or not len(rows):
            raise CalibrationError(
                f"{self.name}: rows have shape {rows.shape}; give the {len(self.inputs)} columns "
                f"{', '.join(self.inputs)}"
            )
        if not np.isfinite(rows).all():
            row, column = np.argwhere(~np.isfinite(rows))[0]
            raise CalibrationError(
                f"{self.name}: {self.inputs[column]!r} in row {row} is not finite; leave it out"
            )
        return rows


def _checked_steps(steps: ArrayLike | None, n: int, name: str) -> Array:
    if steps is None:
        return regular_steps(n)
    intervals = np.array(steps, dtype=np.float64)
    if intervals.shape != (n,) or not (np.isfinite(intervals) & (intervals >= 0.0)).all():
        raise CalibrationError(
            f"{name}: time steps have shape {intervals.shape}; give {n} times since the row before "
            "[s], not negative, 0 where a history starts"
        )
    intervals[0] = 0.0
    return intervals


def counts_samples(model: JointRegressor) -> bool:
    """Whether a fitted estimator holds only at the sample interval of its training."""
    return isinstance(model, SequenceRegressor) and model.counts_samples
