"""Networks, in float64: the deep one of peng2024, IV-B, a recurrent and a convolutional one.

Of the two that remember, the output sees the features beside the state or the last layer: what is
linear needs no memory. Gated recurrent units are of Cho et al., EMNLP 2014; their reset gate acts
on the product with the state, as in cuDNN, Keras and torch, so that one product serves all gates.
A layer of convolutions sees what the one before gave now and ``2**i`` updates ago, so that the last
of n sees ``2**n`` updates; it adds what its rectified units give to what it was given (dilated
causal convolutions with residual connections: Bai, Kolter and Koltun, arXiv 1803.01271).
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, fill, matrix, unrolled, vector
from truejoint.estimators.family import Family, Shape
from truejoint.estimators.rules import RANDOM_STATE, Params, Rule, integer, is_list, number
from truejoint.layout import Layout, Memory
from truejoint.products import add_product, layer, padded, rescale, standardise

MAX_LAYERS: Final = 8
MAX_UNITS: Final = 2048
MAX_TCN_LAYERS: Final = 12

DESCENT: Final[Mapping[str, Rule]] = {
    "weight_decay": number(0.0, 1e3),
    "learning_rate": number(1e-9, 10.0),
    "epochs": integer(1, 10**6),
    "random_state": RANDOM_STATE,
}
"""Rules of what every network is trained by."""
TRAINING: Final[Mapping[str, Rule]] = {
    **DESCENT,
    "period": number(1e-6, 1e3),
    "window": integer(2, 10**5),
    "batch_size": integer(1, 10**5),
}
"""Rules of what every network that remembers is trained by."""


LAYOUT: Final = Layout().declare(__package__, "scaling", "network")
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
    biases = [padded(arrays[f"bias_{i}"]) for i in layers]
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
            lambda sizes: is_list(sizes, 1, MAX_LAYERS, integer(1, MAX_UNITS).holds),
            f"1 to {MAX_LAYERS} layers of 1 to {MAX_UNITS} units",
        ),
        **DESCENT,
        "batch_size": integer(1, 10**6),
    },
    shapes=_shapes,
    pack=_pack,
    row=network_row,
)

GRU_LAYOUT: Final = Layout().declare(__package__, "scaling", "sequence", "recurrent")
GRU_ELAPSED: Final = GRU_LAYOUT.at("elapsed")
unpack_gru = GRU_LAYOUT.unpacker()


@compiled
def gru_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict from the features and the state, which is updated once in a period.

    A row in between is predicted from the state that it would give, and leaves no trace.
    """
    m = unpack_gru(numbers, memory)
    new, scaled = vector(m.seen, 0, m.units), vector(m.seen, m.units, m.n_features)
    standardise(x, m.mean, m.inverse_scale, scaled)
    if dt == 0.0:
        fill(m.state, m.units, 0.0)
    layer(scaled, m.input_weights, m.input_bias, m.gates)
    layer(m.state, m.state_weights, m.state_bias, m.from_state)
    for i in range(2 * m.width):
        m.gates[i] += m.from_state[i]
    logistic(m.gates, 2 * m.width)
    for i in range(m.units):
        drive = m.gates[2 * m.width + i] + m.gates[m.width + i] * m.from_state[2 * m.width + i]
        candidate = tanh(drive)
        new[i] = candidate + m.gates[i] * (m.state[i] - candidate)
    elapsed = m.elapsed + dt
    if is_update(dt, elapsed, m.period):
        copy(new, m.state, m.units)
        elapsed = 0.0
    memory[GRU_ELAPSED] = elapsed
    layer(m.seen, m.output_weights, m.output_bias, m.sums)
    rescale(m.sums, m.target_mean, m.target_scale, out)


@compiled
def tanh(x: float) -> float:
    """Hyperbolic tangent by way of `exp`, the same in C."""
    return 2.0 / (1.0 + math.exp(-2.0 * x)) - 1.0


@compiled
def is_update(dt: float, elapsed: float, period: float) -> bool:
    """Whether a row updates the state: the first of a history, and that nearest to the period."""
    # Not quite a half, so that jitter decides nothing where a period is 1.5 or 2.5 rows.
    return dt == 0.0 or elapsed >= period - 0.45 * dt


def _sequence_shapes(
    k: int, n_outputs: int, units: int, width: int, **state: Shape
) -> dict[str, Shape]:
    """Shapes of the arrays of a network that sees `k` features in `width` columns."""
    return {
        **scaling_shapes(k, n_outputs),
        "input_weights": (k, width),
        "input_bias": (width,),
        **state,
        "output_weights": (units + k, n_outputs),
        "output_bias": (n_outputs,),
    }


def _gru_shapes(params: Params, k: int, n_outputs: int) -> dict[str, Shape]:
    units = int(params["units"])
    state = {"state_weights": (units, 3 * units), "state_bias": (units,)}
    return _sequence_shapes(k, n_outputs, units, 3 * units, **state)


def _gru_pack(params: Params, arrays: Mapping[str, Array], k: int, _n: int) -> Memory:
    units = int(params["units"])
    table = dict(arrays)
    for name in ("output_weights", "output_bias", "state_bias"):
        table[name] = padded(arrays[name])
    width = len(table["state_bias"])
    for name in ("input_weights", "input_bias", "state_weights"):  # each gate by itself
        gates = padded(arrays[name].reshape(-1, 3, units))
        table[name] = gates.reshape(*arrays[name].shape[:-1], 3 * width)
    table["state_bias"] = np.append(np.zeros(2 * width), table["state_bias"])
    return GRU_LAYOUT.pack(width=width, period=params["period"], **table)


GRU: Final = Family(
    "network.gru",
    rules={"units": integer(1, 512), **TRAINING},
    shapes=_gru_shapes,
    pack=_gru_pack,
    row=gru_row,
    remembers=True,
    counts_samples=True,
)

TCN_LAYOUT: Final = Layout().declare(__package__, "scaling", "sequence", "convolution")
TCN_ELAPSED, COUNT = TCN_LAYOUT.places("elapsed count")
unpack_tcn = TCN_LAYOUT.unpacker()


@compiled
def tcn_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict from the features and what the layers were given; a period keeps one row.

    A row in between is predicted as if it were the next that is kept, and leaves no trace.
    """
    m = unpack_tcn(numbers, memory)
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
    memory[COUNT], memory[TCN_ELAPSED] = count, elapsed
    layer(m.seen, m.output_weights, m.output_bias, m.sums)
    rescale(m.sums, m.target_mean, m.target_scale, out)


def _tcn_shapes(params: Params, k: int, n_outputs: int) -> dict[str, Shape]:
    units, n_layers = int(params["units"]), int(params["layers"])
    layers = dict.fromkeys(("now_weights", "past_weights"), (n_layers * units, units))
    return _sequence_shapes(k, n_outputs, units, units, **layers, layer_bias=(n_layers, units))


def _tcn_pack(params: Params, arrays: Mapping[str, Array], k: int, _n: int) -> Memory:
    units, n_layers = int(params["units"]), int(params["layers"])
    table = dict(arrays)
    for name in ("input_weights", "input_bias", "layer_bias", "output_bias"):
        table[name] = padded(arrays[name])
    for name in ("now_weights", "past_weights"):
        table[name] = padded(arrays[name].reshape(n_layers, units, units), axes=2).ravel()
    from_units, from_features = np.split(padded(arrays["output_weights"]), [units])
    table["output_weights"] = np.vstack([padded(from_units, axes=2), from_features])
    return TCN_LAYOUT.pack(period=params["period"], **table, n_past=2**n_layers - 1)


TCN: Final = Family(
    "network.tcn",
    rules={"layers": integer(1, MAX_TCN_LAYERS), "units": integer(1, 512), **TRAINING},
    shapes=_tcn_shapes,
    pack=_tcn_pack,
    row=tcn_row,
    remembers=True,
    counts_samples=True,
)
