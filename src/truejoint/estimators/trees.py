"""Trees that scikit-learn has grown, as the arrays of `models.trees`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from sklearn.dummy import DummyRegressor
from sklearn.ensemble import (
    BaggingRegressor,
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
    VotingRegressor,
)
from sklearn.tree import BaseDecisionTree

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.models.family import EstimatorData
from truejoint.models.trees import FAMILY, MAX_NODES

_FORESTS: Final = (RandomForestRegressor, ExtraTreesRegressor)


@dataclass(frozen=True, eq=False)
class Tree:
    """One tree, its nodes in the order in which a walk to the left first meets them."""

    feature: Integers  # (n_nodes,), -1 for a leaf
    threshold: Array  # up to which a row goes to the next node
    right: Integers  # node that other rows go to; 0 for a leaf
    value: Array  # (n_nodes, n_outputs), of which those of the leaves count


@dataclass(frozen=True, eq=False)
class TreeSum:
    """Trees whose values are added to `offset` (n_outputs,)."""

    trees: Sequence[Tree]
    offset: Array

    def rescaled(self, mean: Array | float, scale: Array | float) -> TreeSum:
        """Give `mean` and `scale`, numbers or (n_outputs,), times what this gives."""
        trees = [replace(tree, value=tree.value * scale) for tree in self.trees]
        return TreeSum(trees, mean + scale * self.offset)


def tree_sum(regressor: object) -> TreeSum | None:
    """Trees of a fitted regressor of scikit-learn; None if it is no sum of trees."""
    if isinstance(regressor, BaseDecisionTree):
        return _sum_of([_grown(regressor, 1.0)], 0.0)
    if isinstance(regressor, _FORESTS):
        share = 1.0 / len(regressor.estimators_)
        return _sum_of([_grown(tree, share) for tree in regressor.estimators_], 0.0)
    if isinstance(regressor, GradientBoostingRegressor):
        return _gradient_boosted(regressor)
    if isinstance(regressor, HistGradientBoostingRegressor):
        return _histogram_boosted(regressor)
    if isinstance(regressor, (BaggingRegressor, VotingRegressor)):
        return _averaged(regressor)
    return None


def trees_data(sums: Sequence[TreeSum], mean: Array, scale: Array) -> EstimatorData:
    """One sum for all outputs, or one for each, on features less `mean` over `scale` (k,).

    Raises CalibrationError if the trees are too many for a model file.
    """
    trees = [tree for part in sums for tree in part.trees]
    n_nodes = sum(len(tree.feature) for tree in trees)
    n_values = sum(tree.value[tree.feature < 0].size for tree in trees)
    if max(n_nodes, n_values) > MAX_NODES:
        raise CalibrationError(
            f"its {len(trees)} trees have {n_nodes} nodes and {n_values} values, more than the "
            f"{MAX_NODES} of either that a model file holds; set min_samples_leaf or "
            "max_leaf_nodes, or fit at a lower rate"
        )
    outputs = [-1] if len(sums) == 1 else range(len(sums))
    output = np.concatenate([np.full(len(p.trees), j) for j, p in zip(outputs, sums, strict=True)])
    sizes = np.array([len(tree.feature) for tree in trees])
    root = np.cumsum(sizes) - sizes
    feature = np.concatenate([tree.feature for tree in trees])
    leaf = feature < 0
    width = np.repeat([tree.value.shape[1] for tree in trees], sizes)[leaf]
    right = np.concatenate([tree.right for tree in trees]) + np.repeat(root, sizes)
    right[leaf] = np.cumsum(width) - width
    arrays = {
        "mean": mean,
        "scale": scale,
        "offset": np.concatenate([part.offset for part in sums]),
        "root": root,
        "output": output,
        "feature": feature,
        "threshold": np.concatenate([tree.threshold for tree in trees]),
        "right": right,
        "value": np.concatenate([tree.value[tree.feature < 0].ravel() for tree in trees]),
    }
    params = {"n_trees": len(trees), "n_nodes": n_nodes, "n_values": n_values}
    return EstimatorData(FAMILY.name, params, {n: a.astype(np.float64) for n, a in arrays.items()})


def _gradient_boosted(regressor: Any) -> TreeSum | None:
    offset = 0.0
    if regressor.init != "zero":
        if not isinstance(regressor.init_, DummyRegressor):
            return None
        offset = float(regressor.init_.constant_.item())
    rate = regressor.learning_rate
    return _sum_of([_grown(tree, rate) for tree in regressor.estimators_.ravel()], offset)


def _histogram_boosted(regressor: Any) -> TreeSum | None:
    # scikit-learn has no public names for what histogram boosting has learnt.
    stages = [stage[0].nodes for stage in regressor._predictors]
    if any(nodes["is_categorical"].any() for nodes in stages):
        return None
    trees = []
    for nodes in stages:  # which compare features as they are
        leaf = nodes["is_leaf"].astype(bool)
        feature = np.where(leaf, -1, nodes["feature_idx"])
        threshold = np.where(leaf, 0.0, nodes["num_threshold"])
        left, right = (nodes[side].astype(np.int64) for side in ("left", "right"))
        value = nodes["value"][:, None].copy()
        trees.append(_in_order(feature, threshold, left, right, value))
    return _sum_of(trees, regressor._baseline_prediction.item())


def _averaged(regressor: Any) -> TreeSum | None:
    members = [tree_sum(member) for member in regressor.estimators_]
    sums = [member for member in members if member is not None]
    if len(sums) != len(members):
        return None
    weights = np.ones(len(sums))
    if isinstance(regressor, VotingRegressor) and regressor.weights is not None:
        named = zip(regressor.estimators, regressor.weights, strict=True)
        weights = np.array([weight for (_, member), weight in named if member != "drop"])
    scaled = [s.rescaled(0.0, w) for s, w in zip(sums, weights / weights.sum(), strict=True)]
    if isinstance(regressor, BaggingRegressor):  # of which each sees some features
        seen = zip(scaled, regressor.estimators_features_, strict=True)
        trees = [
            replace(t, feature=np.where(t.feature < 0, -1, np.asarray(columns)[t.feature]))
            for one, columns in seen
            for t in one.trees
        ]
    else:
        trees = [tree for one in scaled for tree in one.trees]
    return TreeSum(trees, np.sum([one.offset for one in scaled], axis=0))


def _sum_of(trees: Sequence[Tree], offset: float) -> TreeSum:
    return TreeSum(trees, np.full(trees[0].value.shape[1] if trees else 1, offset))


def _grown(regressor: Any, factor: float) -> Tree:
    """Tree of `sklearn.tree`, which compares features in single precision."""
    tree = regressor.tree_
    feature = np.where(tree.children_left < 0, -1, tree.feature)
    threshold = np.where(feature < 0, 0.0, single_threshold(tree.threshold))
    value = factor * tree.value[:, :, 0]
    return _in_order(feature, threshold, tree.children_left, tree.children_right, value)


def _in_order(
    feature: Integers, threshold: Array, left: Integers, right: Integers, value: Array
) -> Tree:
    """Tree with its nodes in the order of a walk to the left first; most are in it already."""
    inner = np.flatnonzero(feature >= 0)
    if not (left[inner] == inner + 1).all():
        order, rest = [], [0]
        while rest:
            node = rest.pop()
            order.append(node)
            if feature[node] >= 0:
                rest += [int(right[node]), int(left[node])]
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        right = np.where(feature >= 0, place[right], 0)[order]
        feature, threshold, value = feature[order], threshold[order], value[order]
    return Tree(feature, threshold, np.where(feature >= 0, right, 0), value)


def single_threshold(threshold: Array) -> Array:
    """Largest numbers (n,) that are at most `threshold` (n,) once they are rounded to float32."""
    below = threshold.astype(np.float32)
    below = np.where(below > threshold, np.nextafter(below, np.float32(-np.inf)), below)
    above = np.nextafter(below, np.float32(np.inf))
    half = 0.5 * (below.astype(np.float64) + above)
    # Half-way between two numbers goes to the one whose last bit is 0.
    return np.where(half.astype(np.float32) == below, half, np.nextafter(half, -np.inf))
