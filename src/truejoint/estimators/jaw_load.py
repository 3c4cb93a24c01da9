"""The external load on the jaw from both sides of the cable, its stiffness, and its zero."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Flags, RowState
from truejoint.estimators.play import Play
from truejoint.models.family import POSITIVE
from truejoint.models.jaw import MOTOR, RESET
from truejoint.robots.forceps_mechanism import TABLE_1, ForcepsMechanism

GRAVITY: Final = 9.81  # [m/s2]
SMALLEST_RATIO: Final = 0.3  # of identified and assumed stiffness, either over the other
LARGEST_SHIFT: Final = 3e-4  # shift [m] beyond which the instrument was not homed but taken apart
_SMALLEST_RANGE: Final = 0.2  # of the range of the calibration


@dataclass(frozen=True)
class Stiffness:
    """Drive-cable stiffness found with a known weight.

    Attributes
    ----------
    drive_stiffness : float
        ``K_d`` [N/m] that makes the estimated load the known one.
    ratio : float
        It over the stiffness that was assumed.
    deviation : float
        How far the friction of the jaw may have put it off [N/m]: the dead band's half.

    Examples
    --------
    >>> Stiffness(drive_stiffness=12e3, ratio=0.86, deviation=300.0).ratio
    0.86
    """

    drive_stiffness: float
    ratio: float
    deviation: float


@dataclass(eq=False, repr=False)
class JawLoad:
    """External torque on the jaw: what the drive cable stretches beyond what it does unloaded.

    Unloaded, the drive side's displacement follows from the history of the reset side's. Under a
    load the two part, by the load over ``K_d r``. The jaw's own friction holds back up to twice its
    size before it lets the jaw turn round: the dead band.

    Parameters
    ----------
    drive_stiffness, reset_stiffness : float
        ``K_d`` and ``K_r`` [N/m]. The torque is proportional to the first: find it with one known
        weight, `identify_stiffness`.
    mechanism : ForcepsMechanism
        Gear and radii.

    Examples
    --------
    >>> JawLoad(drive_stiffness=12e3).grams(np.array([0.01]), arm=0.02).round(1)
    array([51.])
    """

    inputs: ClassVar = (MOTOR, RESET)
    drive_stiffness: float = 14e3
    reset_stiffness: float = 14e3
    mechanism: ForcepsMechanism = TABLE_1

    def __post_init__(self) -> None:
        _check_positive(drive_stiffness=self.drive_stiffness, reset_stiffness=self.reset_stiffness)

    def fit(self, X: ArrayLike, y: ArrayLike, dt: ArrayLike | None = None) -> Self:
        """Learn how both sides move together without a load.

        `X` (n, 2) are motor angle [rad] and ``x2`` [m] of an unloaded motion with reversals, `y`
        (n,) the jaw angle [rad], NaN where unknown, which tells the jaw's friction from the
        slider's, and `dt` (n,) the time since the row before [s], 0 where a history starts; rows 5
        ms apart by default. Raises CalibrationError if the rows cannot tell it: see `JawEstimator`.
        """
        rows = self._rows(X)
        angle = np.asarray(y, dtype=np.float64)
        self.angle_ = Play(("reset",)).fit(rows[:, 1:], angle, dt=dt)
        drive = np.where(np.isfinite(angle), self._drive(rows), np.nan)
        self.drive_ = Play(("reset",)).fit(rows[:, 1:], drive, dt=dt)
        return self

    @property
    def jaw_friction(self) -> float:
        """Friction torque of the jaw [Nm] that the unloaded motion shows.

        Turning round, the drive side moves by both frictions, ``F_s (1/K_r + 1/K_d) + tau/(K_d r)``
        each way, and the angle by the slider's alone, ``F_s / (K_r r)``.
        """
        r = self.mechanism.jaw_radius
        drive, angle = (
            float(model.weights_[model.degree : model.degree + len(model.reset_widths)].sum())
            for model in (self.drive_, self.angle_)
        )  # half of what turning round adds to each hysteresis
        slider = angle * r * (1.0 + self.reset_stiffness / self.drive_stiffness)
        return max((drive - slider) * self.drive_stiffness * r, 0.0)

    @property
    def dead_band(self) -> float:
        """Load [Nm] that may hang against the last motion without showing: twice the friction."""
        return 2.0 * self.jaw_friction

    def predict(self, X: ArrayLike, dt: ArrayLike | None = None) -> Array:
        """External torque (n,) [Nm] in every row, positive where it opens the jaw."""
        rows = self._rows(X)
        return self._torque(rows, self.drive_.predict(rows[:, 1:], dt))

    def start(self) -> RowState:
        """Memory before the first row."""
        return self.drive_.start()

    def step(self, state: RowState, dt: float, row: Array) -> float:
        """External torque [Nm] of one row; see `JointRegressor.step`."""
        return float(self._torque(row[None], self.drive_.step(state, dt, row[1:]))[0])

    def grams(self, torque: Array, arm: float) -> Array:
        """Weights (n,) [g] that make torques (n,) [Nm] at a lever of `arm` [m]."""
        _check_positive(arm=arm)
        return np.asarray(1e3 * torque / (GRAVITY * arm))

    def with_stiffness(self, drive_stiffness: float) -> JawLoad:
        """Copy with another ``K_d`` [N/m], fitted as this one is."""
        copy = JawLoad(drive_stiffness, self.reset_stiffness, self.mechanism)
        copy.angle_, copy.drive_ = self.angle_, self.drive_
        return copy

    def _rows(self, X: ArrayLike) -> Array:
        rows = np.ascontiguousarray(X, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 2 or not np.isfinite(rows).all():
            raise CalibrationError(
                f"load: rows have shape {rows.shape}; give finite {MOTOR} and {RESET}"
            )
        return rows

    def _drive(self, rows: Array) -> Array:
        return np.asarray(self.mechanism.drive_from_motor(rows[:, 0]))

    def _torque(self, rows: Array, unloaded: Array) -> Array:
        stretch = self._drive(rows) - unloaded
        return np.asarray(-self.drive_stiffness * self.mechanism.jaw_radius * stretch)


def identify_stiffness(
    load: JawLoad,
    X: ArrayLike,
    unloaded: Flags,
    loaded: Flags,
    torque: float,
    dt: ArrayLike | None = None,
) -> Stiffness:
    """Find the drive cable's stiffness from one known weight on the jaw.

    Hang it so that it pulls along the last motion: the jaw's friction then gives way at once.

    Parameters
    ----------
    load : JawLoad
        Fitted, with an assumed stiffness.
    X : array_like, shape (n, 2)
        A record in which the weight is put on.
    unloaded, loaded : ndarray of bool, shape (n,)
        Rows at rest before and after.
    torque : float
        Of the weight [Nm], positive where it opens the jaw.
    dt : array_like, shape (n,), optional
        As in `JawLoad.fit`.

    Raises
    ------
    CalibrationError
        If the load does not change within the record, is smaller than the dead band, or asks for a
        stiffness far from the assumed one.

    Examples
    --------
    >>> angle = 0.5 * np.sin(np.linspace(0.0, 20.0, 2000))
    >>> X = np.column_stack([angle * 14.0, angle * 4e-3])
    >>> load = JawLoad().fit(X, angle)
    >>> pulled = X - [[6.4, 0.0]]
    >>> both, rows = np.vstack([X, pulled]), np.arange(4000)
    >>> round(identify_stiffness(load, both, rows < 2000, rows >= 2000, 0.1).ratio, 1)
    1.0
    """
    unloaded, loaded = np.asarray(unloaded, dtype=bool), np.asarray(loaded, dtype=bool)
    if not (unloaded.any() and loaded.any()) or (unloaded & loaded).any():
        raise CalibrationError(
            "a record of constant load tells no stiffness: name rows before and rows after the "
            "weight was put on"
        )
    if not (math.isfinite(torque) and abs(torque) > load.dead_band):
        raise CalibrationError(
            f"a weight of {1e3 * abs(torque):.1f} mNm does not show above the jaw's friction, "
            f"which holds {1e3 * load.dead_band:.1f} mNm; hang a heavier one"
        )
    estimate = load.predict(X, dt)
    change = float(estimate[loaded].mean() - estimate[unloaded].mean())
    ratio = torque / change if change != 0.0 else math.inf
    if not SMALLEST_RATIO <= ratio <= 1.0 / SMALLEST_RATIO:
        raise CalibrationError(
            f"a known torque of {1e3 * torque:.1f} mNm shows as {1e3 * change:.1f} mNm: check the "
            "weight, its lever and its sign, and that the record was calibrated unloaded"
        )
    found = load.drive_stiffness * ratio
    return Stiffness(found, ratio, found * load.jaw_friction / abs(torque))


@dataclass(frozen=True)
class EncoderZero:
    """Zero of the reset encoder in this session."""

    shift: float  # by how much ``x2`` reads too much, compared with the calibration [m]
    deviation: float  # of the misfit that is left, which bounds what the shift can mean [m]


def find_encoder_zero(load: JawLoad, X: ArrayLike, dt: ArrayLike | None = None) -> EncoderZero:
    """Find how far homing moved the reset encoder's zero, with no sensor at the jaw.

    Unloaded, motor and reset cable move together as in calibration, and homing keeps the motor's
    zero: what they differ by on average is the reset side's. Rows `X` (n, 2) of motor angle [rad]
    and ``x2`` [m] should be whole cycles about zero, or some friction stays in the average; `dt` is
    as in `JawLoad.fit`. Raises CalibrationError if the motion covers less than a fifth of the
    calibration's range, or no shift below 0.3 mm explains it.
    """
    rows = np.array(X, dtype=np.float64)
    span = np.ptp(rows[:, 1]) * float(load.drive_.scale_[0])
    if not span > _SMALLEST_RANGE:
        raise CalibrationError(
            f"the motion covers {100 * span / 2:.0f} % of the calibration's range; move the jaw "
            "there and back over a tenth of it at least to find its zero"
        )

    def misfit(shift: float) -> Array:
        return load.predict(rows - np.array([0.0, shift]), dt)

    def mean(shift: float) -> float:
        return float(np.mean(misfit(shift)))

    if mean(-LARGEST_SHIFT) * mean(LARGEST_SHIFT) > 0.0:
        raise CalibrationError(
            "no shift of the reset encoder below 0.3 mm explains this motion; is a load on the "
            "jaw, or was the cable mounted anew? Calibrate again"
        )
    shift = float(brentq(mean, -LARGEST_SHIFT, LARGEST_SHIFT, xtol=1e-9))
    stretch = load.drive_stiffness * load.mechanism.jaw_radius
    return EncoderZero(shift, float(np.std(misfit(shift))) / stretch)


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not POSITIVE.holds(value):
            raise CalibrationError(f"load: {name} is {value!r:.60}; it must be {POSITIVE.text}")
