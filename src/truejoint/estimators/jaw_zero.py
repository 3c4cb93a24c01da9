"""Zeros after homing: find the reset encoder's new zero from a short unloaded motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from truejoint.errors import CalibrationError
from truejoint.estimators.jaw_load import JawLoad

Array = NDArray[np.float64]

LARGEST_SHIFT: Final = 3e-4
"""Shift [m] beyond which the instrument was not homed but taken apart."""
_SMALLEST_RANGE: Final = 0.2  # of the range of the calibration


@dataclass(frozen=True)
class Zero:
    """Zero of the reset encoder in this session."""

    shift: float  # by how much ``x2`` reads too much, compared with the calibration [m]
    deviation: float  # of the misfit that is left, which bounds what the shift can mean [m]

    def applied(self, X: ArrayLike) -> Array:
        """Rows (n, 2) of motor angle [rad] and ``x2`` [m], the latter without the shift."""
        rows = np.array(X, dtype=np.float64)
        rows[:, 1] -= self.shift
        return rows


def find_zero(load: JawLoad, X: ArrayLike, dt: ArrayLike | None = None) -> Zero:
    """Find how far homing moved the reset encoder's zero, with no sensor at the jaw.

    Unloaded, motor and reset cable move together as in calibration. The motor keeps its zero, at
    the limit switch of the drive side, so what they differ by on average is the reset side's. The
    motion, rows `X` (n, 2) of motor angle [rad] and ``x2`` [m], should consist of whole cycles
    about zero, as the calibration did: half a cycle more one way leaves half of the friction in the
    average. `load` is fitted to the calibration, `dt` as in `JawLoad.fit`. Raises CalibrationError
    if the motion covers less than a fifth of the calibration's range, or no shift below 0.3 mm
    explains it.
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
    return Zero(shift, float(np.std(misfit(shift))) / stretch)
