"""The estimators of a jaw under loads: an unscented filter, and plays gated by their agreement.

The filter carries friction and the external load in its state. A few elastoplastic elements, each a
bristle that bends with the reset cable's motion until it slides, stand for friction. What the
motor's side reads, against what it should, corrects their deflections and the load: fast and small
as friction, slow and lasting as a load. A session shows of a fitted jaw the encoder's zero, and the
drive cable's stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, least_squares

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.family import Family, evaluate
from truejoint.estimators.filtered import Estimate, run_filter
from truejoint.estimators.jaw.learn import JawEstimator, MechanismEstimator, reversals, usual_dt
from truejoint.estimators.jaw.signals import FLICKER, SLIDING
from truejoint.estimators.jaw_load import run as friction_filter
from truejoint.estimators.jaw_load.run import DEGREE, external_torque
from truejoint.estimators.plays import run as plays
from truejoint.estimators.plays.learn import JAW_PENALTY, fit_jaw_bank
from truejoint.estimators.plays.run import follow_rows
from truejoint.estimators.polynomial.learn import ridge

WIDTHS: Final = (4e-6, 12e-6, 40e-6, 120e-6)  # [m] that each element bends before it slides
SMALLEST_ERROR: Final = 0.05
"""Share of a load that the law of stiffness may be off by, however well it was identified."""
USUAL_GROWTH: Final = 500.0
"""Growth of a wire rope's stiffness [N/m per N]: 0.1 to 0.5 of it per pretension of 5 to 12 N."""
LARGEST_SHIFT: Final = 3e-4  # shift [m] beyond which the instrument was not homed but taken apart
SHOWN: Final = 2.0  # deviations that a shift must have to be one
_SMALLEST_RANGE: Final = 0.2  # of the range of the calibration
_RESOLUTION: Final = 0.3e-6  # [m], of an encoder of 1 um
LARGEST_RATIO: Final = 3.0  # of identified and assumed stiffness, either over the other
_SCATTER: Final = 1e-3  # of what a weight that shows is seen as [Nm]
_GROWTH_SPREAD: Final = 300.0  # of the stiffness' growth about the usual [N/m per N]
_ROUNDS: Final = 4  # of finding stiffness and friction, which is in proportion to it


@dataclass(frozen=True)
class Stiffness:
    """Drive-cable stiffness found with known weights, by `identify_stiffness`.

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
        `identify_stiffness`.
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

    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, has_truth: Flags, progress: Progress
    ) -> Arrays:
        drive, scale = self._drive(X), float(1.0 / np.abs(X[:, 1]).max())
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

    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, has_truth: Flags, progress: Progress
    ) -> Arrays:
        widths, estimates = tuple(self.plays), {}
        arrays: Arrays = {}
        for side, k in friction_filter.SIDES.items():
            rows = np.ascontiguousarray(X[:, -k:])
            learnt = fit_jaw_bank(widths, JAW_PENALTY, rows, y, dt, has_truth)
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


@dataclass(frozen=True)
class EncoderZero:
    """Zero of the reset encoder in this session.

    Attributes
    ----------
    shift : float
        By how much ``x2`` reads too much, compared with the calibration [m].
    deviation : float
        Standard deviation of that [m].

    Examples
    --------
    >>> EncoderZero(shift=2e-6, deviation=1.5e-6).correction
    0.0
    """

    shift: float
    deviation: float

    @property
    def correction(self) -> float:
        """Shift to take off ``x2`` [m]: 0 where it is within two deviations, and would harm."""
        return self.shift if abs(self.shift) > SHOWN * self.deviation else 0.0


def find_encoder_zero(
    model: FrictionFilter, X: ArrayLike, dt: ArrayLike | None = None
) -> EncoderZero:
    """Find how far homing moved the reset encoder's zero, with no sensor at the jaw.

    Unloaded, motor and reset cable move together as in calibration, and homing keeps the motor's
    zero: what they differ by on average is the reset side's. Another friction than in calibration
    shifts the two ways apart. It shifts their mean by up to about half of that, which is the
    deviation (12 virtual forceps, four motions each: 0.0 to 2.2 of it).

    Parameters
    ----------
    model : FrictionFilter
        Fitted to an unloaded motion.
    X : array_like, shape (n, 2)
        Motor angle [rad] and ``x2`` [m]: whole cycles about zero, or some friction stays in the
        average.
    dt : array_like, shape (n,), optional
        Time since the row before [s]; rows 5 ms apart by default.

    Raises
    ------
    CalibrationError
        If the motion covers less than a fifth of the calibration's range or turns round less than
        twice, or no shift below 0.3 mm explains it.

    Examples
    --------
    >>> phase = np.linspace(0.0, 12.0 * np.pi, 4000)
    >>> X = np.column_stack([11.5 * np.sin(phase), 3e-3 * np.sin(phase)])
    >>> model = FrictionFilter().fit(X, 0.8 * np.sin(phase))
    >>> round(1e6 * find_encoder_zero(model, X + [0.0, 2e-5]).shift, 1)
    20.0
    """
    rows = np.array(X, dtype=np.float64)
    times = model.time_steps(dt, len(rows))
    span = float(np.ptp(rows[:, 1]) * model.arrays_["scale"][0])
    if not span > _SMALLEST_RANGE:
        raise CalibrationError(
            f"the motion covers {100 * span / 2:.0f} % of the calibration's range; move the jaw "
            "there and back over a tenth of it at least to find its zero"
        )
    turns = reversals(rows[:, 0])
    if turns < 2:
        raise CalibrationError(
            f"the motion turns round {turns} times; friction puts the way there and the way back "
            "apart, so move the jaw whole cycles about zero"
        )

    def misfit(shift: float) -> Array:
        return model.misfit(rows - np.array([0.0, shift]), times)

    def mean(shift: float) -> float:
        return float(np.mean(misfit(shift)))

    ends = mean(-LARGEST_SHIFT), mean(LARGEST_SHIFT)
    if ends[0] * ends[1] > 0.0:
        raise CalibrationError(
            "no shift of the reset encoder below 0.3 mm explains this motion; is a load on the "
            "jaw, or was the cable mounted anew? Calibrate again"
        )
    shift = float(brentq(mean, -LARGEST_SHIFT, LARGEST_SHIFT, xtol=1e-9))
    residual, opens = misfit(shift), np.gradient(rows[:, 0]) > 0.0
    loop_width = abs(residual[opens].mean() - residual[~opens].mean())
    slope = abs(ends[1] - ends[0]) / (2.0 * LARGEST_SHIFT)
    return EncoderZero(shift, math.hypot(_RESOLUTION, 0.25 * loop_width / slope))


def identify_stiffness(
    model: FrictionFilter, X: ArrayLike, torque: ArrayLike, dt: ArrayLike | None = None
) -> Stiffness:
    """Find the drive cable's stiffness, and its growth with tension, from known weights.

    Hang one each way, which tells the growth, and move the jaw slowly there and back under it,
    whole cycles: friction then cancels. Under a weight that only hangs still, what friction may
    hide of it counts as not known, and what a hand's swinging leaves in it biases the stiffness.

    Parameters
    ----------
    model : FrictionFilter
        Fitted to an unloaded motion.
    X : array_like, shape (n, 2)
        Records in which weights hang: motor angle [rad] and ``x2`` [m].
    torque : array_like, shape (n,)
        Torque of the weight that hangs freely in a row [Nm], positive where it opens the jaw; NaN
        in rows where none does.
    dt : array_like, shape (n,), optional
        Time since the row before [s], 0 where a record starts; rows 5 ms apart by default.

    Raises
    ------
    CalibrationError
        If no weight is stated, one is beyond `FrictionFilter.largest_load`, none shows above the
        jaw's friction, or no stiffness within a factor of 3 of the model's explains them.

    Examples
    --------
    >>> phase = np.linspace(0.0, 12.0 * np.pi, 4000)
    >>> angle, reset = 0.8 * np.sin(phase), 3e-3 * np.sin(phase)
    >>> X = np.column_stack([11.5 * np.sin(phase), reset])
    >>> model = FrictionFilter().fit(X, angle)
    >>> at_rest = np.tile(X[-1], (1000, 1))
    >>> loaded = at_rest - [1.0, 0.0]
    >>> rows = np.concatenate([X, at_rest, loaded])
    >>> torque = np.where(np.arange(6000) > 5500, 0.016, np.nan)
    >>> round(identify_stiffness(model, rows, torque).drive_stiffness / 1e3, 1)
    15.4
    """
    rows, torques = np.ascontiguousarray(X, dtype=np.float64), np.asarray(torque, dtype=np.float64)
    times = model.time_steps(dt, len(rows))
    hangs = _hangs(torques, times)
    stretch = model.states(rows, times).states[:, -1]
    means = np.array(
        [
            [
                torques[hang].mean(),
                model.spring_stiffness * rows[hang, 1].mean(),
                stretch[hang].mean(),
            ]
            for hang in hangs
        ]
    )
    weights, tension, stretched = means.T
    heaviest = float(np.abs(weights).max())
    if heaviest > model.largest_load:
        raise CalibrationError(
            f"a weight of {1e3 * heaviest:.1f} mNm is beyond the {1e3 * model.largest_load:.1f} "
            "mNm that no load exceeds (largest_load): the drive cable would be slack; hang a "
            "lighter one"
        )
    hidden = _hidden(model, rows, times, hangs, weights)
    stiffness = Stiffness(model.drive_stiffness, model.stiffness_growth, math.inf)
    for _ in range(_ROUNDS):
        friction = model.with_stiffness(stiffness).jaw_friction
        scatter = np.hypot(_SCATTER, hidden * friction / math.sqrt(3.0))
        if not (np.abs(weights) > hidden * friction).any():
            raise CalibrationError(
                f"a weight of {1e3 * heaviest:.1f} mNm does not show above the jaw's friction, "
                f"which hides {1e3 * float(hidden.max()) * friction:.1f} mNm; hang a heavier one, "
                "or along the last motion"
            )
        stiffness = _fitted(model, weights, tension, stretched, scatter)
    return stiffness


def _hidden(
    model: FrictionFilter, rows: Array, times: Array, hangs: Sequence[slice], weights: Array
) -> Array:
    """Share (n,) of the jaw's friction that may still turn round under each weight.

    None where the jaw yields to the weight.
    """
    bent = model.elements(rows, times) @ model.arrays_["drive"][1 + DEGREE :]
    most = max(abs(float(model.arrays_["drive"][1 + DEGREE :].sum())), 1e-12)
    turned = np.array([bent[hang].mean() for hang in hangs]) / most
    moved = np.array([np.ptp(rows[hang, 1]) for hang in hangs])
    known_again = np.exp(-np.maximum(moved - FLICKER, 0.0) / SLIDING)
    return np.asarray(np.clip(1.0 - np.sign(weights) * turned, 0.0, 2.0) * known_again)


def _fitted(
    model: FrictionFilter, weights: Array, tension: Array, stretched: Array, scatter: Array
) -> Stiffness:
    """Stiffness and growth by least squares; the growth is also what is usual of ropes."""
    assumed = model.drive_stiffness

    def misfit(ratio_and_growth: Array) -> Array:
        cable = np.array([assumed * ratio_and_growth[0], *ratio_and_growth[1:], model.jaw_radius])
        shown = [external_torque(*pair, cable) for pair in zip(stretched, tension, strict=True)]
        usual = (ratio_and_growth[1] - USUAL_GROWTH) / _GROWTH_SPREAD
        return np.append((np.array(shown) - weights) / scatter, usual)

    bounds = [1.0 / LARGEST_RATIO, 1.0], [LARGEST_RATIO, 5e3]
    search = least_squares(misfit, [1.0, USUAL_GROWTH], bounds=bounds, x_scale=[1.0, 1e3])
    ratio, growth = (float(value) for value in search.x)
    if not 1.01 / LARGEST_RATIO < ratio < 0.99 * LARGEST_RATIO:
        raise CalibrationError(
            f"no stiffness within {LARGEST_RATIO:g} times {assumed:g} N/m explains the weights: "
            "check weight, lever and sign, and that the model was calibrated unloaded"
        )
    slopes = np.asarray(search.jac)
    spread = np.linalg.inv(slopes.T @ slopes)[0, 0]
    return Stiffness(assumed * ratio, growth, assumed * math.sqrt(float(spread)))


def _hangs(torque: Array, dt: Array) -> list[slice]:
    """Give the runs of rows in which a weight hangs; refuses rows without any."""
    hung = np.isfinite(torque) & (torque != 0.0)
    starts = hung & (np.concatenate([[True], ~hung[:-1]]) | (dt == 0.0))
    ends = hung & np.concatenate([~hung[1:] | (dt[1:] == 0.0), [True]])
    pairs = zip(np.flatnonzero(starts), np.flatnonzero(ends), strict=True)
    hangs = [slice(int(first), int(last) + 1) for first, last in pairs]
    if not hangs:
        raise CalibrationError(
            "no weight is stated: give the torque of each in the rows in which it hangs freely, "
            "and NaN in the others"
        )
    return hangs
