"""Sums of decision trees: single ones, forests, and boosted trees."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, inlined, vector
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Shape
from truejoint.estimators.rules import Params, integer
from truejoint.layout import Layout, Memory

MAX_TREES: Final = 10**5
MAX_NODES: Final = 6 * 10**6
"""Most nodes of all trees together, and most values of their leaves."""
ABREAST: Final = 16
"""Trees that are walked through together, so that none waits for what another asks."""

LAYOUT: Final = Layout().declare(__package__, "trees", ABREAST=ABREAST)
unpack = LAYOUT.unpacker()


@compiled
def trees_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict an offset and the sum of the leaves that the scaled features lead to."""
    m = unpack(numbers, memory)
    for i in range(x.shape[0]):
        m.scaled[i] = (x[i] - m.mean[i]) / m.scale[i]
    n = out.shape[0]
    copy(m.offset, out, n)
    for begin in range(0, m.n_trees, ABREAST):
        count = min(ABREAST, m.n_trees - begin)
        copy(vector(m.root, begin, ABREAST), m.node, ABREAST)
        levels = m.levels[begin // ABREAST]
        find_leaves(m.feature, m.child, m.threshold, m.scaled, levels, m.node)
        for i in range(count):
            output, first = m.output[begin + i], m.first[m.node[i]]
            if output >= 0:
                out[output] += m.value[first]
            else:
                for j in range(n):
                    out[j] += m.value[first + j]


@inlined
def find_leaves(
    feature: Integers, child: Integers, threshold: Array, x: Array, levels: int, node: Integers
) -> None:
    """Go so many levels down from each `node` (ABREAST,) of `ABREAST` trees.

    All go down as many levels, where a leaf stays, and a comparison picks the next node without a
    branch, which no processor could foresee.
    """
    for _level in range(levels):
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
    n_trees, n_nodes, n_values = (int(params[f"n_{what}"]) for what in ("trees", "nodes", "values"))
    return {
        **dict.fromkeys(("mean", "scale"), (n_features,)),
        "offset": (n_outputs,),
        **dict.fromkeys(("root", "output"), (n_trees,)),
        **dict.fromkeys(("feature", "threshold", "right"), (n_nodes,)),
        "value": (n_values,),
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
        raise CalibrationError("trees have a leaf whose value is not among their values")
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
