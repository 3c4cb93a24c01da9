"""The filter of an elastic joint, and trees that learn what it leaves.

The filter knows how load and friction make each other at any speed. Trees know what its responses
lack: they see plays of its two signals, and its state, so that they need not find out the load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isnan
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, vector
from truejoint.estimators.family import EstimatorData, Params, Shape
from truejoint.estimators.motor_side import run as elastic_joint
from truejoint.estimators.motor_side.run import elastic_joint_row, n_told
from truejoint.estimators.plays import run as play_bank
from truejoint.estimators.plays.run import expand
from truejoint.estimators.trees import run as trees
from truejoint.estimators.trees.run import trees_row
from truejoint.filters.fields import unpack_filter
from truejoint.layout import Layout, Memory, part_memory, part_numbers

SIGNALS: Final = 2
"""Driver and torque, of which trees see plays."""
SEEN_OF_BANK: Final = "plays", "time_constants"
"""Parameters of `play_bank` that tell what trees see of the signals."""
_UNSEEN: Final[Params] = {
    "pairs": (), "growing": (1.0,), "coupled": (), "shares": (1.0,), "turns": ()
}  # fmt: skip
_TREES: Final = "trees/"  # begins the names of their arrays
SIZES: Final = tuple(trees.FAMILY.rules)
"""Parameters that tell the sizes of the trees."""

LAYOUT: Final = Layout()
BESIDE: Final = LAYOUT.scalar("beside_deviations", "that the torque's half-width is; 0: none")
STARTED: Final = LAYOUT.scalar("started", "whether there is a row before; 0: start anew")
LAYOUT.integer("n_states", "of the filter")
LAYOUT.integer("n_plays", "signals, their plays and low-passes")
LAYOUT.array("inputs", "of the trees: these, states and angle of the filter", "n_inputs")
LAYOUT.array("residual", "of the filter, as the trees tell", "n_told")
LAYOUT.array("torque", "at the jaw, and its half-width [Nm]", 2)
FILTER: Final = LAYOUT.part("filter", "of the elastic joint")
PLAYS: Final = LAYOUT.part("plays", "of its signals")
TREES: Final = LAYOUT.part("trees", "of what it leaves")
unpack = LAYOUT.unpacker()


def n_states(params: Params) -> int:
    """Count the states of the filter: friction elements, load, rest of friction."""
    return int(params["elements"]) + 2


def bank(params: Params) -> Params:
    """Parameters of `play_bank`, of those of the family."""
    return {**_UNSEEN, **{name: params[name] for name in SEEN_OF_BANK}}


def n_plays(params: Params) -> int:
    """Count what trees see of the signals: themselves, their plays and low-passes."""
    return play_bank.n_seen(bank(params), SIGNALS)


def n_seen(params: Params) -> int:
    """Count what the trees see."""
    return n_plays(params) + n_states(params) + 1


@compiled
def elastic_hybrid_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the filter of the elastic joint, and by trees on what it and plays say."""
    m = unpack(numbers, memory)
    sizes, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    state[elastic_joint.BESIDE] = m.beside_deviations
    elastic_joint_row(sizes, state, dt, x, out, half_width)
    copy(vector(state, sizes[elastic_joint.TOLD], 2), m.torque, 2)
    if m.started == 0.0:
        dt = 0.0
    memory[STARTED] = 0.0 if isnan(out[0]) else 1.0
    if isnan(out[0]):
        return  # plays would remember it
    expand(part_numbers(numbers, PLAYS), part_memory(numbers, memory, PLAYS), dt, x, m.inputs)
    inner = part_numbers(sizes, elastic_joint.FILTER)
    f = unpack_filter(inner, part_memory(sizes, state, elastic_joint.FILTER))
    for i in range(m.n_states):
        m.inputs[m.n_plays + i] = f.x[i]
    m.inputs[m.n_plays + m.n_states] = out[0]
    trees_row(
        part_numbers(numbers, TREES), part_memory(numbers, memory, TREES), dt, m.inputs,
        m.residual, half_width,
    )  # fmt: skip
    out[0] += m.residual[0]
    if m.n_told > 1:
        m.torque[0] += m.residual[1]


def parts(
    params: Params, arrays: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, Array], EstimatorData]:
    """Arrays of the filter, those by which signals are scaled for plays, and the trees as data."""
    filtered, learnt = dict(arrays), {}
    for name in [name for name in arrays if name.startswith(_TREES)]:
        learnt[name.removeprefix(_TREES)] = filtered.pop(name)
    scales = {name: filtered.pop(name) for name in ("centre", "inverse_half_range")}
    sizes = {name: params[name] for name in SIZES}
    return filtered, scales, EstimatorData(trees.FAMILY.name, sizes, learnt)


def joined(
    filtered: Mapping[str, Array], scales: Mapping[str, Array], learnt: Mapping[str, Array]
) -> dict[str, Array]:
    """Arrays of the family, of those of the filter, of the scales of signals, and of the trees."""
    return {**filtered, **scales, **{_TREES + name: array for name, array in learnt.items()}}


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    of_filter = elastic_joint.FAMILY.shapes(params, n_features, n_outputs)
    scales: dict[str, Shape] = {"centre": (SIGNALS,), "inverse_half_range": (SIGNALS,)}
    of_trees = trees.FAMILY.shapes(params, n_seen(params), n_told(params))
    return {**of_filter, **scales, **{_TREES + name: shape for name, shape in of_trees.items()}}


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    filtered, scales, learnt = parts(params, arrays)
    chosen = {name: params[name] for name in elastic_joint.FAMILY.rules}
    data = EstimatorData(elastic_joint.FAMILY.name, chosen, filtered)
    return LAYOUT.pack(
        n_states=n_states(params),
        n_plays=n_plays(params),
        inputs=np.zeros(n_seen(params)),
        residual=np.zeros(n_told(params)),
        torque=np.zeros(2),
        filter=elastic_joint.FAMILY.memory(data, n_features, n_outputs),
        plays=play_bank.packed(bank(params), scales, SIGNALS),
        trees=trees.FAMILY.memory(learnt, n_seen(params), n_told(params)),
    )


FAMILY: Final = replace(
    elastic_joint.FAMILY,
    name="motor_side.hybrid_rows",
    rules={
        **elastic_joint.FAMILY.rules,
        **{name: play_bank.FAMILY.rules[name] for name in SEEN_OF_BANK},
        **trees.FAMILY.rules,
    },
    shapes=_shapes,
    pack=_pack,
    row=elastic_hybrid_row,
    states_deviation=None,
)
