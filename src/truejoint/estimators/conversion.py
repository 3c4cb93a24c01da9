"""What scikit-learn has learnt as arrays of ours, where a family of ours computes the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MaxAbsScaler, RobustScaler, StandardScaler

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.trees import tree_sum, trees_data
from truejoint.models import network, polynomial
from truejoint.models.family import EstimatorData

_SCALERS: Final = {StandardScaler: "mean_", RobustScaler: "center_", MaxAbsScaler: ""}
"""Steps that take away the attribute of this name and divide by ``scale_``."""


@dataclass(frozen=True, eq=False)
class _Scaled:
    """A regressor that sees features less `mean` over `scale` (k,)."""

    regressor: Any
    mean: Array
    scale: Array


def convert(
    parts: Sequence[object], n_features: int, target_mean: Array, target_scale: Array
) -> EstimatorData | None:
    """Give data of a family of ours that computes what regressors do; None if there is none.

    `parts` are one for all outputs, or one for each, and predict targets less `target_mean`, over
    `target_scale` (n_outputs,). Whoever calls compares what both predict: a class that inherits
    from one of scikit-learn's may predict in a way of its own. Raises CalibrationError for too
    large trees.
    """
    separate = [
        p.estimators_ if isinstance(p, MultiOutputRegressor) else [p] for p in parts
    ]  # one by one, where they are fitted so
    scaled = [_scaled(one, n_features) for ones in separate for one in ones]
    found = [one for one in scaled if one is not None]
    if len(found) != len(scaled) or len(found) not in (1, len(target_mean)):
        return None
    mean, scale = found[0].mean, found[0].scale
    if any((one.mean != mean).any() or (one.scale != scale).any() for one in found):
        return None
    sums = [tree_sum(one.regressor) for one in found]
    trees = [one for one in sums if one is not None and one.trees]
    if len(trees) == len(sums):
        means, scales = (np.split(a, len(trees)) for a in (target_mean, target_scale))
        rescaled = [one.rescaled(*by) for one, *by in zip(trees, means, scales, strict=True)]
        return trees_data(rescaled, mean, scale)
    if isinstance(found[0].regressor, MLPRegressor):
        return _network(found[0], target_mean, target_scale) if len(found) == 1 else None
    return _linear(found, target_mean, target_scale)


def is_convertible_step(step: object) -> bool:
    """Whether a step of a pipeline before its last can become a part of arrays of ours."""
    return step is None or step == "passthrough" or type(step) in _SCALERS


def _scaled(regressor: Any, n_features: int) -> _Scaled | None:
    """Strip a regressor of search and scaling; None if there is more."""
    found = getattr(regressor, "best_estimator_", regressor)
    mean, scale = np.zeros(n_features), np.ones(n_features)
    if not isinstance(found, Pipeline):
        return _Scaled(found, mean, scale)
    *before, (_, last) = found.steps
    steps: list[Any] = [step for _, step in before if step not in (None, "passthrough")]
    if len(steps) > 1 or not all(map(is_convertible_step, steps)):
        return None
    for step in steps:
        taken = getattr(step, _SCALERS[type(step)] or "", None)
        mean = mean if taken is None else np.asarray(taken, dtype=np.float64)
        scale = scale if step.scale_ is None else np.asarray(step.scale_, dtype=np.float64)
    return _Scaled(last, mean, scale)


def _linear(
    parts: Sequence[_Scaled], target_mean: Array, target_scale: Array
) -> EstimatorData | None:
    """Polynomial of degree 1, of whatever has coefficients and an intercept."""
    shape = len(target_mean) // len(parts), len(parts[0].mean)
    found = [part.regressor for part in parts]
    try:
        coefs = [np.asarray(one.coef_, np.float64).reshape(shape) for one in found]
        each = [np.ravel(one.intercept_).astype(np.float64) for one in found]
        intercepts = [np.broadcast_to(intercept, shape[0]) for intercept in each]
    except (AttributeError, TypeError, ValueError):
        return None
    arrays = {
        "mean": parts[0].mean,
        "inverse_scale": 1.0 / parts[0].scale,
        "coef": np.ascontiguousarray(np.concatenate(coefs).T * target_scale),
        "intercept": target_mean + target_scale * np.concatenate(intercepts),
    }
    return EstimatorData(polynomial.FAMILY.name, {"degree": 1}, arrays)


def _network(part: _Scaled, target_mean: Array, target_scale: Array) -> EstimatorData | None:
    """Network of ours, of one with logistic hidden units."""
    fitted = part.regressor
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
    arrays = {
        "mean": part.mean,
        "inverse_scale": 1.0 / part.scale,
        "target_mean": target_mean,
        "target_scale": target_scale,
    }
    for i, (weight, bias) in enumerate(zip(fitted.coefs_, fitted.intercepts_, strict=True)):
        arrays |= {f"weight_{i}": np.array(weight), f"bias_{i}": np.array(bias)}
    return EstimatorData(network.FAMILY.name, params, arrays)
