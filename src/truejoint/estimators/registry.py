"""Every estimator by the name that a user writes; what learns is imported when asked for.

A preset is a line: the class that learns, the module whose `FAMILY` runs what it learnt, and
parameters. A new estimator is a folder beside this file, a line here and one in `summaries.toml`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import import_module, resources
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from truejoint.errors import CalibrationError, unknown
from truejoint.plugins import plugins

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

OFFSET: Final = "offset"  # errors are given as a percentage of its error
RAW: Final = "raw"  # the measured position without a correction
BASELINES: Final = (OFFSET, "linear", "poly2")
"""What every calibration carries along to be compared with."""
LINEAR: Final = BASELINES[1]  # what an automatic choice keeps unless another is better
AUTO: Final = "auto"  # stands for an automatic choice where the name of an estimator does
DEFAULT: Final = AUTO  # what is fitted where none is named
NETWORK: Final = "dnn"  # that of peng2024
BOOSTED_TREES: Final = "boosted_trees"  # of scikit-learn, as a member of a stack
FILTER_WITH_TREES: Final = "hybrid"  # of which a choice believes, before it knows, that half of it
BESIDE_FILTER: Final = "rich_trees"  # and half of this are best


class Preset(NamedTuple):
    """A class with parameters, and whether an automatic choice tries it."""

    learns: str  # class, with its module below this package
    runs: str  # module below this package whose `FAMILY` runs it, or the one named behind a colon
    params: Mapping[str, Any] = {}  # all that tell the presets of a class from each other
    is_tried: bool = False

    @property
    def family(self) -> str:
        """Name of what runs it."""
        return self.runs.replace(".run", "").replace(":", ".")

    @property
    def kind(self) -> Any:
        """Class that learns, imported."""
        module, _, name = self.learns.rpartition(".")
        return getattr(import_module(f"{__package__}.{module}"), name)


_PLAYS: Final = "plays.learn.Plays", "plays.run"
_JAW_PLAYS: Final = "plays.learn.JawPlays", "plays.run:jaw_bank"
_LEAST_SQUARES: Final = "jaw.learn.CableLeastSquares", "jaw.run:least_squares"
_POLYNOMIAL: Final = "polynomial.learn.Polynomial", "polynomial.run"

PRESETS: Final[dict[str, Preset]] = {
    OFFSET: Preset(*_POLYNOMIAL, {"degree": 0, "ridge": False}, True),
    "linear": Preset(*_POLYNOMIAL, {"degree": 1, "ridge": False}, True),
    "poly2": Preset(*_POLYNOMIAL, {"degree": 2, "ridge": False}),
    "dnn": Preset("network.learn.NeuralNetwork", "network.run"),
    "poly2_ridge": Preset(*_POLYNOMIAL, {"degree": 2, "ridge": True}, True),
    "linear_trees": Preset(
        "stack.learn.Stack", "stack.run", {"members": (LINEAR, BOOSTED_TREES)}, True
    ),
    "rich_play": Preset(*_PLAYS, {"learner": "ridge", "couple": False, "turn": False}, True),
    "rich_trees": Preset(*_PLAYS, {"learner": "trees", "couple": False, "turn": False}, True),
    "coupled_play": Preset(*_PLAYS, {"learner": "trees", "couple": True, "turn": False}, True),
    "run_out": Preset(*_PLAYS, {"learner": "ridge", "couple": False, "turn": True}, True),
    "gp": Preset("gp.learn.GaussianProcess", "gp.run", {}, True),
    "gp_lowpass": Preset(
        *_PLAYS, {"learner": "gaussian_process", "couple": False, "turn": False}, True
    ),
    "gru": Preset("network.learn.GRU", "network.run:gru"),
    "tcn": Preset("network.learn.TCN", "network.run:tcn"),
    "lsm": Preset(*_LEAST_SQUARES, {"intercept": False, "compensated": False}),
    "lsm_intercept": Preset(*_LEAST_SQUARES, {"intercept": True, "compensated": False}),
    "lsm_compensated": Preset(*_LEAST_SQUARES, {"intercept": False, "compensated": True}),
    "ukf": Preset("jaw.learn.JawFilter", "jaw.run", {"compensated": False}),
    "ukf_compensated": Preset("jaw.learn.JawFilter", "jaw.run", {"compensated": True}),
    "play_motor": Preset(*_JAW_PLAYS, {"signals": ("motor/jaw",)}),
    "play_drive": Preset(*_JAW_PLAYS, {"signals": ("cable/drive",)}),
    "play_reset": Preset(*_JAW_PLAYS, {"signals": ("cable/reset",)}),
    "play_both": Preset(*_JAW_PLAYS, {"signals": ("motor/jaw", "cable/reset")}),
    "play_cables": Preset(*_JAW_PLAYS, {"signals": ("cable/drive", "cable/reset")}),
    "play_gated": Preset("jaw_load.learn.GatedPlays", "jaw_load.run:gated", {}, True),
    "ukf_friction": Preset("jaw_load.learn.FrictionFilter", "jaw_load.run"),
    "ukf_elastic": Preset("motor_side.learn.ElasticJointFilter", "motor_side.run"),
    "hybrid": Preset("motor_side.learn.ElasticJointHybrid", "motor_side.run:hybrid_rows", {}, True),
    "ukf_cables": Preset("cables.learn.CableFilter", "cables.run"),
    "hybrid_cables": Preset("cables.learn.CableHybrid", "cables.run:hybrid_rows", {}, True),
}
BOOSTED: Final = {"early_stopping": False, "random_state": 0}
"""Parameters of scikit-learn's boosted trees as a member of a stack; they become arrays of ours."""
OWN: Final = tuple(PRESETS)  # names of truejoint's own
FAMILIES: Final = {p.family: p.runs for p in PRESETS.values()} | {"trees": "trees.run"}
"""Where each family is, by its name; trees are part of other estimators."""

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


def summaries() -> dict[str, dict[str, str]]:
    """Say `what` each of truejoint's own estimators is, and what it `sees`.

    Examples
    --------
    >>> summaries()["linear"]
    {'what': 'least squares on the features', 'sees': 'any features'}
    """
    text = resources.files(__package__).joinpath("summaries.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def registered(name: str) -> Any:
    """Unfitted estimator of one of truejoint's own names."""
    return PRESETS[name].kind(**PRESETS[name].params)


def member(name: str) -> Any:
    """Unfitted regressor that a stack calls so: one of truejoint's own names, or boosted trees.

    Raises CalibrationError if it is neither.
    """
    if name == BOOSTED_TREES:
        ensemble = import_module("sklearn.ensemble")
        return ensemble.HistGradientBoostingRegressor(**BOOSTED)
    if name not in OWN:
        raise CalibrationError(unknown("member", name, (*OWN, BOOSTED_TREES)))
    return registered(name)


def plugged_in() -> dict[str, EntryPoint]:
    """Regressors of other packages, each a class with scikit-learn's `fit` and `predict`."""
    return plugins("truejoint.estimators", OWN)


def name_of(estimator: Any) -> str:
    """Name of the preset of an estimator's class and parameters; else that of its family."""
    for cls in type(estimator).__mro__:
        learns = f"{cls.__module__}.{cls.__name__}".removeprefix(f"{__package__}.")
        for name, preset in PRESETS.items():
            same = (getattr(estimator, key) == value for key, value in preset.params.items())
            if preset.learns == learns and all(same):
                return name
    return str(estimator.family.name)
