"""The arithmetic of the exported C in single precision, to measure what it costs.

Every operation below rounds to float32 as the C source does, in the same order; only `exp` may
differ, in its last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.export.c_models import BLOCK
from truejoint.models.families import EstimatorData, degree_of, polynomial_terms
from truejoint.models.features import Feature, FeatureSet

Single = NDArray[np.float32]


def single_features(
    feature_set: FeatureSet, samples: ArrayLike, steps: Sequence[float], sources: Sequence[int]
) -> Single:
    """Features (n, k) of samples.

    Parameters
    ----------
    feature_set : FeatureSet
    samples : array_like, shape (n, n_signals)
    steps : sequence of float
        Time since the sample before [s]; 0 where the history starts anew.
    sources : sequence of int
        Which signal each feature is made of.
    """
    table = np.asarray(samples, dtype=np.float32)
    out = np.empty((len(table), len(feature_set)), dtype=np.float32)
    for i, feature in enumerate(feature_set.features):
        out[:, i] = _OPERATIONS[feature.operation](feature, table[:, sources[i]], steps)
    return out


def single_prediction(model: EstimatorData, X: Single) -> Single:
    """Prediction (n, n_outputs) of features (n, k)."""
    arrays = {name: array.astype(np.float32) for name, array in model.arrays.items()}
    if model.family == "offset":
        return np.tile(arrays["offset"], (len(X), 1))
    scaled = (X - arrays["mean"]) * arrays["inverse_scale"]
    if model.family in ("linear", "polynomial"):
        factors = polynomial_terms(X.shape[1], degree_of(model))
        with_one = np.column_stack([scaled, np.ones(len(X), np.float32)])  # -1 finds the factor 1
        terms = with_one[:, factors[:, 0]]
        for factor in factors.T[1:]:
            terms = terms * with_one[:, factor]
        return _affine(terms, arrays["coef"], arrays["intercept"])
    units = scaled
    for i in count():
        units = _affine(units, arrays[f"weight_{i}"], arrays[f"bias_{i}"])
        if f"weight_{i + 1}" not in arrays:
            break
        units = np.float32(1) / (np.float32(1) + np.exp(-units))
    return arrays["target_mean"] + arrays["target_scale"] * units


def single_plays(
    regressions: Sequence[Mapping[str, Any]], gate: float | None, X: Single, steps: Sequence[float]
) -> Single:
    """Prediction (n, 1) of estimators by play operators, whose values `c_history` gives.

    Parameters
    ----------
    regressions : sequence of mapping
    gate : float or None
    X : ndarray, shape (n, k)
    steps : sequence of float
        As for `single_features`.
    """
    parts = [_regression(regression, X, steps) for regression in regressions]
    if gate is None:
        return parts[0][:, None]
    reset, both = parts
    difference, limit = both - reset, np.float32(gate)
    size, twice = np.abs(difference), np.float32(2) * limit
    with np.errstate(divide="ignore", invalid="ignore"):  # 0 / 0 is not taken below
        falling = difference * (twice - size) / size
    within = np.where(size >= twice, np.float32(0), falling)
    return np.asarray(reset + np.where(size <= limit, difference, within))[:, None]


def _regression(values: Mapping[str, Any], X: Single, steps: Sequence[float]) -> Single:
    columns: list[Single] = []
    for bank in values["banks"]:
        signal = X[:, bank["column"]]
        signal = signal if bank["factor"] is None else signal * np.float32(bank["factor"])
        power = np.ones_like(signal)
        for _ in range(values["degree"]):
            power = power * (signal * np.float32(bank["scale"]))
            columns.append(power)
        for width in bank["widths"].astype(np.float32):
            columns.append((signal - _follow(width, signal, steps)) / width)
    columns += [columns[0] * columns[pair] for pair in values["pairs"]]
    total = np.zeros(len(X), np.float32)
    for column, weight in zip(columns, values["weights"].astype(np.float32), strict=True):
        total = total + column * weight
    return np.asarray(total + np.float32(values["constant"]))


def _affine(source: Single, weight: Single, bias: Single) -> Single:
    """``source @ weight + bias``, summed up in the order of the C source."""
    total = np.tile(bias, (len(source), 1))
    whole = len(weight) // BLOCK * BLOCK
    for i in range(0, whole, BLOCK):
        a, b, c, d = (source[:, k, None] * weight[k] for k in range(i, i + BLOCK))
        total += (a + b) + (c + d)
    for i in range(whole, len(weight)):
        total += source[:, i, None] * weight[i]
    return total


def _value(_feature: Feature, signal: Single, _steps: Sequence[float]) -> Single:
    return signal


def _lag(feature: Feature, signal: Single, steps: Sequence[float]) -> Single:
    out = np.empty_like(signal)
    start = 0
    for row, step in enumerate(steps):
        start = row if step == 0.0 else start
        out[row] = signal[max(start, row - int(feature.parameter))]
    return out


def _lowpass(feature: Feature, signal: Single, steps: Sequence[float]) -> Single:
    constant = np.float32(feature.parameter)
    out = np.empty_like(signal)
    last: Any = None
    for row, step in enumerate(steps):
        value = signal[row]
        if step == 0.0:
            out[row] = value
        else:
            elapsed = np.float32(step)
            trail = constant * (value - last) / elapsed
            out[row] = value - trail + (out[row - 1] - last + trail) * np.exp(-elapsed / constant)
        last = value
    return out


def _rate(feature: Feature, signal: Single, steps: Sequence[float]) -> Single:
    return (signal - _lowpass(feature, signal, steps)) / np.float32(feature.parameter)


def _play(feature: Feature, signal: Single, steps: Sequence[float]) -> Single:
    return _follow(np.float32(feature.parameter), signal, steps)


def _follow(half_width: np.float32, signal: Single, steps: Sequence[float]) -> Single:
    """Output of a play operator."""
    out = np.empty_like(signal)
    for row, step in enumerate(steps):
        before = signal[row] if step == 0.0 else out[row - 1]
        out[row] = min(max(before, signal[row] - half_width), signal[row] + half_width)
    return out


_OPERATIONS = {"value": _value, "lag": _lag, "lowpass": _lowpass, "rate": _rate, "play": _play}
