"""Networks that remember, trained in numpy by back-propagation through time."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import check_random_state

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, JointRegressor, Progress, scaling
from truejoint.estimators.family import Family
from truejoint.estimators.network import recurrent, temporal_convolution
from truejoint.estimators.network.adam import Adam, check_loss
from truejoint.estimators.network.backpropagation import (
    Weights,
    convolution_gradient,
    recurrent_gradient,
)
from truejoint.estimators.network.layers import Floats
from truejoint.estimators.network.learn import BATCHES_PER_EPOCH
from truejoint.estimators.network.recurrent import GATES_OF, is_update

Gradient = Callable[[Weights, NDArray[np.int64], float], tuple[float, dict[str, Floats]]]


@dataclass(eq=False, repr=False)
class SequenceNetwork(JointRegressor):
    """Network that remembers and learns what a linear regression leaves, fitted as it runs.

    It sees one row in a period, and is trained on windows of such rows by Adam, whose rate falls
    linearly to 0. A row in between is predicted as if it were the next that it sees.
    """

    least_rows: ClassVar[int] = 1000
    rows_per_feature: ClassVar[int] = 50
    units: int = 24
    period: float = 0.02
    weight_decay: float = 50.0
    learning_rate: float = 0.01
    window: int = 64
    batch_size: int = 16
    epochs: int = 60
    random_state: int | np.random.RandomState | None = 0

    @abstractmethod
    def _gradient(self, steps: list[Floats]) -> Gradient:
        """Loss and its gradient, of weights, first steps of windows (b,), and weight decay.

        `steps` are features, targets and history of each step, as `backpropagation` has them.
        """

    def _start(self, weights: dict[str, Floats], rng: np.random.RandomState) -> None:
        """Draw the weights of which training starts, but those of the output, which are 0."""
        for name, weight in weights.items():
            if name.endswith("weights") and name != "output_weights":
                bound = math.sqrt(3.0 / weight.shape[-2])
                weight[:] = rng.uniform(-bound, bound, weight.shape)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        known = np.asarray(np.isfinite(y).all(axis=1))
        rows = step_rows(dt, known, float(self.period))
        history = np.cumsum(dt == 0.0)[rows]
        longest = int(np.bincount(history).max())
        if longest < self.window or not known[rows].any():
            raise CalibrationError(
                f"{self.name}: too few rows for a history: the longest has {longest}, at least "
                f"{self.period:g} s apart, and a window {self.window}; {known[rows].sum()} have a "
                "target: record longer without a gap, or choose a smaller window or period"
            )
        scales = scaling(X, y[known])
        X, known = (X[rows] - scales["mean"]) * scales["inverse_scale"], known[rows]
        y = (y[rows] - scales["target_mean"]) / scales["target_scale"]
        line = np.linalg.lstsq(X[known], y[known], rcond=1e-4)[0]
        steps = [s.astype(np.float32) for s in (X, y - X @ line, history[:, None])]
        shapes = self.family.shapes(self.model_params(), X.shape[1], y.shape[1])
        weights = {
            name: np.zeros(shape, np.float32)
            for name, shape in shapes.items()
            if name.endswith(("weights", "bias"))
        }
        self._train(weights, steps, float(self.weight_decay) / int(known.sum()), progress)
        arrays = {name: weight.astype(np.float64) for name, weight in weights.items()}
        arrays["output_weights"][int(self.units) :] += line
        return arrays | scales

    def _train(
        self, weights: dict[str, Floats], steps: list[Floats], decay: float, progress: Progress
    ) -> None:
        rng = check_random_state(self.random_state)
        self._start(weights, rng)
        n, window, epochs = len(steps[0]), int(self.window), int(self.epochs)
        size = min(int(self.batch_size), max(1, n // window // BATCHES_PER_EPOCH))
        adams = {name: Adam(weight, 0.0) for name, weight in weights.items()}
        gradient_of = self._gradient(steps)
        self.loss_curve_: list[float] = []
        for epoch in range(epochs):
            starts = np.arange(-rng.randint(window), n, window)
            starts = rng.permutation(np.unique(np.clip(starts, 0, n - window)))
            losses = []
            for first in range(0, len(starts), size):
                loss, gradient = gradient_of(weights, starts[first : first + size], decay)
                losses.append(loss)
                for name, adam in adams.items():
                    done = (epoch + first / len(starts)) / epochs
                    adam.learning_rate = float(self.learning_rate) * (1.0 - done)
                    adam.step(gradient[name])
            self.loss_curve_.append(float(np.mean(losses)))
            check_loss(self.loss_curve_, epochs, float(self.learning_rate))
            progress((epoch + 1) / epochs)


@dataclass(eq=False, repr=False)
class RecurrentNetwork(SequenceNetwork):
    """One layer of recurrent cells that learn what a linear regression leaves.

    Gated recurrent units (Cho et al., EMNLP 2014), or long short-term memory (Hochreiter and
    Schmidhuber, Neural Computation 9(8), 1997), by which Hwang et al. (IEEE RA-L 5(4), 2020)
    calibrate a da Vinci arm. The gradient reaches back to the start of a window of updates; the
    state there is the one in which the epoch before left it, so that the network is fitted as it
    runs. Adam's rate falls linearly to 0. A row between two updates is predicted from the state
    that it would give.

    Parameters
    ----------
    cell : {"gated_unit", "long_short_term"}
        Gated recurrent units, or long short-term memory.
    units : int
        Of the state.
    period : float
        Time between updates of the state [s]; where rows are further apart, each updates it.
    weight_decay : float
        Factor of the sum of the squared weights over the number of rows, beside the logarithm of
        the mean squared error: it means the same for any number of rows, and for any noise.
    learning_rate : float
        Of Adam at the start, with decay rates 0.9 and 0.999.
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
    >>> x = np.random.default_rng(0).normal(size=(3000, 1))
    >>> y = np.roll(x[:, 0], 1)
    >>> model = RecurrentNetwork(units=8, period=0.005, window=8).fit(x[:2000], y[:2000])
    >>> bool(model.score(x[2000:], y[2000:]) > 0.9)
    True
    """

    family: ClassVar[Family] = recurrent.FAMILY
    cell: str = "gated_unit"

    def _start(self, weights: dict[str, Floats], rng: np.random.RandomState) -> None:
        super()._start(weights, rng)
        units, is_gru = int(self.units), GATES_OF[self.cell] == 3
        kept = slice(0, units) if is_gru else slice(units, 2 * units)
        weights["input_bias"][kept] = 1.0  # at first, a state is kept

    def _gradient(self, steps: list[Floats]) -> Gradient:
        size = int(self.units) * (GATES_OF[self.cell] - 2)  # with the cells of an LSTM
        states = np.zeros((len(steps[0]), size), np.float32)

        def gradient(
            weights: Weights, starts: NDArray[np.int64], decay: float
        ) -> tuple[float, dict[str, Floats]]:
            rows = starts + np.arange(int(self.window))[:, None]
            history = steps[2][:, 0]
            goes_on = (starts > 0) & (history[starts] == history[starts - 1])
            loss, found, states[rows] = recurrent_gradient(
                weights,
                [values[rows] for values in steps],
                states[starts] * goes_on[:, None].astype(np.float32),
                decay,
            )
            return loss, found

        return gradient


@dataclass(eq=False, repr=False)
class TemporalConvolution(SequenceNetwork):
    """Dilated causal convolutions that learn what a linear regression leaves.

    Each layer sees what the one before gave now and twice as long ago as that saw, so that the last
    of n layers sees ``2**n`` updates, and adds its rectified units to it (Bai, Kolter and Koltun,
    arXiv 1803.01271). Park et al. (IEEE RA-L, 2024) calibrate a continuum manipulator by such a
    network. Windows are trained with all that they look back to.

    Parameters
    ----------
    layers : int
        That look back.
    units : int
        Of each layer.
    period : float
        Time between the rows that it sees [s]; where rows are further apart, it sees each.
    weight_decay, learning_rate, window, batch_size, epochs, random_state
        As of `RecurrentNetwork`.

    Attributes
    ----------
    loss_curve_ : list of float
        Mean loss over the batches of each epoch.

    Examples
    --------
    >>> x = np.random.default_rng(0).normal(size=(3000, 1))
    >>> y = np.roll(x[:, 0], 1)
    >>> model = TemporalConvolution(layers=2, units=8, period=0.005).fit(x[:2000], y[:2000])
    >>> bool(model.score(x[2000:], y[2000:]) > 0.9)
    True
    """

    family: ClassVar[Family] = temporal_convolution.FAMILY
    layers: int = 8
    units: int = 16
    window: int = 256
    batch_size: int = 8

    def _start(self, weights: dict[str, Floats], rng: np.random.RandomState) -> None:
        super()._start(weights, rng)
        for name in ("now_weights", "past_weights"):  # so that a sum over layers stays as large
            weights[name] *= 0.5 * math.sqrt(int(self.layers))

    def _gradient(self, steps: list[Floats]) -> Gradient:
        before = 2 ** int(self.layers) - 1

        def gradient(
            weights: Weights, starts: NDArray[np.int64], decay: float
        ) -> tuple[float, dict[str, Floats]]:
            rows = starts + np.arange(-before, int(self.window))[:, None]
            X, y, history = (values[np.maximum(rows, 0)] for values in steps)
            y[:before] = np.nan  # seen, but judged in windows of their own
            history[rows < 0] = -1.0
            return convolution_gradient(weights, [X, y, history], decay)

        return gradient


def step_rows(dt: Array, known: Flags, period: float) -> NDArray[np.int64]:
    """Rows (m,) of `dt` (n,) [s] to train on: one in a period, with a target where one has.

    Of the rows from one that a network sees to the next, the first that is `known` (n,), or else
    that one itself.
    """
    kept = np.zeros(len(dt), dtype=np.bool_)
    _mark_steps(dt, known, period, kept)
    return np.flatnonzero(kept)


@compiled
def _mark_steps(dt: Array, known: Flags, period: float, kept: Flags) -> None:
    elapsed, last, is_waiting = 0.0, 0, False
    for i in range(dt.shape[0]):
        elapsed += dt[i]
        if is_update(dt[i], elapsed, period):
            kept[i], last, is_waiting, elapsed = True, i, not known[i], 0.0
        elif is_waiting and known[i]:
            kept[i], kept[last], is_waiting = True, False, False
