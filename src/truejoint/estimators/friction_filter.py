"""An unscented filter that carries friction and the external load in its state.

Slider, cables and jaw hold friction that depends on which way they last moved. A few elastoplastic
elements, each a bristle that bends with the reset cable's motion until it slides, stand for it;
their deflections and the load's torque are the state. The reset cable's displacement drives them,
and what the motor's side then reads, against what it should, corrects them: fast and small as
friction, slow and lasting as a load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.base import Progress
from truejoint.estimators.jaw import MOTOR, RESET, JawEstimator
from truejoint.estimators.play import ridge
from truejoint.estimators.sequence import regular_steps
from truejoint.filters import FilterResult, FilterState
from truejoint.models.friction_filter import DEGREE, friction_filter, friction_prior
from truejoint.models.jaw_kernels import bank_rows
from truejoint.robots.forceps_mechanism import TABLE_1

Array = NDArray[np.float64]

WIDTHS: Final = (4e-6, 12e-6, 40e-6, 120e-6)
"""How far each element bends before it slides [m] of the reset cable."""
_PENALTY: Final = 1e-5


@dataclass
class FrictionMemory:
    """What the filter remembers between rows."""

    state: FilterState | None = None
    reset: float = 0.0


@dataclass(frozen=True, eq=False)
class JawStates:
    """Everything that the filter says about a record.

    Attributes
    ----------
    angle, angle_deviation : ndarray, shape (n,)
        Jaw angle [rad], and its standard deviation: of the state, and of what the model misses.
    load, load_deviation : ndarray, shape (n,)
        Torque from outside [Nm], positive where it opens the jaw, and its standard deviation as
        the filter has it; friction at the jaw that did not turn round is not in it.
    """

    angle: Array
    angle_deviation: Array
    load: Array
    load_deviation: Array


class FrictionFilter(JawEstimator):
    """Unscented filter with friction and external load in its state; past yan2020.

    Fitted to an unloaded motion: the jaw's angle and the motor's side, each as a polynomial in
    ``x2`` and weights of the elements.

    Parameters
    ----------
    drive_stiffness : float
        ``K_d`` [N/m], which turns stretch into torque; see `stiffness.identify_stiffness`.
    load_drift : float
        How fast a load may change [Nm per square root of a second].
    friction_drift : float
        How fast friction leaves what the elements say [share of it per square root of a second].
    error_time : float
        Time over which the motor side's misfit stays the same [s]: rows closer than that tell
        little new.
    widths : tuple of float
        How far each element bends before it slides [m].
    gear_ratio, wheel_radius, jaw_radius : float
        ``z_i``, ``R``, ``r`` [m].
    """

    family: ClassVar[str] = "ukf_friction"
    inputs: ClassVar[tuple[str, ...]] = (MOTOR, RESET)

    def __init__(
        self,
        drive_stiffness: float = 14e3,
        load_drift: float = 2e-3,
        friction_drift: float = 0.02,
        error_time: float = 0.1,
        widths: tuple[float, ...] = WIDTHS,
        gear_ratio: float = TABLE_1.gear_ratio,
        wheel_radius: float = TABLE_1.wheel_radius,
        jaw_radius: float = TABLE_1.jaw_radius,
    ) -> None:
        self.drive_stiffness = drive_stiffness
        self.load_drift = load_drift
        self.friction_drift = friction_drift
        self.error_time = error_time
        self.widths = widths
        self.gear_ratio = gear_ratio
        self.wheel_radius = wheel_radius
        self.jaw_radius = jaw_radius

    def states(self, X: Array, steps: Array) -> JawStates:
        """Angle and load in every row, each from the rows up to it.

        Parameters
        ----------
        X : ndarray, shape (n, 2)
        steps : ndarray, shape (n,)
            Time since the row before [s], 0 where a history starts.
        """
        angle, spread, load, deviation = np.empty((4, len(X)))
        for rows, result in self._pieces(X, steps):
            angle[rows] = self._angle(result.x, X[rows, 1])
            spread[rows] = self._angle_deviation(result.P)
            load[rows] = result.x[:, -1]
            deviation[rows] = np.sqrt(result.P[:, -1, -1])
        return JawStates(angle, spread, load, deviation)

    def smoothed(self, X: Array, steps: Array) -> JawStates:
        """As `states`, each from all rows before and after it: not causal."""
        angle, spread, load, deviation = np.empty((4, len(X)))
        for rows, result in self._pieces(X, steps):
            smooth = self._filter.smooth(result)
            angle[rows] = self._angle(smooth.x, X[rows, 1])
            spread[rows] = self._angle_deviation(smooth.P)
            load[rows] = smooth.x[:, -1]
            deviation[rows] = np.sqrt(np.maximum(smooth.P[:, -1, -1], 0.0))
        return JawStates(angle, spread, load, deviation)

    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, 2) in the order of time."""
        return self.states(X, regular_steps(len(X)) if steps is None else steps).angle[:, None]

    def start(self) -> FrictionMemory:
        """Memory before the first row."""
        return FrictionMemory()

    def step(self, state: FrictionMemory, interval: float, row: Array) -> Array:
        """Jaw angle (1,) [rad] of one row; see `SequenceRegressor.step`."""
        reset = float(row[1])
        moved = reset - state.reset
        if state.state is None or interval == 0.0:
            state.state = self._filter.initial_state(*self._prior())
            moved, interval = 0.0, 0.0
        drive = float(row[0]) * (self.wheel_radius / self.gear_ratio)
        self._filter.step(state.state, (drive,), (moved, reset), interval)
        state.reset = reset
        return self._angle(state.state.x[None], row[1:])

    def to_arrays(self) -> dict[str, Array]:
        """Constants, powers and weights of angle [rad] and drive [m], and what scales them.

        ``misfit`` (2,) is the standard deviation of what they miss of the drive and of the angle.
        """
        return {
            "angle": self.angle_,
            "drive": self.drive_,
            "scale": self.scale_,
            "misfit": self.misfit_,
            "interval": self.interval_,
        }

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.angle_, self.drive_ = arrays["angle"], arrays["drive"]
        self.scale_, self.misfit_ = arrays["scale"], arrays["misfit"]
        self.interval_ = arrays["interval"]
        self._prepare()

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        reset = np.ascontiguousarray(X[:, 1])
        drive = X[:, 0] * (self.wheel_radius / self.gear_ratio)
        self.scale_ = np.array([1.0 / np.abs(reset).max()])
        columns = np.empty((len(X), DEGREE + len(self.widths)))
        widths = np.array(self.widths, dtype=np.float64)
        bank_rows(steps, reset, float(self.scale_[0]), DEGREE, widths, columns)
        self.angle_ = _stacked(columns[known], y[known])
        self.drive_ = _stacked(columns[known], drive[known])
        progress(0.7)
        sides = ((drive, self.drive_), (y, self.angle_))
        left = [side - (w[0] + columns @ w[1:]) for side, w in sides]
        self.misfit_ = np.maximum([np.sqrt(np.mean(e[known] ** 2)) for e in left], 1e-9)
        moved = steps[steps > 0.0]
        self.interval_ = np.array([float(np.median(moved)) if len(moved) else 5e-3])
        self._prepare()

    def _prepare(self) -> None:
        self._filter = friction_filter(self.get_params(), self.to_arrays())

    def _pieces(self, X: Array, steps: Array) -> list[tuple[slice, FilterResult]]:
        """Filter each history on its own."""
        drive = X[:, :1] * (self.wheel_radius / self.gear_ratio)
        reset = X[:, 1]
        edges = [*np.flatnonzero(steps == 0.0).tolist(), len(X)]
        mean, covariance = self._prior()
        pieces = []
        for first, last in pairwise(edges):
            rows = slice(first, last)
            control = np.column_stack([np.diff(reset[rows], prepend=reset[first]), reset[rows]])
            result = self._filter.run(drive[rows], control, x0=mean, P0=covariance, dt=steps[rows])
            pieces.append((rows, result))
        return pieces

    def _prior(self) -> tuple[Array, Array]:
        return friction_prior(len(self.widths))

    def _angle_deviation(self, P: Array) -> Array:
        """Tell how far off the angle may be (n,) [rad], for states of covariances `P` (n, k, k)."""
        weights = self.angle_[1 + DEGREE :]
        variance = np.einsum("i,nij,j->n", weights, P[:, :-1, :-1], weights)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0) + self.misfit_[1] ** 2))

    def _angle(self, x: Array, reset: Array) -> Array:
        """Jaw angle (n,) [rad] of states (n, k) and displacements (n,) [m]."""
        place = reset * self.scale_[0]
        angle = np.full(len(reset), self.angle_[0])
        power = np.ones(len(reset))
        for weight in self.angle_[1 : 1 + DEGREE]:
            power = power * place
            angle = angle + weight * power
        for i, weight in enumerate(self.angle_[1 + DEGREE :]):
            angle = angle + weight * x[:, i]
        return np.asarray(angle)


def _stacked(columns: Array, y: Array) -> Array:
    weights, constant = ridge(columns, y, _PENALTY).weights
    return np.concatenate([[constant], weights])
