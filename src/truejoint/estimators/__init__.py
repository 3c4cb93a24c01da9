"""Everything that turns motor-side signals into a joint position, and the model file."""

from truejoint.estimators.base import JointRegressor
from truejoint.estimators.calibration import Calibration, OnlineState, load_calibration
from truejoint.estimators.features import (
    Feature,
    FeatureSet,
    default_features,
    default_gap_limit,
    run_starts,
    sample_interval,
)
from truejoint.estimators.fitting import calibrate
from truejoint.estimators.linear import FixedOffset, LinearRegressor, PolynomialRegressor
from truejoint.estimators.network import NeuralNetwork
from truejoint.estimators.registry import (
    BASELINES,
    ESTIMATORS,
    estimator_names,
    get_estimator,
)

__all__ = [
    "BASELINES",
    "ESTIMATORS",
    "Calibration",
    "Feature",
    "FeatureSet",
    "FixedOffset",
    "JointRegressor",
    "LinearRegressor",
    "NeuralNetwork",
    "OnlineState",
    "PolynomialRegressor",
    "calibrate",
    "default_features",
    "default_gap_limit",
    "estimator_names",
    "get_estimator",
    "load_calibration",
    "run_starts",
    "sample_interval",
]
