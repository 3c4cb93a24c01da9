"""Names of the estimators, for those who only list them: nothing of what learns is imported."""

from __future__ import annotations

from typing import Final

REGRESSORS: Final = ("offset", "linear", "poly2", "dnn")
"""Estimators that keep no history."""

JAW_ESTIMATORS: Final = (
    "lsm", "lsm_intercept", "lsm_compensated", "ukf", "ukf_compensated", "play_motor", "play_reset",
    "play_both", "play_cables", "play_gated", "ukf_friction", "ukf_friction_smoothed",
)  # fmt: skip
"""Estimators of a cable-driven jaw from its cables: those of yan2020, and past them."""

MOTOR_SIDE_ESTIMATORS: Final = ("ukf_elastic",)
"""Estimators of a cable-driven jaw of which only the driver's angle and torque are measured."""


def estimator_names() -> tuple[str, ...]:
    """Names that `get_estimator` knows."""
    return (*REGRESSORS, *JAW_ESTIMATORS, *MOTOR_SIDE_ESTIMATORS)
