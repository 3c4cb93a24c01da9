"""The deep neural network of peng2024, IV-B: its training by the Keras loss, and Adam."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

import numpy as np
from sklearn.utils import check_random_state

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, JointRegressor, Progress, scaling
from truejoint.estimators.family import Family, Params, Rule, integer, optional
from truejoint.estimators.network import run as network
from truejoint.estimators.network.adam import Adam, check_loss
from truejoint.estimators.network.layers import (
    Floats,
    Layers,
    forward,
    loss_and_gradient,
)

MINIMUM_ROWS: Final = 300  # ten seconds at 30 Hz; fewer hold half a motion
ROWS_PER_FEATURE: Final = 10
BATCHES_PER_EPOCH: Final = 8  # at least: where rows are few, batches shrink to keep their number
SMALLEST_BATCH: Final = 32
BLOCKS: Final = 10  # that the rows are cut into, to see when training has converged
LEFT_OUT: Final = (2, 7)  # which of them training does not see meanwhile
LONGEST: Final = 30_000  # steps of Adam until convergence, at most
PATIENCE: Final = 4_000  # steps without a better loss that are always waited for


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
    rows_per_feature: ClassVar[int] = ROWS_PER_FEATURE
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
        self.epochs_ = int(self.epochs) or self._converged(rows, targets, sizes, progress)
        rng = check_random_state(self.random_state)
        layers = Layers.glorot(sizes, rng)
        self.train(layers, rows, targets, self.epochs_, rng, progress)
        for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
            arrays |= {f"weight_{i}": weight.astype(float), f"bias_{i}": bias.astype(float)}
        return arrays

    def train(
        self,
        layers: Layers,
        X: Floats,
        y: Floats,
        epochs: int,
        rng: np.random.RandomState,
        progress: Progress,
    ) -> None:
        """Train layers in place on standardised rows."""
        for epoch in self._epochs(layers, X, y, epochs, rng):
            progress((epoch + 1) / epochs)

    def _converged(
        self,
        X: Floats,
        y: Floats,
        sizes: tuple[int, ...],
        progress: Progress,
    ) -> int:
        """Epochs after which the loss of the rows left out was least."""
        rng = check_random_state(self.random_state)
        layers = Layers.glorot(sizes, rng)
        blocks = np.arange(len(X)) * BLOCKS // len(X)
        unseen = np.isin(blocks, LEFT_OUT)
        per_epoch = -(-int((~unseen).sum()) // effective_batch(len(X), int(self.batch_size)))
        longest, patience = LONGEST // per_epoch + 1, PATIENCE // per_epoch + 1
        least, best = math.inf, 1
        for epoch in self._epochs(layers, X[~unseen], y[~unseen], longest, rng):
            delta = forward(layers, X[unseen])[-1] - y[unseen]
            delta[np.isnan(y[unseen])] = 0.0
            loss = float(np.vdot(delta, delta))
            if loss < least:
                least, best = loss, epoch + 1
            if epoch + 1 >= best + max(patience, best // 2):
                break
            progress(0.0)
        return best

    def _epochs(
        self,
        layers: Layers,
        X: Floats,
        y: Floats,
        epochs: int,
        rng: np.random.RandomState,
    ) -> Iterator[int]:
        """Train in place, in a fresh order of the rows in each epoch; give each when it is over."""
        sizes = len(layers.weights[0]), *map(len, layers.biases)
        gradient = Layers.zeros(sizes, layers.flat.dtype)
        decay, rate = float(self.weight_decay), float(self.learning_rate)
        adam = Adam(layers.flat, rate)
        self.batch_size_ = effective_batch(len(X), int(self.batch_size))
        self.loss_curve_: list[float] = []
        for epoch in range(epochs):
            order = rng.permutation(len(X))
            losses = []
            for start in range(0, len(X), self.batch_size_):
                rows = order[start : start + self.batch_size_]
                inputs, wanted = (
                    table.take(rows, axis=0, mode="clip") for table in (X, y)
                )  # fastest
                losses.append(loss_and_gradient(layers, inputs, wanted, decay, gradient))
                adam.step(gradient.flat)
            self.loss_curve_.append(float(np.mean(losses)))
            check_loss(self.loss_curve_, epochs, rate)
            yield epoch

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.non_deterministic = self.random_state is None
        return tags


def effective_batch(n_rows: int, batch_size: int) -> int:
    """Rows of a batch: `batch_size`, or an eighth of the rows where these are few."""
    return min(batch_size, max(SMALLEST_BATCH, n_rows // BATCHES_PER_EPOCH))
