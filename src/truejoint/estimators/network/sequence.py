"""Networks that remember, trained by torch on windows of rows."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import check_random_state

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, JointRegressor, Progress, scaling
from truejoint.estimators.family import Family
from truejoint.estimators.network import run as network
from truejoint.estimators.network.learn import BATCHES_PER_EPOCH, Floats, check_loss
from truejoint.estimators.network.run import is_update
from truejoint.extras import require

FLOOR: Final = 1e-6  # added to the mean squared error of targets of variance 1

Indices = NDArray[np.int64]
Tensors = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Steps:
    """Standardised rows that a network is trained on, in the order of time."""

    X: Floats  # (n, k)
    y: Floats  # (n, n_outputs), residuals of a linear regression; NaN where unknown
    first: Indices  # (n,), row at which the history of a row starts

    def windows(self, length: int, rng: np.random.RandomState) -> Indices:
        """First rows of windows, in random order, that cover each history from a random row on."""
        ends = np.append(np.unique(self.first), len(self.first))
        starts = [
            np.clip(np.arange(a - rng.randint(length), b, length), a, max(a, b - length))
            for a, b in pairwise(ends)
        ]
        return rng.permutation(np.unique(np.concatenate(starts)))

    def batch(self, starts: Indices, before: int, length: int) -> tuple[Indices, Flags]:
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


def step_rows(dt: Array, labelled: Flags, period: float) -> NDArray[np.int64]:
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
