"""A cable-driven jaw's signals, and the rational error model (25) of yan2020."""

from collections.abc import Mapping
from math import exp, nan
from typing import Final

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.estimators.family import Shape
from truejoint.estimators.rules import LARGEST, POSITIVE, Rule, number
from truejoint.features.feature_set import play

MOTOR: Final = "motor/jaw"
DRIVE: Final = "cable/drive"
RESET: Final = "cable/reset"

MECHANISM_RULES: Final[Mapping[str, Rule]] = {
    "gear_ratio": number(1.0, LARGEST),
    "spring_stiffness": POSITIVE,
    "wheel_radius": POSITIVE,
    "jaw_radius": POSITIVE,
}
"""What the values of yan2020, Table 1, must be."""

COEFFICIENTS: Final = 11
"""Coefficients of the error model (25)."""
NEAREST: Final = 1e-3
"""To which the error model's denominator is kept from zero when evaluated."""
ERROR_SHAPES: Final[Mapping[str, Shape]] = {
    "scale": (2,),
    "error_coef": (COEFFICIENTS,),
    "error_range": (2,),
}
"""What is learnt of (25), and how far it may go."""


STANDSTILL: Final = 0.5
"""Time that the reset cable must stand for friction to have given way all it does [s]."""
SLIDING: Final = 2e-5
"""Motion of the reset cable after which friction is known again [m]."""
FLICKER: Final = 2e-6
"""Motion of the reset cable that is none, but counts of its encoder [m]."""


@compiled
def stand(dt: float, reset: float, hold: Array) -> float:
    """How far friction has had the time to hide a load from a reset cable that stands, 0 to 1.

    `hold` (2,), where the cable stands [m] and what was last returned, changes; `dt` is 0 where a
    history starts.
    """
    place = play(FLICKER, dt == 0.0, reset, hold[0])
    moved = 0.0 if dt == 0.0 else abs(place - hold[0])
    hold[1] = 1.0 if dt == 0.0 else min(hold[1] + dt / STANDSTILL, 1.0) * exp(-moved / SLIDING)
    hold[0] = place
    return float(hold[1])


@compiled
def rational_error(motor: float, reset: float, scale: Array, p: Array) -> float:
    """Error (25) at one motor angle [rad] and displacement [m]; finite whatever the denominator."""
    u = motor * scale[0]
    v = reset * scale[1]
    above = p[0] + p[2] * u + p[4] * v + p[6] * u * u + p[8] * v * v + p[10] * u * v
    below = 1.0 + p[1] * u + p[3] * v + p[5] * u * u + p[7] * v * v + p[9] * u * u * v
    if abs(below) < NEAREST:
        below = NEAREST if below >= 0.0 else -NEAREST
    return float(above / below)


@compiled
def bounded_error(
    motor: float, reset: float, scale: Array, p: Array, error_range: Array, half_width: Array
) -> float:
    """Error (25) kept within the (2,) that calibration saw [rad]: beyond, a pole may be near.

    Where it is cut off, `half_width` becomes NaN: the model extrapolates.
    """
    error = rational_error(motor, reset, scale, p)
    bounded = min(max(error, error_range[0]), error_range[1])
    if bounded != error:
        half_width[0] = nan
    return float(bounded)
