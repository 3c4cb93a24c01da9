"""Every estimator by the name that a user writes; what learns is imported when asked for."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from truejoint.models.names import OFFSET
from truejoint.plugins import plugins

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

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


def parameter_names(name: str) -> tuple[str, ...]:
    """Parameters of one of truejoint's own names, read from its source; none of another name.

    A shell that completes a word cannot wait for what learns to be imported.
    """
    module, cls, _ = _ESTIMATORS.get(name, ("registry", "", {}))
    source = Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8")
    classes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)}
    found: dict[str, None] = {}
    while cls in classes:  # what it inherits from within the module
        for node in classes[cls].body:
            if isinstance(node, ast.AnnAssign) and "ClassVar" not in ast.unparse(node.annotation):
                found[ast.unparse(node.target)] = None
        cls = ast.unparse(classes[cls].bases[0])
    return tuple(found)


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
