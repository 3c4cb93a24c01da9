"""Training of a network: the Keras loss of peng2024, its gradient, and Adam."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from truejoint.errors import CalibrationError
from truejoint.estimators.base import Progress

Floats = NDArray[np.floating]

# Adam as in peng2024, IV-B; the last is the default of Keras, which the paper does not state.
FIRST_DECAY: Final = 0.9
SECOND_DECAY: Final = 0.999
EPSILON: Final = 1e-7


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
    layers: Layers, X: Floats, y: Floats, weight_decay: float, gradient: Layers
) -> float:
    """Keras' loss of a batch `X` (n, n_inputs), `y` (n, n_outputs), and its gradient, in place.

    The loss is ``mean((y - f(X))**2) + weight_decay * sum(weights**2)``: the mean is over rows and
    outputs, biases are free. scikit-learn's ``MLPRegressor`` halves the squared error, sums it over
    outputs and divides its penalty ``alpha / 2`` by the rows of the batch: its minimiser is the
    same at ``alpha = weight_decay * n_outputs * n_rows``.
    """
    activations = _forward(layers, X)
    delta = activations.pop()
    delta -= y
    loss = float(np.vdot(delta, delta)) / delta.size
    delta *= 2.0 / delta.size
    for layer in reversed(range(len(layers.weights))):
        source, weight = activations[layer], layers.weights[layer]
        np.matmul(source.T, delta, out=gradient.weights[layer])
        gradient.weights[layer][:] += (2.0 * weight_decay) * weight
        np.sum(delta, axis=0, out=gradient.biases[layer])
        loss += weight_decay * float(np.vdot(weight, weight))
        if layer:
            delta = delta @ weight.T
            delta *= source
            np.subtract(1.0, source, out=source)
            delta *= source
    return loss


def _forward(layers: Layers, X: Floats) -> list[Floats]:
    """Activations of every layer, input first, output last."""
    activations = [X]
    last = len(layers.weights) - 1
    for layer, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        units = activations[-1] @ weight
        units += bias
        if layer < last:
            # The logistic function by way of tanh, which numpy computes ten times faster than
            # scipy's expit.
            units *= 0.5
            np.tanh(units, out=units)
            units *= 0.5
            units += 0.5
        activations.append(units)
    return activations


class Adam:
    """Adam (Kingma and Ba, 2014) on one flat vector, in place."""

    def __init__(self, values: Floats, learning_rate: float) -> None:
        self._values = values
        self.learning_rate = learning_rate
        self._first = np.zeros_like(values)
        self._second = np.zeros_like(values)
        self._room = np.empty_like(values)
        self._steps = 0

    def step(self, gradient: Floats) -> None:
        """Move the values one step down `gradient`."""
        self._steps += 1
        self._first *= FIRST_DECAY
        np.multiply(gradient, 1.0 - FIRST_DECAY, out=self._room)
        self._first += self._room
        self._second *= SECOND_DECAY
        np.multiply(gradient, gradient, out=self._room)
        self._room *= 1.0 - SECOND_DECAY
        self._second += self._room
        # With the bias corrections folded into the step and epsilon beside the uncorrected root, as
        # in section 2 of the paper on Adam, in Keras and in scikit-learn.
        root = math.sqrt(1.0 - SECOND_DECAY**self._steps)
        np.sqrt(self._second, out=self._room)
        self._room += EPSILON
        np.divide(self._first, self._room, out=self._room)
        self._room *= self.learning_rate * root / (1.0 - FIRST_DECAY**self._steps)
        self._values -= self._room


def train(
    layers: Layers,
    X: Floats,
    y: Floats,
    *,
    weight_decay: float,
    learning_rate: float,
    batch_size: int,
    epochs: int,
    rng: np.random.RandomState,
    progress: Progress,
) -> list[float]:
    """Train in place, rows in a fresh order in each epoch; mean loss over the batches of each.

    `X` (n, n_inputs) and `y` (n, n_outputs) are standardised, and of the type of `layers`. Raises
    CalibrationError if the loss grows out of bounds.
    """
    sizes = len(layers.weights[0]), *map(len, layers.biases)
    gradient = Layers.zeros(sizes, layers.flat.dtype)
    adam = Adam(layers.flat, learning_rate)
    history = []
    for epoch in range(epochs):
        order = rng.permutation(len(X))
        X_epoch, y_epoch = X[order], y[order]
        losses = []
        for start in range(0, len(X), batch_size):
            rows = slice(start, start + batch_size)
            losses.append(
                loss_and_gradient(layers, X_epoch[rows], y_epoch[rows], weight_decay, gradient)
            )
            adam.step(gradient.flat)
        history.append(float(np.mean(losses)))
        check_loss(history, epochs, learning_rate)
        progress((epoch + 1) / epochs)
    return history


def check_loss(history: list[float], epochs: int, learning_rate: float) -> None:
    """Raise CalibrationError if the loss of the last of the epochs so far is out of bounds."""
    if not math.isfinite(history[-1]):
        raise CalibrationError(
            f"training diverged in epoch {len(history)} of {epochs} at learning rate "
            f"{learning_rate:g}; lower the learning rate"
        )
