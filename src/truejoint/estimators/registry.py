"""Every estimator by the name that a user writes: one line each, and nothing else names them."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any, Final, cast

from truejoint.errors import CalibrationError, unknown
from truejoint.plugins import load_plugin, plugins

if TYPE_CHECKING:  # names are listed without what learns
    from truejoint.estimators.base import JointRegressor

BASELINES: Final = ("offset", "linear", "poly2")
"""What every calibration carries along to be compared with."""
DEFAULT: Final = "dnn"
"""What is fitted where none is named."""

_ESTIMATORS: Final[dict[str, tuple[str, str, dict[str, Any]]]] = {
    "offset": ("polynomial", "FixedOffset", {}),
    "linear": ("polynomial", "PolynomialRegressor", {"degree": 1}),
    "poly2": ("polynomial", "PolynomialRegressor", {}),
    "dnn": ("network", "NeuralNetwork", {}),
    "gru": ("recurrent", "RecurrentNetwork", {}),
    "lsm": ("cable_least_squares", "CableLeastSquares", {}),
    "lsm_intercept": ("cable_least_squares", "CableLeastSquares", {"intercept": True}),
    "lsm_compensated": ("cable_least_squares", "CableLeastSquares", {"compensated": True}),
    "ukf": ("jaw_filter", "JawFilter", {}),
    "ukf_compensated": ("jaw_filter", "JawFilter", {"compensation": "output"}),
    "play_motor": ("play", "Play", {"displacements": ("motor",)}),
    "play_reset": ("play", "Play", {"displacements": ("reset",)}),
    "play_both": ("play", "Play", {"displacements": ("reset", "motor")}),
    "play_cables": ("play", "Play", {"displacements": ("reset", "drive")}),
    "play_gated": ("play", "GatedPlay", {}),
    "ukf_friction": ("friction_filter", "FrictionFilter", {}),
    "ukf_friction_smoothed": ("friction_filter", "FrictionSmoother", {}),
    "ukf_elastic": ("elastic_joint", "ElasticJointFilter", {}),
}
"""Module of this package, class, and parameters that are not its defaults, by name."""

TITLES: Final = {
    "offset": ("Fixed offset", "the fixed offset"),
    "linear": ("Linear", "the linear model"),
    "poly2": ("2nd-order polynomial", "the 2nd-order polynomial"),
    "dnn": ("Neural network", "the neural network"),
}
"""What a person calls some of them, alone and within a sentence; others go by their names."""


def estimator_names() -> tuple[str, ...]:
    """Names that `get_estimator` knows: truejoint's own, and those of other packages.

    Examples
    --------
    >>> estimator_names()[:4]
    ('offset', 'linear', 'poly2', 'dnn')
    """
    return (*_ESTIMATORS, *_plugins())


def get_estimator(name: str) -> JointRegressor:
    """Unfitted estimator called `name`; raises CalibrationError naming the known ones.

    Examples
    --------
    >>> get_estimator("poly2").degree
    2
    """
    if name in _ESTIMATORS:
        return _class(name)(**_ESTIMATORS[name][2])
    if name not in _plugins():
        raise CalibrationError(unknown("estimator", name, estimator_names()))
    joint_regressor = _imported("wrapped", "joint_regressor")
    return cast("JointRegressor", joint_regressor(load_plugin(_plugins()[name], type)()))


def _plugins() -> dict[str, EntryPoint]:
    """Regressors of other packages, each a class with scikit-learn's `fit` and `predict`."""
    return plugins("truejoint.estimators", tuple(_ESTIMATORS))


def name_of(estimator: JointRegressor) -> str:
    """Name under which an estimator of these parameters is registered; else that of its family."""
    for cls in type(estimator).__mro__:
        kinds = {
            name: own
            for name, (module, known, own) in _ESTIMATORS.items()
            if (f"truejoint.estimators.{module}", known) == (cls.__module__, cls.__name__)
        }
        told_apart = {parameter for own in kinds.values() for parameter in own}
        for name in kinds:
            registered = get_estimator(name)
            if all(getattr(estimator, p) == getattr(registered, p) for p in told_apart):
                return name
    return estimator.family.name


def class_of(family: str) -> type[JointRegressor]:
    """Class of estimators whose family is called so: one by name, or what runs any family."""
    for name in _ESTIMATORS:
        cls = _class(name)
        if cls.family.name == family:
            return cls
    return cast("type[JointRegressor]", _imported("wrapped", "WrappedRegressor"))


def _class(name: str) -> type[JointRegressor]:
    return cast("type[JointRegressor]", _imported(*_ESTIMATORS[name][:2]))


def _imported(module: str, name: str) -> Any:
    """Import what a module of this package holds only now: names are listed without it."""
    return getattr(import_module(f"truejoint.estimators.{module}"), name)
