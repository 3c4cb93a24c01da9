"""Every estimator by the name that a user writes; what learns is imported when asked for.

A new estimator is a folder beside this file and a table in `presets.toml`.
"""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from truejoint.errors import CalibrationError, unknown
from truejoint.plugins import plugins
from truejoint.toml_file import shipped_table

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
ERROR_MODELS: Final = ("rich_play", "coupled_play")  # of true positions: of one joint, of several
FILTER_WITH_TREES: Final = "hybrid"  # of which a choice believes, before it knows, that half of it
BESIDE_FILTER: Final = "rich_trees"  # and half of this are best


class Preset(NamedTuple):
    """A class with parameters, and whether an automatic choice tries it, as `presets.toml` says."""

    learns: str
    what: str
    sees: str = "any features"
    family: str = ""  # name of what runs it
    params: Mapping[str, Any] = {}
    is_tried: bool = False
    title: Sequence[str] = ()

    @property
    def kind(self) -> Any:
        """Class that learns, imported."""
        module, _, name = self.learns.rpartition(".")
        return getattr(import_module(f"{__package__}.{module}"), name)


PRESETS: Final = {
    name: Preset(**{"family": row["learns"].partition(".")[0], **row})
    for name, row in shipped_table(__package__, "presets.toml").items()
}
BOOSTED: Final = {"early_stopping": False, "random_state": 0}
"""Parameters of scikit-learn's boosted trees as a member of a stack; they become arrays of ours."""
OWN: Final = tuple(PRESETS)  # names of truejoint's own
FAMILIES: Final = {preset.family for preset in PRESETS.values()} | {"trees"}
"""Names of the families, each its folder and, of a further one, what it is; trees are parts."""

TITLES: Final = {name: preset.title for name, preset in PRESETS.items() if preset.title}
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


def plugged_in() -> "dict[str, EntryPoint]":
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
