"""The deep neural network of peng2024, IV-B, and its forward pass in float64."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from sklearn.utils import check_random_state

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, JointRegressor, Progress, scaling
from truejoint.estimators.training import Layers, train
from truejoint.models import network
from truejoint.models.family import Family

MINIMUM_ROWS: Final = 1000
"""Fewest rows for a network: half a minute at 30 Hz; fewer hold a motion or two."""
ROWS_PER_FEATURE: Final = 50
BATCHES_PER_EPOCH: Final = 8
"""With fewer rows than this many batches, batches shrink so that training keeps its steps."""
SMALLEST_BATCH: Final = 32


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
        Passes over the rows; there is no early stop.
    random_state : int, RandomState or None
        Seeds the start and the order of the rows; None differs every time.

    Attributes
    ----------
    weight_0_, weight_1_, ... : ndarray, shape (inputs, units)
    bias_0_, bias_1_, ... : ndarray, shape (units,)
    batch_size_ : int
        Batch that training used.
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
    hidden_layer_sizes: tuple[int, ...] = (100, 100)
    weight_decay: float = 5e-4
    learning_rate: float = 1e-3
    batch_size: int = 1024
    epochs: int = 200
    random_state: int | np.random.RandomState | None = 0

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        arrays = scaling(X, y)
        self.batch_size_ = effective_batch(len(X), int(self.batch_size))
        rng = check_random_state(self.random_state)
        sizes = network.layer_sizes(self.get_params(), X.shape[1], y.shape[1])
        layers = Layers.glorot(sizes, rng)
        self.loss_curve_ = train(
            layers,
            ((X - arrays["mean"]) * arrays["inverse_scale"]).astype(np.float32),
            ((y - arrays["target_mean"]) / arrays["target_scale"]).astype(np.float32),
            weight_decay=float(self.weight_decay),
            learning_rate=float(self.learning_rate),
            batch_size=self.batch_size_,
            epochs=int(self.epochs),
            rng=rng,
            progress=progress,
        )
        for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
            arrays[f"weight_{i}"] = weight.astype(np.float64)
            arrays[f"bias_{i}"] = bias.astype(np.float64)
        return arrays

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.non_deterministic = self.random_state is None
        return tags


def effective_batch(n_rows: int, batch_size: int) -> int:
    """Rows of a batch: `batch_size`, or an eighth of the rows where these are few."""
    return min(batch_size, max(SMALLEST_BATCH, n_rows // BATCHES_PER_EPOCH))
