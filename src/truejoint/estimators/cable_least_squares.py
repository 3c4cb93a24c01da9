"""The paper's other estimators: least squares (29), and least squares with compensation (30)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.jaw import JawEstimator
from truejoint.estimators.rational import fit_rational
from truejoint.models import cable_least_squares
from truejoint.models.family import Family


@dataclass(eq=False, repr=False, kw_only=True)
class CableLeastSquares(JawEstimator):
    """Least squares on both displacements and their derivatives: yan2020, (29) and (30).

    Speeds and accelerations are plain differences of the rows.

    Parameters
    ----------
    intercept : bool
        Whether a constant is added, as the paper does not: the fair form of its baseline.
    compensated : bool
        Whether a rational error model in motor angle and ``x2`` is taken off: (30).
    fit_method : {"projection", "quasi_newton", "global"}
        How the error model is fitted: see `fit_rational`.

    Examples
    --------
    >>> CableLeastSquares(compensated=True).name
    'lsm_compensated'
    """

    family: ClassVar[Family] = cable_least_squares.FAMILY
    intercept: bool = False
    compensated: bool = False
    fit_method: str = "projection"

    def _learn_jaw(self, X: Array, y: Array, dt: Array, known: Flags, progress: Progress) -> Arrays:
        drive, reset = X[:, -2], X[:, -1]
        observed = np.empty((len(X), cable_least_squares.OBSERVED))
        cable_least_squares.observe_rows(
            dt, np.ascontiguousarray(drive), np.ascontiguousarray(reset), observed
        )
        rows = observed[known]
        columns = np.column_stack([rows, np.ones(len(rows))]) if self.intercept else rows
        # Columns from 1e-3 m to 10 m/s2 are brought to one length.
        length = np.linalg.norm(columns, axis=0)
        inverse = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
        found = np.linalg.lstsq(columns * inverse, y[known], rcond=1e-12)[0] * inverse
        solution = np.append(found, 0.0)
        progress(0.5)
        arrays = {"coef": solution[: rows.shape[1]].copy(), "constant": solution[7:8].copy()}
        if self.compensated:
            error = rows @ arrays["coef"] + arrays["constant"] - y[known]
            arrays |= fit_rational(X[known, 0], reset[known], error, self.fit_method)
        return arrays
