"""Estimators of a jaw: what they share, and the unscented filter and least squares of yan2020."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

import numpy as np
from scipy.optimize import least_squares

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, JointRegressor, Progress
from truejoint.estimators.family import EstimatorData, Family
from truejoint.estimators.filtered import FilterRun, run_filter
from truejoint.estimators.jaw import run as jaw_filter
from truejoint.estimators.jaw.signals import COEFFICIENTS, NEAREST
from truejoint.recordings import Recording
from truejoint.robots.cable_mechanism import Forceps

ERROR_MARGIN: Final = 0.25  # share of the range of errors seen by which (25) may leave it
SMALLEST_DENOMINATOR: Final = 0.3  # that fitting allows on the tube; 1 in the middle of the range

_TUBE: Final = 0.15  # half-width round the curve that the data follow, of the scaled range
_REACH: Final = 1.3  # how far the tube goes on beyond the data
_PENALTY: Final = 30.0  # of a denominator that is short by one, in spreads of the error
_ROWS: Final = 1500  # rows that the search looks at; the last solution uses all
_STARTS: Final = np.vstack([np.zeros(5), np.random.default_rng(0).uniform(-1.0, 1.0, (4, 5))])
TABLE_1: Final = Forceps()
MIN_ROWS: Final = 400  # rows that a fit needs at least: two seconds at 200 Hz
_REVERSAL: Final = 0.05  # of the range that the jaw must come back to count as a reversal
_APART: Final = 10  # times as many rows as usual between two with truth: these are no neighbours


class JawEstimator(JointRegressor):
    """Base of the estimators of one jaw from motor angle and cable displacements.

    Calibrated as the paper does, on an unloaded motion with reversals, which show friction.
    """

    least_rows: ClassVar[int] = MIN_ROWS

    def for_recordings(self, recordings: Sequence[Recording]) -> Self:
        """Unfitted copy for the mechanism that was recorded.

        A parameter that was set to other than Table 1's value stays. Raises CalibrationError for a
        load on the jaw, a sensor that is not installed, and mechanisms that differ, and RobotError
        for one that cannot be.
        """
        inputs = self.family.inputs(self.model_params()) if self.family.inputs else ()
        for recording in recordings:
            if recording.provenance.load > 0.0:
                raise CalibrationError(
                    f"{recording.provenance.source or 'recording'}: a load of "
                    f"{1e3 * recording.provenance.load:g} g on the jaw; {self.name} learns how "
                    "motor and cables relate without one: record the calibration unloaded"
                )
            missing = [name for name in inputs if name not in recording.units]
            if missing:
                raise CalibrationError(
                    f"{recording.provenance.source or 'recording'}: no {' and no '.join(missing)}; "
                    f"{self.name} reads {' and '.join(inputs)}: install the sensor, or choose an "
                    "estimator that does without"
                )
        robots = (recording.robot.mechanism for recording in recordings)
        mechanism, *others = dict.fromkeys(TABLE_1 if m is None else Forceps.of(m) for m in robots)
        if others:
            raise CalibrationError(
                f"the recordings are of {1 + len(others)} different mechanisms; calibrate each by "
                "itself"
            )
        recorded, parameters = mechanism._asdict(), self.get_params(deep=False)
        usual = {n: v for n, v in recorded.items() if parameters.get(n) == getattr(TABLE_1, n)}
        return self.with_params(**usual)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        rows = np.flatnonzero(self._known(y))
        apart = np.diff(rows, prepend=rows[0])  # far where a part of the truth is hidden
        history = np.cumsum(dt == 0.0)[rows] + np.cumsum(apart > _APART * np.median(apart))
        self._check_motion(X[rows], y[rows, 0], history)
        arrays = self._learn_jaw(X, y[:, 0], dt, progress)
        progress(1.0)
        return arrays

    @abstractmethod
    def _learn_jaw(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        """Learn from rows `X` (n, k) and jaw angles `y` (n,), NaN where they are not known."""

    def _check_motion(self, X: Array, y: Array, history: Integers) -> None:
        inputs = self.family.inputs(self.model_params()) if self.family.inputs else ()
        for name, column in (*zip(inputs, X.T, strict=True), ("the jaw's truth", y)):
            check_changes(self.name, name, column)
            check_jumps(self.name, name, column, history)
            longest = longest_standstill(column, X, inputs.index(name) if name in inputs else None)
            if longest > 0.2:
                raise CalibrationError(
                    f"{self.name}: {name} stands still for {100 * longest:.0f} % of the rows while "
                    "the others move on; its sensor is stuck: record the calibration again"
                )
        check_reversals(self.name, "jaw", reversals(y))


@dataclass(eq=False, repr=False, kw_only=True)
class MechanismEstimator(JawEstimator):
    """Base of those that know the mechanism; `calibrate` takes it from the recordings.

    Parameters
    ----------
    gear_ratio, spring_stiffness, wheel_radius, jaw_radius : float
        ``z_i``, ``K_sp`` [N/m], ``R`` [m] and ``r`` [m]; by default those of yan2020, Table 1.
    """

    gear_ratio: float = TABLE_1.gear_ratio
    spring_stiffness: float = TABLE_1.spring_stiffness
    wheel_radius: float = TABLE_1.wheel_radius
    jaw_radius: float = TABLE_1.jaw_radius


def check_changes(estimator: str, name: str, column: Array, how: str = "") -> None:
    """Raise CalibrationError when a signal (n,) stands still all the time."""
    if not np.ptp(column) > 0.0:
        raise CalibrationError(
            f"{estimator}: {name} never changes; move the jaw over its range{how}, and check that "
            "the sensor is connected"
        )


def check_jumps(estimator: str, name: str, column: Array, history: Integers) -> None:
    """Raise CalibrationError when a signal (n,) changes between two rows far more than usual.

    Far more is thirty times what it exceeds in one row of a hundred, and a fiftieth of its range.
    Between rows that differ in their number of `history` (n,) it may: the robot was homed.
    """
    moves = np.abs(np.diff(column)) * (np.diff(history) == 0)
    usual = float(np.quantile(moves, 0.99))
    if moves.max() > max(30.0 * usual, 0.02 * float(np.ptp(column))):
        raise CalibrationError(
            f"{estimator}: {name} jumps between two rows further than it ever moves; check its "
            "sensor and cut the recording before the jump"
        )


def check_reversals(estimator: str, what: str, count: int) -> None:
    """Raise CalibrationError for fewer than two reversals."""
    if count < 2:
        raise CalibrationError(
            f"{estimator}: the {what} reverses {count} times in the training rows; friction shows "
            "only where the motion turns: record a motion there and back, twice"
        )


def usual_dt(dt: Array, average: Callable[[Array], Any] = np.median) -> float:
    """Average of the time between rows [s] within histories; 5 ms where there is only one row."""
    moved = dt[dt > 0.0]
    return float(average(moved)) if len(moved) else 5e-3


def reversals(y: Array) -> int:
    """Count the turns of a motion (n,), ignoring those below a twentieth of its range."""
    band = _REVERSAL * float(np.ptp(y))
    count, direction, extreme = 0, 0, float(y[0])
    for value in y[:: max(1, len(y) // 5000)]:
        if direction >= 0 and value > extreme:
            extreme = float(value)
            direction = direction or (1 if value > y[0] + band else 0)
        elif direction <= 0 and value < extreme:
            extreme = float(value)
            direction = direction or (-1 if value < y[0] - band else 0)
        elif direction != 0 and abs(value - extreme) > band:
            count, direction, extreme = count + 1, -direction, float(value)
    return count


def longest_standstill(column: Array, X: Array, place: int | None) -> float:
    """Longest stretch, of the rows, in which `column` (n,) repeats a value while others move.

    Another signal of `X` (n, k) than its `place` must move by a fifth of its range within it.
    """
    edges = np.concatenate([[0], np.flatnonzero(np.diff(column)) + 1, [len(column)]])
    others = X if place is None else np.delete(X, place, axis=1)
    least = 0.2 * np.ptp(others, axis=0)
    for i in np.argsort(np.diff(edges))[::-1][:20]:
        if (np.ptp(others[edges[i] : edges[i + 1]], axis=0) > least).any():
            return int(edges[i + 1] - edges[i]) / len(column)
    return 0.0


@dataclass(eq=False, repr=False, kw_only=True)
class JawFilter(MechanismEstimator):
    """Unscented filter on the linear model (12): yan2020, (15)-(26).

    The measured speed is the difference of displacements. Friction, which (12) leaves out, is what
    the process noise stands for: it sets how far the filter trusts motor and slider. Since (12) is
    linear, this is a Kalman filter.

    A constant makes up for the error that remains, or the error model (25), fitted to estimate
    minus truth (24). The model is subtracted from the output. (26), as it is printed, adds it to
    the state, which doubles the error.

    Parameters
    ----------
    compensated : bool
        Whether (25) is taken off, in place of a constant.
    drive_stiffness, reset_stiffness : float
        ``K_d`` and ``K_r`` [N/m].
    jaw_inertia, slider_mass : float
        ``J_e`` [kg m2] and ``m_g2`` [kg].
    jaw_friction, slider_friction : float
        Sizes of the friction that (12) neglects [Nm], [N].
    correlation_time : float
        Time for which that friction counts as one draw [s].
    displacement_noise, speed_noise : float
        Standard deviations of what is measured [m], [m/s].
    gear_ratio, spring_stiffness, wheel_radius, jaw_radius : float
        As for `MechanismEstimator`.

    Examples
    --------
    >>> JawFilter(compensated=True).name
    'ukf_compensated'
    """

    family: ClassVar[Family] = jaw_filter.FAMILY
    compensated: bool = False
    drive_stiffness: float = 14e3
    reset_stiffness: float = 14e3
    jaw_inertia: float = 1e-6
    slider_mass: float = 0.05
    jaw_friction: float = 1.5e-3
    slider_friction: float = 0.2
    correlation_time: float = 5e-3
    displacement_noise: float = 4e-7
    speed_noise: float = 1e-4

    def states(self, X: Array, dt: Array) -> FilterRun:
        """Run the bare filter, (23) without any compensation, over rows `X` (n, 2) of histories.

        `dt` (n,) [s] is the time since the row before. The covariance is what it states of itself,
        which holds as far as friction is the white noise that it takes it for.
        """
        params = {**self.model_params(), "compensated": False}
        return run_filter(EstimatorData(self.family.name, params, {"constant": np.zeros(1)}), X, dt)

    def _learn_jaw(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        has_truth = np.isfinite(y)
        error = self.states(X, dt).x[has_truth, 0] - y[has_truth]
        progress(0.3)
        if self.compensated:
            return fit_rational(X[has_truth, 0], X[has_truth, 1], error)
        return {"constant": np.array([-float(np.mean(error))])}


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

    Examples
    --------
    >>> CableLeastSquares(compensated=True).name
    'lsm_compensated'
    """

    family: ClassVar[Family] = jaw_filter.LEAST_SQUARES
    intercept: bool = False
    compensated: bool = False

    def _learn_jaw(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        has_truth, (drive, reset) = np.isfinite(y), np.ascontiguousarray(X[:, -2:].T)
        observed = np.empty((len(X), jaw_filter.OBSERVED))
        jaw_filter.observe_rows(dt, drive, reset, observed)
        rows = observed[has_truth]
        columns = np.column_stack([rows, np.ones(len(rows))]) if self.intercept else rows
        # Columns from 1e-3 m to 10 m/s2 are brought to one length.
        length = np.linalg.norm(columns, axis=0)
        inverse = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
        coefficients = np.linalg.lstsq(columns * inverse, y[has_truth], rcond=1e-12)[0] * inverse
        solution = np.append(coefficients, 0.0)
        progress(0.5)
        arrays = {"coef": solution[: rows.shape[1]].copy(), "constant": solution[7:8].copy()}
        if self.compensated:
            error = rows @ arrays["coef"] + arrays["constant"] - y[has_truth]
            arrays |= fit_rational(X[has_truth, 0], reset[has_truth], error)
        return arrays


def fit_rational(motor: Array, reset: Array, error: Array) -> Arrays:
    """Fit (25) to the error (n,) [rad] of an estimate at motor angles [rad] and displacements [m].

    Variable projection: for a given denominator the numerator is a linear least-squares problem, so
    only five coefficients are searched (Golub and Pereyra 1973). The search has five starts, and a
    penalty keeps the denominator above `SMALLEST_DENOMINATOR` on a tube round the data. Gives what
    `ERROR_SHAPES` names: scales are inverse largest values, the range is that of the errors, wider
    by a quarter on each side. Raises CalibrationError for fewer than 110 rows, or a variable that
    does not vary.
    """
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
    u, v = motor * scale[0], reset * scale[1]
    denominator = _search(u, v, error)
    design = _numerator_terms(u, v) / (1.0 + _denominator_terms(u, v) @ denominator)[:, None]
    p = np.empty(COEFFICIENTS)
    p[0::2], p[1::2] = np.linalg.lstsq(design, error, rcond=None)[0], denominator
    return {**arrays, "error_coef": p}


def _search(u: Array, v: Array, error: Array) -> Array:
    """Find the denominator (5,) that leaves least once the numerator is eliminated."""
    rows = slice(None, None, max(1, len(error) // _ROWS))
    shown = np.linspace(-_REACH, _REACH, 27)
    curve = np.polynomial.Polynomial.fit(u[rows], v[rows], 1)(shown)
    tube = np.vstack([_denominator_terms(shown, curve + side) for side in (-_TUBE, 0.0, _TUBE)])
    u, v, error = u[rows], v[rows], error[rows]
    numerator, denominator = _numerator_terms(u, v), _denominator_terms(u, v)
    weight = _PENALTY * max(float(np.std(error)) * np.sqrt(len(error)), 1e-12)

    def projected(d: Array) -> tuple[Array, Array, Array]:
        below = 1.0 + denominator @ d
        below = np.where(np.abs(below) < NEAREST, NEAREST, below)
        basis = np.linalg.qr(numerator / below[:, None])[0]
        return below, basis, basis @ (basis.T @ error)

    def residuals(d: Array) -> Array:
        # The error left by the best numerator, and what the tube lacks in denominator.
        short = np.maximum(SMALLEST_DENOMINATOR - (1.0 + tube @ d), 0.0)
        return np.concatenate([error - projected(d)[2], weight * short])

    def jacobian(d: Array) -> Array:
        # Kaufman's form: the numerator's own change with the denominator left out.
        below, basis, fitted = projected(d)
        change = denominator * (fitted / below)[:, None]
        active = 1.0 + tube @ d < SMALLEST_DENOMINATOR
        slopes = change - basis @ (basis.T @ change)
        return np.vstack([slopes, -weight * tube * active[:, None]])

    solutions = [
        least_squares(residuals, start, jacobian, x_scale="jac", max_nfev=200) for start in _STARTS
    ]
    return np.asarray(min(solutions, key=lambda solution: float(solution.cost)).x)


def _numerator_terms(u: Array, v: Array) -> Array:
    return np.column_stack([np.ones_like(u), u, v, u * u, v * v, u * v])


def _denominator_terms(u: Array, v: Array) -> Array:
    return np.column_stack([u, v, u * u, v * v, u * u * v])
