"""What learns: scikit-learn estimators of joint positions, by name in the registry."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.estimators.base import JointRegressor
    from truejoint.estimators.linear import FixedOffset, LinearRegressor, PolynomialRegressor
    from truejoint.estimators.network import NeuralNetwork
    from truejoint.estimators.registry import ESTIMATORS, estimator_names, get_estimator

__all__ = [
    "ESTIMATORS",
    "FixedOffset",
    "JointRegressor",
    "LinearRegressor",
    "NeuralNetwork",
    "PolynomialRegressor",
    "estimator_names",
    "get_estimator",
]

_HOMES = {
    "ESTIMATORS": "truejoint.estimators.registry",
    "FixedOffset": "truejoint.estimators.linear",
    "JointRegressor": "truejoint.estimators.base",
    "LinearRegressor": "truejoint.estimators.linear",
    "NeuralNetwork": "truejoint.estimators.network",
    "PolynomialRegressor": "truejoint.estimators.linear",
    "estimator_names": "truejoint.estimators.registry",
    "get_estimator": "truejoint.estimators.registry",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.estimators' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
