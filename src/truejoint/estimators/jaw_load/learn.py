"""The estimators of a jaw under loads: an unscented filter, and plays gated by their agreement."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Progress
from truejoint.estimators.family import Family, evaluate
from truejoint.estimators.filtered import Estimate, run_filter
from truejoint.estimators.jaw.learn import JawEstimator, MechanismEstimator, usual_dt
from truejoint.estimators.jaw_load import run as friction_filter
from truejoint.estimators.jaw_load.run import DEGREE
from truejoint.estimators.plays import run as plays
from truejoint.estimators.plays.learn import JAW_PENALTY, fit_jaw_bank
from truejoint.estimators.plays.run import follow_rows
from truejoint.estimators.polynomial.learn import ridge

WIDTHS: Final = (4e-6, 12e-6, 40e-6, 120e-6)  # [m] that each element bends before it slides
SMALLEST_ERROR: Final = 0.05
"""Share of a load that the law of stiffness may be off by, however well it was identified."""
USUAL_GROWTH: Final = 500.0
"""Growth of a wire rope's stiffness [N/m per N]: 0.1 to 0.5 of it per pretension of 5 to 12 N."""


@dataclass(frozen=True)
class Stiffness:
    """Drive-cable stiffness by known weights, see `truejoint.calibration.identify_stiffness`.

    Attributes
    ----------
    drive_stiffness : float
        ``K_d`` where the jaw is at its zero [N/m].
    growth : float
        By how much it grows with the tension [N/m per N].
    deviation : float
        Standard deviation of the first [N/m].

    Examples
    --------
    >>> Stiffness(drive_stiffness=12e3, growth=500.0, deviation=300.0).growth
    500.0
    """

    drive_stiffness: float
    growth: float
    deviation: float


@dataclass(eq=False, repr=False, kw_only=True)
class FrictionFilter(MechanismEstimator):
    """Unscented filter with friction and external load in its state; past yan2020.

    Fitted to an unloaded motion: the jaw's angle and the motor's side, each as a polynomial in
    ``x2`` and weights of the elements.

    Parameters
    ----------
    drive_stiffness : float
        ``K_d`` [N/m] where the jaw is at its zero, which turns stretch into torque; see
        `truejoint.calibration.identify_stiffness`.
    stiffness_growth : float
        By how much it grows with the cable's tension [N/m per N].
    stiffness_error : float
        Share by which a load may be off since they are not known better.
    largest_load : float
        Bound that no load exceeds [Nm]; the drive cable is slack from its pretension times ``r``
        on. An angle under more than that is not believed.
    stretch_drift : float
        How fast a load may stretch the drive cable [m per square root of a second].
    friction_drift : float
        How fast friction leaves what the elements say [share of it per square root of a second].
    error_time : float
        Time over which the motor side's misfit stays the same [s]: rows closer than that tell
        little new.
    widths : tuple of float
        How far each element bends before it slides [m].
    gear_ratio, spring_stiffness, wheel_radius, jaw_radius : float
        As for `MechanismEstimator`.

    Examples
    --------
    >>> FrictionFilter(widths=(1e-5, 1e-4)).name
    'ukf_friction'
    """

    family: ClassVar[Family] = friction_filter.FAMILY
    drive_stiffness: float = 14e3
    stiffness_growth: float = USUAL_GROWTH
    stiffness_error: float = 0.3
    largest_load: float = 0.05
    stretch_drift: float = 3.6e-5
    friction_drift: float = 0.02
    error_time: float = 0.1
    widths: tuple[float, ...] = WIDTHS

    @property
    def jaw_friction(self) -> float:
        """Friction torque of the jaw [Nm], as the unloaded motion and the stiffness tell it.

        Up to twice that may hang against the last motion without showing: the dead band.
        """
        return friction_filter.jaw_friction(self.model_params(), self.arrays_)

    def with_stiffness(self, stiffness: Stiffness) -> Self:
        """Copy with an identified stiffness, fitted as this one is."""
        params = {
            **self.model_params(),
            "drive_stiffness": stiffness.drive_stiffness,
            "stiffness_growth": stiffness.growth,
            "stiffness_error": min(
                max(stiffness.deviation / stiffness.drive_stiffness, SMALLEST_ERROR), 1.0
            ),
        }
        copy = self.from_data(replace(self.data, params=params), 2, 1)
        copy.single_output_ = self.single_output_
        return copy

    def elements(self, X: Array, dt: Array) -> Array:
        """How far each element is bent (n, m), -1 to 1, by the motion of ``x2`` alone."""
        return self._columns(X, dt, 1.0)[:, DEGREE:]

    def misfit(self, X: Array, dt: Array) -> Array:
        """Stretch of the drive cable (n,) [m] beyond what the elements alone make of ``x2``."""
        columns = self._columns(X, dt, float(self.arrays_["scale"][0]))
        drive = self.arrays_["drive"]
        return np.asarray(self._drive(X) - drive[0] - columns @ drive[1:])

    def states(self, X: Array, dt: Array, *, smoothed: bool = False) -> Estimate:
        """Angle and load in every row of `X` (n, 2), `dt` (n,) [s] after that before.

        The load is positive where it opens the jaw; the last state is the drive cable's stretch by
        it [m]. Each is from the rows up to it or, `smoothed`, which no controller can, from later
        ones as well.
        """
        # Whatever the load is, the angle is told.
        params = {**self.model_params(), "largest_load": math.inf}
        run = run_filter(replace(self.data, params=params), X, dt, smoothed=smoothed)
        load, load_deviation = run.beside[:, :, 0].T
        return Estimate(run.outputs[:, 0], run.deviations[:, 0], load, load_deviation, run.x)

    def _learn_jaw(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        drive, scale = self._drive(X), float(1.0 / np.abs(X[:, 1]).max())
        has_truth = np.isfinite(y)
        columns = self._columns(X, dt, scale)
        fits, misfit = [], []
        for side in (y, drive):
            weights, constant = ridge(columns[has_truth], side[has_truth], JAW_PENALTY)
            residual = side - (constant + columns @ weights)
            fits.append(np.append(constant, weights))
            misfit.append(float(np.sqrt(np.mean(residual[has_truth] ** 2))))
        progress(0.7)
        arrays = {
            "angle": fits[0],
            "drive": fits[1],
            "scale": np.array([scale]),
            "misfit": np.maximum(misfit[::-1], 1e-9),
            "dt": np.array([usual_dt(dt)]),
        }
        friction_filter.friction_filter(self.model_params(), arrays)
        return arrays

    def _drive(self, X: Array) -> Array:
        """Displacement of the drive cable (n,) [m] that the motor's angle makes."""
        return np.asarray(X[:, 0] * (self.wheel_radius / self.gear_ratio))

    def _columns(self, X: Array, dt: Array, scale: float) -> Array:
        """Powers of ``x2`` and deflections of the elements (n, k)."""
        bent, reset = np.empty((len(X), len(self.widths))), np.ascontiguousarray(X[:, 1])
        follow_rows(dt, reset, np.array(self.widths), bent)
        powers = np.cumprod(np.tile((scale * reset)[:, None], DEGREE), axis=1)
        return np.hstack([powers, bent])


@dataclass(eq=False, repr=False, kw_only=True)
class GatedPlays(JawEstimator):
    """`JawPlays` on the reset cable, corrected by those on both sides as far as the two agree.

    Without a load both see the same jaw, and their difference stays within a few times what it was
    in calibration; the estimate from both sides is then the better one. A load stretches the drive
    cable, which only that one mistakes for a motion of the jaw: the difference grows, and the
    estimate goes over, without a jump, to the reset cable's. In the loop it states how far off it
    may be, which a load makes more.

    Parameters
    ----------
    gate : float
        How many times the difference's RMS in calibration still counts as agreement.
    smallest_gate : float
        Difference that always does [rad].
    plays : tuple of float
        Half-widths of the plays, as for `JawPlays`.

    Examples
    --------
    >>> GatedPlays(gate=4.0).name
    'play_gated'
    """

    family: ClassVar[Family] = friction_filter.GATED
    gate: float = 3.0
    smallest_gate: float = 1.75e-3
    plays: tuple[float, ...] = plays.JAW_WIDTHS

    def _learn_jaw(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        widths, has_truth, estimates = tuple(self.plays), np.isfinite(y), {}
        arrays: Arrays = {}
        for side, k in friction_filter.SIDES.items():
            rows = np.ascontiguousarray(X[:, -k:])
            learnt = fit_jaw_bank(widths, JAW_PENALTY, rows, y, dt)
            memory = plays.pack(plays.jaw_bank(widths, k), learnt, k, 1)
            estimates[side] = evaluate(plays.FAMILY, memory, rows, dt, 1)[has_truth, 0]
            arrays |= {f"{side}/{name}": array for name, array in learnt.items()}
            progress(0.4 * k)
        both, reset = estimates["both"], estimates["reset"]
        misfit = [_rms(both - y[has_truth]), _rms(reset - y[has_truth])]
        return {
            **arrays,
            "gate": np.array([max(self.gate * _rms(both - reset), self.smallest_gate)]),
            "misfit": np.array(misfit),
        }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
