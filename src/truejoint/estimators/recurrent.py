"""A gated recurrent unit network, trained by truncated back-propagation through time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import check_random_state

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators import network
from truejoint.estimators.base import Arrays, Flags, JointRegressor, Progress, scaling
from truejoint.estimators.network import Floats
from truejoint.models import recurrent
from truejoint.models.family import Family, Shape

FLOOR: Final = 1e-6  # added to the mean squared error of targets of variance 1: close enough


@dataclass(eq=False, repr=False)
class RecurrentNetwork(JointRegressor):
    """Gated recurrent units (Cho et al., EMNLP 2014) that learn what a linear regression leaves.

    The gradient reaches back to the start of a window of updates; the state there is the one in
    which the epoch before left it, so that the network is fitted as it runs. Adam's rate falls
    linearly to 0. A row between two updates is predicted from the state that it would give.

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

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        known = np.asarray(np.isfinite(y).all(axis=1))
        rows, updates = step_rows(dt, known, float(self.period))
        longest = int(np.diff([*np.flatnonzero(dt[rows] == 0.0), len(rows)]).max())
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
        steps = X, y - X @ line, dt[rows, None] > 0.0, updates[:, None]
        shapes = self.family.shapes(self.model_params(), X.shape[1], y.shape[1])
        decay = float(self.weight_decay) / int(known.sum())
        weights = self._train([s.astype(np.float32) for s in steps], shapes, decay, progress)
        arrays = {name: weight.astype(np.float64) for name, weight in weights.items()}
        arrays["output_weights"][int(self.units) :] += line
        return arrays | scales

    def _train(
        self,
        steps: list[Floats],
        shapes: Mapping[str, Shape],
        decay: float,
        progress: Progress,
    ) -> dict[str, Floats]:
        rng = check_random_state(self.random_state)
        weights = {
            name: np.zeros(shape, np.float32)
            for name, shape in shapes.items()
            if name.endswith(("weights", "bias"))
        }
        for name in ("input_weights", "state_weights"):
            bound = math.sqrt(3.0 / len(weights[name]))
            weights[name][:] = rng.uniform(-bound, bound, shapes[name])
        weights["input_bias"][: int(self.units)] = 1.0  # at first, a state is kept
        n, window, epochs = len(steps[0]), int(self.window), int(self.epochs)
        size = min(int(self.batch_size), max(1, n // window // network.BATCHES_PER_EPOCH))
        adams = {name: network.Adam(weight, 0.0) for name, weight in weights.items()}
        states = np.zeros((n, int(self.units)), np.float32)
        self.loss_curve_: list[float] = []
        for epoch in range(epochs):
            starts = np.arange(-rng.randint(window), n, window)
            starts = rng.permutation(np.unique(np.clip(starts, 0, n - window)))
            losses = []
            for first in range(0, len(starts), size):
                rows = starts[first : first + size] + np.arange(window)[:, None]
                batch = [values[rows] for values in steps]
                loss, gradient, states[rows] = loss_and_gradient(
                    weights, batch, states[rows[0]], decay
                )
                losses.append(loss)
                for name, adam in adams.items():
                    done = (epoch + first / len(starts)) / epochs
                    adam.learning_rate = float(self.learning_rate) * (1.0 - done)
                    adam.step(gradient[name])
            self.loss_curve_.append(float(np.mean(losses)))
            network.check_loss(self.loss_curve_, epochs, float(self.learning_rate))
            progress((epoch + 1) / epochs)
        return weights


def loss_and_gradient(
    weights: Mapping[str, Floats],
    batch: list[Floats],
    state: Floats,
    decay: float,
) -> tuple[float, dict[str, Floats], Floats]:
    """Loss of a batch of windows, its gradient, and the states before each step.

    The mean over outputs of ``log(mean((y - f(X))**2) + FLOOR)``, but for a constant the likelihood
    of noise of unknown size, plus `decay` times the sum of the squared weights. Arrays (window,
    batch, columns) of `batch`: features; targets, NaN where unknown; whether a history goes on;
    whether the state is updated. `state` (batch, units) is that before the first step.
    """
    X, y, goes_on, updates = batch
    units = state.shape[1]
    shape = (*X.shape[:2], units)
    from_x = X @ weights["input_weights"] + weights["input_bias"]
    states, before, new, candidates, inner = np.empty((5, *shape), X.dtype)
    gates = np.empty((*X.shape[:2], 2 * units), X.dtype)
    for t in range(len(X)):
        states[t] = state
        before[t] = state * goes_on[t]
        from_state = before[t] @ weights["state_weights"]
        half = 0.5 * (from_x[t, :, : 2 * units] + from_state[:, : 2 * units])
        gates[t] = 0.5 + 0.5 * np.tanh(half)
        inner[t] = from_state[:, 2 * units :] + weights["state_bias"]
        candidates[t] = np.tanh(from_x[t, :, 2 * units :] + gates[t, :, units:] * inner[t])
        new[t] = candidates[t] + gates[t, :, :units] * (before[t] - candidates[t])
        state = before[t] + updates[t] * (new[t] - before[t])
    seen = np.concatenate([new, X], axis=2)
    known = np.isfinite(y)
    error = seen @ weights["output_weights"] + weights["output_bias"] - np.where(known, y, 0.0)
    error *= known
    count = np.maximum(known.sum(axis=(0, 1)), 1)
    square = (error * error).sum(axis=(0, 1)) / count + FLOOR
    loss = float(np.log(square).mean())
    error *= (2.0 / (count * square * len(square))).astype(X.dtype)
    d_new = error @ weights["output_weights"][:units].T
    d_from_x, d_from_state = np.empty((2, *X.shape[:2], 3 * units), X.dtype)
    d_state = np.zeros_like(state)
    for t in reversed(range(len(X))):
        d = d_new[t] + updates[t] * d_state
        keep, reset = gates[t, :, :units], gates[t, :, units:]
        drive = d * (1.0 - keep) * (1.0 - candidates[t] ** 2)
        d_gates = np.hstack([d * (before[t] - candidates[t]), drive * inner[t]])
        d_gates *= gates[t] * (1.0 - gates[t])
        d_from_x[t] = np.hstack([d_gates, drive])
        d_from_state[t] = np.hstack([d_gates, drive * reset])
        d_state = d_state - updates[t] * d_state + d * keep
        d_state = goes_on[t] * (d_state + d_from_state[t] @ weights["state_weights"].T)
    over = ([0, 1], [0, 1])
    gradient = {
        "input_weights": np.tensordot(X, d_from_x, over),
        "input_bias": d_from_x.sum(axis=(0, 1)),
        "state_weights": np.tensordot(before, d_from_state, over),
        "state_bias": d_from_state[:, :, 2 * units :].sum(axis=(0, 1)),
        "output_weights": np.tensordot(seen, error, over),
        "output_bias": error.sum(axis=(0, 1)),
    }
    for name in ("input_weights", "state_weights", "output_weights"):
        gradient[name] += 2.0 * decay * weights[name]
        loss += decay * float(np.vdot(weights[name], weights[name]))
    return loss, gradient, states


def step_rows(dt: Array, known: Flags, period: float) -> tuple[NDArray[np.int64], Flags]:
    """Rows (m,) of `dt` (n,) [s] to train on, and which of them (m,) update the state.

    Those that do and, where its target is not known, the first after one of them whose is.
    """
    kinds = np.zeros(len(dt), np.int64)
    _mark_steps(dt, known, period, kinds)
    rows = np.flatnonzero(kinds)
    return rows, kinds[rows] == 1


@compiled
def _mark_steps(dt: Array, known: Flags, period: float, kinds: NDArray[np.int64]) -> None:
    elapsed, is_waiting = 0.0, False
    for i in range(dt.shape[0]):
        elapsed += dt[i]
        if recurrent.is_update(dt[i], elapsed, period):
            kinds[i], is_waiting, elapsed = 1, not known[i], 0.0
        elif is_waiting and known[i]:
            kinds[i], is_waiting = 2, False
