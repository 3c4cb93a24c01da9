"""What an estimator is without its training: parameters and plain arrays, and the rules for both.

A control loop needs no more than this, so nothing here imports scikit-learn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import CalibrationError

Array = NDArray[np.float64]
Shape = tuple[int, ...]

BASELINES: Final = ("offset", "linear", "poly2")
"""What every calibration carries along to be compared with."""

MAX_DEGREE: Final = 5
MAX_TERMS: Final = 4000
"""Most terms of a polynomial: 88 features at degree 2."""
MAX_LAYERS: Final = 8
MAX_UNITS: Final = 2048


@dataclass(frozen=True, eq=False)
class EstimatorData:
    """A fitted estimator as data.

    Attributes
    ----------
    family : str
        A name in `known_families.FAMILIES`.
    params : mapping
        Parameters by name, as JSON values or tuples of them.
    arrays : mapping of str to ndarray
        What was learnt, float64, by name.
    """

    family: str
    params: Mapping[str, Any]
    arrays: Mapping[str, Array]


@dataclass(frozen=True)
class Family:
    """The rules of one kind of estimator.

    Attributes
    ----------
    parameters : frozenset of str
        Names of its parameters.
    check : callable
        Raises CalibrationError when one of the parameters breaks its rule.
    shapes : callable
        Name and shape of each array, of parameters, number of features and number of outputs;
        raises CalibrationError for numbers that the estimator does not take.
    counts_samples : bool
        Whether what was learnt belongs to one sample interval, within half.
    causal : bool
        Whether its output depends on no later row.
    """

    parameters: frozenset[str]
    check: Callable[[Mapping[str, Any]], None]
    shapes: Callable[[Mapping[str, Any], int, int], dict[str, Shape]]
    counts_samples: bool = False
    causal: bool = True


def check_names(family: str, params: Mapping[str, Any], known: Set[str]) -> None:
    """Raise CalibrationError when a parameter is unknown or missing."""
    if set(params) != known:
        raise CalibrationError(
            f"{family} has parameters {sorted(params)}; it needs {sorted(known)}"
        )


def check_arrays(family: str, arrays: Mapping[str, Array], shapes: Mapping[str, Shape]) -> None:
    """Raise CalibrationError when an array is missing, left over, mis-shaped or not finite."""
    if set(shapes) != set(arrays):
        raise CalibrationError(f"{family} has arrays {sorted(arrays)}; it needs {sorted(shapes)}")
    for name, shape in shapes.items():
        array = arrays[name]
        if array.shape != shape or array.dtype != np.float64:
            raise CalibrationError(
                f"{family} array {name!r} is {array.dtype} {array.shape}; "
                f"it must be float64 {shape}"
            )
        if not np.isfinite(array).all():
            raise CalibrationError(f"{family} array {name!r} is not finite")


def degree_of(data: EstimatorData) -> int:
    """Degree of a linear or polynomial estimator."""
    return int(data.params.get("degree", 1))


def count_terms(n_features: int, degree: int) -> int:
    """Count the products of 1 to `degree` of `n_features` features."""
    return math.comb(n_features + degree, degree) - 1


def polynomial_terms(n_features: int, degree: int) -> NDArray[np.int64]:
    """Features that each term multiplies (n_terms, degree), filled up with -1."""
    terms = [
        (*term, *(-1,) * (degree - order))
        for order in range(1, degree + 1)
        for term in combinations_with_replacement(range(n_features), order)
    ]
    return np.array(terms, dtype=np.int64).reshape(-1, degree)


def layer_sizes(params: Mapping[str, Any], n_features: int, n_outputs: int) -> tuple[int, ...]:
    """Units of the input, the hidden layers and the output of a network."""
    return (n_features, *(int(size) for size in params["hidden_layer_sizes"]), n_outputs)


def is_number(value: object, low: float, high: float) -> bool:
    """Whether `value` is a finite real number (no bool) in [low, high]."""
    return (
        isinstance(value, (int, float, np.integer, np.floating))
        and not isinstance(value, bool)
        and bool(low <= value <= high)
    )


def is_integer(value: object, low: int, high: int) -> bool:
    """Whether `value` is an integer (no bool) in [low, high]."""
    return (
        isinstance(value, (int, np.integer))
        and not isinstance(value, bool)
        and bool(low <= value <= high)
    )


def _check_nothing(_params: Mapping[str, Any]) -> None:
    """There are no parameters."""


def _offset_shapes(
    _params: Mapping[str, Any], _n_features: int, n_outputs: int
) -> dict[str, Shape]:
    return {"offset": (n_outputs,)}


def _check_polynomial(params: Mapping[str, Any]) -> None:
    if not is_integer(params["degree"], 1, MAX_DEGREE):
        raise CalibrationError(
            f"polynomial degree {params['degree']!r:.60} is not an integer from 1 to {MAX_DEGREE}"
        )


def _polynomial_shapes(
    params: Mapping[str, Any], n_features: int, n_outputs: int
) -> dict[str, Shape]:
    degree = int(params.get("degree", 1))
    n_terms = count_terms(n_features, degree)
    if n_terms > MAX_TERMS:
        raise CalibrationError(
            f"a polynomial of degree {degree} in {n_features} features has {n_terms} "
            f"terms, more than {MAX_TERMS}; choose fewer features"
        )
    return {
        "mean": (n_features,),
        "inverse_scale": (n_features,),
        "coef": (n_terms, n_outputs),
        "intercept": (n_outputs,),
    }


def _check_network(params: Mapping[str, Any]) -> None:
    sizes = params["hidden_layer_sizes"]
    good_sizes = (
        isinstance(sizes, (tuple, list))
        and 1 <= len(sizes) <= MAX_LAYERS
        and all(is_integer(size, 1, MAX_UNITS) for size in sizes)
    )
    seed = params["random_state"]
    good_seed = (
        seed is None or isinstance(seed, np.random.RandomState) or is_integer(seed, 0, 2**32 - 1)
    )
    rules = {
        "hidden_layer_sizes": (good_sizes, f"1 to {MAX_LAYERS} layers of 1 to {MAX_UNITS} units"),
        "weight_decay": (is_number(params["weight_decay"], 0.0, 1e3), "from 0 to 1000"),
        "learning_rate": (is_number(params["learning_rate"], 1e-9, 10.0), "from 1e-9 to 10"),
        "batch_size": (is_integer(params["batch_size"], 1, 10**6), "an integer from 1 to 1e6"),
        "epochs": (is_integer(params["epochs"], 1, 10**6), "an integer from 1 to 1e6"),
        "random_state": (good_seed, "None or an integer from 0 to 2**32 - 1"),
    }
    for name, (good, rule) in rules.items():
        if not good:
            raise CalibrationError(
                f"network parameter {name} is {params[name]!r:.60}; it must be {rule}"
            )


def _network_shapes(params: Mapping[str, Any], n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {
        "mean": (n_features,),
        "inverse_scale": (n_features,),
        "target_mean": (n_outputs,),
        "target_scale": (n_outputs,),
    }
    for i, (inputs, units) in enumerate(pairwise(layer_sizes(params, n_features, n_outputs))):
        shapes[f"weight_{i}"] = (inputs, units)
        shapes[f"bias_{i}"] = (units,)
    return shapes


REGRESSORS: Final[Mapping[str, Family]] = {
    "offset": Family(frozenset(), _check_nothing, _offset_shapes),
    "linear": Family(frozenset(), _check_nothing, _polynomial_shapes),
    "polynomial": Family(frozenset({"degree"}), _check_polynomial, _polynomial_shapes),
    "dnn": Family(
        frozenset(
            {
                "hidden_layer_sizes", "weight_decay", "learning_rate", "batch_size", "epochs",
                "random_state",
            }
        ),
        _check_network,
        _network_shapes,
    ),
}  # fmt: skip
"""Rules of the estimators that keep no history, by the name that stands in model files."""
