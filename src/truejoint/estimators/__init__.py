"""What learns: scikit-learn estimators of joint positions, by name in the registry."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.estimators.base import JointRegressor
    from truejoint.estimators.cable_least_squares import CableLeastSquares
    from truejoint.estimators.elastic_joint import ElasticJointFilter
    from truejoint.estimators.friction_filter import FrictionFilter, FrictionSmoother
    from truejoint.estimators.gated_play import GatedPlay
    from truejoint.estimators.jaw_filter import JawFilter
    from truejoint.estimators.jaw_load import JawLoad, Stiffness, identify_stiffness
    from truejoint.estimators.network import NeuralNetwork
    from truejoint.estimators.offset import FixedOffset
    from truejoint.estimators.play import Play
    from truejoint.estimators.polynomial import LinearRegressor, PolynomialRegressor
    from truejoint.estimators.registry import BASELINES, estimator_names, get_estimator

__all__ = [
    "BASELINES",
    "CableLeastSquares",
    "ElasticJointFilter",
    "FixedOffset",
    "FrictionFilter",
    "FrictionSmoother",
    "GatedPlay",
    "JawFilter",
    "JawLoad",
    "JointRegressor",
    "LinearRegressor",
    "NeuralNetwork",
    "Play",
    "PolynomialRegressor",
    "Stiffness",
    "estimator_names",
    "get_estimator",
    "identify_stiffness",
]

_HOMES = {
    "BASELINES": "truejoint.estimators.registry",
    "CableLeastSquares": "truejoint.estimators.cable_least_squares",
    "ElasticJointFilter": "truejoint.estimators.elastic_joint",
    "FixedOffset": "truejoint.estimators.offset",
    "FrictionFilter": "truejoint.estimators.friction_filter",
    "FrictionSmoother": "truejoint.estimators.friction_filter",
    "GatedPlay": "truejoint.estimators.gated_play",
    "JawFilter": "truejoint.estimators.jaw_filter",
    "JawLoad": "truejoint.estimators.jaw_load",
    "JointRegressor": "truejoint.estimators.base",
    "LinearRegressor": "truejoint.estimators.polynomial",
    "NeuralNetwork": "truejoint.estimators.network",
    "Play": "truejoint.estimators.play",
    "PolynomialRegressor": "truejoint.estimators.polynomial",
    "Stiffness": "truejoint.estimators.jaw_load",
    "estimator_names": "truejoint.estimators.registry",
    "get_estimator": "truejoint.estimators.registry",
    "identify_stiffness": "truejoint.estimators.jaw_load",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.estimators' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
