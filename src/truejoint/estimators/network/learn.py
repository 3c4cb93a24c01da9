"""Training of networks: of the deep one of peng2024, IV-B, and by torch of those that remember.

The deep one is trained by the Keras loss and Adam, the others on windows of rows.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, Final, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray
from sklearn.utils import check_random_state

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, JointRegressor, Progress, scaling
from truejoint.estimators.family import Family, Params, Rule, integer, optional
from truejoint.estimators.network import run as network
from truejoint.estimators.network.run import is_update
from truejoint.extras import require

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

FLOOR: Final = 1e-6  # added to the mean squared error of targets of variance 1

Floats = NDArray[np.floating]
Tensors = Mapping[str, Any]


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


@dataclass(frozen=True, eq=False)
class Steps:
    """Standardised rows that a network is trained on, in the order of time."""

    X: Floats  # (n, k)
    y: Floats  # (n, n_outputs), residuals of a linear regression; NaN where unknown
    first: Integers  # (n,), row at which the history of a row starts

    def windows(self, length: int, rng: np.random.RandomState) -> Integers:
        """First rows of windows, in random order, that cover each history from a random row on."""
        ends = np.append(np.unique(self.first), len(self.first))
        starts = [
            np.clip(np.arange(a - rng.randint(length), b, length), a, max(a, b - length))
            for a, b in pairwise(ends)
        ]
        return rng.permutation(np.unique(np.concatenate(starts)))

    def batch(self, starts: Integers, before: int, length: int) -> tuple[Integers, Flags]:
        """Rows (before + length, b) of windows, and which are of the window's history."""
        rows = starts + np.arange(-before, length)[:, None]
        within = np.clip(rows, 0, len(self.X) - 1)
        return within, (rows == within) & (self.first[within] == self.first[starts])


@dataclass(eq=False, repr=False)
class SequenceNetwork(JointRegressor):
    """Network that remembers, and learns the residuals of a linear regression.

    It sees one row in a period, and is trained on windows of such rows by Adam, whose rate falls
    linearly to 0. A row in between is predicted as if it were the next that it sees.
    """

    least_rows: ClassVar[int] = 1000
    rows_per_feature: ClassVar[int] = 50
    looks_back = 0  # rows before a window that training sees
    units: int = 24
    period: float = 0.02
    weight_decay: float = 50.0
    learning_rate: float = 0.01
    window: int = 64
    batch_size: int = 16
    epochs: int = 60
    random_state: int | np.random.RandomState | None = 0

    @abstractmethod
    def forward(self, weights: Tensors, X: Any, within: Any, state: Any) -> Any:
        """Units (rows, b, units) that the output sees beside the features, as tensors.

        `weights` by the names of the family's arrays, `X` (rows, b, k), `within` (rows, b, 1) 0
        for rows before the history, `state` (b, units) before the first row.
        """

    def _start(self, weights: dict[str, Floats], rng: np.random.RandomState) -> None:
        """Draw the weights with which training starts, but those of the output, which are 0."""
        for name, weight in weights.items():
            if name.endswith("weights") and name != "output_weights":
                bound = math.sqrt(3.0 / weight.shape[-2])
                weight[:] = rng.uniform(-bound, bound, weight.shape)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        labelled = np.asarray(np.isfinite(y).all(axis=1))
        rows = step_rows(dt, labelled, float(self.period))
        history = np.cumsum(dt == 0.0)[rows]
        longest = int(np.bincount(history).max())
        if longest < self.window or not labelled[rows].any():
            raise CalibrationError(
                f"{self.name}: too few rows for a history: the longest has {longest}, at least "
                f"{self.period:g} s apart, and a window {self.window}; {labelled[rows].sum()} have "
                "a target: record longer without a gap, or choose a smaller window or period"
            )
        scales = scaling(X, y[labelled])
        X, labelled = (X[rows] - scales["mean"]) * scales["inverse_scale"], labelled[rows]
        y = (y[rows] - scales["target_mean"]) / scales["target_scale"]
        line = np.linalg.lstsq(X[labelled], y[labelled], rcond=1e-4)[0]
        first = np.searchsorted(history, history)
        steps = Steps(X.astype(np.float32), (y - X @ line).astype(np.float32), first)
        shapes = self.family.shapes(self.model_params(), X.shape[1], y.shape[1]).items()
        learnt = {name: shape for name, shape in shapes if name.endswith(("weights", "bias"))}
        weights = {name: np.zeros(shape, np.float32) for name, shape in learnt.items()}
        self._train(weights, steps, float(self.weight_decay) / int(labelled.sum()), progress)
        arrays = {name: weight.astype(np.float64) for name, weight in weights.items()}
        arrays["output_weights"][int(self.units) :] += line
        return arrays | scales

    def _train(
        self, arrays: dict[str, Floats], steps: Steps, decay: float, progress: Progress
    ) -> None:
        """Train arrays in place, of which torch's tensors are views."""
        torch = require("torch", "torch", f"training {self.name}")
        rng = check_random_state(self.random_state)
        self._start(arrays, rng)
        weights = {n: torch.from_numpy(a).requires_grad_() for n, a in arrays.items()}
        window, epochs, before = int(self.window), int(self.epochs), self.looks_back
        n_windows = max(1, len(steps.X) // window // BATCHES_PER_EPOCH)
        size = min(int(self.batch_size), n_windows)
        adam = torch.optim.Adam(weights.values(), eps=1e-7)
        states = np.zeros((len(steps.X), int(self.units)), np.float32)
        self.loss_curve_: list[float] = []
        n_threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            for epoch in range(epochs):
                starts = steps.windows(window, rng)
                losses = []
                for place in range(0, len(starts), size):
                    some = starts[place : place + size]
                    rows, within = steps.batch(some, before, window)
                    goes_on = (some > steps.first[some])[:, None]
                    tables = steps.X[rows], within[..., None].astype(np.float32)
                    X, valid, state = map(torch.from_numpy, (*tables, states[some] * goes_on))
                    units = self.forward(weights, X, valid, state)
                    y = np.where(within[..., None], steps.y[rows], np.nan)[before:]
                    loss = loss_of(torch, weights, (units[before:], X[before:]), y, decay)
                    done = (epoch + place / len(starts)) / epochs
                    adam.param_groups[0]["lr"] = float(self.learning_rate) * (1.0 - done)
                    adam.zero_grad()
                    loss.backward()
                    adam.step()
                    losses.append(loss.item())
                    inner = within[before + 1 :]
                    states[rows[before + 1 :][inner]] = units[before:-1].detach().numpy()[inner]
                self.loss_curve_.append(float(np.mean(losses)))
                check_loss(self.loss_curve_, epochs, float(self.learning_rate))
                progress((epoch + 1) / epochs)
        finally:
            torch.set_num_threads(n_threads)


def loss_of(torch: Any, weights: Tensors, inputs: tuple[Any, Any], y: Floats, decay: float) -> Any:
    """Loss of what the output sees: the logarithm of the mean squared error, mean over outputs.

    It is but for a constant the likelihood of noise of unknown size. To it is added `decay` times
    the sum of the squared weights. `y` (rows, b, n_outputs) is NaN where it is unknown.
    """
    labelled = np.isfinite(y)
    error = torch.cat(inputs, 2) @ weights["output_weights"] + weights["output_bias"]
    error = (error - torch.from_numpy(np.where(labelled, y, 0.0))) * torch.from_numpy(labelled)
    count = torch.from_numpy(np.maximum(labelled.sum(axis=(0, 1)), 1))
    loss = torch.log(error.square().sum((0, 1)) / count + FLOOR).mean()
    return loss + decay * sum(w.square().sum() for n, w in weights.items() if n.endswith("weights"))


@dataclass(eq=False, repr=False)
class GRU(SequenceNetwork):
    """One layer of gated recurrent units that learn the residuals of a linear regression.

    Gated recurrent units are of Cho et al., EMNLP 2014; Hwang et al. (IEEE RA-L 5(4), 2020)
    calibrate a da Vinci arm by a recurrent network. The gradient reaches back to the start of a
    window of updates. The state there is the one in which the epoch before left it, so that the
    network is fitted as it runs. A row between two updates is predicted from the state that it
    would give. Training needs torch (``pip install "truejoint[torch]"``), running does not.

    Parameters
    ----------
    units : int
        Of the state.
    period : float
        Time between updates of the state [s]; where rows are further apart, each updates it.
    weight_decay : float
        Factor of the sum of the squared weights over the number of rows, beside the logarithm of
        the mean squared error: it means the same for any number of rows, and for any noise.
    learning_rate : float
        Of Adam at the start, with decay rates 0.9 and 0.999; it falls linearly to 0.
    window : int
        Updates through which an error is propagated back.
    batch_size : int
        Windows of a batch, drawn over all histories; fewer where an epoch has not eight batches.
    epochs : int
        Passes over the rows.
    random_state : int, RandomState or None
        Seeds the start and the windows; None differs every time.

    Attributes
    ----------
    loss_curve_ : list of float
        Mean loss over the batches of each epoch.

    Examples
    --------
    >>> GRU(units=8, period=0.005, window=8).name
    'gru'
    """

    family: ClassVar[Family] = network.GRU

    def _start(self, weights: dict[str, Floats], rng: np.random.RandomState) -> None:
        super()._start(weights, rng)
        weights["input_bias"][: int(self.units)] = 1.0  # at first, a state is kept

    def forward(self, weights: Tensors, X: Any, within: Any, state: Any) -> Any:
        """Units (rows, b, units), as `SequenceNetwork.forward` says."""
        torch = require("torch", "torch", f"training {self.name}")

        def in_order(columns: Any) -> Any:  # torch has the reset gate first
            keep, reset, candidate = columns.split(int(self.units), -1)
            return torch.cat([reset, keep, candidate], -1).transpose(0, -1)

        bias = weights["state_bias"]
        inner = torch.cat([torch.zeros(2 * int(self.units), dtype=bias.dtype), bias])
        outer = [in_order(weights[n]) for n in ("input_weights", "state_weights", "input_bias")]
        return torch.gru(X, state[None], (*outer, inner), True, 1, 0.0, True, False, False)[0]


@dataclass(eq=False, repr=False)
class TCN(SequenceNetwork):
    """Dilated causal convolutions that learn the residuals of a linear regression.

    Each layer sees what the one before gave now and twice as long ago as that saw, so that the last
    of n layers sees ``2**n`` updates, and adds its rectified units to it (Bai, Kolter and Koltun,
    arXiv 1803.01271). Park et al. (IEEE RA-L, 2024) calibrate a continuum manipulator by such a
    network. Windows are trained with all that they look back to, by torch.

    Parameters
    ----------
    layers : int
        That look back.
    units : int
        Of each layer.
    period : float
        Time between the rows that it sees [s]; where rows are further apart, it sees each.
    weight_decay, learning_rate, window, batch_size, epochs, random_state
        As of `GRU`.

    Attributes
    ----------
    loss_curve_ : list of float
        Mean loss over the batches of each epoch.

    Examples
    --------
    >>> TCN(layers=2, units=8, period=0.005).name
    'tcn'
    """

    family: ClassVar[Family] = network.TCN
    layers: int = 8
    units: int = 16
    window: int = 256
    batch_size: int = 8

    @property
    def looks_back(self) -> int:  # type: ignore[override]  # by a parameter
        """Rows before a window that training sees."""
        return int(2 ** int(self.layers)) - 1

    def _start(self, weights: dict[str, Floats], rng: np.random.RandomState) -> None:
        super()._start(weights, rng)
        for name in ("now_weights", "past_weights"):  # so that a sum over layers stays as large
            weights[name] *= 0.5 * math.sqrt(int(self.layers))

    def forward(self, weights: Tensors, X: Any, within: Any, state: Any) -> Any:
        """Units (rows, b, units), as `SequenceNetwork.forward` says; there is no state."""
        torch = require("torch", "torch", f"training {self.name}")
        hidden = (X @ weights["input_weights"] + weights["input_bias"]) * within
        squares = (weights[name].split(int(self.units)) for name in ("now_weights", "past_weights"))
        for i, (now, past) in enumerate(zip(*squares, strict=True)):
            ago = torch.cat([torch.zeros_like(hidden[: 2**i]), hidden[: -(2**i)]])
            units = hidden @ now + ago @ past + weights["layer_bias"][i]
            hidden = (hidden + units.relu()) * within
        return hidden


def step_rows(dt: Array, labelled: Flags, period: float) -> Integers:
    """Rows (m,) of `dt` (n,) [s] to train on: one in a period, with a target where one has.

    Of the rows from one that a network sees to the next, the first that is `labelled` (n,), or else
    that one itself.
    """
    is_step = np.zeros(len(dt), dtype=np.bool_)
    _mark_steps(dt, labelled, period, is_step)
    return np.flatnonzero(is_step)


@compiled
def _mark_steps(dt: Array, labelled: Flags, period: float, is_step: Flags) -> None:
    elapsed, last, is_waiting = 0.0, 0, False
    for i in range(dt.shape[0]):
        elapsed += dt[i]
        if is_update(dt[i], elapsed, period):
            is_step[i], last, is_waiting, elapsed = True, i, not labelled[i], 0.0
        elif is_waiting and labelled[i]:
            is_step[i], is_step[last], is_waiting = True, False, False
