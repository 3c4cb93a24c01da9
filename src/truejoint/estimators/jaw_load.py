"""The external load on the jaw from both sides of the cable, and the cable's stiffness."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.errors import CalibrationError
from truejoint.estimators.base import RowState
from truejoint.estimators.play import Play
from truejoint.models.family import POSITIVE
from truejoint.models.jaw import MOTOR, RESET
from truejoint.robots.forceps_mechanism import TABLE_1, ForcepsMechanism

Array = NDArray[np.float64]

GRAVITY: Final = 9.81  # [m/s2]
SMALLEST_RATIO: Final = 0.3
"""Identified over assumed stiffness below which, or beyond whose inverse, something is wrong."""


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
    """

    drive_stiffness: float
    ratio: float
    deviation: float


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
    """

    inputs = (MOTOR, RESET)

    def __init__(
        self,
        drive_stiffness: float = 14e3,
        reset_stiffness: float = 14e3,
        mechanism: ForcepsMechanism = TABLE_1,
    ) -> None:
        _check_positive(drive_stiffness=drive_stiffness, reset_stiffness=reset_stiffness)
        self.drive_stiffness = drive_stiffness
        self.reset_stiffness = reset_stiffness
        self.mechanism = mechanism

    def fit(self, X: ArrayLike, y: ArrayLike, dt: ArrayLike | None = None) -> Self:
        """Learn how both sides move together without a load.

        Parameters
        ----------
        X : array_like, shape (n, 2)
            Motor angle [rad] and ``x2`` [m] of an unloaded motion with reversals.
        y : array_like, shape (n,)
            Jaw angle [rad], NaN where unknown; it tells the jaw's friction from the slider's.
        dt : array_like, shape (n,), optional
            Time since the row before [s], 0 where a history starts; rows 5 ms apart by default.

        Raises
        ------
        CalibrationError
            If the rows cannot tell it: see `JawEstimator`.
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
        drive, angle = (_turning(model) for model in (self.drive_, self.angle_))
        slider = angle * r * (1.0 + self.reset_stiffness / self.drive_stiffness)
        return max((drive - slider) * self.drive_stiffness * r, 0.0)

    @property
    def dead_band(self) -> float:
        """Load [Nm] that may hang against the last motion without showing: twice the friction."""
        return 2.0 * self.jaw_friction

    def predict(self, X: ArrayLike, dt: ArrayLike | None = None) -> Array:
        """External torque (n,) [Nm] in every row, positive where it opens the jaw."""
        rows = self._rows(X)
        unloaded = self.drive_.predict(rows[:, 1:], dt)
        return self._torque(self._drive(rows) - unloaded)

    def start(self) -> RowState:
        """Memory before the first row."""
        return self.drive_.start()

    def step(self, state: RowState, dt: float, row: Array) -> float:
        """External torque [Nm] of one row; see `JointRegressor.step`."""
        unloaded = self.drive_.step(state, dt, row[1:])
        return float(self._torque(self._drive(row[None]) - unloaded)[0])

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

    def _torque(self, stretch: Array) -> Array:
        return np.asarray(-self.drive_stiffness * self.mechanism.jaw_radius * stretch)


def identify_stiffness(
    load: JawLoad,
    X: ArrayLike,
    unloaded: NDArray[np.bool_],
    loaded: NDArray[np.bool_],
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


def _turning(model: Play) -> float:
    """Half of what turning round adds to a fitted hysteresis, in its unit."""
    widths = len(model.reset_widths)
    plays = model.weights_[int(model.degree) : int(model.degree) + widths]
    return float(plays.sum())


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not POSITIVE.holds(value):
            raise CalibrationError(f"load: {name} is {value!r:.60}; it must be {POSITIVE.text}")
