"""Gaussian process regression by inducing points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
import scipy.linalg
from scipy.optimize import minimize

from truejoint.array_types import Array, Integers
from truejoint.estimators.base import Arrays, JointRegressor, Progress, scaling
from truejoint.models import gaussian_process
from truejoint.models.family import Family

LENGTH: Final = 1.0, 0.1, 1e3
"""Start and bounds of the way over which the error changes, in deviations of a feature.

The start is for one feature; for k of them it is longer by the root of k, as distances are.
"""
VARIANCE: Final = 1.0, 1e-2, 1e2
"""Start and bounds of the variance of what is told, in variances of the target."""
NOISE: Final = 1e-2, 1e-4, 1.0
"""The same of what is left to noise."""

_CHUNK: Final = 4096  # rows that are held at a time
_JITTER: Final = 1e-10  # of the mean of a diagonal, which rounding may take from it


@dataclass(eq=False, repr=False)
class GaussianProcess(JointRegressor):
    """Gaussian process with a squared-exponential kernel of its own for each output.

    Lengths of the features, variance and noise are those of the largest marginal likelihood of
    rows that are evenly spread. These rows are the inducing points, too, by which the process is
    fitted to all rows: a subset of regressors (Quiñonero-Candela and Rasmussen, Journal of Machine
    Learning Research 6, 2005, IV). Mahler et al. (CASE 2014) calibrate a RAVEN-II by a Gaussian
    process. Far from what it was fitted to, it predicts the mean: it does not extrapolate.

    Parameters
    ----------
    points : int
        Inducing points.

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.0, 400)[:, None]
    >>> model = GaussianProcess(points=30).fit(x, np.sin(3.0 * x[:, 0]))
    >>> model.predict([[0.5], [500.0]]).round(2) + 0.0
    array([1., 0.])
    """

    family: ClassVar[Family] = gaussian_process.FAMILY
    least_rows: ClassVar[int] = 100
    rows_per_feature: ClassVar[int] = 10
    points: int = 200

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        scales = scaling(X, y)
        scaled = (X - scales["mean"]) * scales["inverse_scale"]
        targets = (y - scales["target_mean"]) / scales["target_scale"]
        some = np.linspace(0, len(X) - 1, int(self.points)).round().astype(np.int64)
        inverse, weights = [], []
        for number, target in enumerate(targets.T):
            own, noise = likeliest_kernel(*(rows[np.unique(some)] for rows in (scaled, target)))
            inverse.append(own)
            weights.append(_weights(scaled * own, target, some, noise))
            progress((number + 1) / len(targets.T))
        return scales | {
            "points": scaled[some],
            "inverse_lengths": np.array(inverse),
            "weights": np.array(weights),
        }


def likeliest_kernel(X: Array, y: Array) -> tuple[Array, float]:
    """Inverse lengths (k,) of the largest marginal likelihood, and the noise's share of variance.

    Of rows `X` (n, k) and `y` (n,), standardised; the length of a feature that never changes is
    infinite.
    """
    used = np.ptp(X, axis=0) > 0.0
    k = int(used.sum())
    start, low, high = np.log(np.array([*[LENGTH] * k, VARIANCE, NOISE]).T)
    start[:k] += 0.5 * math.log(max(k, 1))
    found = minimize(
        unlikelihood, start, (np.ascontiguousarray(X[:, used]), y), "L-BFGS-B", jac=True,
        bounds=list(zip(low, high, strict=True)), options={"maxiter": 60},
    ).x  # fmt: skip
    inverse = np.zeros(len(used))
    inverse[used] = np.exp(-found[:k])
    return inverse, math.exp(found[k + 1] - found[k])


def unlikelihood(theta: Array, X: Array, y: Array) -> tuple[float, Array]:
    """Minus the logarithm of the marginal likelihood of rows `X` (n, k), `y` (n,); its gradient.

    Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), (2.30) and (5.9).
    `theta` (k + 2,) are logarithms of the lengths, the variance and the noise's variance.
    """
    scaled = X * np.exp(-theta[:-2])
    bells = math.exp(theta[-2]) * _bells(scaled, scaled)
    covariance = bells.copy()
    covariance[np.diag_indices_from(covariance)] += math.exp(theta[-1])
    factor = scipy.linalg.cholesky(covariance, lower=True)
    solved = scipy.linalg.cho_solve((factor, True), y)
    inverse = scipy.linalg.cho_solve((factor, True), np.eye(len(y)))
    value = 0.5 * (y @ solved + len(y) * math.log(2.0 * math.pi)) + np.log(np.diag(factor)).sum()
    slope = 0.5 * (inverse - np.outer(solved, solved))  # of the value, by the covariance
    by_bell = slope * bells
    # Sums of by_bell[i, j] * (scaled[i] - scaled[j])**2, one for each feature.
    squares = 2.0 * (by_bell.sum(axis=0) @ scaled**2 - np.sum(scaled * (by_bell @ scaled), axis=0))
    noise = math.exp(theta[-1]) * np.trace(slope)
    return float(value), np.concatenate([squares, [by_bell.sum(), noise]])


def _weights(scaled: Array, y: Array, some: Integers, noise: float) -> Array:
    """Weights (m,) of the rows `some` of `scaled` (n, k), in lengths, fitted to all targets."""
    points = scaled[some]
    total, right = noise * _bells(points, points), np.zeros(len(some))
    for start in range(0, len(scaled), _CHUNK):
        rows = slice(start, start + _CHUNK)
        bells = _bells(scaled[rows], points)
        total += bells.T @ bells
        right += bells.T @ y[rows]
    total[np.diag_indices_from(total)] += _JITTER * np.trace(total) / len(total)
    return np.asarray(scipy.linalg.solve(total, right, assume_a="pos"))


def _bells(rows: Array, points: Array) -> Array:
    """``exp(-d**2 / 2)`` (n, m) of the distance of every row from every point."""
    square = np.sum(rows**2, axis=1)[:, None] + np.sum(points**2, axis=1) - 2.0 * rows @ points.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0.0)))
