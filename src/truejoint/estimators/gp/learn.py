"""Gaussian process regression by inducing points."""

import math
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import numpy as np
import scipy.linalg
from scipy.optimize import minimize

from truejoint.array_types import Array, Integers
from truejoint.estimators.base import Arrays, JointRegressor, Progress, scaling
from truejoint.estimators.family import Family
from truejoint.estimators.gp import run as gaussian_process

LENGTH: Final = 1.0, 0.1, 1e3
"""Start and bounds of the way over which the error changes, in deviations of a feature.

The start is for one feature; for k of them it is longer by the root of k, as distances are.
"""
VARIANCE: Final = 1.0, 1e-2, 1e2
"""Start and bounds of the variance of what is told, in variances of the target."""
NOISE: Final = 1e-2, 4e-3, 1.0
"""The same of what is left to noise.

Rows on end err alike, and a likelihood that takes them for independent finds less noise than there
is, and too many bends.
"""
ZERO: Final = 1e-3, 1e-6, 1.0
"""The same of the zeros of histories."""

_CHUNK: Final = 4096  # rows that are held at a time
_JITTER: Final = 1e-10  # of the mean of a diagonal, which rounding may take from it


@dataclass(eq=False, repr=False)
class GaussianProcess(JointRegressor):
    """Gaussian process with a squared-exponential kernel for each output.

    Lengths of the features, variance and noise are those of the largest marginal likelihood of
    rows that are evenly spread. These rows are the inducing points, too, by which the process is
    fitted to all rows: a subset of regressors (Quiñonero-Candela and Rasmussen, Journal of Machine
    Learning Research 6, 2005, IV). Mahler et al. (CASE 2014) calibrate a RAVEN-II by a Gaussian
    process. Far from what it was fitted to, it predicts the mean: it does not extrapolate.

    If `dt` holds several histories, each has a separate zero, which shifts its targets and
    which no feature shows: a nuisance whose variance is found with the rest, and which is not
    predicted (Rasmussen and Williams, 2006, 2.7, with an indicator of each history as basis).
    Without it, the lengths come out short, to explain what is of the recording.

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
        inducing, history = np.unique(some), np.cumsum(dt == 0.0) - 1
        inverse, weights = [], []
        for number, target in enumerate(targets.T):
            kernel = likeliest_kernel(scaled[inducing], target[inducing], history[inducing])
            inverse.append(kernel.inverse_lengths)
            weights.append(_weights(scaled * kernel.inverse_lengths, target, history, some, kernel))
            progress((number + 1) / len(targets.T))
        return scales | {
            "points": scaled[some],
            "inverse_lengths": np.array(inverse),
            "weights": np.array(weights),
        }


class Kernel(NamedTuple):
    """Kernel of the largest marginal likelihood; variances are shares of that of what is told."""

    inverse_lengths: Array  # (k,), of each feature; 0 of one that never changes
    noise: float
    zero: float = 0.0  # of the zeros of histories


def likeliest_kernel(X: Array, y: Array, history: Integers) -> Kernel:
    """Kernel of the largest marginal likelihood of rows `X` (n, k) and `y` (n,), standardised.

    `history` (n,) numbers the histories that rows are of; one alone has no zero of its own.
    """
    used = np.ptp(X, axis=0) > 0.0
    k = int(used.sum())
    together = np.equal.outer(history, history).astype(float) if np.ptp(history) else None
    zeros = [] if together is None else [ZERO]
    start, low, high = np.log(np.array([*[LENGTH] * k, VARIANCE, NOISE, *zeros]).T)
    start[:k] += 0.5 * math.log(max(k, 1))
    theta = minimize(
        unlikelihood, start, (np.ascontiguousarray(X[:, used]), y, together), "L-BFGS-B", jac=True,
        bounds=list(zip(low, high, strict=True)), options={"maxiter": 60},
    ).x  # fmt: skip
    inverse = np.zeros(len(used))
    inverse[used] = np.exp(-theta[:k])
    return Kernel(inverse, *np.exp(theta[k + 1 :] - theta[k]).tolist())


def unlikelihood(
    theta: Array, X: Array, y: Array, together: Array | None = None
) -> tuple[float, Array]:
    """Minus the logarithm of the marginal likelihood of rows `X` (n, k), `y` (n,); its gradient.

    Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), (2.30) and (5.9).
    `theta` (k + 2,) are logarithms of the lengths, the variance and the noise's variance; with
    `together` (n, n), 1 for two rows of one history and else 0, that of the zeros follows (k + 3,).
    """
    k = X.shape[1]
    scaled = X * np.exp(-theta[:k])
    bells = math.exp(theta[k]) * _bells(scaled, scaled)
    covariance = bells.copy()
    np.fill_diagonal(covariance, covariance.diagonal() + math.exp(theta[k + 1]))
    if together is not None:
        covariance += math.exp(theta[k + 2]) * together
    factor = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    solved = scipy.linalg.cho_solve((factor, True), y, check_finite=False)
    lower = scipy.linalg.lapack.dpotri(factor, lower=1)[0]
    inverse = np.where(np.tri(len(y), dtype=bool), lower, lower.T)
    value = 0.5 * (y @ solved + len(y) * math.log(2.0 * math.pi)) + np.log(np.diag(factor)).sum()
    slope = 0.5 * (inverse - np.outer(solved, solved))  # of the value, by the covariance
    by_bell = slope * bells
    # Sums of by_bell[i, j] * (scaled[i] - scaled[j])**2, one for each feature.
    squares = 2.0 * (by_bell.sum(axis=0) @ scaled**2 - np.sum(scaled * (by_bell @ scaled), axis=0))
    others = [math.exp(theta[k + 1]) * np.trace(slope)]
    if together is not None:
        others.append(math.exp(theta[k + 2]) * np.sum(slope * together))
    return float(value), np.concatenate([squares, [by_bell.sum()], others])


def _weights(scaled: Array, y: Array, history: Integers, some: Integers, kernel: Kernel) -> Array:
    """Weights (m,) of the rows `some` of `scaled` (n, k), in lengths, fitted to all targets.

    The zeros of histories, of which each row (n,) is of one, are eliminated.
    """
    points = scaled[some]
    total, right = kernel.noise * _bells(points, points), np.zeros(len(some))
    sums = np.zeros((history[-1] + 1, len(some)))  # of the bells in each history
    for start in range(0, len(scaled), _CHUNK):
        rows = slice(start, start + _CHUNK)
        bells = _bells(scaled[rows], points)
        total += bells.T @ bells
        right += bells.T @ y[rows]
        for number in np.unique(history[rows]):
            sums[number] = np.vstack([sums[number], bells[history[rows] == number]]).sum(axis=0)
    if kernel.zero:
        shares = 1.0 / (np.bincount(history) + kernel.noise / kernel.zero)
        total -= sums.T @ (shares[:, None] * sums)
        right -= sums.T @ (shares * np.bincount(history, y))
    jitter = _JITTER * np.trace(total) / len(total)
    while True:  # rounding leaves less where the zeros took most of it
        total[np.diag_indices_from(total)] += jitter
        try:
            return np.asarray(scipy.linalg.solve(total, right, assume_a="pos"))
        except np.linalg.LinAlgError:
            jitter *= 10.0


def _bells(rows: Array, points: Array) -> Array:
    """``exp(-d**2 / 2)`` (n, m) of the distance of every row from every point."""
    square = np.sum(rows**2, axis=1)[:, None] + np.sum(points**2, axis=1) - 2.0 * rows @ points.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0.0)))
