"""A recurrent network: one layer of gated recurrent units, linear output.

Gated recurrent units are of Cho et al., EMNLP 2014. Their reset gate acts on the product with the
state, as in cuDNN, Keras and torch, so that one product serves all gates. The output sees the
features beside the state: what is linear needs no memory.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, fill, vector
from truejoint.estimators.family import (
    RANDOM_STATE,
    Family,
    Params,
    Rule,
    Shape,
    integer,
    number,
)
from truejoint.estimators.network.run import logistic, scaling_shapes
from truejoint.estimators.products import BLOCK, layer, padded, rescale, standardise
from truejoint.layout import Layout, Memory

TRAINING: Final[Mapping[str, Rule]] = {
    "period": number(1e-6, 1e3),
    "weight_decay": number(0.0, 1e3),
    "learning_rate": number(1e-9, 10.0),
    "window": integer(2, 10**5),
    "batch_size": integer(1, 10**5),
    "epochs": integer(1, 10**6),
    "random_state": RANDOM_STATE,
}
"""Rules of what every network that remembers is trained by."""

LAYOUT: Final = Layout()
LAYOUT.scalar("period", "time between updates of the state [s]")
ELAPSED: Final = LAYOUT.scalar("elapsed", "time since the state was updated [s]")
LAYOUT.array("mean", "of each feature in training", "n_features")
LAYOUT.array("inverse_scale", "of each feature; 0 where it is not used", "n_features")
LAYOUT.array("target_mean", "of each output", "n_outputs")
LAYOUT.array("target_scale", "of each output", "n_outputs")
LAYOUT.array("input_weights", "columns: the gates, then the candidate", "n_features", "gates_width")
LAYOUT.array("input_bias", "of gates and candidate", "gates_width")
LAYOUT.array("state_weights", "columns as the inputs'", "units", "gates_width")
LAYOUT.array("state_bias", "of the candidate, within the reset gate", "gates_width")
LAYOUT.array("output_weights", "a row for each unit and each feature", "n_seen", "columns")
LAYOUT.array("output_bias", "of each output", "columns")
LAYOUT.array("state", "as it was last updated", "units")
LAYOUT.array("seen", "by the output: new state and standardised features", "n_seen")
LAYOUT.array("gates", "what the features give gates and candidate", "gates_width")
LAYOUT.array("from_state", "what the state gives gates and candidate", "gates_width")
LAYOUT.array("sums", "standardised outputs", "columns")
LAYOUT.integer("width", "units, filled up to a multiple of 4")
unpack = LAYOUT.unpacker()


@compiled
def gru_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict from the features and the state, which is updated once in a period.

    A row in between is predicted from the state that it would give, and leaves no trace.
    """
    m = unpack(numbers, memory)
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
    memory[ELAPSED] = elapsed
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


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    units = int(params["units"])
    return {
        **scaling_shapes(n_features, n_outputs),
        "input_weights": (n_features, 3 * units),
        "input_bias": (3 * units,),
        "state_weights": (units, 3 * units),
        "state_bias": (units,),
        "output_weights": (units + n_features, n_outputs),
        "output_bias": (n_outputs,),
    }


def _pack(params: Params, arrays: Mapping[str, Array], k: int, _n: int) -> Memory:
    units = int(params["units"])
    width = units + -units % BLOCK
    bias = padded(arrays["output_bias"][None])[0]
    table = {**arrays, "output_weights": padded(arrays["output_weights"]), "output_bias": bias}
    for name in ("input_weights", "input_bias", "state_weights"):  # each gate by itself
        array = padded(arrays[name].reshape(-1, units))
        table[name] = array.reshape(*arrays[name].shape[:-1], 3 * width)
    table["state_bias"] = np.zeros(3 * width)
    table["state_bias"][2 * width :][:units] = arrays["state_bias"]
    return LAYOUT.pack(
        width=width,
        period=params["period"],
        **table,
        **dict.fromkeys(("gates", "from_state"), np.zeros(3 * width)),
        state=np.zeros(units),
        seen=np.zeros(units + k),
        sums=np.zeros_like(bias),
    )


FAMILY: Final = Family(
    "network.gru",
    rules={"units": integer(1, 512), **TRAINING},
    shapes=_shapes,
    pack=_pack,
    row=gru_row,
    remembers=True,
    counts_samples=True,
)
