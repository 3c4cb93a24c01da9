"""A temporal convolution network: layers that look further and further back, linear output.

A layer sees what the one before gave now and ``2**i`` updates ago, so that the last of n sees
``2**n`` updates; it adds what its rectified units give to what it was given (dilated causal
convolutions with residual connections: Bai, Kolter and Koltun, arXiv 1803.01271). The output sees
the features beside the last layer: what is linear needs no memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, fill, matrix, vector
from truejoint.estimators.family import Family, Params, Shape, integer
from truejoint.estimators.network.recurrent import TRAINING, is_update
from truejoint.estimators.network.run import scaling_shapes
from truejoint.estimators.products import BLOCK, add_product, layer, padded, rescale, standardise
from truejoint.layout import Layout, Memory

MAX_LAYERS: Final = 12

LAYOUT: Final = Layout()
N_LAYERS: Final = LAYOUT.integer("n_layers", "that look back")
WIDTH: Final = LAYOUT.integer("width", "units of a layer, filled up to a multiple of 4")
COLUMNS: Final = LAYOUT.integer("columns", "outputs, filled up to a multiple of 4")
PERIOD: Final = LAYOUT.scalar("period", "time between updates [s]")
ELAPSED: Final = LAYOUT.scalar("elapsed", "time since the last update [s]")
COUNT: Final = LAYOUT.scalar("count", "updates, from 0 again after the longest way back")
MEAN: Final = LAYOUT.array("mean", "of each feature in training")
INVERSE_SCALE: Final = LAYOUT.array("inverse_scale", "of each feature; 0 where it is not used")
TARGET_MEAN: Final = LAYOUT.array("target_mean", "of each output")
TARGET_SCALE: Final = LAYOUT.array("target_scale", "of each output")
INPUT_WEIGHTS: Final = LAYOUT.array("input_weights", "a row for each feature")
INPUT_BIAS: Final = LAYOUT.array("input_bias", "of what the first layer sees")
NOW_WEIGHTS: Final = LAYOUT.array("now_weights", "of each layer, of what it is given now")
PAST_WEIGHTS: Final = LAYOUT.array("past_weights", "of each layer, of what it was given before")
LAYER_BIAS: Final = LAYOUT.array("layer_bias", "of each layer")
OUTPUT_WEIGHTS: Final = LAYOUT.array("output_weights", "a row for each unit and each feature")
OUTPUT_BIAS: Final = LAYOUT.array("output_bias", "of each output")
PAST: Final = LAYOUT.array("past", "what each layer was given at as many updates as it looks back")
SEEN: Final = LAYOUT.array("seen", "by the output: last layer and standardised features")
UNITS_NOW: Final = LAYOUT.array("units_now", "of one layer, before they are rectified")
SUMS: Final = LAYOUT.array("sums", "standardised outputs")


@compiled
def convolution_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict from the features and what the layers were given; a period keeps one row.

    A row in between is predicted as if it were the next that is kept, and leaves no trace.
    """
    k, n, width, n_layers = x.shape[0], out.shape[0], numbers[WIDTH], numbers[N_LAYERS]
    given = vector(memory, numbers[SEEN], width)
    scaled = vector(memory, numbers[SEEN] + width, k)
    mean = vector(memory, numbers[MEAN], k)
    standardise(x, mean, vector(memory, numbers[INVERSE_SCALE], k), scaled)
    longest = 1 << n_layers
    if dt == 0.0:
        fill(vector(memory, numbers[PAST], width * (longest - 1)), width * (longest - 1), 0.0)
    memory[ELAPSED] += dt
    keeps = is_update(dt, memory[ELAPSED], memory[PERIOD])
    count = int(memory[COUNT])
    weights = matrix(memory, numbers[INPUT_WEIGHTS], k, width)
    layer(scaled, weights, vector(memory, numbers[INPUT_BIAS], width), given)
    units = vector(memory, numbers[UNITS_NOW], width)
    back = 1
    for i in range(n_layers):
        bias = vector(memory, numbers[LAYER_BIAS] + i * width, width)
        at = i * width * width
        layer(given, matrix(memory, numbers[NOW_WEIGHTS] + at, width, width), bias, units)
        past = vector(memory, numbers[PAST] + width * (back - 1 + count % back), width)
        add_product(past, matrix(memory, numbers[PAST_WEIGHTS] + at, width, width), units)
        if keeps:
            copy(given, past, width)
        for j in range(width):
            given[j] += max(units[j], 0.0)
        back *= 2
    if keeps:
        memory[COUNT] = (count + 1) % longest
        memory[ELAPSED] = 0.0
    columns = numbers[COLUMNS]
    sums = vector(memory, numbers[SUMS], columns)
    weights = matrix(memory, numbers[OUTPUT_WEIGHTS], width + k, columns)
    seen = vector(memory, numbers[SEEN], width + k)
    layer(seen, weights, vector(memory, numbers[OUTPUT_BIAS], columns), sums)
    target_mean = vector(memory, numbers[TARGET_MEAN], n)
    rescale(sums, target_mean, vector(memory, numbers[TARGET_SCALE], n), out)


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    units, n_layers = int(params["units"]), int(params["layers"])
    return {
        **scaling_shapes(n_features, n_outputs),
        "input_weights": (n_features, units),
        "input_bias": (units,),
        "now_weights": (n_layers * units, units),
        "past_weights": (n_layers * units, units),
        "layer_bias": (n_layers, units),
        "output_weights": (units + n_features, n_outputs),
        "output_bias": (n_outputs,),
    }


def _pack(params: Params, arrays: Mapping[str, Array], k: int, _n: int) -> Memory:
    units, n_layers = int(params["units"]), int(params["layers"])
    more = -units % BLOCK
    width = units + more
    table = dict(arrays)
    for name in ("input_weights", "input_bias", "layer_bias", "output_bias"):
        table[name] = padded(np.atleast_2d(arrays[name]))
    for name in ("now_weights", "past_weights"):
        squares = arrays[name].reshape(n_layers, units, units)
        square = np.pad(squares, ((0, 0), (0, more), (0, more)))
        table[name] = square.reshape(-1, width)
    from_units, from_features = np.split(padded(arrays["output_weights"]), [units])
    table["output_weights"] = np.vstack([padded(from_units, rows=True), from_features])
    return LAYOUT.pack(
        n_layers=n_layers,
        width=width,
        columns=table["output_bias"].size,
        period=params["period"],
        **table,
        past=np.zeros((2**n_layers - 1, width)),
        seen=np.zeros(width + k),
        units_now=np.zeros(width),
        sums=np.zeros(table["output_bias"].size),
    )


FAMILY: Final = Family(
    "network.temporal_convolution",
    rules={"layers": integer(1, MAX_LAYERS), "units": integer(1, 512), **TRAINING},
    shapes=_shapes,
    pack=_pack,
    row=convolution_row,
    remembers=True,
    counts_samples=True,
)
