"""Everything that turns motor-side signals into a joint position, and the model file."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.estimators.base import JointRegressor
    from truejoint.estimators.calibration import Calibration, OnlineState, load_calibration
    from truejoint.estimators.families import BASELINES
    from truejoint.estimators.features import (
        Feature,
        FeatureSet,
        default_features,
        default_gap_limit,
        run_starts,
        sample_interval,
    )
    from truejoint.estimators.fitting import calibrate
    from truejoint.estimators.interval import Interval, needed_trajectories
    from truejoint.estimators.interval_checks import (
        Coverage,
        CrossCheck,
        cross_check,
        measure_coverage,
    )
    from truejoint.estimators.linear import FixedOffset, LinearRegressor, PolynomialRegressor
    from truejoint.estimators.names import estimator_names
    from truejoint.estimators.network import NeuralNetwork
    from truejoint.estimators.registry import ESTIMATORS, get_estimator
    from truejoint.estimators.uncertainty import with_interval
    from truejoint.estimators.zeroing import Zero, find_zero, rezeroed

__all__ = [
    "BASELINES",
    "ESTIMATORS",
    "Calibration",
    "Coverage",
    "CrossCheck",
    "Feature",
    "FeatureSet",
    "FixedOffset",
    "Interval",
    "JointRegressor",
    "LinearRegressor",
    "NeuralNetwork",
    "OnlineState",
    "PolynomialRegressor",
    "Zero",
    "calibrate",
    "cross_check",
    "default_features",
    "default_gap_limit",
    "estimator_names",
    "find_zero",
    "get_estimator",
    "load_calibration",
    "measure_coverage",
    "needed_trajectories",
    "rezeroed",
    "run_starts",
    "sample_interval",
    "with_interval",
]

# Where each public name lives; imported on first use, so that a control loop does not wait for
# the training stack.
_HOMES = {
    "BASELINES": "truejoint.estimators.families",
    "Calibration": "truejoint.estimators.calibration",
    "Coverage": "truejoint.estimators.interval_checks",
    "CrossCheck": "truejoint.estimators.interval_checks",
    "ESTIMATORS": "truejoint.estimators.registry",
    "Feature": "truejoint.estimators.features",
    "FeatureSet": "truejoint.estimators.features",
    "FixedOffset": "truejoint.estimators.linear",
    "Interval": "truejoint.estimators.interval",
    "JointRegressor": "truejoint.estimators.base",
    "LinearRegressor": "truejoint.estimators.linear",
    "NeuralNetwork": "truejoint.estimators.network",
    "OnlineState": "truejoint.estimators.calibration",
    "PolynomialRegressor": "truejoint.estimators.linear",
    "Zero": "truejoint.estimators.zeroing",
    "calibrate": "truejoint.estimators.fitting",
    "cross_check": "truejoint.estimators.interval_checks",
    "default_features": "truejoint.estimators.features",
    "default_gap_limit": "truejoint.estimators.features",
    "estimator_names": "truejoint.estimators.names",
    "find_zero": "truejoint.estimators.zeroing",
    "get_estimator": "truejoint.estimators.registry",
    "load_calibration": "truejoint.estimators.calibration",
    "measure_coverage": "truejoint.estimators.interval_checks",
    "needed_trajectories": "truejoint.estimators.interval",
    "rezeroed": "truejoint.estimators.zeroing",
    "run_starts": "truejoint.estimators.features",
    "sample_interval": "truejoint.estimators.features",
    "with_interval": "truejoint.estimators.uncertainty",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.estimators' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
