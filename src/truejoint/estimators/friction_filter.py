"""An unscented filter that carries friction and the external load in its state.

Slider, cables and jaw hold friction that depends on which way they last moved. A few elastoplastic
elements, each a bristle that bends with the reset cable's motion until it slides, stand for it;
their deflections and the load's torque are the state. The reset cable's displacement drives them,
and what the motor's side then reads, against what it should, corrects them: fast and small as
friction, slow and lasting as a load.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.estimators.base import Progress
from truejoint.estimators.jaw import JawEstimator
from truejoint.estimators.play import ridge
from truejoint.models import friction_filter, friction_smoother
from truejoint.models.family import Family
from truejoint.models.friction_filter import DEGREE, friction_prior
from truejoint.models.play import bank_columns
from truejoint.robots.forceps_mechanism import TABLE_1

Array = NDArray[np.float64]

WIDTHS: Final = (4e-6, 12e-6, 40e-6, 120e-6)
"""How far each element bends before it slides [m] of the reset cable."""
_PENALTY: Final = 1e-5


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

    Examples
    --------
    >>> FrictionFilter(widths=(1e-5, 1e-4)).name
    'ukf_friction'
    """

    family: ClassVar[Family] = friction_filter.FAMILY

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

    def states(self, X: Array, dt: Array, *, smoothed: bool = False) -> JawStates:
        """Angle and load in every row, each from the rows up to it.

        Parameters
        ----------
        X : ndarray, shape (n, 2)
        dt : ndarray, shape (n,)
            Time since the row before [s], 0 where a history starts.
        smoothed : bool
            Use later rows as well, which no controller can.
        """
        unscented = friction_filter.friction_filter(self.model_params(), self.arrays_)
        drive, reset = X[:, :1] * (self.wheel_radius / self.gear_ratio), X[:, 1]
        mean, covariance = friction_prior(len(self.widths))
        angle, spread, load, deviation = np.empty((4, len(X)))
        edges = [*np.flatnonzero(dt == 0.0).tolist(), len(X)]
        for first, last in pairwise(edges):
            rows = slice(first, last)
            control = np.column_stack([np.diff(reset[rows], prepend=reset[first]), reset[rows]])
            result = unscented.run(drive[rows], control, x0=mean, P0=covariance, dt=dt[rows])
            found = unscented.smooth(result) if smoothed else result
            friction_filter.jaw_angles(
                reset[rows] * self.arrays_["scale"][0], found.x, found.P, self.arrays_["angle"],
                angle[rows], spread[rows],
            )  # fmt: skip
            load[rows] = found.x[:, -1]
            deviation[rows] = np.sqrt(np.maximum(found.P[:, -1, -1], 0.0))
        return JawStates(angle, np.sqrt(spread + self.arrays_["misfit"][1] ** 2), load, deviation)

    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, known: NDArray[np.bool_], progress: Progress
    ) -> dict[str, Array]:
        reset = np.ascontiguousarray(X[:, 1])
        drive = X[:, 0] * (self.wheel_radius / self.gear_ratio)
        scale = 1.0 / np.abs(reset).max()
        columns = np.empty((len(X), DEGREE + len(self.widths)))
        bank_columns(dt, reset, scale, np.array(self.widths, dtype=np.float64), columns)
        sides = [(side, _stacked(columns[known], side[known])) for side in (y, drive)]
        progress(0.7)
        left = [side - (w[0] + columns @ w[1:]) for side, w in sides]
        angle, drive_misfit = (float(np.sqrt(np.mean(e[known] ** 2))) for e in left)
        moved = dt[dt > 0.0]
        arrays = {
            "angle": sides[0][1],
            "drive": sides[1][1],
            "scale": np.array([scale]),
            "misfit": np.maximum([drive_misfit, angle], 1e-9),
            "dt": np.array([float(np.median(moved)) if len(moved) else 5e-3]),
        }
        friction_filter.friction_filter(self.model_params(), arrays)
        return arrays


def _stacked(columns: Array, y: Array) -> Array:
    weights, constant = ridge(columns, y, _PENALTY).weights
    return np.concatenate([[constant], weights])


class FrictionSmoother(FrictionFilter):
    """`FrictionFilter` with a Rauch-Tung-Striebel smoother: each row from all rows of the record.

    Not causal. Parameters as `FrictionFilter`.

    Examples
    --------
    >>> FrictionSmoother().name
    'ukf_friction_smoothed'
    """

    family: ClassVar[Family] = friction_smoother.FAMILY

    def evaluate(self, X: Array, dt: ArrayLike | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, 2), each from all of them."""
        return self.states(X, self.time_steps(dt, len(X)), smoothed=True).angle[:, None]
