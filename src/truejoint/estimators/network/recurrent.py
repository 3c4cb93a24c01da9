"""A recurrent network: one layer of cells that remember, linear output.

Cells are gated recurrent units (Cho et al., EMNLP 2014), whose reset gate acts on the product with
the state, as in cuDNN and Keras, so that one product serves all gates; or long short-term memory
(Hochreiter and Schmidhuber, Neural Computation 9(8), 1997, with the forget gate of Gers et al.,
2000). The output sees the features beside the state: what is linear needs no memory.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, fill, matrix, vector
from truejoint.estimators.family import (
    Family,
    Params,
    Rule,
    Shape,
    integer,
    number,
    one_of,
    random_state,
)
from truejoint.estimators.network.run import logistic, scaling_shapes
from truejoint.estimators.products import BLOCK, layer, padded, rescale, standardise
from truejoint.layout import Layout, Memory

GATES_OF: Final[Mapping[str, int]] = {"gated_unit": 3, "long_short_term": 4}
"""Kinds of cells, and their gates with the candidate."""
TRAINING: Final[Mapping[str, Rule]] = {
    "period": number(1e-6, 1e3),
    "weight_decay": number(0.0, 1e3),
    "learning_rate": number(1e-9, 10.0),
    "window": integer(2, 10**5),
    "batch_size": integer(1, 10**5),
    "epochs": integer(1, 10**6),
    "random_state": random_state(),
}
"""Rules of what every network that remembers is trained by."""

LAYOUT: Final = Layout()
N_GATES: Final = LAYOUT.integer("n_gates", "with the candidate: 3 of a GRU, 4 of an LSTM")
UNITS: Final = LAYOUT.integer("units", "of the state")
WIDTH: Final = LAYOUT.integer("width", "units, filled up to a multiple of 4")
COLUMNS: Final = LAYOUT.integer("columns", "outputs, filled up to a multiple of 4")
PERIOD: Final = LAYOUT.scalar("period", "time between updates of the state [s]")
ELAPSED: Final = LAYOUT.scalar("elapsed", "time since the state was updated [s]")
MEAN: Final = LAYOUT.array("mean", "of each feature in training")
INVERSE_SCALE: Final = LAYOUT.array("inverse_scale", "of each feature; 0 where it is not used")
TARGET_MEAN: Final = LAYOUT.array("target_mean", "of each output")
TARGET_SCALE: Final = LAYOUT.array("target_scale", "of each output")
INPUT_WEIGHTS: Final = LAYOUT.array(
    "input_weights", "a row for each feature; columns: the gates, then the candidate"
)
INPUT_BIAS: Final = LAYOUT.array("input_bias", "of gates and candidate")
STATE_WEIGHTS: Final = LAYOUT.array("state_weights", "a row for each unit, columns as the inputs'")
STATE_BIAS: Final = LAYOUT.array("state_bias", "of a GRU's candidate, within the reset gate")
OUTPUT_WEIGHTS: Final = LAYOUT.array("output_weights", "a row for each unit and each feature")
OUTPUT_BIAS: Final = LAYOUT.array("output_bias", "of each output")
STATE: Final = LAYOUT.array("state", "as it was last updated")
CELL: Final = LAYOUT.array("cell", "of an LSTM, as it was last updated")
NEW_CELL: Final = LAYOUT.array("new_cell", "of an LSTM")
SEEN: Final = LAYOUT.array("seen", "by the output: new state and standardised features")
GATES: Final = LAYOUT.array("gates", "what the features give gates and candidate")
FROM_STATE: Final = LAYOUT.array("from_state", "what the state gives gates and candidate")
SUMS: Final = LAYOUT.array("sums", "standardised outputs")


@compiled
def recurrent_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict from the features and the state, which is updated once in a period.

    A row in between is predicted from the state that it would give, and leaves no trace.
    """
    k, n, units, width = x.shape[0], out.shape[0], numbers[UNITS], numbers[WIDTH]
    state = vector(memory, numbers[STATE], units)
    new = vector(memory, numbers[SEEN], units)
    scaled = vector(memory, numbers[SEEN] + units, k)
    mean, inverse_scale = (
        vector(memory, numbers[MEAN], k),
        vector(memory, numbers[INVERSE_SCALE], k),
    )
    standardise(x, mean, inverse_scale, scaled)
    cell, new_cell = vector(memory, numbers[CELL], units), vector(memory, numbers[NEW_CELL], units)
    if dt == 0.0:
        fill(state, units, 0.0)
        fill(cell, units, 0.0)
    n_gates = numbers[N_GATES]
    gates = vector(memory, numbers[GATES], n_gates * width)
    weights = matrix(memory, numbers[INPUT_WEIGHTS], k, n_gates * width)
    layer(scaled, weights, vector(memory, numbers[INPUT_BIAS], n_gates * width), gates)
    from_state = vector(memory, numbers[FROM_STATE], n_gates * width)
    weights = matrix(memory, numbers[STATE_WEIGHTS], units, n_gates * width)
    layer(state, weights, vector(memory, numbers[STATE_BIAS], n_gates * width), from_state)
    if n_gates == 3:
        gated_units(gates, from_state, width, state, new)
    else:
        memory_units(gates, from_state, width, cell, new_cell, new)
    memory[ELAPSED] += dt
    if is_update(dt, memory[ELAPSED], memory[PERIOD]):
        copy(new, state, units)
        copy(new_cell, cell, units)
        memory[ELAPSED] = 0.0
    columns = numbers[COLUMNS]
    sums = vector(memory, numbers[SUMS], columns)
    weights = matrix(memory, numbers[OUTPUT_WEIGHTS], units + k, columns)
    seen = vector(memory, numbers[SEEN], units + k)
    layer(seen, weights, vector(memory, numbers[OUTPUT_BIAS], columns), sums)
    target_mean = vector(memory, numbers[TARGET_MEAN], n)
    rescale(sums, target_mean, vector(memory, numbers[TARGET_SCALE], n), out)


@compiled
def gated_units(gates: Array, from_state: Array, width: int, state: Array, new: Array) -> None:
    """Give the new state of gated recurrent units, of what features and state give the gates."""
    for i in range(2 * width):
        gates[i] += from_state[i]
    logistic(gates, 2 * width)
    for i in range(state.shape[0]):
        drive = gates[2 * width + i] + gates[width + i] * from_state[2 * width + i]
        candidate = tanh(drive)
        new[i] = candidate + gates[i] * (state[i] - candidate)


@compiled
def memory_units(
    gates: Array, from_state: Array, width: int, cell: Array, new_cell: Array, new: Array
) -> None:
    """Give new cell and state of long short-term memory, of what both give the gates."""
    for i in range(4 * width):
        gates[i] += from_state[i]
    logistic(gates, 3 * width)
    for i in range(cell.shape[0]):
        candidate = tanh(gates[3 * width + i])
        new_cell[i] = gates[width + i] * cell[i] + gates[i] * candidate
        new[i] = gates[2 * width + i] * tanh(new_cell[i])


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
    units, n_gates = int(params["units"]), GATES_OF[params["cell"]]
    within = {"state_bias": (units,)} if n_gates == 3 else {}
    return {
        **scaling_shapes(n_features, n_outputs),
        "input_weights": (n_features, n_gates * units),
        "input_bias": (n_gates * units,),
        "state_weights": (units, n_gates * units),
        **within,
        "output_weights": (units + n_features, n_outputs),
        "output_bias": (n_outputs,),
    }


def _pack(params: Params, arrays: Mapping[str, Array], k: int, _n: int) -> Memory:
    units, n_gates = int(params["units"]), GATES_OF[params["cell"]]
    width = units + -units % BLOCK
    table = dict(arrays)
    for name in ("output_weights", "output_bias"):
        table[name] = padded(np.atleast_2d(arrays[name]))
    for name in ("input_weights", "input_bias", "state_weights"):  # each gate by itself
        table[name] = padded(arrays[name].reshape(-1, units)).reshape(-1, n_gates * width)
    bias = np.zeros(n_gates * width)
    if "state_bias" in arrays:
        bias[-width:][:units] = arrays["state_bias"]
    return LAYOUT.pack(
        n_gates=n_gates,
        units=units,
        width=width,
        columns=table["output_bias"].size,
        period=params["period"],
        **(table | {"state_bias": bias}),
        state=np.zeros(units),
        cell=np.zeros(units),
        new_cell=np.zeros(units),
        seen=np.zeros(units + k),
        gates=np.zeros(n_gates * width),
        from_state=np.zeros(n_gates * width),
        sums=np.zeros(table["output_bias"].size),
    )


FAMILY: Final = Family(
    "network.recurrent",
    rules={"cell": one_of(*GATES_OF), "units": integer(1, 512), **TRAINING},
    shapes=_shapes,
    pack=_pack,
    row=recurrent_row,
    remembers=True,
    counts_samples=True,
)
