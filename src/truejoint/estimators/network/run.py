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
    Family,
    Params,
    Rule,
    Shape,
    integer,
    is_integer,
    number,
    random_state,
)
from truejoint.estimators.products import layer, padded, rescale, standardise
from truejoint.layout import Layout, Memory

MAX_LAYERS: Final = 8
MAX_UNITS: Final = 2048

LAYOUT: Final = Layout()
N_LAYERS: Final = LAYOUT.integer("n_layers", "hidden layers and the output")
WIDEST: Final = LAYOUT.integer("widest", "units of the widest layer, filled up")
MEAN: Final = LAYOUT.array("mean", "of each feature in training")
INVERSE_SCALE: Final = LAYOUT.array("inverse_scale", "of each feature; 0 where it is not used")
TARGET_MEAN: Final = LAYOUT.array("target_mean", "of each output")
TARGET_SCALE: Final = LAYOUT.array("target_scale", "of each output")
WEIGHTS: Final = LAYOUT.array("weights", "of all layers, a row for each input")
BIASES: Final = LAYOUT.array("biases", "of all layers")
ACTIVATIONS: Final = LAYOUT.array("activations", "of two layers in turn")
UNITS: Final = LAYOUT.integers("units", "of the input and each layer")
COLUMNS: Final = LAYOUT.integers("columns", "units of each layer, filled up to a multiple of 4")
FIRST_WEIGHT: Final = LAYOUT.integers("first_weight", "of each layer")
FIRST_BIAS: Final = LAYOUT.integers("first_bias", "of each layer")


@compiled
def network_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by layers of logistic units and a linear output, between standardised values."""
    k, n, n_layers, widest = x.shape[0], out.shape[0], numbers[N_LAYERS], numbers[WIDEST]
    mean, inverse_scale = (
        vector(memory, numbers[MEAN], k),
        vector(memory, numbers[INVERSE_SCALE], k),
    )
    standardise(x, mean, inverse_scale, vector(memory, numbers[ACTIVATIONS], k))
    for i in range(unrolled(n_layers)):
        inputs = numbers[numbers[UNITS] + i]
        columns = numbers[numbers[COLUMNS] + i]
        source = vector(memory, numbers[ACTIVATIONS] + widest * (i % 2), inputs)
        target = vector(memory, numbers[ACTIVATIONS] + widest * ((i + 1) % 2), columns)
        weight = numbers[WEIGHTS] + numbers[numbers[FIRST_WEIGHT] + i]
        bias = vector(memory, numbers[BIASES] + numbers[numbers[FIRST_BIAS] + i], columns)
        layer(source, matrix(memory, weight, inputs, columns), bias, target)
        if i < n_layers - 1:
            logistic(target, numbers[numbers[UNITS] + i + 1])
    last = vector(memory, numbers[ACTIVATIONS] + widest * (n_layers % 2), n)
    target_mean = vector(memory, numbers[TARGET_MEAN], n)
    rescale(last, target_mean, vector(memory, numbers[TARGET_SCALE], n), out)


@compiled
def logistic(values: Array, count: int) -> None:
    """Replace the first values by their logistic function."""
    for j in range(count):
        values[j] = 1.0 / (1.0 + math.exp(-values[j]))


def layer_sizes(params: Mapping[str, Any], n_features: int, n_outputs: int) -> tuple[int, ...]:
    """Units of the input, the hidden layers and the output of a network."""
    return (n_features, *(int(size) for size in params["hidden_layer_sizes"]), n_outputs)


def _are_layers(sizes: object) -> bool:
    return (
        isinstance(sizes, (tuple, list))
        and 1 <= len(sizes) <= MAX_LAYERS
        and all(is_integer(size, 1, MAX_UNITS) for size in sizes)
    )


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
        n_layers=len(weights),
        widest=widest,
        **{name: arrays[name] for name in ("mean", "inverse_scale", "target_mean", "target_scale")},
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
            _are_layers, f"1 to {MAX_LAYERS} layers of 1 to {MAX_UNITS} units"
        ),
        "weight_decay": number(0.0, 1e3),
        "learning_rate": number(1e-9, 10.0),
        "batch_size": integer(1, 10**6),
        "epochs": integer(0, 10**6),
        "random_state": random_state(),
    },
    shapes=_shapes,
    pack=_pack,
    row=network_row,
)
