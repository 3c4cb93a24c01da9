"""The deep neural network of peng2024, IV-B: its forward pass in float64."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, matrix, unrolled, vector
from truejoint.estimators.family import (
    RANDOM_STATE,
    Family,
    Params,
    Rule,
    Shape,
    integer,
    is_integer,
    number,
)
from truejoint.estimators.products import layer, padded, rescale, standardise
from truejoint.layout import Layout, Memory

MAX_LAYERS: Final = 8
MAX_UNITS: Final = 2048

LAYOUT: Final = Layout()
LAYOUT.array("mean", "of each feature in training", "n_features")
LAYOUT.array("inverse_scale", "of each feature; 0 where it is not used", "n_features")
LAYOUT.array("target_mean", "of each output", "n_outputs")
LAYOUT.array("target_scale", "of each output", "n_outputs")
LAYOUT.array("weights", "of all layers, a row for each input", "n_weights")
LAYOUT.array("biases", "of all layers", "n_biases")
LAYOUT.array("activations", "of two layers in turn", 2, "widest")
LAYOUT.integers("units", "of the input and each layer", "n_units")
LAYOUT.integers("columns", "units of each layer, filled up to a multiple of 4", "n_layers")
LAYOUT.integers("first_weight", "of each layer", "n_layers")
LAYOUT.integers("first_bias", "of each layer", "n_layers")
unpack = LAYOUT.unpacker()


@compiled
def network_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by layers of logistic units and a linear output, between standardised values."""
    m = unpack(numbers, memory)
    standardise(x, m.mean, m.inverse_scale, m.activations[0])
    for i in range(unrolled(m.n_layers)):
        inputs, columns = m.units[i], m.columns[i]
        source = vector(m.activations[i % 2], 0, inputs)
        target = vector(m.activations[(i + 1) % 2], 0, columns)
        weight = matrix(m.weights, m.first_weight[i], inputs, columns)
        layer(source, weight, vector(m.biases, m.first_bias[i], columns), target)
        if i < m.n_layers - 1:
            logistic(target, m.units[i + 1])
    rescale(m.activations[m.n_layers % 2], m.target_mean, m.target_scale, out)


@compiled
def logistic(values: Array, count: int) -> None:
    """Replace the first values by their logistic function."""
    for j in range(count):
        values[j] = 1.0 / (1.0 + math.exp(-values[j]))


def layer_sizes(params: Mapping[str, Any], n_features: int, n_outputs: int) -> tuple[int, ...]:
    """Units of the input, the hidden layers and the output of a network."""
    return (n_features, *(int(size) for size in params["hidden_layer_sizes"]), n_outputs)


def scaling_shapes(n_features: int, n_outputs: int) -> dict[str, Shape]:
    """Shapes of the arrays by which features and targets are standardised."""
    features, targets = ("mean", "inverse_scale"), ("target_mean", "target_scale")
    return {**dict.fromkeys(features, (n_features,)), **dict.fromkeys(targets, (n_outputs,))}


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = scaling_shapes(n_features, n_outputs)
    for i, (inputs, units) in enumerate(pairwise(layer_sizes(params, n_features, n_outputs))):
        shapes[f"weight_{i}"] = (inputs, units)
        shapes[f"bias_{i}"] = (units,)
    return shapes


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    units = layer_sizes(params, n_features, n_outputs)
    layers = range(len(units) - 1)
    weights = [padded(arrays[f"weight_{i}"]) for i in layers]
    biases = [padded(arrays[f"bias_{i}"][None])[0] for i in layers]
    columns = [len(bias) for bias in biases]
    widest = max(n_features, *columns)
    return LAYOUT.pack(
        **{name: arrays[name] for name in scaling_shapes(n_features, n_outputs)},
        weights=np.concatenate([weight.ravel() for weight in weights]),
        biases=np.concatenate(biases),
        activations=np.zeros((2, widest)),
        units=units,
        columns=columns,
        first_weight=np.cumsum([0, *(weight.size for weight in weights[:-1])]),
        first_bias=np.cumsum([0, *columns[:-1]]),
    )


FAMILY: Final = Family(
    "network",
    rules={
        "hidden_layer_sizes": Rule(
            lambda sizes: (
                isinstance(sizes, (tuple, list))
                and 1 <= len(sizes) <= MAX_LAYERS
                and all(is_integer(size, 1, MAX_UNITS) for size in sizes)
            ),
            f"1 to {MAX_LAYERS} layers of 1 to {MAX_UNITS} units",
        ),
        "weight_decay": number(0.0, 1e3),
        "learning_rate": number(1e-9, 10.0),
        "batch_size": integer(1, 10**6),
        "epochs": integer(0, 10**6),
        "random_state": RANDOM_STATE,
    },
    shapes=_shapes,
    pack=_pack,
    row=network_row,
)
