"""Layers of a network and their loss: that of Keras, and its gradient."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from truejoint.compiled import compiled

Floats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Layers:
    """Weights and biases of a network, as views into one flat vector for the optimiser."""

    flat: Floats
    weights: tuple[Floats, ...]  # (inputs, units)
    biases: tuple[Floats, ...]  # (units,)

    @classmethod
    def zeros(cls, sizes: tuple[int, ...], dtype: DTypeLike = np.float32) -> Self:
        """Layers between `sizes` = (inputs, hidden units..., outputs), all zero."""
        pairs = list(pairwise(sizes))
        ends = np.cumsum([n for inputs, units in pairs for n in (inputs * units, units)])
        flat = np.zeros(ends[-1], dtype)
        parts = np.split(flat, ends[:-1])
        biases = tuple(parts[1::2])
        weights = (w.reshape(-1, len(b)) for w, b in zip(parts[::2], biases, strict=True))
        return cls(flat, tuple(weights), biases)

    @classmethod
    def glorot(
        cls, sizes: tuple[int, ...], rng: np.random.RandomState, dtype: DTypeLike = np.float32
    ) -> Self:
        """Layers as Keras starts them: uniform within sqrt(6 / (inputs + units)), zero biases."""
        layers = cls.zeros(sizes, dtype)
        for weight in layers.weights:
            bound = math.sqrt(6.0 / sum(weight.shape))
            weight[:] = rng.uniform(-bound, bound, weight.shape)
        return layers


def loss_and_gradient(
    layers: Layers,
    X: Floats,
    y: Floats,
    weight_decay: float,
    gradient: Layers,
) -> float:
    """Keras' loss of a batch `X` (n, n_inputs), `y` (n, n_outputs), and its gradient, in place.

    ``mean((y - f(X))**2) + weight_decay * sum(weights**2)``, the mean over rows and outputs, biases
    free; where `y` is NaN, the difference is none. The loss of scikit-learn's ``MLPRegressor`` has
    the same minimiser at ``alpha = weight_decay * n_outputs * n_rows``.
    """
    activations = forward(layers, X)
    delta = activations.pop()
    sums = np.zeros_like(layers.biases[-1])
    loss = _slopes_of_squares(delta, y, np.array([2.0 / delta.size], delta.dtype), sums)
    for layer in reversed(range(len(layers.weights))):
        source, weight = activations[layer], layers.weights[layer]
        np.matmul(source.T, delta, out=gradient.weights[layer])
        gradient.weights[layer][:] += (2.0 * weight_decay) * weight
        gradient.biases[layer][:] = sums
        loss += weight_decay * float(np.vdot(weight, weight))
        if layer:
            delta = delta @ weight.T
            sums = np.zeros_like(layers.biases[layer - 1])
            _through_logistic(delta, source, sums)
    return loss


@compiled
def _slopes_of_squares(predicted: Floats, y: Floats, scale: Floats, sums: Floats) -> float:
    """Make slopes of the mean square of what was found (n, k), and give it; add them up (k,).

    `scale` (1,) is twice the inverse of its numbers, of their precision; unknown is what is NaN.
    """
    total = 0.0
    for i in range(predicted.shape[0]):
        for j in range(predicted.shape[1]):
            difference = predicted[i, j] - y[i, j]
            if math.isnan(y[i, j]):
                difference = predicted[i, j] - predicted[i, j]
            total += difference * difference
            predicted[i, j] = difference * scale[0]
            sums[j] += predicted[i, j]
    return total / predicted.size


@compiled
def _through_logistic(delta: Floats, hidden: Floats, sums: Floats) -> None:
    """Multiply slopes (n, units) by that of the function that gave `hidden`; add up (units,)."""
    for i in range(delta.shape[0]):
        for j in range(delta.shape[1]):
            delta[i, j] *= hidden[i, j] - hidden[i, j] * hidden[i, j]
            sums[j] += delta[i, j]


def forward(layers: Layers, X: Floats) -> list[Floats]:
    """Activations of every layer, input first, output last."""
    activations = [X]
    last = len(layers.weights) - 1
    for layer, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        # The logistic function by way of tanh of half, which numpy computes ten times faster than
        # scipy's expit; halving the weights costs less than halving what they give.
        half = 0.5 if layer < last else 1.0
        units = activations[-1] @ (half * weight)
        _add_to_rows(units, half * bias)
        if layer < last:
            np.tanh(units, out=units)
            _lift(units, units.dtype.type(0.5))
        activations.append(units)
    return activations


@compiled
def _add_to_rows(values: Floats, row: Floats) -> None:
    """Add a row (k,) to values (n, k); numpy takes five times as long for so short a one."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[i, j] += row[j]


@compiled
def _lift(values: Floats, half: float) -> None:
    """Make a logistic function of tanh, in one pass; a `half` of the values' own precision."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[i, j] = half * values[i, j] + half
