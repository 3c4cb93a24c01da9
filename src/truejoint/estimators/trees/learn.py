"""What scikit-learn has learnt as arrays of ours, where a family of ours computes the same."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn.dummy import DummyRegressor
from sklearn.ensemble import (
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.tree import BaseDecisionTree

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.network import run as network
from truejoint.estimators.polynomial import run as polynomial
from truejoint.estimators.trees.run import FAMILY, MAX_NODES


def convert(
    parts: Sequence[object], n_features: int, target_mean: Array, target_scale: Array
) -> EstimatorData | None:
    """Give data of a family of ours that computes what regressors do; None if there is none.

    `parts`, one for all outputs or one for each, predict targets less `target_mean` over
    `target_scale` (n_outputs,). Whoever calls compares what both predict: a class may inherit from
    one of scikit-learn's and predict otherwise. Raises CalibrationError for too large trees.
    """
    separate = [p.estimators_ if isinstance(p, MultiOutputRegressor) else [p] for p in parts]
    scaled = [_scaled(regressor, n_features) for single in separate for regressor in single]
    regressors, (mean, scale) = [regressor for regressor, *_ in scaled], scaled[0][1:]
    alike = [r is not None and (m == mean).all() and (s == scale).all() for r, m, s in scaled]
    if not all(alike) or len(scaled) not in (1, len(target_mean)):
        return None
    sums = [tree_sum(regressor) for regressor in regressors]
    if all(part is not None and part.trees for part in sums):
        means, scales = (np.split(a, len(sums)) for a in (target_mean, target_scale))
        by = zip(filter(None, sums), means, scales, strict=True)
        return trees_data([trees.rescaled(*scaling) for trees, *scaling in by], mean, scale)
    standard = {"mean": mean, "inverse_scale": 1.0 / scale}
    if isinstance(regressors[0], MLPRegressor):
        targets = {"target_mean": target_mean, "target_scale": target_scale}
        return _network(regressors[0], standard | targets) if len(scaled) == 1 else None
    return _linear(regressors, standard, target_mean, target_scale)


def _scaled(regressor: Any, n_features: int) -> tuple[Any, Array, Array]:
    """Strip a regressor of search and scaling: it, or None if there is more; mean and scale."""
    searched = getattr(regressor, "best_estimator_", regressor)
    mean, scale = np.zeros(n_features), np.ones(n_features)
    if not isinstance(searched, Pipeline):
        return searched, mean, scale
    *before, (_, last) = searched.steps
    steps: list[Any] = [step for _, step in before if step not in (None, "passthrough")]
    if len(steps) > 1 or any(type(step) is not StandardScaler for step in steps):
        return None, mean, scale
    for step in steps:
        mean = mean if step.mean_ is None else np.asarray(step.mean_, dtype=np.float64)
        scale = scale if step.scale_ is None else np.asarray(step.scale_, dtype=np.float64)
    return last, mean, scale


def _linear(
    fitted: Sequence[Any], standard: dict[str, Array], target_mean: Array, target_scale: Array
) -> EstimatorData | None:
    """Polynomial of degree 1, of whatever has coefficients and an intercept."""
    n, k = len(target_mean) // len(fitted), len(standard["mean"])
    try:
        coefs = [np.asarray(r.coef_, np.float64).reshape(n, k) for r in fitted]
        intercepts = [np.ravel(r.intercept_).astype(np.float64) for r in fitted]
        intercept = np.concatenate([np.broadcast_to(part, n) for part in intercepts])
    except (AttributeError, TypeError, ValueError):
        return None
    arrays = standard | {
        "coef": np.ascontiguousarray(np.concatenate(coefs).T * target_scale),
        "intercept": target_mean + target_scale * intercept,
    }
    return EstimatorData(polynomial.FAMILY.name, polynomial.of_degree(1), arrays)


def _network(fitted: Any, scales: dict[str, Array]) -> EstimatorData | None:
    """Network of ours, of one with logistic hidden units."""
    params = {
        "hidden_layer_sizes": tuple(len(bias) for bias in fitted.intercepts_[:-1]),
        "weight_decay": float(fitted.alpha),
        "learning_rate": float(fitted.learning_rate_init),
        "batch_size": 200 if fitted.batch_size == "auto" else int(fitted.batch_size),
        "epochs": int(fitted.n_iter_),
        "random_state": fitted.random_state,
    }
    try:
        network.FAMILY.check_params(params)
    except CalibrationError:
        return None
    arrays = dict(scales)
    for i, (weight, bias) in enumerate(zip(fitted.coefs_, fitted.intercepts_, strict=True)):
        arrays |= {f"weight_{i}": np.array(weight), f"bias_{i}": np.array(bias)}
    return EstimatorData(network.FAMILY.name, params, arrays)


class Tree(NamedTuple):
    """One tree, its nodes in the order in which a walk to the left first meets them."""

    feature: Integers  # (n_nodes,), -1 for a leaf
    threshold: Array  # up to which a row goes to the next node
    right: Integers  # node that other rows go to; 0 for a leaf
    value: Array  # (n_nodes, n_outputs), of which those of the leaves count


class TreeSum(NamedTuple):
    """Trees whose values are added to `offset` (n_outputs,)."""

    trees: list[Tree]
    offset: Array

    def rescaled(self, mean: Array | float, scale: Array | float) -> "TreeSum":
        """Give `mean` and `scale`, numbers or (n_outputs,), times what this gives."""
        trees = [tree._replace(value=tree.value * scale) for tree in self.trees]
        return TreeSum(trees, mean + scale * self.offset)


def tree_sum(regressor: object) -> TreeSum | None:
    """Trees of a fitted regressor of scikit-learn; None if it is no sum of trees."""
    if isinstance(regressor, BaseDecisionTree):
        return _sum_of([_grown(regressor, 1.0)], 0.0)
    if isinstance(regressor, (RandomForestRegressor, ExtraTreesRegressor)):
        share = 1.0 / len(regressor.estimators_)
        return _sum_of([_grown(tree, share) for tree in regressor.estimators_], 0.0)
    if isinstance(regressor, GradientBoostingRegressor):
        return _gradient_boosted(regressor)
    if isinstance(regressor, HistGradientBoostingRegressor):
        return _histogram_boosted(regressor)
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


def _sum_of(trees: list[Tree], offset: float) -> TreeSum:
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
