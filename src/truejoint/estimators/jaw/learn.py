"""The estimators of yan2020 for the jaw: unscented filter, least squares, and their error model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Final, Self

import numpy as np
from scipy.optimize import Bounds, differential_evolution, least_squares, minimize

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.family import EstimatorData, Family, Params, Rule
from truejoint.estimators.jaw import least_squares as cable_least_squares
from truejoint.estimators.jaw import run as jaw_filter
from truejoint.estimators.jaw.base import JawEstimator, median_dt
from truejoint.estimators.jaw.dynamics import ForcepsModel, injection_gain, steady_gain
from truejoint.estimators.jaw.run import MECHANISM_NAMES, NOISE_NAMES, FilterNoise
from truejoint.estimators.jaw.signals import COEFFICIENTS, FIT_METHODS, NEAREST
from truejoint.filters import FilterResult

_OBSERVED: Final = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])

ERROR_MARGIN: Final = 0.25  # share of the range of errors seen by which (25) may leave it
SMALLEST_DENOMINATOR: Final = 0.3  # that fitting allows on the tube; 1 in the middle of the range

_TUBE: Final = 0.15  # half-width round the curve that the data follow, of the scaled range
_REACH: Final = 1.3  # how far the tube goes on beyond the data
_PENALTY: Final = 30.0  # of a denominator that is short by one, in spreads of the error
_ROWS: Final = 1500  # rows that the search looks at; the last solution uses all
_BOUND: Final = 3.0  # on the five denominator coefficients in the global search
_STARTS: Final = np.vstack([np.zeros(5), np.random.default_rng(0).uniform(-1.0, 1.0, (4, 5))])


@dataclass(eq=False, repr=False)
class JawFilter(JawEstimator):
    """Unscented filter on the linear model (12): yan2020, (15)-(26).

    The measured speed is the difference of displacements. Friction, which (12) leaves out, is what
    the process noise stands for: it sets how far the filter trusts motor and slider. Since (12) is
    linear, this is a Kalman filter.

    What is left of the error is made up for by a constant, or by the error model (25), fitted to
    estimate minus truth (24). (26) adds that to the state; since it is the error, it must be
    subtracted, and since the next measurement takes part of it back, what is added must be divided
    by the loop's gain ``g`` for the whole of it to show.

    Parameters
    ----------
    compensation : {"constant", "output", "scaled", "signed", "literal"}
        A constant; or (25): subtracted from the output only; subtracted in the loop and divided by
        ``g``; subtracted in the loop; or added in the loop as (26) is printed.
    mechanism : ForcepsModel
        What the filter takes the forceps for; Table 1 by default.
    noise : FilterNoise
        What it does not know of it.
    lambda_ : float
        ``lambda`` of (15), above -4.
    fit_method : {"projection", "quasi_newton", "global"}
        How (25) is fitted: see `fit_rational`.

    Examples
    --------
    >>> JawFilter(compensation="output").set_params(gear_ratio=50.0).mechanism.gear_ratio
    50.0
    """

    family: ClassVar[Family] = jaw_filter.FAMILY
    training: ClassVar[Mapping[str, Rule]] = {
        "mechanism": Rule(lambda value: isinstance(value, ForcepsModel), "a ForcepsModel"),
        "noise": Rule(lambda value: isinstance(value, FilterNoise), "a FilterNoise"),
    }
    compensation: str = "constant"
    mechanism: ForcepsModel = ForcepsModel()  # noqa: RUF009  # frozen
    noise: FilterNoise = FilterNoise()  # noqa: RUF009
    lambda_: float = -1.0
    fit_method: str = "projection"

    def set_params(self, **params: Any) -> Self:
        """Set parameters, those of mechanism and noise by their own names too."""
        for part, names in (("mechanism", MECHANISM_NAMES), ("noise", NOISE_NAMES)):
            given = {name: params.pop(name) for name in names if name in params}
            if given:
                params[part] = replace(params.get(part, getattr(self, part)), **given)
        super().set_params(**params)
        return self

    def model_params(self) -> Params:
        """Parameters as the family knows them: mechanism and noise by their own names."""
        own = {n: getattr(self, n) for n in ("compensation", "lambda_", "fit_method")}
        return {**asdict(self.mechanism), **asdict(self.noise), **own}

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Unfitted estimator of the parameters of its family."""
        own = {n: params[n] for n in ("compensation", "lambda_", "fit_method")}
        return cls(
            mechanism=jaw_filter.mechanism_of(params), noise=jaw_filter.noise_of(params), **own
        )

    def loop_gain(self, dt: float) -> float:
        """``g`` of `jaw_dynamics.injection_gain` for rows `dt` [s] apart."""
        noise = self.noise
        density = self.mechanism.noise_density(
            noise.jaw_friction, noise.slider_friction, noise.correlation_time
        )
        transition, _gain, covariance = self.mechanism.discrete(density, dt)
        kalman = steady_gain(transition, covariance, _OBSERVED, noise.sensor)
        return injection_gain(transition, _OBSERVED, kalman)

    def states(self, X: Array, dt: Array) -> FilterResult:
        """States, covariances, innovations and NIS of the bare filter over one history.

        Of rows `X` (n, 2), `dt` (n,) [s] after those before; the covariance is what it states of
        itself, which holds as far as friction is the white noise that it takes it for.
        """
        speed = np.divide(
            np.diff(X[:, 1], prepend=X[0, 1]), dt, where=dt > 0.0, out=np.full(len(X), np.nan)
        )
        motor = np.concatenate([X[:1, 0], X[:-1, 0]])
        return jaw_filter.jaw_filter(self.model_params()).run(
            np.column_stack([X[:, 1], speed]),
            np.column_stack([motor, np.zeros(len(X))]),
            x0=self.mechanism.at_rest(*X[0]),
            P0=jaw_filter.rest_spread(self.mechanism, self.noise),
            dt=dt,
        )

    def filtered(self, X: Array, dt: Array) -> Array:
        """Angle of the bare filter (n,) [rad]: (23) without any compensation."""
        params = {**self.model_params(), "compensation": "constant"}
        data = EstimatorData(self.family.name, params, {"constant": np.zeros(1)})
        return JawFilter.from_data(data, 2, 1).evaluate(X, dt)[:, 0]

    def _learn_jaw(self, X: Array, y: Array, dt: Array, known: Flags, progress: Progress) -> Arrays:
        error = self.filtered(X, dt)[known] - y[known]
        progress(0.3)
        if self.compensation == "constant":
            return {"constant": np.array([-float(np.mean(error))])}
        arrays = fit_rational(X[known, 0], X[known, 1], error, self.fit_method)
        return arrays | {"loop_gain": np.array([self.loop_gain(median_dt(dt))])}


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


def fit_rational(motor: Array, reset: Array, error: Array, method: str = "projection") -> Arrays:
    """Fit (25) to the error (n,) [rad] of an estimate at motor angles [rad] and displacements [m].

    Gives ``scale`` (2,), the inverse largest motor angle and displacement, ``error_coef`` (11,),
    p_1 to p_11 for the two times these, and ``error_range`` (2,) [rad], within which it is
    believed: that of the errors given, wider by a quarter. ``projection``: given the denominator
    the numerator is a linear least-squares problem, so only five coefficients are searched (Golub
    and Pereyra 1973), from five starts, with a penalty that keeps the denominator above
    `SMALLEST_DENOMINATOR` on a tube round the data. ``global``: the same by differential evolution.
    ``quasi_newton``: all eleven by BFGS from zero in the units of the data, unconstrained, as the
    paper says it did. Raises CalibrationError for fewer than 110 rows, a variable that does not
    vary, or an unknown method.
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
    margin = ERROR_MARGIN * np.ptp(error)
    arrays = {"scale": scale, "error_range": np.array([error.min() - margin, error.max() + margin])}
    if method == "quasi_newton":
        return {**arrays, "error_coef": _quasi_newton(motor, reset, error, scale)}
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
    return {**arrays, "error_coef": p}


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
