"""Sums of decision trees: single ones, forests, and boosted trees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, vector
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Params, Shape, integer
from truejoint.layout import Layout, Memory

MAX_TREES: Final = 10**5
MAX_NODES: Final = 6 * 10**6
"""Most nodes of all trees together, and most values of their leaves."""
ABREAST: Final = 16
"""Trees that are walked through together, so that none waits for what another asks."""

LAYOUT: Final = Layout()
N_TREES: Final = LAYOUT.integer("n_trees", "whose values are summed")
N_NODES: Final = LAYOUT.integer("n_nodes", "of all trees")
N_VALUES: Final = LAYOUT.integer("n_values", "of all leaves")
MEAN: Final = LAYOUT.array("mean", "taken from each feature")
SCALE: Final = LAYOUT.array("scale", "that each feature is then divided by")
SCALED: Final = LAYOUT.array("scaled", "features of one row, then 0")
OFFSET: Final = LAYOUT.array("offset", "of each output, which the values are added to")
ROOT: Final = LAYOUT.integers("root", "node at which each tree begins, flat trees first")
LEVELS: Final = LAYOUT.integers("levels", "of the deepest of every so many trees, below its root")
OUTPUT: Final = LAYOUT.integers("output", "that each tree adds to; -1: to every one")
FEATURE: Final = LAYOUT.integers("feature", "that each node asks for; of a leaf the 0")
CHILD: Final = LAYOUT.integers("child", "up to the threshold; above it, the next; a leaf: itself")
FIRST: Final = LAYOUT.integers("first", "value of each leaf")
NODE: Final = LAYOUT.integers("node", "at which trees that are walked through together are")
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
            first = numbers[numbers[FIRST] + node[i]]
            if output >= 0:
                out[output] += value[first]
            else:
                for j in range(n):
                    out[j] += value[first + j]


@compiled
def find_leaves(numbers: Integers, memory: Array, x: Array, begin: int, node: Integers) -> None:
    """Leaves of the trees from `begin` on, into `node` (ABREAST,).

    All go down as many levels, where a leaf stays, and a comparison picks the next node without a
    branch, which no processor could foresee.
    """
    n_nodes = numbers[N_NODES]
    feature = vector(numbers, numbers[FEATURE], n_nodes)
    child = vector(numbers, numbers[CHILD], n_nodes)
    threshold = vector(memory, numbers[THRESHOLD], n_nodes)
    copy(vector(numbers, numbers[ROOT] + begin, ABREAST), node, ABREAST)
    for _level in range(numbers[numbers[LEVELS] + begin // ABREAST]):
        for i in range(ABREAST):
            at = node[i]
            node[i] = child[at] + int(x[feature[at]] > threshold[at])


@compiled
def measure_trees(feature: Integers, right: Integers, size: Integers, levels: Integers) -> bool:
    """Nodes of the tree that each node (n_nodes,) is the root of, and levels below it.

    False if one to the right does not stand behind all that are to the left, or nowhere.
    """
    n_nodes = feature.shape[0]
    for node in range(n_nodes - 1, -1, -1):
        size[node], levels[node] = 1, 0
        if feature[node] >= 0:
            left, other = node + 1, right[node]
            if other >= n_nodes or left >= n_nodes or other != left + size[left]:
                return False
            size[node] += size[left] + size[other]
            levels[node] = 1 + max(levels[left], levels[other])
    return True


@compiled
def by_levels(
    feature: Integers, right: Integers, size: Integers, order: Integers, child: Integers
) -> None:
    """Order of nodes in which trees stand one level after the other, two children side by side.

    What is asked first then stands together, and one step leads from a `child` to the other. Both
    are (n_nodes,), `child` by the new places.
    """
    begin = 0
    while begin < feature.shape[0]:
        order[begin] = begin
        free = begin + 1
        for place in range(begin, begin + size[begin]):
            node = order[place]
            child[place] = place
            if feature[node] >= 0:
                order[free], order[free + 1], child[place] = node + 1, right[node], free
                free += 2
        begin += size[begin]


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
    size, levels, order, child = np.zeros((4, n_nodes), dtype=np.int64)
    within = measure_trees(feature, right, size, levels)
    if not within or root[0] != 0 or (np.diff(root, append=n_nodes) != size[root]).any():
        raise CalibrationError("trees have a node that leads out of its tree, or back")
    inner, width = feature >= 0, np.repeat(np.where(output < 0, n_outputs, 1), size[root])
    if (right[~inner] + width[~inner] > n_values).any():
        raise CalibrationError("trees have a leaf whose value is none of theirs")
    if (arrays["scale"] == 0.0).any():
        raise CalibrationError("trees array 'scale' divides by zero")
    by_levels(feature, right, size, order, child)
    inner = inner[order]
    trees = np.argsort(levels[root], kind="stable")
    roots = np.append(root[trees], np.full(-len(root) % ABREAST, root[trees[-1]]))
    return LAYOUT.pack(
        **params,
        **{name: arrays[name] for name in ("mean", "scale", "offset", "value")},
        scaled=np.zeros(n_features + 1),
        root=roots,
        levels=levels[roots].reshape(-1, ABREAST).max(axis=1),
        output=output[trees],
        feature=np.where(inner, feature[order], n_features),
        child=child,
        first=np.where(inner, 0, right[order]),
        node=np.zeros(ABREAST, dtype=np.int64),
        threshold=np.where(inner, arrays["threshold"][order], 0.0),
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
