"""Loss of networks that remember, and its gradient through time.

Arrays (window, batch, columns) of a batch: features; targets, NaN where unknown; number of the
history that a row is of. The loss is the mean over outputs of ``log(mean((y - f(X))**2) + FLOOR)``,
but for a constant the likelihood of noise of unknown size, plus `decay` times the sum of the
squared weights.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.estimators.network.layers import Floats

FLOOR: Final = 1e-6  # added to the mean squared error of targets of variance 1: close enough

Weights = Mapping[str, Floats]
_TIMES: Final = ([0, 1], [0, 1])  # window and batch, over which products are summed


def recurrent_gradient(
    weights: Weights, batch: list[Floats], state: Floats, decay: float
) -> tuple[float, dict[str, Floats], Floats]:
    """Loss of a recurrent network on a batch of windows, its gradient, and states before each row.

    `state` (batch, units) of gated recurrent units, with (batch, 2 units) of long short-term memory
    the cells behind it, is that before the first row; the gradient goes no further back.
    """
    X, y, history = batch
    units = len(weights["state_weights"])
    forward, backward = (
        (_gru_forward, _gru_backward)
        if state.shape[1] == units
        else (_lstm_forward, _lstm_backward)
    )
    goes_on = np.ones((*X.shape[:2], 1), X.dtype)
    goes_on[1:] = history[1:] == history[:-1]
    from_x = X @ weights["input_weights"] + weights["input_bias"]
    states, before, new = np.empty((3, *X.shape[:2], state.shape[1]), X.dtype)
    kept = []
    bias = np.zeros(from_x.shape[2], X.dtype)
    if "state_bias" in weights:
        bias[-units:] = weights["state_bias"]
    for t in range(len(X)):
        states[t] = state
        before[t] = state * goes_on[t]
        from_state = before[t][:, :units] @ weights["state_weights"] + bias
        state, saved = forward(from_x[t], from_state, before[t])
        new[t] = state
        kept.append(saved)
    loss, d_seen, gradient = _output_gradient(weights, new[:, :, :units], X, y)
    d_from_x, d_from_state = np.empty((2, *from_x.shape), X.dtype)
    d_state = np.zeros_like(state)
    for t in reversed(range(len(X))):
        d_state[:, :units] += d_seen[t]
        d_from_x[t], d_from_state[t], d_before = backward(d_state, before[t], kept[t])
        d_before[:, :units] += d_from_state[t] @ weights["state_weights"].T
        d_state = goes_on[t] * d_before
    gradient |= {
        "input_weights": np.tensordot(X, d_from_x, _TIMES),
        "input_bias": d_from_x.sum(axis=(0, 1)),
        "state_weights": np.tensordot(before[:, :, :units], d_from_state, _TIMES),
    }
    if "state_bias" in weights:
        gradient["state_bias"] = d_from_state[:, :, -units:].sum(axis=(0, 1))
    return loss + penalise(weights, gradient, decay), gradient, states


def convolution_gradient(
    weights: Weights, batch: list[Floats], decay: float
) -> tuple[float, dict[str, Floats]]:
    """Loss of a temporal convolution network on a batch of windows, and its gradient."""
    X, y, history = batch
    n, units = weights["layer_bias"].shape
    now, past = (weights[name].reshape(n, units, units) for name in ("now_weights", "past_weights"))
    goes_on = [(history[2**i :] == history[: -(2**i)]).astype(X.dtype) for i in range(n)]
    given = X @ weights["input_weights"] + weights["input_bias"]
    kept = []
    for i, (own, other, bias) in enumerate(zip(now, past, weights["layer_bias"], strict=True)):
        back = np.zeros_like(given)
        back[2**i :] = given[: -(2**i)] * goes_on[i]
        rectified = np.maximum(given @ own + back @ other + bias, 0.0)
        kept.append((given, back, rectified > 0.0))
        given = given + rectified
    loss, d_given, gradient = _output_gradient(weights, given, X, y)
    by_now, by_past, by_bias = (
        np.zeros_like(now),
        np.zeros_like(past),
        np.zeros((n, units), X.dtype),
    )
    for i in reversed(range(n)):
        given, back, is_on = kept[i]
        d_units = d_given * is_on
        by_now[i] = np.tensordot(given, d_units, _TIMES)
        by_past[i] = np.tensordot(back, d_units, _TIMES)
        by_bias[i] = d_units.sum(axis=(0, 1))
        d_back = d_units @ past[i].T
        d_given = d_given + d_units @ now[i].T
        d_given[: -(2**i)] += d_back[2**i :] * goes_on[i]
    gradient |= {
        "input_weights": np.tensordot(X, d_given, _TIMES),
        "input_bias": d_given.sum(axis=(0, 1)),
        "now_weights": by_now.reshape(-1, units),
        "past_weights": by_past.reshape(-1, units),
        "layer_bias": by_bias,
    }
    return loss + penalise(weights, gradient, decay), gradient


def _output_gradient(
    weights: Weights, units: Floats, X: Floats, y: Floats
) -> tuple[float, Floats, dict[str, Floats]]:
    """Loss by the output layer on what it sees, its slope by the units, and by its own weights."""
    seen = np.concatenate([units, X], axis=2)
    known = np.isfinite(y)
    error = seen @ weights["output_weights"] + weights["output_bias"] - np.where(known, y, 0.0)
    error *= known
    count = np.maximum(known.sum(axis=(0, 1)), 1)
    square = (error * error).sum(axis=(0, 1)) / count + FLOOR
    error *= (2.0 / (count * square * len(square))).astype(X.dtype)
    gradient = {
        "output_weights": np.tensordot(seen, error, _TIMES),
        "output_bias": error.sum(axis=(0, 1)),
    }
    by_units = error @ weights["output_weights"][: units.shape[2]].T
    return float(np.log(square).mean()), by_units, gradient


def penalise(weights: Weights, gradient: dict[str, Floats], decay: float) -> float:
    """Give the penalty on the weights, biases free, and add its gradient."""
    loss = 0.0
    for name, weight in weights.items():
        if name.endswith("weights"):
            gradient[name] += 2.0 * decay * weight
            loss += decay * float(np.vdot(weight, weight))
    return loss


def _logistic(values: Floats) -> Floats:
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * values))


Saved = tuple[Floats, ...]


def _gru_forward(from_x: Floats, from_state: Floats, before: Floats) -> tuple[Floats, Saved]:
    units = before.shape[1]
    gates = _logistic(from_x[:, : 2 * units] + from_state[:, : 2 * units])
    inner = from_state[:, 2 * units :]
    candidate = np.tanh(from_x[:, 2 * units :] + gates[:, units:] * inner)
    return candidate + gates[:, :units] * (before - candidate), (gates, candidate, inner)


def _gru_backward(d: Floats, before: Floats, saved: Saved) -> tuple[Floats, Floats, Floats]:
    gates, candidate, inner = saved
    keep, reset = np.hsplit(gates, 2)
    drive = d * (1.0 - keep) * (1.0 - candidate**2)
    d_gates = np.hstack([d * (before - candidate), drive * inner]) * gates * (1.0 - gates)
    return np.hstack([d_gates, drive]), np.hstack([d_gates, drive * reset]), d * keep


def _lstm_forward(from_x: Floats, from_state: Floats, before: Floats) -> tuple[Floats, Saved]:
    units = before.shape[1] // 2
    both = from_x + from_state
    gates, candidate = _logistic(both[:, : 3 * units]), np.tanh(both[:, 3 * units :])
    take, keep, give = np.hsplit(gates, 3)
    cell = keep * before[:, units:] + take * candidate
    told = np.tanh(cell)
    return np.hstack([give * told, cell]), (gates, candidate, told)


def _lstm_backward(d: Floats, before: Floats, saved: Saved) -> tuple[Floats, Floats, Floats]:
    gates, candidate, told = saved
    take, keep, give = np.hsplit(gates, 3)
    d_state, d_cell = np.hsplit(d, 2)
    d_cell = d_cell + d_state * give * (1.0 - told**2)
    old = np.hsplit(before, 2)[1]
    d_gates = np.hstack([d_cell * candidate, d_cell * old, d_state * told]) * gates * (1.0 - gates)
    d_both = np.hstack([d_gates, d_cell * take * (1.0 - candidate**2)])
    return d_both, d_both, np.hstack([np.zeros_like(d_state), d_cell * keep])
