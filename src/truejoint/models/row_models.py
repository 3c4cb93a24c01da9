"""How each family of estimators predicts one row in the loop.

A row model is two flat arrays and one compiled function with one signature for all families. A new
family, also one that remembers, adds a builder to `BUILDERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from truejoint.compiled import compiled
from truejoint.errors import ModelFileError
from truejoint.filters.memory import matrix, vector
from truejoint.models import kernels
from truejoint.models.families import EstimatorData, degree_of, layer_sizes, polynomial_terms
from truejoint.models.filter_rows import FILTERS
from truejoint.models.jaw_rows import REGRESSIONS
from truejoint.models.known_families import FAMILIES
from truejoint.models.row_model import Array, Integers, RowModel


def row_model(data: EstimatorData, n_features: int, n_outputs: int) -> RowModel:
    """Row model of a fitted estimator.

    Raises
    ------
    ModelFileError
        If its family has none, as one that needs later rows.
    CalibrationError, FilterError
        If its numbers make no filter.
    """
    if data.family in FAMILIES and not FAMILIES[data.family].causal:
        raise ModelFileError(
            f"estimator {data.family!r} uses later rows and cannot run in a loop; it corrects "
            "recordings only"
        )
    if data.family not in BUILDERS:
        raise ModelFileError(
            f"estimator family {data.family!r:.60} has no kernel for the loop; known: "
            f"{', '.join(BUILDERS)}"
        )
    return BUILDERS[data.family](data, n_features, n_outputs)


@compiled
def offset_row(
    numbers: Integers,
    memory: Array,
    interval: float,  # noqa: ARG001  # every row function takes the same arguments
    features: Array,  # noqa: ARG001
    out: Array,
    half_width: Array,  # noqa: ARG001
) -> None:
    """Predict one row: a fixed offset.

    Parameters
    ----------
    numbers, memory : ndarray, 1-D
        Those of the `RowModel`; `memory` may change.
    interval : float
        Time since the row before [s], 0 where a history starts.
    features : ndarray, shape (k,)
    out : ndarray, shape (n_outputs,)
        Receives error or position [rad or m]; NaN where the model knows that it has none.
    half_width : ndarray, shape (n_outputs,)
        That of the calibration [rad or m]; a model that knows better overwrites it.
    """
    for j in range(numbers[0]):
        out[j] = memory[j]


@compiled
def polynomial_row(
    numbers: Integers,
    memory: Array,
    interval: float,  # noqa: ARG001
    features: Array,
    out: Array,
    half_width: Array,  # noqa: ARG001
) -> None:
    """Predict one row: linear or polynomial; arguments as in `offset_row`."""
    k, n, n_terms, degree = numbers[0], numbers[1], numbers[2], numbers[3]
    coef = 3 * k + n
    kernels.polynomial_row(
        features,
        vector(memory, 0, k),
        vector(memory, k, k),
        numbers[4:].reshape(n_terms, degree),
        matrix(memory, coef, n_terms, n),
        vector(memory, 3 * k, n),
        vector(memory, 2 * k, k),
        out,
    )


@compiled
def network_row(
    numbers: Integers,
    memory: Array,
    interval: float,  # noqa: ARG001
    features: Array,
    out: Array,
    half_width: Array,  # noqa: ARG001
) -> None:
    """Predict one row: a network; arguments as in `offset_row`."""
    k, n, width, n_biases, n_weights = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    work = 2 * k + 2 * n
    biases = work + 2 * width
    kernels.network_row(
        features,
        vector(memory, 0, k),
        vector(memory, k, k),
        numbers[5:],
        vector(memory, biases + n_biases, n_weights),
        vector(memory, biases, n_biases),
        vector(memory, 2 * k, n),
        vector(memory, 2 * k + n, n),
        matrix(memory, work, 2, width),
        out,
    )


def _offset(data: EstimatorData, _n_features: int, n_outputs: int) -> RowModel:
    return RowModel(offset_row, np.array([n_outputs]), data.arrays["offset"].copy())


def _polynomial(data: EstimatorData, n_features: int, n_outputs: int) -> RowModel:
    arrays = data.arrays
    terms = polynomial_terms(n_features, degree_of(data))
    parts = (
        arrays["mean"], arrays["inverse_scale"], np.zeros(n_features), arrays["intercept"],
        arrays["coef"].ravel(),
    )  # fmt: skip
    numbers = np.concatenate([[n_features, n_outputs, *terms.shape], terms.ravel()])
    return RowModel(polynomial_row, numbers.astype(np.int64), np.concatenate(parts))


def _network(data: EstimatorData, n_features: int, n_outputs: int) -> RowModel:
    arrays = data.arrays
    sizes = layer_sizes(data.params, n_features, n_outputs)
    layers = range(len(sizes) - 1)
    biases = np.concatenate([arrays[f"bias_{i}"] for i in layers])
    weights = np.concatenate([arrays[f"weight_{i}"].ravel() for i in layers])
    parts = (
        arrays["mean"], arrays["inverse_scale"], arrays["target_mean"], arrays["target_scale"],
        np.zeros(2 * max(sizes)), biases, weights,
    )  # fmt: skip
    numbers = [n_features, n_outputs, max(sizes), len(biases), len(weights), *sizes]
    return RowModel(network_row, np.array(numbers, dtype=np.int64), np.concatenate(parts))


BUILDERS: Final[Mapping[str, Callable[[EstimatorData, int, int], RowModel]]] = {
    "offset": _offset,
    "linear": _polynomial,
    "polynomial": _polynomial,
    "dnn": _network,
    **REGRESSIONS,
    **FILTERS,
}
"""Builder of the row model of each family, of its data, features and outputs."""
