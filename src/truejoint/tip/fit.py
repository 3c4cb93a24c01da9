"""The fit of corrections and of a frame's pose to points of the tool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import CalibrationError
from truejoint.tip.rows import Equations, TipPrior, TipRows, TipState

HUBER: Final = 2.8
"""Whitened residuals longer than this get Huber's weight; one good residual in twenty is."""
GATE: Final = 4.5
"""Points further than this from what the others expect [deviations] are outliers. In sets of 30
good points, one set in two hundred has such a point."""
_MOST_STEPS: Final = 50
_SETTLED: Final = 1e-4  # of a parameter's standard deviation
_OPEN: Final = 1e-13  # eigenvalue of the scaled normal equations below which a direction is open


@dataclass(frozen=True, eq=False)
class TipFit:
    """Parameters that fit the points, and how surely."""

    state: TipState
    covariance: Array  # (n, n), of all parameters; zero for those that were held
    residual: Array  # (m, 3), predicted less stated points [m]
    # (m,), distance of each point from what the others expect, in its standard deviations
    distance: Array
    weight: Array  # (m,), with which each point counted; 0 for an outlier
    # Sum of squares of all whitened residuals, the prior's included; expected to be `freedom`
    misfit: float
    freedom: int  # Residuals less parameters that are estimated
    # Logarithm of the restricted likelihood of the points, by which priors and standard deviations
    # are chosen
    evidence: float

    @property
    def sd(self) -> Array:
        """Standard deviations (n,) of the parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def left_out(self) -> Mask:
        """Which points (m,) are outliers."""
        return np.asarray(self.weight == 0.0)


class Whitened(NamedTuple):
    """Equations in standard deviations, with a weight for each row."""

    equations: Equations
    whitening: Array  # (m, d, d)
    residual: Array  # (m, d)
    jacobian: Array  # (m, d, n)
    weight: Array  # (m,)

    @classmethod
    def of(cls, equations: Equations, whitening: Array, weight: Array | None = None) -> Whitened:
        """Whiten equations; without a `weight` (m,) Huber's of the residuals' lengths."""
        residual = np.einsum("mij,mj->mi", whitening, equations.residual)
        if weight is None:
            weight = huber(np.linalg.norm(residual, axis=1))
        return cls(equations, whitening, residual, whitening @ equations.by_parameter, weight)


class Settled(NamedTuple):
    """Where Gauss-Newton steps lead, with the equations and normal matrix of the last step."""

    state: TipState
    whitened: Whitened
    normal: Array  # (n, n)
    is_settled: bool


def gauss_newton(
    prior: TipPrior,
    state: TipState,
    whiten: Callable[[TipState], Whitened],
    *,
    most_steps: int = _MOST_STEPS,
    tolerance: float = _SETTLED,
) -> Settled:
    """Step from `state` until no free parameter moves by more than a share of its deviation.

    `whiten` gives the weighted equations at a state. Raises CalibrationError if points and prior
    leave a direction of the parameters open.
    """
    free, is_settled = np.flatnonzero(prior.free), False
    for _ in range(most_steps):
        whitened = whiten(state)
        normal, gradient = normal_equations(prior, state, whitened)
        inverse = inverted(normal[np.ix_(free, free)], prior, free)
        step = np.zeros(len(prior.free))
        step[free] = -inverse @ gradient[free]
        state = state.moved(step)
        is_settled = bool((np.abs(step[free]) <= tolerance * np.sqrt(np.diag(inverse))).all())
        if is_settled:
            break
    return Settled(state, whitened, normal, is_settled)


def normal_equations(prior: TipPrior, state: TipState, whitened: Whitened) -> tuple[Array, Array]:
    """Give the normal matrix (n, n) and gradient (n,) of the weighted rows and the prior."""
    jacobian = whitened.jacobian
    flat = jacobian.reshape(-1, jacobian.shape[2])
    weighted = (whitened.weight[:, None, None] * jacobian).reshape(flat.shape).T
    gradient = prior.precision @ state.minus(prior.state) + weighted @ whitened.residual.ravel()
    return prior.precision + weighted @ flat, gradient


def inverted(normal: Array, prior: TipPrior, free: Integers) -> Array:
    """Invert the normal matrix of the `free` parameters, which are of very different size.

    Raises CalibrationError naming parameters that stay open.
    """
    size = np.sqrt(np.diag(normal))
    if not (size > 0.0).all():
        name = prior.state.names[free[int(np.argmin(size))]]
        raise CalibrationError(f"the points say nothing of {name}")
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    if values[0] < _OPEN * values[-1]:
        share = np.abs(vectors[:, 0])
        names = prior.state.names
        open_ = [names[free[i]] for i in np.argsort(-share)[:4] if share[i] > 0.2]
        raise CalibrationError(
            f"the points leave open {', '.join(open_)} together; touch more, from other sides, or "
            "state what is known"
        )
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))


def fit_rows(
    rows: TipRows, prior: TipPrior, *, gate: float = GATE, start: TipState | None = None
) -> TipFit:
    """Fit corrections and pose to points of the tool: Gauss-Newton, Huber's weights, priors.

    After the robust fit, points further than `gate` standard deviations from what all others
    expect are dropped as outliers, the worst first, and the rest is fitted again. `TipFit.weight`
    names them. The fit begins at `start`, by default at the prior's state; held parameters are
    always the prior's.

    Raises
    ------
    CalibrationError
        If points and prior leave a direction of the parameters open, if the fit does not settle,
        or if more than a fifth of the points, and more than one, are outliers: among few points,
        the two that are dropped may be the good ones.
    """
    inlier = np.ones(len(rows), dtype=np.bool_)
    state = prior.state
    if start is not None:
        state = state.moved(np.where(prior.free, start.minus(state), 0.0))
    while True:
        fit = _fit_inliers(rows, prior, state, inlier)
        distance = np.where(inlier, fit.distance, 0.0)
        worst = int(np.argmax(distance))
        if not distance[worst] > gate:
            break
        inlier[worst] = False
        if (~inlier).sum() > max(1, len(rows) // 5):
            raise CalibrationError(
                f"{(~inlier).sum()} of {len(rows)} points do not fit the others: is this the "
                "block that was touched, the arm that touched it, and its pose of this day?"
            )
        state = fit.state
    # A point that was dropped beside a worse one may fit after all.
    back = ~inlier & (fit.distance <= gate)
    return _fit_inliers(rows, prior, fit.state, inlier | back) if back.any() else fit


def _whiten(rows: TipRows, inlier: Mask, state: TipState) -> Whitened:
    """Equations in deviations that the rows state; outliers weigh nothing."""
    equations = rows.equations(state)
    white = Whitened.of(equations, equations.whitening(rows.joint_sd, np.array(rows.point_sd)))
    return white._replace(weight=white.weight * inlier)


def huber(distance: Array) -> Array:
    """Huber's weights (m,) of distances (m,) in standard deviations."""
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(distance, 1e-300)))


def _fit_inliers(rows: TipRows, prior: TipPrior, state: TipState, inlier: Mask) -> TipFit:
    """Fit to the inliers with Huber's weights, and judge every point."""
    free = np.flatnonzero(prior.free)
    settled = gauss_newton(prior, state, lambda at: _whiten(rows, inlier, at))
    if not settled.is_settled:
        raise CalibrationError(
            "the points do not settle on one correction; are they of this arm and this frame?"
        )
    state = settled.state
    white = _whiten(rows, inlier, state)
    jacobian, residual, weight = white.jacobian, white.residual, white.weight
    normal, _ = normal_equations(prior, state, white)
    inverse = inverted(normal[np.ix_(free, free)], prior, free)
    covariance = np.zeros_like(normal)
    covariance[np.ix_(free, free)] = inverse
    # What the fit of the others expects of each point: its own share is taken out of the normal
    # equations (Cook and Weisberg, Residuals and Influence in Regression, 1982, ch. 2).
    leverage = jacobian @ covariance @ jacobian.transpose(0, 2, 1)
    without = np.eye(3) - weight[:, None, None] * leverage + 1e-9 * np.eye(3)
    deleted = np.linalg.solve(without, residual[:, :, None])
    spread = np.eye(3) + np.linalg.solve(without, leverage)
    distance = np.sqrt((deleted * np.linalg.solve(spread, deleted)).sum(axis=(1, 2)))
    off = prior.state.minus(state)
    misfit = float((weight[:, None] * residual**2).sum() + off @ prior.precision @ off)
    log_size = float(np.log(np.linalg.det(white.whitening[inlier])).sum())
    evidence = log_size - 0.5 * misfit + 0.5 * float(np.linalg.slogdet(inverse)[1])
    stated = np.flatnonzero(np.diag(prior.precision))
    evidence += 0.5 * float(np.linalg.slogdet(prior.precision[np.ix_(stated, stated)])[1])
    rank = int(np.linalg.matrix_rank(prior.precision, hermitian=True))
    freedom = 3 * int(inlier.sum()) + rank - len(free)
    points = white.equations.residual
    return TipFit(state, covariance, points, distance, weight, misfit, freedom, evidence)
