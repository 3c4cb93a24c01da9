"""Every estimator by the name that a user writes: one line each, and nothing else names them."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from truejoint.errors import CalibrationError, unknown

if TYPE_CHECKING:  # names are listed without what learns
    from truejoint.estimators.base import JointRegressor

BASELINES: Final = ("offset", "linear", "poly2")
"""What every calibration carries along to be compared with."""

_ESTIMATORS: Final[dict[str, tuple[str, str, dict[str, Any]]]] = {
    "offset": ("offset", "FixedOffset", {}),
    "linear": ("polynomial", "LinearRegressor", {}),
    "poly2": ("polynomial", "PolynomialRegressor", {}),
    "dnn": ("network", "NeuralNetwork", {}),
    "lsm": ("cable_least_squares", "CableLeastSquares", {}),
    "lsm_intercept": ("cable_least_squares", "CableLeastSquares", {"intercept": True}),
    "lsm_compensated": ("cable_least_squares", "CableLeastSquares", {"compensated": True}),
    "ukf": ("jaw_filter", "JawFilter", {}),
    "ukf_compensated": ("jaw_filter", "JawFilter", {"compensation": "output"}),
    "play_motor": ("play", "Play", {"displacements": ("motor",)}),
    "play_reset": ("play", "Play", {"displacements": ("reset",)}),
    "play_both": ("play", "Play", {"displacements": ("reset", "motor")}),
    "play_cables": ("play", "Play", {"displacements": ("reset", "drive")}),
    "play_gated": ("gated_play", "GatedPlay", {}),
    "ukf_friction": ("friction_filter", "FrictionFilter", {}),
    "ukf_friction_smoothed": ("friction_filter", "FrictionSmoother", {}),
    "ukf_elastic": ("elastic_joint", "ElasticJointFilter", {}),
}
"""Module of this package, class, and parameters that are not its defaults, by name."""


def estimator_names() -> tuple[str, ...]:
    """Names that `get_estimator` knows."""
    return tuple(_ESTIMATORS)


def get_estimator(name: str) -> JointRegressor:
    """Unfitted estimator called `name`; raises CalibrationError naming the known ones.

    Examples
    --------
    >>> get_estimator("poly2").degree
    2
    """
    if name not in _ESTIMATORS:
        raise CalibrationError(unknown("estimator", name, estimator_names()))
    return _class(name)(**_ESTIMATORS[name][2])


def class_of(family: str) -> type[JointRegressor]:
    """Class of estimators whose family is called so; raises CalibrationError if there is none."""
    for name in _ESTIMATORS:
        cls = _class(name)
        if cls.family.name == family:
            return cls
    raise CalibrationError(f"no estimator of family {family!r:.60}")


def _class(name: str) -> type[JointRegressor]:
    module, cls, _params = _ESTIMATORS[name]
    found: type[JointRegressor] = getattr(import_module(f"truejoint.estimators.{module}"), cls)
    return found
