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
from truejoint.estimators.network.gru import TRAINING, is_update
from truejoint.estimators.network.run import scaling_shapes
from truejoint.estimators.products import BLOCK, add_product, layer, padded, rescale, standardise
from truejoint.layout import Layout, Memory

MAX_LAYERS: Final = 12

LAYOUT: Final = Layout()
LAYOUT.scalar("period", "time between updates [s]")
ELAPSED: Final = LAYOUT.scalar("elapsed", "time since the last update [s]")
COUNT: Final = LAYOUT.scalar("count", "updates, from 0 again after the longest way back")
LAYOUT.array("mean", "of each feature in training", "n_features")
LAYOUT.array("inverse_scale", "of each feature; 0 where it is not used", "n_features")
LAYOUT.array("target_mean", "of each output", "n_outputs")
LAYOUT.array("target_scale", "of each output", "n_outputs")
LAYOUT.array("input_weights", "a row for each feature", "n_features", "width")
LAYOUT.array("input_bias", "of what the first layer sees", "width")
LAYOUT.array("now_weights", "of each layer, of what it is given now", "n_squares")
LAYOUT.array("past_weights", "of each layer, of what it was given before", "n_squares")
LAYOUT.array("layer_bias", "of each layer", "n_layers", "width")
LAYOUT.array("output_weights", "a row for each unit and each feature", "n_seen", "columns")
LAYOUT.array("output_bias", "of each output", "columns")
LAYOUT.array("past", "what layers were given, as long ago as they look back", "n_past", "width")
LAYOUT.array("seen", "by the output: last layer and standardised features", "n_seen")
LAYOUT.array("units_now", "of one layer, before they are rectified", "width")
LAYOUT.array("sums", "standardised outputs", "columns")
unpack = LAYOUT.unpacker()


@compiled
def tcn_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict from the features and what the layers were given; a period keeps one row.

    A row in between is predicted as if it were the next that is kept, and leaves no trace.
    """
    m = unpack(numbers, memory)
    width, units = m.width, m.units_now
    hidden, scaled = vector(m.seen, 0, width), vector(m.seen, width, m.n_features)
    standardise(x, m.mean, m.inverse_scale, scaled)
    if dt == 0.0:
        for row in range(m.n_past):
            fill(m.past[row], width, 0.0)
    elapsed, count = m.elapsed + dt, int(m.count)
    keeps = is_update(dt, elapsed, m.period)
    layer(scaled, m.input_weights, m.input_bias, hidden)
    back = 1
    for i in range(m.n_layers):
        at = i * width * width
        layer(hidden, matrix(m.now_weights, at, width, width), m.layer_bias[i], units)
        past = m.past[back - 1 + count % back]
        add_product(past, matrix(m.past_weights, at, width, width), units)
        if keeps:
            copy(hidden, past, width)
        for j in range(width):
            hidden[j] += max(units[j], 0.0)
        back *= 2
    if keeps:
        count, elapsed = (count + 1) % back, 0.0
    memory[COUNT], memory[ELAPSED] = count, elapsed
    layer(m.seen, m.output_weights, m.output_bias, m.sums)
    rescale(m.sums, m.target_mean, m.target_scale, out)


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
    for name in ("input_weights", "layer_bias"):
        table[name] = padded(arrays[name])
    for name in ("input_bias", "output_bias"):
        table[name] = padded(arrays[name][None])[0]
    for name in ("now_weights", "past_weights"):
        squares = arrays[name].reshape(n_layers, units, units)
        square = np.pad(squares, ((0, 0), (0, more), (0, more)))
        table[name] = square.ravel()
    from_units, from_features = np.split(padded(arrays["output_weights"]), [units])
    table["output_weights"] = np.vstack([padded(from_units, rows=True), from_features])
    return LAYOUT.pack(
        period=params["period"],
        **table,
        past=np.zeros((2**n_layers - 1, width)),
        seen=np.zeros(width + k),
        units_now=np.zeros(width),
        sums=np.zeros(table["output_bias"].size),
    )


FAMILY: Final = Family(
    "network.tcn",
    rules={"layers": integer(1, MAX_LAYERS), "units": integer(1, 512), **TRAINING},
    shapes=_shapes,
    pack=_pack,
    row=tcn_row,
    remembers=True,
    counts_samples=True,
)
