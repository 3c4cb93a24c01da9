"""Training of networks: of the deep one of peng2024, IV-B, and by torch of those that remember.

The deep one is trained by the Keras loss and Adam, the others on windows of rows.
"""

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, Final, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray
from sklearn.utils import check_random_state

from truejoint.array_types import Array, Integers, Mask
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, JointRegressor, Progress, scaling
from truejoint.estimators.family import Family
from truejoint.estimators.network import run as network
from truejoint.estimators.network.run import is_update
from truejoint.extras import require

MINIMUM_ROWS: Final = 300  # ten seconds at 30 Hz; fewer hold half a motion
BATCHES_PER_EPOCH: Final = 8  # at least: where rows are few, batches shrink to keep their number
SMALLEST_BATCH: Final = 32
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
    weights, by Adam from Keras' default start. Features and targets are standardised by the
    training rows. Trains in float32, predicts in float64.

    Parameters
    ----------
    hidden_layer_sizes : sequence of int
        Units of each hidden layer.
    weight_decay : float
        Factor of the L2 penalty on the weights in the sense of Keras; biases are free.
    learning_rate : float
        Rate of Adam, with decay rates 0.9 and 0.999.
    batch_size : int
        Rows of a batch. If there are fewer rows than eight such batches, a batch is an eighth of
        the rows, yet at least 32.
    epochs : int
        Passes over the rows.
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
    rows_per_feature: ClassVar[int] = 10
    partial: ClassVar[bool] = True
    hidden_layer_sizes: tuple[int, ...] = (100, 100)
    weight_decay: float = 5e-4
    learning_rate: float = 1e-3
    batch_size: int = 1024
    epochs: int = 200
    random_state: int | np.random.RandomState | None = 0

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        arrays = scaling(X, y)
        rows = ((X - arrays["mean"]) * arrays["inverse_scale"]).astype(np.float32)
        targets = ((y - arrays["target_mean"]) / arrays["target_scale"]).astype(np.float32)
        sizes = network.layer_sizes(self.get_params(), X.shape[1], y.shape[1])
        rng, epochs = check_random_state(self.random_state), int(self.epochs)
        layers = Layers(sizes).drawn(rng)
        for epoch in self.train(layers, rows, targets, epochs, rng):
            progress((epoch + 1) / epochs)
        for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
            arrays |= {f"weight_{i}": weight.astype(float), f"bias_{i}": bias.astype(float)}
        return arrays

    def train(
        self, layers: "Layers", X: Floats, y: Floats, epochs: int, rng: np.random.RandomState
    ) -> Iterator[int]:
        """Train in place on standardised rows, in a fresh order in each epoch; give each of them.

        Raises CalibrationError if the loss of an epoch is out of bounds.
        """
        gradient = Layers((len(layers.weights[0]), *map(len, layers.biases)), layers.flat.dtype)
        decay, rate = float(self.weight_decay), float(self.learning_rate)
        moments, n_steps = np.zeros((2, layers.flat.size), layers.flat.dtype), 0
        self.batch_size_ = effective_batch(len(X), int(self.batch_size))
        self.loss_curve_: list[float] = []
        for epoch in range(epochs):
            order = rng.permutation(len(X))
            losses = []
            for start in range(0, len(X), self.batch_size_):
                rows = order[start : start + self.batch_size_]
                inputs, targets = (a.take(rows, axis=0, mode="clip") for a in (X, y))  # fastest
                losses.append(loss_and_gradient(layers, inputs, targets, decay, gradient))
                n_steps += 1
                adam_step(layers.flat, gradient.flat, moments, n_steps, rate)
            add_loss(self.loss_curve_, losses, epochs, rate)
            yield epoch


def effective_batch(n_rows: int, batch_size: int) -> int:
    """Rows of a batch: `batch_size`, or an eighth of the rows where these are few."""
    return min(batch_size, max(SMALLEST_BATCH, n_rows // BATCHES_PER_EPOCH))


class Layers:
    """Weights and biases of a network, 0 at first, as views into one flat vector.

    `sizes` are inputs, hidden units and outputs.
    """

    def __init__(self, sizes: Sequence[int], dtype: DTypeLike = np.float32) -> None:
        ends = np.cumsum([n for k, units in pairwise(sizes) for n in (k * units, units)])
        self.flat: Floats = np.zeros(ends[-1], dtype)
        parts: list[Floats] = np.split(self.flat, ends[:-1])
        self.biases = parts[1::2]  # (units,)
        self.weights = [  # (inputs, units)
            weight.reshape(-1, len(bias))
            for weight, bias in zip(parts[::2], self.biases, strict=True)
        ]

    def drawn(self, rng: np.random.RandomState) -> Self:
        """Start as Keras does: uniform within sqrt(6 / (inputs + units)), zero biases."""
        for weight in self.weights:
            bound = math.sqrt(6.0 / sum(weight.shape))
            weight[:] = rng.uniform(-bound, bound, weight.shape)
        return self


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
    with np.errstate(over="ignore"):  # exp(-x) of a unit that is 0
        for layer, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
            units = activations[-1] @ weight
            units += bias
            if layer < len(layers.weights) - 1:  # numpy's exp takes half as long as its tanh
                np.exp(np.negative(units, out=units), out=units)
                np.reciprocal(np.add(units, 1.0, out=units), out=units)
            activations.append(units)
    return activations


def adam_step(
    values: Floats, gradient: Floats, moments: Floats, n_steps: int, learning_rate: float
) -> None:
    """Move flat `values` down `gradient` by Adam (Kingma and Ba, 2014), in place.

    The bias corrections are folded into the step and epsilon is beside the uncorrected root, as in
    section 2 of the paper, in Keras and in scikit-learn. `n_steps` counts this step.
    """
    first, second = FIRST_DECAY, SECOND_DECAY
    rate = learning_rate * math.sqrt(1.0 - second**n_steps) / (1.0 - first**n_steps)
    factors = first, 1.0 - first, second, 1.0 - second, EPSILON, rate
    _descend(values, gradient, moments[0], moments[1], np.array(factors, values.dtype))


@compiled
def _descend(
    values: Floats, gradient: Floats, first: Floats, second: Floats, factors: Floats
) -> None:
    """Take a step of Adam: both decays, each with what is left to 1, epsilon and the rate."""
    for i in range(values.shape[0]):
        first[i] = factors[0] * first[i] + factors[1] * gradient[i]
        second[i] = factors[2] * second[i] + factors[3] * (gradient[i] * gradient[i])
        values[i] -= factors[5] * (first[i] / (np.sqrt(second[i]) + factors[4]))


def add_loss(curve: list[float], losses: list[float], epochs: int, learning_rate: float) -> None:
    """Add the mean loss of an epoch; raises CalibrationError if it is out of bounds."""
    curve.append(float(np.mean(losses)))
    if not math.isfinite(curve[-1]):
        raise CalibrationError(
            f"training diverged in epoch {len(curve)} of {epochs} at learning rate "
            f"{learning_rate:g}; lower the learning rate"
        )


def windows(first: Integers, length: int, rng: np.random.RandomState) -> Integers:
    """First rows of windows, in random order, that cover each history from a random row on.

    `first` (n,) is the row at which the history of each row starts.
    """
    ends = np.append(np.unique(first), len(first))
    starts = [
        np.clip(np.arange(a - rng.randint(length), b, length), a, max(a, b - length))
        for a, b in pairwise(ends)
    ]
    return rng.permutation(np.unique(np.concatenate(starts)))


def window_rows(
    first: Integers, starts: Integers, before: int, length: int
) -> tuple[Integers, Mask]:
    """Rows (before + length, b) of windows, and which are of the window's history."""
    rows = starts + np.arange(-before, length)[:, None]
    within = np.clip(rows, 0, len(first) - 1)
    return within, (rows == within) & (first[within] == first[starts])


@dataclass(eq=False, repr=False)
class SequenceNetwork(JointRegressor):
    """Network that remembers, and learns the residuals of a linear regression.

    It sees one row in a period, and is trained on windows of such rows by Adam, whose rate falls
    linearly to 0. A row in between is predicted as if it were the next that it sees.

    Attributes
    ----------
    loss_curve_ : list of float
        Mean loss over the batches of each epoch.
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
        steps = X.astype(np.float32), (y - X @ line).astype(np.float32), first
        shapes = self.family.shapes(self.model_params(), X.shape[1], y.shape[1]).items()
        learnt = {name: shape for name, shape in shapes if name.endswith(("weights", "bias"))}
        weights = {name: np.zeros(shape, np.float32) for name, shape in learnt.items()}
        self._train(weights, steps, float(self.weight_decay) / int(labelled.sum()), progress)
        arrays = {name: weight.astype(np.float64) for name, weight in weights.items()}
        arrays["output_weights"][int(self.units) :] += line
        return arrays | scales

    def _train(
        self,
        arrays: dict[str, Floats],
        steps: tuple[Floats, Floats, Integers],
        decay: float,
        progress: Progress,
    ) -> None:
        """Train arrays in place, of which torch's tensors are views.

        `steps` are features, residuals of a linear regression (NaN where unknown), and the row at
        which the history of each row starts.
        """
        torch = require("torch", "torch", f"training {self.name}")
        rng = check_random_state(self.random_state)
        self._start(arrays, rng)
        weights = {n: torch.from_numpy(a).requires_grad_() for n, a in arrays.items()}
        features, residuals, first = steps
        window, epochs, before = int(self.window), int(self.epochs), self.looks_back
        n_windows = max(1, len(first) // window // BATCHES_PER_EPOCH)
        size = min(int(self.batch_size), n_windows)
        adam = torch.optim.Adam(weights.values(), eps=EPSILON)
        states = np.zeros((len(first), int(self.units)), np.float32)
        self.loss_curve_: list[float] = []
        n_threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            for epoch in range(epochs):
                starts = windows(first, window, rng)
                losses = []
                for place in range(0, len(starts), size):
                    some = starts[place : place + size]
                    rows, within = window_rows(first, some, before, window)
                    goes_on = (some > first[some])[:, None]
                    tables = features[rows], within[..., None].astype(np.float32)
                    X, valid, state = map(torch.from_numpy, (*tables, states[some] * goes_on))
                    units = self.forward(weights, X, valid, state)
                    y = np.where(within[..., None], residuals[rows], np.nan)[before:]
                    loss = loss_of(torch, weights, (units[before:], X[before:]), y, decay)
                    done = (epoch + place / len(starts)) / epochs
                    adam.param_groups[0]["lr"] = float(self.learning_rate) * (1.0 - done)
                    adam.zero_grad()
                    loss.backward()
                    adam.step()
                    losses.append(loss.item())
                    inner = within[before + 1 :]
                    states[rows[before + 1 :][inner]] = units[before:-1].detach().numpy()[inner]
                add_loss(self.loss_curve_, losses, epochs, float(self.learning_rate))
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
        Size of the state.
    period : float
        Time between updates of the state [s]; where rows are further apart, each updates it.
    weight_decay : float
        Factor of the sum of the squared weights over the number of rows, beside the logarithm of
        the mean squared error: it means the same for any number of rows, and for any noise.
    learning_rate : float
        Rate of Adam at the start, with decay rates 0.9 and 0.999; it falls linearly to 0.
    window : int
        Updates through which an error is propagated back.
    batch_size : int
        Windows of a batch, drawn over all histories; fewer where an epoch has not eight batches.
    epochs : int
        Passes over the rows.
    random_state : int, RandomState or None
        Seeds the start and the windows; None differs every time.

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

    Each layer sees the output of the one before now and twice as long ago as that saw. The last
    of n layers sees ``2**n`` updates, and adds its rectified units to it (Bai, Kolter and Koltun,
    arXiv 1803.01271). Park et al. (IEEE RA-L, 2024) calibrate a continuum manipulator by such a
    network. Windows are trained with all that they look back to, by torch.

    Parameters
    ----------
    layers : int
        Layers that look back.
    units : int
        Units of each layer.
    period : float
        Time between the rows that it sees [s]; where rows are further apart, it sees each.
    weight_decay, learning_rate, window, batch_size, epochs, random_state
        As of `GRU`.

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


@compiled
def step_rows(dt: Array, labelled: Mask, period: float) -> Integers:
    """Rows (m,) of `dt` (n,) [s] to train on: one in a period, with a target where one has.

    Of the rows from one that a network sees to the next, the first that is `labelled` (n,), or else
    that one itself.
    """
    is_step = np.zeros(len(dt), np.bool_)
    elapsed, last, is_waiting = 0.0, 0, False
    for i in range(len(dt)):
        elapsed += dt[i]
        if is_update(dt[i], elapsed, period):
            is_step[i], last, is_waiting, elapsed = True, i, not labelled[i], 0.0
        elif is_waiting and labelled[i]:
            is_step[i], is_step[last], is_waiting = True, False, False
    return np.flatnonzero(is_step)
