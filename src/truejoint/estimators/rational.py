"""The rational error model (25) of yan2020 and three ways to fit it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import Bounds, differential_evolution, least_squares, minimize

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays
from truejoint.models.jaw import COEFFICIENTS, FIT_METHODS, NEAREST

SMALLEST_DENOMINATOR: Final = 0.3  # that fitting allows on the tube; 1 in the middle of the range

_TUBE: Final = 0.15  # half-width round the curve that the data follow, of the scaled range
_REACH: Final = 1.3  # how far the tube goes on beyond the data
_PENALTY: Final = 30.0  # of a denominator that is short by one, in spreads of the error
_ROWS: Final = 1500  # rows that the search looks at; the last solution uses all
_BOUND: Final = 3.0  # on the five denominator coefficients in the global search
_STARTS: Final = np.vstack([np.zeros(5), np.random.default_rng(0).uniform(-1.0, 1.0, (4, 5))])


def fit_rational(motor: Array, reset: Array, error: Array, method: str = "projection") -> Arrays:
    """Fit (25) to the error (n,) [rad] of an estimate at motor angles [rad] and displacements [m].

    Gives ``scale`` (2,), the inverse largest motor angle [1/rad] and displacement [1/m], and
    ``error_coef`` (11,), p_1 to p_11 for the two variables times these.

    ``projection``: given the denominator the numerator is a linear least-squares problem, so only
    five coefficients are searched (Golub and Pereyra 1973), with a penalty that keeps the
    denominator above `SMALLEST_DENOMINATOR` on a tube round the data; the best of five starts.
    ``global``: the same problem by differential evolution. ``quasi_newton``: all eleven by BFGS
    from zero in the units of the data, unconstrained, as the paper says it did. Raises
    CalibrationError for fewer than 110 rows, a variable that does not vary, or an unknown method.
    """
    if method not in FIT_METHODS:
        raise CalibrationError(f"fit method {method!r:.60}; choose one of {', '.join(FIT_METHODS)}")
    if len(error) < 10 * COEFFICIENTS:
        raise CalibrationError(
            f"{len(error)} rows for the {COEFFICIENTS} coefficients of an error model; it needs "
            f"{10 * COEFFICIENTS}"
        )
    if np.ptp(motor) == 0.0 or np.ptp(reset) == 0.0:
        raise CalibrationError(
            "motor angle or reset cable never move, so an error model has nothing to depend on"
        )
    scale = 1.0 / np.array([np.abs(motor).max(), np.abs(reset).max()])
    if method == "quasi_newton":
        return {"scale": scale, "error_coef": _quasi_newton(motor, reset, error, scale)}
    u, v = motor * scale[0], reset * scale[1]
    problem = _Projection.of(u, v, error)
    found = [
        least_squares(problem.residuals, start, problem.jacobian, x_scale="jac", max_nfev=200)
        for start in (_global_search(problem) if method == "global" else _STARTS)
    ]
    best = min(found, key=lambda solution: float(solution.cost))
    design = _numerator_terms(u, v) / (1.0 + _denominator_terms(u, v) @ best.x)[:, None]
    p = np.empty(COEFFICIENTS)
    p[0::2], p[1::2] = np.linalg.lstsq(design, error, rcond=None)[0], best.x
    return {"scale": scale, "error_coef": p}


def _global_search(problem: _Projection) -> Array:
    def cost(d: Array) -> float:
        return float(np.sum(problem.residuals(d) ** 2))

    bounds = Bounds(np.full(5, -_BOUND), np.full(5, _BOUND))
    found = differential_evolution(
        cost, bounds, seed=0, tol=1e-8, popsize=10, maxiter=300, polish=False
    )
    return np.array([found.x])


@dataclass(frozen=True, eq=False)
class _Projection:
    """What is left of the problem when the numerator is eliminated."""

    above: Array  # (m, 6)
    below: Array  # (m, 5)
    error: Array  # (m,)
    tube: Array  # (k, 5), denominator terms round the data
    weight: float

    @classmethod
    def of(cls, u: Array, v: Array, error: Array) -> _Projection:
        rows = slice(None, None, max(1, len(error) // _ROWS))
        shown = np.linspace(-_REACH, _REACH, 27)
        curve = np.polynomial.Polynomial.fit(u[rows], v[rows], 1)(shown)
        tube = [_denominator_terms(shown, curve + side) for side in (-_TUBE, 0.0, _TUBE)]
        spread = float(np.std(error[rows])) * np.sqrt(len(error[rows]))
        return cls(
            _numerator_terms(u[rows], v[rows]),
            _denominator_terms(u[rows], v[rows]),
            error[rows],
            np.vstack(tube),
            _PENALTY * max(spread, 1e-12),
        )

    def residuals(self, d: Array) -> Array:
        """Error left (m,) by the best numerator, and what the tube lacks in denominator (k,)."""
        basis = np.linalg.qr(self.above / self._below(d)[:, None])[0]
        left = self.error - basis @ (basis.T @ self.error)
        short = np.maximum(SMALLEST_DENOMINATOR - (1.0 + self.tube @ d), 0.0)
        return np.concatenate([left, self.weight * short])

    def jacobian(self, d: Array) -> Array:
        """Kaufman's form (m + k, 5): the numerator's own change with the denominator left out."""
        below = self._below(d)
        basis = np.linalg.qr(self.above / below[:, None])[0]
        fitted = basis @ (basis.T @ self.error)
        change = self.below * (fitted / below)[:, None]
        left = change - basis @ (basis.T @ change)
        active = 1.0 + self.tube @ d < SMALLEST_DENOMINATOR
        return np.vstack([left, -self.weight * self.tube * active[:, None]])

    def _below(self, d: Array) -> Array:
        below = 1.0 + self.below @ d
        return np.where(np.abs(below) < NEAREST, NEAREST, below)


def _quasi_newton(motor: Array, reset: Array, error: Array, scale: Array) -> Array:
    above, below = _numerator_terms(motor, reset), _denominator_terms(motor, reset)

    def cost(p: Array) -> tuple[float, Array]:
        denominator = 1.0 + below @ p[1::2]
        model = (above @ p[0::2]) / denominator
        left = model - error
        gradient = np.empty(COEFFICIENTS)
        gradient[0::2] = 2.0 * (above / denominator[:, None]).T @ left
        gradient[1::2] = -2.0 * (below * (model / denominator)[:, None]).T @ left
        return float(left @ left), gradient

    found = minimize(cost, np.zeros(COEFFICIENTS), jac=True, method="BFGS")
    u, v = 1.0 / scale  # from coefficients in rad and m to those of the scaled variables
    change = [1.0, u, u, v, v, u * u, u * u, v * v, v * v, u * u * v, u * v]
    return np.asarray(found.x * np.array(change))


def _numerator_terms(u: Array, v: Array) -> Array:
    return np.column_stack([np.ones_like(u), u, v, u * u, v * v, u * v])


def _denominator_terms(u: Array, v: Array) -> Array:
    return np.column_stack([u, v, u * u, v * v, u * u * v])
