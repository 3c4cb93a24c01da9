"""What the C template of each family of estimators needs to know of a fitted one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import ExportError
from truejoint.models.families import EstimatorData, degree_of, polynomial_terms

Array = NDArray[np.float64]

BLOCK: Final = 4
"""Columns of a matrix are filled up with zeros to a multiple of this."""


def model_context(model: EstimatorData) -> tuple[str, Mapping[str, Any]]:
    """Template of a fitted estimator, and the values that it takes.

    The template defines ``static void predict(const real *x, real *predicted)``; ``room`` is how
    many numbers that needs on the stack. An estimator that is to be exported needs a template and
    an entry in `_CONTEXTS`.

    Raises
    ------
    ExportError
        If there is no template for the estimator's family.
    """
    if model.family not in _CONTEXTS:
        raise ExportError(
            f"estimator {model.family!r:.60} has no C source; known: {', '.join(_CONTEXTS)}"
        )
    template, context = _CONTEXTS[model.family]
    return template, context(model)


def padded(matrix: Array) -> Array:
    """Matrix (n, m), its columns filled up with zeros to a multiple of `BLOCK`."""
    return np.pad(matrix, ((0, 0), (0, -matrix.shape[1] % BLOCK)))


def _offset(model: EstimatorData) -> dict[str, Any]:
    return {**model.arrays, "room": 0}


def _polynomial(model: EstimatorData) -> dict[str, Any]:
    arrays = model.arrays
    n_features = len(arrays["mean"])
    degree = degree_of(model)
    terms = polynomial_terms(n_features, degree)
    coef = padded(arrays["coef"])
    return {
        "mean": arrays["mean"],
        "inverse_scale": arrays["inverse_scale"],
        "coef": coef,
        "intercept": padded(arrays["intercept"][None]),
        "columns": coef.shape[1],
        "degree": degree,
        "n_terms": len(terms),
        "terms": np.where(terms < 0, n_features, terms),
        "room": n_features + 1 + coef.shape[1] + (len(terms) if degree > 1 else 0),
    }


def _network(model: EstimatorData) -> dict[str, Any]:
    arrays = model.arrays
    n_layers = sum(name.startswith("weight_") for name in arrays)
    layers = []
    for i in range(n_layers):
        inputs, units = arrays[f"weight_{i}"].shape
        weight, bias = padded(arrays[f"weight_{i}"]), padded(arrays[f"bias_{i}"][None])
        layers.append(
            {
                "inputs": inputs,
                "units": units,
                "columns": weight.shape[1],
                "weight": weight,
                "bias": bias,
            }
        )
    columns = [int(layer["columns"]) for layer in layers]
    even, odd = max(layers[0]["inputs"], *columns[1::2]), max(columns[::2])
    return {
        "mean": arrays["mean"],
        "inverse_scale": arrays["inverse_scale"],
        "target_mean": arrays["target_mean"],
        "target_scale": arrays["target_scale"],
        "layers": layers,
        "room_even": even,
        "room_odd": odd,
        "room": even + odd,
    }


_CONTEXTS: Final = cast(
    "Mapping[str, tuple[str, Callable[[EstimatorData], dict[str, Any]]]]",
    {
        "offset": ("offset.c.j2", _offset),
        "linear": ("polynomial.c.j2", _polynomial),
        "polynomial": ("polynomial.c.j2", _polynomial),
        "dnn": ("dnn.c.j2", _network),
    },
)
