"""Every estimator by the name that a user writes; what learns is imported when asked for."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint
from typing import Any, Final

from truejoint.models.names import OFFSET
from truejoint.plugins import plugins

BASELINES: Final = (OFFSET, "linear", "poly2")
"""What every calibration carries along to be compared with."""
DEFAULT: Final = "dnn"  # what is fitted where none is named

_ESTIMATORS: Final[dict[str, tuple[str, str, dict[str, Any]]]] = {
    OFFSET: ("polynomial", "FixedOffset", {}),
    "linear": ("polynomial", "PolynomialRegressor", {"degree": 1}),
    "poly2": ("polynomial", "PolynomialRegressor", {}),
    "dnn": ("network", "NeuralNetwork", {}),
    "gru": ("recurrent", "RecurrentNetwork", {}),
    "lsm": ("yan2020", "CableLeastSquares", {}),
    "lsm_intercept": ("yan2020", "CableLeastSquares", {"intercept": True}),
    "lsm_compensated": ("yan2020", "CableLeastSquares", {"compensated": True}),
    "ukf": ("yan2020", "JawFilter", {}),
    "ukf_compensated": ("yan2020", "JawFilter", {"compensation": "output"}),
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
OWN: Final = tuple(_ESTIMATORS)  # names of truejoint's own

TITLES: Final = {
    OFFSET: ("Fixed offset", "the fixed offset"),
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
    return (*OWN, *plugged_in())


def registered(name: str) -> Any:
    """Unfitted estimator of one of truejoint's own names."""
    module, cls, own = _ESTIMATORS[name]
    return getattr(import_module(f"truejoint.estimators.{module}"), cls)(**own)


def plugged_in() -> dict[str, EntryPoint]:
    """Regressors of other packages, each a class with scikit-learn's `fit` and `predict`."""
    return plugins("truejoint.estimators", OWN)


def name_of(estimator: Any) -> str:
    """Name under which an estimator of these parameters is registered; else that of its family."""
    for cls in type(estimator).__mro__:
        kinds = {
            name: own
            for name, (module, known, own) in _ESTIMATORS.items()
            if (f"truejoint.estimators.{module}", known) == (cls.__module__, cls.__name__)
        }
        told_apart = {parameter for own in kinds.values() for parameter in own}
        for name in kinds:
            usual = registered(name)
            if all(getattr(estimator, p) == getattr(usual, p) for p in told_apart):
                return name
    return str(estimator.family.name)
