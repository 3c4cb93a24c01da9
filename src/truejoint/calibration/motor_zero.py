"""A jaw's zero by its motor side."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError
from truejoint.estimators.jaw.learn import reversals
from truejoint.estimators.jaw.signals import RESET
from truejoint.estimators.jaw_load.learn import FrictionFilter
from truejoint.estimators.registry import name_of
from truejoint.recordings import Recording

LARGEST_SHIFT: Final = 3e-4  # shift [m] beyond which the instrument was not homed but taken apart
SHOWN: Final = 2.0  # deviations that a shift must have to be one
_SMALLEST_RANGE: Final = 0.2  # of the range of the calibration
_RESOLUTION: Final = 0.3e-6  # [m], of an encoder of 1 um


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
