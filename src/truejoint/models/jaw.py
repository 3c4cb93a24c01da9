"""A cable-driven jaw's signals, and the rational error model (25) of yan2020."""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.models.family import one_of

MOTOR: Final = "motor/jaw"
DRIVE: Final = "cable/drive"
RESET: Final = "cable/reset"

COEFFICIENTS: Final = 11
"""Coefficients of the error model (25)."""
NEAREST: Final = 1e-3
"""To which the error model's denominator is kept from zero when evaluated."""
FIT_METHODS: Final = ("projection", "quasi_newton", "global")
"""How (25) can be fitted."""
FIT_METHOD: Final = one_of(*FIT_METHODS)


NO_ERROR: Final = {"scale": np.ones(2), "error_coef": np.zeros(COEFFICIENTS)}
"""What stands for the arrays of (25) where there is none."""


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
