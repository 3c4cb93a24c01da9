"""Sums of decision trees: single ones, forests, and boosted trees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, vector
from truejoint.errors import CalibrationError
from truejoint.layout import Layout, Memory
from truejoint.models.family import Family, Params, Shape, integer

MAX_TREES: Final = 10**5
MAX_NODES: Final = 6 * 10**6
"""Most nodes of all trees together, and most values of their leaves."""
ABREAST: Final = 8
"""Trees that are walked through together, so that none waits for what another asks."""

LAYOUT: Final = Layout()
N_TREES: Final = LAYOUT.integer("n_trees", "whose values are summed")
N_NODES: Final = LAYOUT.integer("n_nodes", "of all trees")
N_VALUES: Final = LAYOUT.integer("n_values", "of all leaves")
MEAN: Final = LAYOUT.array("mean", "taken from each feature")
SCALE: Final = LAYOUT.array("scale", "that each feature is then divided by")
SCALED: Final = LAYOUT.array("scaled", "features of one row, then 0")
OFFSET: Final = LAYOUT.array("offset", "of each output, which the values are added to")
ROOT: Final = LAYOUT.integers("root", "node at which each tree begins")
LEVELS: Final = LAYOUT.integers("levels", "of the deepest of every 8 trees, below its root")
OUTPUT: Final = LAYOUT.integers("output", "that each tree adds to; -1: to every one")
FEATURE: Final = LAYOUT.integers("feature", "that each node asks for; of a leaf the 0")
CHILD: Final = LAYOUT.integers("child", "up to the threshold, above it; a leaf: itself, its value")
NODE: Final = LAYOUT.integers("node", "at which 8 trees are")
THRESHOLD: Final = LAYOUT.array("threshold", "of each node; 0 for a leaf")
VALUE: Final = LAYOUT.array("value", "of the leaves")


@compiled
def trees_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict an offset and the sum of the leaves that the scaled features lead to."""
    k, n = x.shape[0], out.shape[0]
    mean, scale = vector(memory, numbers[MEAN], k), vector(memory, numbers[SCALE], k)
    scaled = vector(memory, numbers[SCALED], k + 1)
    for i in range(k):
        scaled[i] = (x[i] - mean[i]) / scale[i]
    copy(vector(memory, numbers[OFFSET], n), out, n)
    value = vector(memory, numbers[VALUE], numbers[N_VALUES])
    node = vector(numbers, numbers[NODE], ABREAST)
    for begin in range(0, numbers[N_TREES], ABREAST):
        count = min(ABREAST, numbers[N_TREES] - begin)
        find_leaves(numbers, memory, scaled, begin, node)
        for i in range(count):
            output = numbers[numbers[OUTPUT] + begin + i]
            first = numbers[numbers[CHILD] + 2 * node[i] + 1]
            if output >= 0:
                out[output] += value[first]
            else:
                for j in range(n):
                    out[j] += value[first + j]


@compiled
def find_leaves(numbers: Integers, memory: Array, x: Array, begin: int, node: Integers) -> None:
    """Leaves of 8 trees from `begin` on, into `node` (8,).

    All go down as many levels, where a leaf stays, and a comparison picks the next node without a
    branch, which no processor could foresee.
    """
    n_nodes = numbers[N_NODES]
    feature = vector(numbers, numbers[FEATURE], n_nodes)
    child = vector(numbers, numbers[CHILD], 2 * n_nodes)
    threshold = vector(memory, numbers[THRESHOLD], n_nodes)
    copy(vector(numbers, numbers[ROOT] + begin, ABREAST), node, ABREAST)
    for _level in range(numbers[numbers[LEVELS] + begin // ABREAST]):
        for i in range(ABREAST):
            at = node[i]
            node[i] = child[2 * at + int(x[feature[at]] > threshold[at])]


@compiled
def count_levels(feature: Integers, right: Integers, levels: Integers) -> None:
    """Levels of nodes below each one, into `levels` (n_nodes,); children come after it."""
    for node in range(feature.shape[0] - 1, -1, -1):
        if feature[node] >= 0:
            levels[node] = 1 + max(levels[node + 1], levels[right[node]])


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    n_trees, n_nodes = (int(params["n_trees"]),), (int(params["n_nodes"]),)
    return {
        "mean": (n_features,),
        "scale": (n_features,),
        "offset": (n_outputs,),
        "root": n_trees,
        "output": n_trees,
        "feature": n_nodes,
        "threshold": n_nodes,
        "right": n_nodes,
        "value": (int(params["n_values"]),),
    }


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    n_nodes, n_values = int(params["n_nodes"]), int(params["n_values"])
    root = _whole("root", arrays["root"], 0, n_nodes - 1)
    output = _whole("output", arrays["output"], -1, n_outputs - 1)
    feature = _whole("feature", arrays["feature"], -1, n_features - 1)
    right = _whole("right", arrays["right"], 0, max(n_nodes, n_values) - 1)
    sizes = np.diff(root, append=n_nodes)
    if root[0] != 0 or (sizes < 1).any():
        raise CalibrationError("trees do not follow one another from the first node on")
    end = np.repeat(root + sizes, sizes)
    width = np.repeat(np.where(output < 0, n_outputs, 1), sizes)
    within = (right > np.arange(n_nodes) + 1) & (right < end)
    if not np.where(feature < 0, right + width <= n_values, within).all():
        raise CalibrationError("trees have a node that leads out of its tree, or back")
    if (arrays["scale"] == 0.0).any():
        raise CalibrationError("trees array 'scale' divides by zero")
    inner, places = feature >= 0, np.arange(n_nodes)
    levels = np.zeros(n_nodes, dtype=np.int64)
    count_levels(feature, right, levels)
    more = -len(root) % ABREAST
    roots = np.append(root, np.full(more, root[-1]))
    return LAYOUT.pack(
        **params,
        **{name: arrays[name] for name in ("mean", "scale", "offset", "output", "value")},
        scaled=np.zeros(n_features + 1),
        root=roots,
        levels=levels[roots].reshape(-1, ABREAST).max(axis=1),
        feature=np.where(inner, feature, n_features),
        child=np.column_stack([np.where(inner, places + 1, places), right]),
        node=np.zeros(ABREAST, dtype=np.int64),
        threshold=np.where(inner, arrays["threshold"], 0.0),
    )


def _whole(name: str, values: Array, low: int, high: int) -> Integers:
    if not ((values >= low) & (values <= high) & (values == np.floor(values))).all():
        raise CalibrationError(f"trees array {name!r} holds no integers from {low} to {high}")
    return values.astype(np.int64)


FAMILY: Final = Family(
    "trees",
    rules={
        "n_trees": integer(1, MAX_TREES),
        "n_nodes": integer(1, MAX_NODES),
        "n_values": integer(1, MAX_NODES),
    },
    shapes=_shapes,
    pack=_pack,
    row=trees_row,
)
