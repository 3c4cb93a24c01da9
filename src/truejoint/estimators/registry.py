"""Every estimator by the name that a user writes."""

from __future__ import annotations

from functools import cache
from typing import Final

from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.linear import FixedOffset, LinearRegressor, PolynomialRegressor
from truejoint.estimators.names import REGRESSORS, estimator_names
from truejoint.estimators.network import NeuralNetwork

ESTIMATORS: Final[dict[str, type[JointRegressor]]] = dict(
    zip(REGRESSORS, (FixedOffset, LinearRegressor, PolynomialRegressor, NeuralNetwork), strict=True)
)
"""Estimators as a class each, whose defaults are those of peng2024."""


@cache
def families() -> dict[str, type[JointRegressor]]:
    """Every class of estimator by the name that stands in model files."""
    # Imported here because the filters compile for seconds on their first use ever.
    from truejoint.estimators.elastic_joint.filter import ElasticJointFilter  # noqa: PLC0415
    from truejoint.estimators.forceps.classes import JAW_CLASSES  # noqa: PLC0415

    classes: tuple[type[JointRegressor], ...] = (
        *ESTIMATORS.values(),
        *JAW_CLASSES,
        ElasticJointFilter,
    )
    return {cls.family: cls for cls in classes}


def get_estimator(name: str) -> JointRegressor:
    """Unfitted estimator called `name`; raises CalibrationError naming the known ones."""
    if name in ESTIMATORS:
        return ESTIMATORS[name]()
    if name in estimator_names():
        return families()[name]()
    raise CalibrationError(unknown("estimator", name, estimator_names()))
