"""An unscented filter that carries friction and the external load in its state.

A few elastoplastic elements, each a bristle that bends with the reset cable's motion until it
slides, stand for friction. What the motor's side reads, against what it should, corrects their
deflections and the load: fast and small as friction, slow and lasting as a load.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.jaw import JawEstimator, median_dt
from truejoint.estimators.play import ridge
from truejoint.models import friction_filter, friction_smoother
from truejoint.models.family import Family
from truejoint.models.filtered import run_histories
from truejoint.models.friction_filter import DEGREE, friction_prior
from truejoint.models.play import bank_columns
from truejoint.robots.forceps_mechanism import TABLE_1

WIDTHS: Final = (4e-6, 12e-6, 40e-6, 120e-6)  # [m] that each element bends before it slides
_PENALTY: Final = 1e-5


@dataclass(frozen=True, eq=False)
class JawStates:
    """What the filter says about each row of a record."""

    angle: Array  # (n,) [rad]
    angle_deviation: Array  # of the state, and of what the model misses
    load: Array  # torque from outside (n,) [Nm], positive where it opens the jaw
    load_deviation: Array  # as the filter has it; friction that did not turn round is not in it


@dataclass(eq=False, repr=False)
class FrictionFilter(JawEstimator):
    """Unscented filter with friction and external load in its state; past yan2020.

    Fitted to an unloaded motion: the jaw's angle and the motor's side, each as a polynomial in
    ``x2`` and weights of the elements.

    Parameters
    ----------
    drive_stiffness : float
        ``K_d`` [N/m], which turns stretch into torque; see `identify_stiffness`.
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
    drive_stiffness: float = 14e3
    load_drift: float = 2e-3
    friction_drift: float = 0.02
    error_time: float = 0.1
    widths: tuple[float, ...] = WIDTHS
    gear_ratio: float = TABLE_1.gear_ratio
    wheel_radius: float = TABLE_1.wheel_radius
    jaw_radius: float = TABLE_1.jaw_radius

    def states(self, X: Array, dt: Array, *, smoothed: bool = False) -> JawStates:
        """Angle and load in every row of `X` (n, 2), `dt` (n,) [s] after that before.

        Each is from the rows up to it or, `smoothed`, which no controller can, from later ones as
        well.
        """
        unscented = friction_filter.friction_filter(self.model_params(), self.arrays_)
        drive, reset = X[:, :1] * (self.wheel_radius / self.gear_ratio), X[:, 1]
        moved = np.where(dt > 0.0, np.diff(reset, prepend=reset[:1]), 0.0)
        control, prior = np.column_stack([moved, reset]), friction_prior(len(self.widths))
        x, P = run_histories(unscented, prior, drive, control, dt, smoothed=smoothed)
        angle, spread = np.empty((2, len(X)))
        places = reset * self.arrays_["scale"][0]
        friction_filter.jaw_angles(places, x, P, self.arrays_["angle"], angle, spread)
        deviation = np.sqrt(spread + self.arrays_["misfit"][1] ** 2)
        return JawStates(angle, deviation, x[:, -1], np.sqrt(np.maximum(P[:, -1, -1], 0.0)))

    def _learn_jaw(self, X: Array, y: Array, dt: Array, known: Flags, progress: Progress) -> Arrays:
        reset = np.ascontiguousarray(X[:, 1])
        drive = X[:, 0] * (self.wheel_radius / self.gear_ratio)
        scale = 1.0 / np.abs(reset).max()
        columns = np.empty((len(X), DEGREE + len(self.widths)))
        bank_columns(dt, reset, scale, np.array(self.widths, dtype=np.float64), columns)
        fits, misfit = [], []
        for side in (y, drive):
            weights, constant = ridge(columns[known], side[known], _PENALTY)
            left = side - (constant + columns @ weights)
            fits.append(np.append(constant, weights))
            misfit.append(float(np.sqrt(np.mean(left[known] ** 2))))
        progress(0.7)
        arrays = {
            "angle": fits[0],
            "drive": fits[1],
            "scale": np.array([scale]),
            "misfit": np.maximum(misfit[::-1], 1e-9),
            "dt": np.array([median_dt(dt)]),
        }
        friction_filter.friction_filter(self.model_params(), arrays)
        return arrays


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
