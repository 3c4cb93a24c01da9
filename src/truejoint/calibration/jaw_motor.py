"""A jaw by its motor side: its zero after a homing, and its cable's stiffness by weights."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, least_squares

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError
from truejoint.estimators.jaw.learn import reversals
from truejoint.estimators.jaw.signals import FLICKER, RESET, SLIDING
from truejoint.estimators.jaw_load.learn import USUAL_GROWTH, FrictionFilter, Stiffness
from truejoint.estimators.jaw_load.run import DEGREE, external_torque
from truejoint.estimators.registry import name_of
from truejoint.recordings import Recording

LARGEST_SHIFT: Final = 3e-4  # shift [m] beyond which the instrument was not homed but taken apart
SHOWN: Final = 2.0  # deviations that a shift must have to be one
_SMALLEST_RANGE: Final = 0.2  # of the range of the calibration
_RESOLUTION: Final = 0.3e-6  # [m], of an encoder of 1 um
LARGEST_RATIO: Final = 3.0  # of identified and assumed stiffness, either over the other
_SCATTER: Final = 1e-3  # of what a weight that shows is seen as [Nm]
_GROWTH_SPREAD: Final = 300.0  # of the stiffness' growth about the usual [N/m per N]
_ROUNDS: Final = 4  # of finding stiffness and friction, which is in proportion to it


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


def motor_zero(
    calibration: Calibration, recording: Recording, by: Calibration | None = None
) -> tuple[Zero, EncoderZero]:
    """Zero of a jaw by its motor side: by how much this homing set the reset encoder's zero wrong.

    No sensor at the jaw is needed; see `find_encoder_zero`.

    Parameters
    ----------
    calibration : Calibration
        Calibration of any estimator that reads ``cable/reset``.
    recording : Recording
        Whole cycles about zero after the homing, without a load.
    by : Calibration, optional
        Calibration of ``ukf_friction``, made of the same motion; `calibration` itself by default.

    Returns
    -------
    Zero, EncoderZero
        The zero for `Calibration.at`, which moves nothing where a correction would be as likely to
        harm, and what it rests on.

    Raises
    ------
    CalibrationError
        If either calibration is not as it must be, or the motion determines no zero.

    Examples
    --------
    >>> motor_zero(model, test)
    Traceback (most recent call last):
        ...
    truejoint.errors.CalibrationError: linear finds no zero; calibrate with -e ukf_friction
    """
    by = calibration if by is None else by
    model = as_calibration(by).model
    if not isinstance(model, FrictionFilter):
        wanted = name_of(FrictionFilter())
        raise CalibrationError(f"{by.estimator} finds no zero; calibrate with -e {wanted}")
    if RESET not in calibration.signals or calibration.target != "position":
        raise CalibrationError(
            f"{calibration.estimator} takes no jaw's position from {RESET}; there is no zero of it"
        )
    if calibration.for_rezeroing.moves is not None:
        raise CalibrationError(
            "the calibration has its own zeros already; give the one that calibrate wrote"
        )
    rows = by.rows(recording)
    encoder_zero = find_encoder_zero(model, rows.X, rows.dt)
    origin = recording.provenance
    if origin.load > 0.0:
        raise CalibrationError(
            f"{source_of(recording)}: a load of {1e3 * origin.load:g} g on the jaw; its zero is "
            "that of a motion without one"
        )
    # A zero of the jaw that moves x2 by as much as it is off.
    moves = np.zeros((len(calibration.signals), len(calibration.joints)))
    moves[calibration.signals.index(RESET)] = model.jaw_radius
    offset = np.full(len(calibration.joints), -encoder_zero.correction / model.jaw_radius)
    zero = Zero(
        offset, source="motor", file=origin.source, homing_id=origin.homing_id, rows=len(rows),
        duration=recording.duration, moves=moves, details=vars(encoder_zero),
    )  # fmt: skip
    return zero, encoder_zero


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
    weights, reset, stretched = (
        np.array([column[hang].mean() for hang in hangs])
        for column in (torques, rows[:, 1], stretch)
    )
    tension = model.spring_stiffness * reset
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
    edges = np.flatnonzero((hung[1:] != hung[:-1]) | (dt[1:] == 0.0)) + 1
    hangs = [slice(*ends) for ends in pairwise([0, *edges, len(hung)]) if hung[slice(*ends)].any()]
    if not hangs:
        raise CalibrationError(
            "no weight is stated: give the torque of each in the rows in which it hangs freely, "
            "and NaN in the others"
        )
    return hangs
