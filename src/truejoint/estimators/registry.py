"""Every estimator by the name that a user writes."""

from __future__ import annotations

from functools import cache
from typing import Final

from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.linear import FixedOffset, LinearRegressor, PolynomialRegressor
from truejoint.estimators.network import NeuralNetwork

ESTIMATORS: Final[dict[str, type[JointRegressor]]] = {
    "offset": FixedOffset,
    "linear": LinearRegressor,
    "poly2": PolynomialRegressor,
    "dnn": NeuralNetwork,
}
"""Estimators as a class each, whose defaults are those of peng2024."""


JAW_ESTIMATORS: Final = (
    "lsm", "lsm_intercept", "lsm_compensated", "ukf", "ukf_compensated", "play_motor", "play_reset",
    "play_both", "play_cables", "play_gated", "ukf_friction", "ukf_friction_smoothed",
)  # fmt: skip
"""Estimators of a cable-driven jaw from its cables: those of yan2020, and past them."""

MOTOR_SIDE_ESTIMATORS: Final = ("ukf_elastic",)
"""Estimators of a cable-driven jaw of which only the driver's angle and torque are measured."""


@cache
def families() -> dict[str, type[JointRegressor]]:
    """Every class of estimator by the name that stands in model files."""
    # Imported here because the filters compile for seconds on their first use ever.
    from truejoint.estimators.elastic_joint import ElasticJointFilter  # noqa: PLC0415
    from truejoint.estimators.jaw_classes import JAW_CLASSES  # noqa: PLC0415

    classes: tuple[type[JointRegressor], ...] = (
        *ESTIMATORS.values(),
        *JAW_CLASSES,
        ElasticJointFilter,
    )
    return {cls.family: cls for cls in classes}


def estimator_names() -> tuple[str, ...]:
    """Names that `get_estimator` knows."""
    return (*ESTIMATORS, *JAW_ESTIMATORS, *MOTOR_SIDE_ESTIMATORS)


def get_estimator(name: str) -> JointRegressor:
    """Unfitted estimator called `name`; raises CalibrationError naming the known ones."""
    if name in ESTIMATORS:
        return ESTIMATORS[name]()
    if name in estimator_names():
        return families()[name]()
    raise CalibrationError(f"no estimator called {name!r}; known: {', '.join(estimator_names())}")
