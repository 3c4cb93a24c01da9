"""The deep neural network of peng2024, IV-B: its training by the Keras loss, and Adam."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray
from sklearn.utils import check_random_state

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, JointRegressor, Progress, scaling
from truejoint.estimators.family import Family, Params, Rule, integer, optional
from truejoint.estimators.network import run as network

MINIMUM_ROWS: Final = 300  # ten seconds at 30 Hz; fewer hold half a motion
BATCHES_PER_EPOCH: Final = 8  # at least: where rows are few, batches shrink to keep their number
SMALLEST_BATCH: Final = 32
BLOCKS: Final = 10  # that the rows are cut into, to see when training has converged
LEFT_OUT: Final = (2, 7)  # which of them training does not see meanwhile
LONGEST: Final = 30_000  # steps of Adam until convergence, at most
PATIENCE: Final = 4_000  # steps without a better loss that are always waited for
FIRST_DECAY: Final = 0.9  # of Adam, as the next
SECOND_DECAY: Final = 0.999
EPSILON: Final = 1e-7  # the default of Keras, which the paper does not state

Floats = NDArray[np.floating]


@dataclass(eq=False, repr=False)
class NeuralNetwork(JointRegressor):
    """Fully connected network with logistic hidden units and linear outputs: peng2024, IV-B.

    Minimises Keras' loss, mean squared error plus `weight_decay` times the sum of the squared
    weights, by Adam from Keras' default start, on features and targets standardised by the
    training rows. Trains in float32, predicts in float64.

    Parameters
    ----------
    hidden_layer_sizes : sequence of int
        Units of each hidden layer.
    weight_decay : float
        Factor of the L2 penalty on the weights in the sense of Keras; biases are free.
    learning_rate : float
        Of Adam, with decay rates 0.9 and 0.999.
    batch_size : int
        Rows of a batch. Where there are fewer rows than eight such batches, a batch is an eighth of
        the rows, yet at least 32, so that few rows still get 1600 steps in 200 epochs.
    epochs : int
        Passes over the rows. 0: until convergence. Two tenths of the rows, each on end, are then
        left out until their loss has not fallen for half as many steps of Adam as it took, and
        4000, at most 30,000 in all; the network is fitted anew to all rows for the best epochs.
    random_state : int, RandomState or None
        Seeds the start and the order of the rows; None differs every time.
    rows : int, optional
        Most rows that it is fitted to, evenly spread; by default all.

    Attributes
    ----------
    weight_0_, weight_1_, ... : ndarray, shape (inputs, units)
    bias_0_, bias_1_, ... : ndarray, shape (units,)
    batch_size_ : int
        Batch that training used.
    epochs_ : int
        Epochs that it took.
    loss_curve_ : list of float
        Mean loss over the batches of each epoch, in standardised units.

    Examples
    --------
    >>> network = NeuralNetwork(hidden_layer_sizes=(8,), epochs=2)
    >>> X = np.arange(50.0)[:, None]
    >>> network.fit(X, X[:, 0]).predict([[3.0]]).shape
    (1,)
    """

    family: ClassVar[Family] = network.FAMILY
    least_rows: ClassVar[int] = MINIMUM_ROWS
    rows_per_feature: ClassVar[int] = 10
    training: ClassVar[Mapping[str, Rule]] = {"rows": optional(integer(MINIMUM_ROWS, 10**9))}
    partial: ClassVar[bool] = True
    hidden_layer_sizes: tuple[int, ...] = (100, 100)
    weight_decay: float = 5e-4
    learning_rate: float = 1e-3
    batch_size: int = 1024
    epochs: int = 200
    random_state: int | np.random.RandomState | None = 0
    rows: int | None = None

    def model_params(self) -> Params:
        """Parameters as the family knows them: once fitted, with the epochs that it took."""
        epochs = self.epochs or vars(self).get("epochs_", 0)
        return {**super().model_params(), "epochs": epochs}

    def settled(self) -> Self:
        """Unfitted network that takes the epochs which this one took.

        In an automatic choice that is the one without the first part: for the median over all
        parts, each would need a search of its own, which trains the network a second time.
        """
        return self.with_params(**self.model_params())

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        if self.rows is not None:
            spread = slice(None, None, -(-len(X) // int(self.rows)))
            X, y = X[spread], y[spread]
        arrays = scaling(X, y)
        rows = ((X - arrays["mean"]) * arrays["inverse_scale"]).astype(np.float32)
        targets = ((y - arrays["target_mean"]) / arrays["target_scale"]).astype(np.float32)
        sizes = network.layer_sizes(self.get_params(), X.shape[1], y.shape[1])
        self.epochs_ = int(self.epochs)
        if not self.epochs_:
            rng = check_random_state(self.random_state)
            layers = Layers.glorot(sizes, rng)
            self.epochs_ = self._converged(rows, targets, layers, rng, progress)
        rng = check_random_state(self.random_state)
        layers = Layers.glorot(sizes, rng)
        for epoch in self.train(layers, rows, targets, self.epochs_, rng):
            progress((epoch + 1) / self.epochs_)
        for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
            arrays |= {f"weight_{i}": weight.astype(float), f"bias_{i}": bias.astype(float)}
        return arrays

    def train(
        self, layers: Layers, X: Floats, y: Floats, epochs: int, rng: np.random.RandomState
    ) -> Iterator[int]:
        """Train in place on standardised rows, in a fresh order in each epoch; give each of them.

        Raises CalibrationError if the loss of an epoch is out of bounds.
        """
        sizes = len(layers.weights[0]), *map(len, layers.biases)
        gradient = Layers.zeros(sizes, layers.flat.dtype)
        decay, adam = float(self.weight_decay), Adam(layers.flat, float(self.learning_rate))
        self.batch_size_ = effective_batch(len(X), int(self.batch_size))
        self.loss_curve_: list[float] = []
        for epoch in range(epochs):
            order = rng.permutation(len(X))
            losses = []
            for start in range(0, len(X), self.batch_size_):
                rows = order[start : start + self.batch_size_]
                inputs, targets = (a.take(rows, axis=0, mode="clip") for a in (X, y))  # fastest
                losses.append(loss_and_gradient(layers, inputs, targets, decay, gradient))
                adam.step(gradient.flat)
            self.loss_curve_.append(float(np.mean(losses)))
            check_loss(self.loss_curve_, epochs, adam.learning_rate)
            yield epoch

    def _converged(
        self, X: Floats, y: Floats, layers: Layers, rng: np.random.RandomState, progress: Progress
    ) -> int:
        """Epochs after which the loss of the rows left out was least."""
        unseen = np.isin(np.arange(len(X)) * BLOCKS // len(X), LEFT_OUT)
        per_epoch = -(-int((~unseen).sum()) // effective_batch(len(X), int(self.batch_size)))
        longest, patience = LONGEST // per_epoch + 1, PATIENCE // per_epoch + 1
        least, best = math.inf, 1
        for epoch in self.train(layers, X[~unseen], y[~unseen], longest, rng):
            delta = forward(layers, X[unseen])[-1] - y[unseen]
            delta[np.isnan(y[unseen])] = 0.0
            loss = float(np.vdot(delta, delta))
            if loss < least:
                least, best = loss, epoch + 1
            if epoch + 1 >= best + max(patience, best // 2):
                break
            progress(0.0)
        return best


def effective_batch(n_rows: int, batch_size: int) -> int:
    """Rows of a batch: `batch_size`, or an eighth of the rows where these are few."""
    return min(batch_size, max(SMALLEST_BATCH, n_rows // BATCHES_PER_EPOCH))


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


class Adam:
    """Adam (Kingma and Ba, 2014) on one flat vector, in place."""

    def __init__(self, values: Floats, learning_rate: float) -> None:
        self._values = values.reshape(-1, copy=False)  # raises where it would be a copy
        self.learning_rate = learning_rate
        self._first, self._second = np.zeros((2, values.size), values.dtype)
        self._steps = 0

    def step(self, gradient: Floats) -> None:
        """Move the values one step down `gradient`."""
        self._steps += 1
        # With the bias corrections folded into the step and epsilon beside the uncorrected root, as
        # in section 2 of the paper on Adam, in Keras and in scikit-learn.
        first, second = FIRST_DECAY, SECOND_DECAY
        root = math.sqrt(1.0 - second**self._steps)
        rate = self.learning_rate * root / (1.0 - first**self._steps)
        factors = np.array(  # of the values' precision, which each step keeps
            [first, 1.0 - first, second, 1.0 - second, EPSILON, rate], self._values.dtype
        )
        _descend(self._values, gradient.ravel(), self._first, self._second, factors)


@compiled
def _descend(
    values: Floats, gradient: Floats, first: Floats, second: Floats, factors: Floats
) -> None:
    """Take a step of Adam: both decays, each with what is left to 1, epsilon and the rate."""
    for i in range(values.shape[0]):
        first[i] = factors[0] * first[i] + factors[1] * gradient[i]
        second[i] = factors[2] * second[i] + factors[3] * (gradient[i] * gradient[i])
        values[i] -= factors[5] * (first[i] / (np.sqrt(second[i]) + factors[4]))


def check_loss(history: list[float], epochs: int, learning_rate: float) -> None:
    """Raise CalibrationError if the loss of the last of the epochs so far is out of bounds."""
    if not math.isfinite(history[-1]):
        raise CalibrationError(
            f"training diverged in epoch {len(history)} of {epochs} at learning rate "
            f"{learning_rate:g}; lower the learning rate"
        )
