"""The paper's other estimators: least squares (29), and least squares with compensation (30)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.base import Progress
from truejoint.estimators.jaw import DRIVE, MOTOR, RESET, JawEstimator
from truejoint.estimators.rational import RationalModel, fit_rational
from truejoint.estimators.sequence import regular_steps
from truejoint.models import jaw_kernels as kernels
from truejoint.models.jaw_families import Method

Array = NDArray[np.float64]


@dataclass
class ObservationMemory:
    """Displacements and speeds (4,) of the row before, and room for a row of (29)."""

    last: Array = field(default_factory=lambda: np.zeros(4))
    row: Array = field(default_factory=lambda: np.zeros(kernels.OBSERVED))


class JawLeastSquares(JawEstimator):
    """Least squares on both displacements and their derivatives, with no constant: yan2020, (29).

    Speeds and accelerations are plain differences of the rows.
    """

    family: ClassVar[str] = "lsm"
    inputs: ClassVar[tuple[str, ...]] = (DRIVE, RESET)
    counts_samples: ClassVar[bool] = True  # differences of rows

    def to_arrays(self) -> dict[str, Array]:
        """Coefficients (7,) in the order of (29), and the constant (1,) [rad]."""
        return {"coef": self.coef_, "constant": self.constant_}

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.coef_, self.constant_ = arrays["coef"], arrays["constant"]

    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, k) in the order of time."""
        rows = self._observed(X, steps)
        out = np.empty(len(X))
        kernels.weighted_rows(rows, self.coef_, out)
        return np.asarray((out + self.constant_[0] - self._error(X))[:, None])

    def start(self) -> ObservationMemory:
        """Memory before the first row."""
        return ObservationMemory()

    def step(self, state: ObservationMemory, interval: float, row: Array) -> Array:
        """Jaw angle (1,) [rad] of one row; see `SequenceRegressor.step`."""
        drive, reset = row[self.inputs.index(DRIVE)], row[self.inputs.index(RESET)]
        kernels.observation_row(interval, drive, reset, state.last, state.row)
        angle = kernels.weighted(state.row, self.coef_) + self.constant_[0]
        return np.asarray(angle - self._error(row[None]))

    def _observed(self, X: Array, steps: Array | None) -> Array:
        intervals = regular_steps(len(X)) if steps is None else steps
        drive = np.ascontiguousarray(X[:, self.inputs.index(DRIVE)])
        reset = np.ascontiguousarray(X[:, self.inputs.index(RESET)])
        out = np.empty((len(X), kernels.OBSERVED))
        kernels.observation_rows(intervals, drive, reset, out)
        return out

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        self.coef_ = _scaled_lstsq(self._observed(X, steps)[known], y[known])
        self.constant_ = np.zeros(1)
        progress(0.5)

    def _error(self, X: Array) -> Array:
        """Modelled error (n,) [rad] that is taken off; none here."""
        return np.zeros(len(X))


class JawLeastSquaresIntercept(JawLeastSquares):
    """(29) with a constant added: the fair form of the paper's baseline."""

    family: ClassVar[str] = "lsm_intercept"

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        rows = self._observed(X, steps)[known]
        solution = _scaled_lstsq(np.column_stack([rows, np.ones(len(rows))]), y[known])
        self.coef_ = np.ascontiguousarray(solution[:-1])
        self.constant_ = np.ascontiguousarray(solution[-1:])
        progress(0.5)


class CompensatedJawLeastSquares(JawLeastSquares):
    """(29) less its own rational error model in motor angle and ``x2``: yan2020, (30).

    Parameters
    ----------
    fit_method : {"projection", "quasi_newton", "global"}
        How the error model is fitted: see `fit_rational`.
    """

    family: ClassVar[str] = "lsm_compensated"
    inputs: ClassVar[tuple[str, ...]] = (MOTOR, DRIVE, RESET)

    def __init__(self, fit_method: Method = "projection") -> None:
        self.fit_method = fit_method

    def to_arrays(self) -> dict[str, Array]:
        """As `JawLeastSquares`, and scale (2,) and coefficients (11,) of the error model."""
        model = self.error_model_
        return {**super().to_arrays(), "scale": model.scale, "error_coef": model.coefficients}

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        super()._set_arrays(arrays)
        self.error_model_ = RationalModel(arrays["scale"], arrays["error_coef"])

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        super()._fit_jaw(X, y, steps, known, progress)
        error = self._observed(X, steps)[known] @ self.coef_ - y[known]
        self.error_model_ = fit_rational(X[known, 0], X[known, 2], error, self.fit_method)

    def _error(self, X: Array) -> Array:
        model = self.error_model_
        if len(X) == 1:
            return np.array(
                [kernels.rational_row(X[0, 0], X[0, 2], model.scale, model.coefficients)]
            )
        return model(np.ascontiguousarray(X[:, 0]), np.ascontiguousarray(X[:, 2]))


def _scaled_lstsq(rows: Array, y: Array) -> Array:
    """Least-squares coefficients; columns from 1e-3 m to 10 m/s2 are brought to one length."""
    length = np.linalg.norm(rows, axis=0)
    inverse = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    return np.asarray(np.linalg.lstsq(rows * inverse, y, rcond=1e-12)[0] * inverse)
