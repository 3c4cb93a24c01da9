"""Every estimator by the name that a user writes."""

from __future__ import annotations

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


def estimator_names() -> tuple[str, ...]:
    """Names that `get_estimator` knows."""
    return tuple(ESTIMATORS)


def get_estimator(name: str) -> JointRegressor:
    """Unfitted estimator called `name`; raises CalibrationError naming the known ones."""
    if name not in ESTIMATORS:
        raise CalibrationError(
            f"no estimator called {name!r}; known: {', '.join(estimator_names())}"
        )
    return ESTIMATORS[name]()
