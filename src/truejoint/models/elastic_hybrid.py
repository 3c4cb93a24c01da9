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
from truejoint.compiled import compiled, vector
from truejoint.filters import fields as at
from truejoint.layout import Layout, Memory, part_memory, part_numbers
from truejoint.models import elastic_joint, play_bank, trees
from truejoint.models.elastic_joint import elastic_joint_row
from truejoint.models.family import EstimatorData, Params, Shape
from truejoint.models.play_bank import expand
from truejoint.models.trees import trees_row

SIGNALS: Final = 2
"""Driver and torque, of which trees see plays."""
BANK: Final[Params] = {
    "plays": (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 0.9),
    "time_constants": (0.05, 0.5, 2.0),
    "pairs": (),
    "growing": (1.0,),
    "coupled": (),
    "shares": (1.0,),
    "turns": (),
}
"""Parameters of `play_bank`, for what trees see of the signals.

They do not stand in model files: trees that are to see other plays need a family of their own.
"""
_TREES: Final = "trees/"  # begins the names of their arrays
SIZES: Final = tuple(trees.FAMILY.rules)
"""Parameters that tell the sizes of the trees."""

LAYOUT: Final = Layout()
STARTED: Final = LAYOUT.scalar("started", "whether there is a row before; 0: start anew")
N_STATES: Final = LAYOUT.integer("n_states", "of the filter")
N_PLAYS: Final = LAYOUT.integer("n_plays", "signals, their plays and low-passes")
SEEN: Final = LAYOUT.array("seen", "by the trees: these, states and outputs of the filter")
LEFT: Final = LAYOUT.array("left", "by the filter, as the trees tell")
FILTER: Final = LAYOUT.part("filter", "of the elastic joint")
PLAYS: Final = LAYOUT.part("plays", "of its signals")
TREES: Final = LAYOUT.part("trees", "of what it leaves")


def n_states(params: Params) -> int:
    """Count the states of the filter: friction elements, load, rest of friction."""
    return int(params["elements"]) + 2


def n_seen(params: Params, n_outputs: int) -> int:
    """Count what the trees see."""
    return play_bank.n_seen(BANK, SIGNALS) + n_states(params) + n_outputs


@compiled
def elastic_hybrid_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the filter of the elastic joint, and by trees on what it and plays say."""
    own, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    elastic_joint_row(own, state, dt, x, out, half_width)
    if memory[STARTED] == 0.0:
        dt = 0.0
    memory[STARTED] = 0.0 if isnan(out[0]) else 1.0
    if memory[STARTED] == 0.0:
        return  # plays would remember it
    n, first = numbers[N_STATES], numbers[N_PLAYS]
    seen = vector(memory, numbers[SEEN], first + n + out.shape[0])
    plays = part_numbers(numbers, PLAYS)
    expand(plays, part_memory(numbers, memory, PLAYS), dt, x, seen)
    inner = part_numbers(own, elastic_joint.FILTER)
    estimate = vector(part_memory(own, state, elastic_joint.FILTER), inner[at.X], n)
    for i in range(n):
        seen[first + i] = estimate[i]
    for j in range(out.shape[0]):
        seen[first + n + j] = out[j]
    left = vector(memory, numbers[LEFT], out.shape[0])
    walked = part_numbers(numbers, TREES)
    trees_row(walked, part_memory(numbers, memory, TREES), dt, seen, left, half_width)
    for j in range(out.shape[0]):
        out[j] += left[j]


def parts(
    params: Params, arrays: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, Array], EstimatorData]:
    """Arrays of the filter, those by which signals are scaled for plays, and the trees as data."""
    filtered, found = dict(arrays), {}
    for name in [name for name in arrays if name.startswith(_TREES)]:
        found[name.removeprefix(_TREES)] = filtered.pop(name)
    scales = {name: filtered.pop(name) for name in ("centre", "inverse_half_range")}
    sizes = {name: params[name] for name in SIZES}
    return filtered, scales, EstimatorData(trees.FAMILY.name, sizes, found)


def joined(
    filtered: Mapping[str, Array], scales: Mapping[str, Array], found: Mapping[str, Array]
) -> dict[str, Array]:
    """Arrays of the family, of those of the filter, of the scales of signals, and of the trees."""
    return {**filtered, **scales, **{_TREES + name: array for name, array in found.items()}}


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    own = elastic_joint.FAMILY.shapes(params, n_features, n_outputs)
    scales: dict[str, Shape] = {"centre": (SIGNALS,), "inverse_half_range": (SIGNALS,)}
    found = trees.FAMILY.shapes(params, n_seen(params, n_outputs), n_outputs)
    return {**own, **scales, **{_TREES + name: shape for name, shape in found.items()}}


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    filtered, scales, found = parts(params, arrays)
    own = {name: params[name] for name in elastic_joint.FAMILY.rules}
    data = EstimatorData(elastic_joint.FAMILY.name, own, filtered)
    return LAYOUT.pack(
        n_states=n_states(params),
        n_plays=play_bank.n_seen(BANK, SIGNALS),
        seen=np.zeros(n_seen(params, n_outputs)),
        left=np.zeros(n_outputs),
        filter=elastic_joint.FAMILY.memory(data, n_features, n_outputs),
        plays=play_bank.packed(BANK, scales, SIGNALS),
        trees=trees.FAMILY.memory(found, n_seen(params, n_outputs), n_outputs),
    )


FAMILY: Final = replace(
    elastic_joint.FAMILY,
    name="elastic_hybrid",
    rules={**elastic_joint.FAMILY.rules, **trees.FAMILY.rules},
    shapes=_shapes,
    pack=_pack,
    row=elastic_hybrid_row,
    states_deviation=None,
)
