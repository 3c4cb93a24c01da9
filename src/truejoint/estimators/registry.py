"""Every estimator by the name that a user writes; what learns is imported when asked for."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.names import OFFSET
from truejoint.plugins import plugins

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

BASELINES: Final = (OFFSET, "linear", "poly2")
"""What every calibration carries along to be compared with."""
LINEAR: Final = BASELINES[1]  # what an automatic choice keeps unless another is better
AUTO: Final = "auto"  # stands for an automatic choice where the name of an estimator does
DEFAULT: Final = "dnn"  # what is fitted where none is named
BESIDE_FILTER: Final = "rich_trees"  # what a choice tries on the signals of a filter with trees


class _Line(NamedTuple):
    """Where an estimator is, and how an automatic choice tries it."""

    module: str  # of this package, or of scikit-learn
    cls: str
    params: Mapping[str, Any]  # that are not its defaults
    tried: Mapping[str, Any] | None = None  # parameters for it besides; None: it is not tried


_MANY: Final = 100_000  # rows, evenly spread, that what takes long is fitted to for a choice
_SMALL: Final = {"epochs": 0, "hidden_layer_sizes": (50, 50), "batch_size": 256, "rows": _MANY}
"""Of a network that converges in seconds.

Its epochs are those of the few thousand rows of a choice; over a million they would take minutes.
"""
_ESTIMATORS: Final[dict[str, _Line]] = {
    OFFSET: _Line("polynomial.learn", "FixedOffset", {}, {}),
    "linear": _Line("polynomial.learn", "PolynomialRegressor", {"degree": 1}, {}),
    "poly2": _Line("polynomial.learn", "PolynomialRegressor", {}),
    "dnn": _Line("network.learn", "NeuralNetwork", {}, _SMALL),
    "pose_network": _Line("network.pose_network", "PoseNetwork", {}),
    "poly2_ridge": _Line("polynomial.ridge", "Ridge", {}, {}),
    "linear_trees": _Line(
        "stack.learn", "Combination", {"members": (LINEAR, "boosted_trees")}, {"rows": _MANY}
    ),
    "network_forest": _Line("stack.learn", "Combination", {"members": ("dnn", "random_forest")}),
    "rich_play": _Line("plays.learn", "RichPlay", {"learner": "ridge"}, {}),
    "rich_trees": _Line("plays.learn", "RichPlay", {"learner": "trees"}, {}),
    "coupled_play": _Line("plays.learn", "RichPlay", {"learner": "trees", "couple": True}, {}),
    "run_out": _Line("plays.learn", "RichPlay", {"learner": "ridge", "turn": True}, {}),
    "gp": _Line("gp.learn", "GaussianProcess", {}, {}),
    "gp_lowpass": _Line("plays.learn", "RichPlay", {"learner": "gaussian_process"}, {}),
    "gru": _Line("network.sequence", "RecurrentNetwork", {"cell": "gated_unit"}),
    "lstm": _Line("network.sequence", "RecurrentNetwork", {"cell": "long_short_term"}),
    "tcn": _Line("network.sequence", "TemporalConvolution", {}),
    "lsm": _Line("jaw.learn", "CableLeastSquares", {}),
    "lsm_intercept": _Line("jaw.learn", "CableLeastSquares", {"intercept": True}),
    "lsm_compensated": _Line("jaw.learn", "CableLeastSquares", {"compensated": True}),
    "ukf": _Line("jaw.learn", "JawFilter", {}),
    "ukf_compensated": _Line("jaw.learn", "JawFilter", {"compensation": "output"}),
    "play_motor": _Line("plays.jaw_plays", "Play", {"displacements": ("motor",)}),
    "play_drive": _Line("plays.jaw_plays", "Play", {"displacements": ("drive",)}),
    "play_reset": _Line("plays.jaw_plays", "Play", {"displacements": ("reset",)}),
    "play_both": _Line("plays.jaw_plays", "Play", {"displacements": ("reset", "motor")}),
    "play_cables": _Line("plays.jaw_plays", "Play", {"displacements": ("reset", "drive")}),
    "play_gated": _Line("plays.jaw_plays", "GatedPlay", {}),
    "ukf_friction": _Line("jaw_load.learn", "FrictionFilter", {}),
    "ukf_elastic": _Line("motor_side.learn", "ElasticJointFilter", {}),
    "hybrid": _Line("motor_side.hybrid", "ElasticJointHybrid", {}, {}),
    "ukf_cables": _Line("cables.learn", "CableFilter", {}),
    "hybrid_cables": _Line("cables.hybrid", "CableHybrid", {}),
}
_TREES: Final = {
    "boosted_trees": _Line(
        "sklearn.ensemble",
        "HistGradientBoostingRegressor",
        {"early_stopping": False, "random_state": 0},
    ),
    "random_forest": _Line(
        "sklearn.ensemble",
        "RandomForestRegressor",
        {"n_estimators": 60, "min_samples_leaf": 5, "n_jobs": 1, "random_state": 0},
    ),
}
"""Of scikit-learn, as members of a combination; they become arrays of ours."""
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
    module, cls, own, _ = _ESTIMATORS[name]
    return getattr(import_module(f"truejoint.estimators.{module}"), cls)(**own)


def parameter_names(name: str) -> tuple[str, ...]:
    """Parameters of one of truejoint's own names, read from its source; none of another name.

    A shell that completes a word cannot wait for what learns to be imported.
    """
    if name not in _ESTIMATORS:
        return ()
    module, cls = _ESTIMATORS[name].module, _ESTIMATORS[name].cls
    found: dict[str, None] = {}
    while module:  # and those that it inherits from, here
        file = Path(__file__).parent.joinpath(*module.split(".")).with_suffix(".py")
        source = file.read_text(encoding="utf-8")
        body = ast.parse(source).body
        classes = {node.name: node for node in body if isinstance(node, ast.ClassDef)}
        while cls in classes:
            for node in classes[cls].body:
                if isinstance(node, ast.AnnAssign) and "ClassVar" not in ast.unparse(
                    node.annotation
                ):
                    found[ast.unparse(node.target)] = None
            cls = ast.unparse(classes[cls].bases[0])
        imported, package = _imported_from(body, cls), f"{__package__}."
        module = imported.removeprefix(package) if imported.startswith(package) else ""
    return tuple(found)


def _imported_from(body: list[ast.stmt], name: str) -> str:
    """Give the module that a source takes a name from; none where it imports no such name."""
    imports = (node for node in body if isinstance(node, ast.ImportFrom))
    known = {alias.name: node.module or "" for node in imports for alias in node.names}
    return known.get(name, "")


def member(name: str) -> Any:
    """Unfitted regressor that a combination calls so: one of truejoint's own names, or of trees.

    Raises CalibrationError if it is neither.
    """
    if name in _TREES:
        line = _TREES[name]
        return getattr(import_module(line.module), line.cls)(**line.params)
    if name not in OWN:
        raise CalibrationError(unknown("member", name, (*OWN, *_TREES)))
    return registered(name)


def tried() -> list[Any]:
    """Unfitted estimators that an automatic choice tries."""
    return [
        registered(name).set_params(**line.tried)
        for name, line in _ESTIMATORS.items()
        if line.tried is not None
    ]


def plugged_in() -> dict[str, EntryPoint]:
    """Regressors of other packages, each a class with scikit-learn's `fit` and `predict`."""
    return plugins("truejoint.estimators", OWN)


def name_of(estimator: Any) -> str:
    """Name under which an estimator of these parameters is registered; else that of its family."""
    for cls in type(estimator).__mro__:
        kinds = {
            name: own
            for name, (module, known, own, _) in _ESTIMATORS.items()
            if (f"truejoint.estimators.{module}", known) == (cls.__module__, cls.__name__)
        }
        told_apart = {parameter for own in kinds.values() for parameter in own}
        for name in kinds:
            usual = registered(name)
            if all(getattr(estimator, p) == getattr(usual, p) for p in told_apart):
                return name
    return str(estimator.family.name)
