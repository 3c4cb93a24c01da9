"""The motions that the forceps of yan2020 are calibrated, verified and loaded on."""

import math
from typing import Final

import numpy as np

from truejoint.errors import TrajectoryError
from truejoint.motion.trajectory import Trajectory

Tone = tuple[float, float]
"""Amplitude [rad] and angular frequency [rad/s] of one sine."""

CALIBRATION_TONES: Final[tuple[Tone, ...]] = ((-math.radians(50.0), 0.3),)  # yan2020, equation (27)

VERIFICATION_TONES: Final[tuple[Tone, ...]] = (
    (-math.radians(30.0), 0.3),
    (-math.radians(15.0), 0.5),
    (-math.radians(10.0), 0.2),
    (-math.radians(10.0), 0.2),
    (-math.radians(10.0), 1.0),
)
"""yan2020, equation (28), as printed: 0.2 rad/s stands there twice."""

RAMP: Final = 2.0  # time in which a motion swells from rest [s], which the paper does not state

DURATION: Final = 20.0 * math.pi  # common period of every sine above [s], 62.8 s; follows the ramp

_RATE: Final = 1000.0


def calibration_trajectory(duration: float = DURATION) -> Trajectory:
    """Motion (27) of yan2020 for `duration` s after the ramp: one sine of 50 deg, 1 kHz."""
    return sine_trajectory(CALIBRATION_TONES, duration, name="yan2020 (27)")


def verification_trajectory(duration: float = DURATION) -> Trajectory:
    """Motion (28) of yan2020 for `duration` s after the ramp: many reversals, 1 kHz."""
    return sine_trajectory(VERIFICATION_TONES, duration, name="yan2020 (28)")


def sine_trajectory(
    tones: tuple[Tone, ...], duration: float = DURATION, *, name: str = "sines"
) -> Trajectory:
    """Sum of sines of `tones` for the jaw of the forceps, swelling from rest over `RAMP`; 1 kHz.

    Raises TrajectoryError unless the duration after it is 1 to 3600 s and all tones are finite.
    """
    if not tones or not np.isfinite(tones).all():
        raise TrajectoryError(f"{name}: tones {tones}; give at least one, all finite")
    if not 1.0 <= duration <= 3600.0:
        raise TrajectoryError(f"{name}: duration {duration} s must be within [1, 3600] s")
    t = np.arange(round((duration + RAMP) * _RATE) + 1) / _RATE
    share = np.clip(t / RAMP, 0.0, 1.0)
    swell = share * share * (3.0 - 2.0 * share)
    angles = swell * sum(amplitude * np.sin(frequency * t) for amplitude, frequency in tones)
    return Trajectory(("jaw",), ("rad",), angles[:, None], t, name, {"robot": "forceps"})
