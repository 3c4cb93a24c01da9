"""Per-sample kernels over plain arrays: features, polynomial and network.

Each ``*_row`` kernel handles one sample and allocates nothing; each ``*_rows`` kernel calls it for
every row of a recording. Offline and in the loop, the same machine code makes the same bits.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.compiled import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

VALUE: Final = 0
LAG: Final = 1
LOWPASS: Final = 2
RATE: Final = 3
PLAY: Final = 4


@compiled
def lag(length: int, fresh: bool, value: float, memory: Array) -> float:
    """Value of `length` samples ago; `memory` (length + 1,) is the next slot, then a ring."""
    if fresh:
        memory[0] = 0.0
        memory[1 : length + 1] = value
    slot = int(memory[0])
    past = memory[slot + 1]
    memory[slot + 1] = value
    memory[0] = (slot + 1) % length
    return float(past)


@compiled
def lowpass(constant: float, fresh: bool, step: float, value: float, memory: Array) -> float:
    """First-order low-pass, exact for a signal that runs straight between its samples.

    Solves ``constant * dy/dt = u - y`` over `step` [s] with u going linearly from the last value
    to `value`, so that a recording at 30 Hz and a loop at 1 kHz see nearly the same feature.
    `memory` (2,) is the output and the input of the last sample.
    """
    if fresh:
        memory[0] = value
    else:
        trail = constant * (value - memory[1]) / step
        memory[0] = value - trail + (memory[0] - memory[1] + trail) * math.exp(-step / constant)
    memory[1] = value
    return float(memory[0])


@compiled
def play(half_width: float, fresh: bool, value: float, memory: Array) -> float:
    """Play (backlash) operator: the output stands still until `value` leaves its dead band.

    `memory` (1,) is the last output. A fresh start puts the output in the middle of the band.
    """
    if fresh:
        memory[0] = value
    memory[0] = min(max(memory[0], value - half_width), value + half_width)
    return float(memory[0])


@compiled
def feature_row(
    operation: Integers,
    source: Integers,
    parameter: Array,
    slot: Integers,
    gap_limit: float,
    t: float,
    sample: Array,
    memory: Array,
    clock: Array,
    out: Array,
) -> bool:
    """Features of one sample; returns whether their history starts here.

    Parameters
    ----------
    operation, source : ndarray of int, shape (k,)
        What to do (`VALUE`, `LAG`, ...) with which signal.
    parameter : ndarray, shape (k,)
        Samples, time constant [s] or half-width [unit of the signal].
    slot : ndarray of int, shape (k,)
        Where the feature's state begins in `memory`.
    gap_limit : float
        Time without a sample [s] after which the history starts anew.
    t : float
        Time stamp [s].
    sample : ndarray, shape (n_signals,)
    memory : ndarray, shape (n_memory,)
        State, changed in place.
    clock : ndarray, shape (2,)
        Whether a sample was seen (0 or 1) and its time stamp [s]; changed in place.
    out : ndarray, shape (k,)
        Receives the features.
    """
    step = t - clock[1]
    fresh = bool(clock[0] == 0.0 or not (step > 0.0 and step <= gap_limit))
    for i in range(operation.shape[0]):
        value = sample[source[i]]
        state = memory[slot[i] :]
        if operation[i] == LAG:
            out[i] = lag(int(parameter[i]), fresh, value, state)
        elif operation[i] == LOWPASS:
            out[i] = lowpass(parameter[i], fresh, step, value, state)
        elif operation[i] == RATE:
            out[i] = (value - lowpass(parameter[i], fresh, step, value, state)) / parameter[i]
        elif operation[i] == PLAY:
            out[i] = play(parameter[i], fresh, value, state)
        else:
            out[i] = value
    clock[0] = 1.0
    clock[1] = t
    return fresh


@compiled
def feature_rows(
    operation: Integers,
    source: Integers,
    parameter: Array,
    slot: Integers,
    gap_limit: float,
    t: Array,
    samples: Array,
    memory: Array,
    out: Array,
) -> None:
    """Features `out` (n, k) of `samples` (n, n_signals) at stamps `t` (n,) [s]."""
    clock = np.zeros(2)
    for row in range(t.shape[0]):
        feature_row(
            operation, source, parameter, slot, gap_limit,
            t[row], samples[row], memory, clock, out[row],
        )  # fmt: skip


@compiled
def polynomial_row(
    x: Array,
    mean: Array,
    inverse_scale: Array,
    terms: Integers,
    coef: Array,
    intercept: Array,
    scaled: Array,
    out: Array,
) -> None:
    """Polynomial of one sample.

    Parameters
    ----------
    x, mean, inverse_scale, scaled : ndarray, shape (k,)
        Features, their scaling (0 where a feature is not used), and room for the scaled features.
    terms : ndarray of int, shape (n_terms, degree)
        Which features each term multiplies; -1 stands for the factor 1.
    coef : ndarray, shape (n_terms, n_outputs)
    intercept, out : ndarray, shape (n_outputs,)
    """
    for i in range(x.shape[0]):
        scaled[i] = (x[i] - mean[i]) * inverse_scale[i]
    for k in range(out.shape[0]):
        out[k] = intercept[k]
    for i in range(terms.shape[0]):
        product = 1.0
        for j in range(terms.shape[1]):
            if terms[i, j] >= 0:
                product *= scaled[terms[i, j]]
        for k in range(out.shape[0]):
            out[k] += product * coef[i, k]


@compiled
def polynomial_rows(
    X: Array,
    mean: Array,
    inverse_scale: Array,
    terms: Integers,
    coef: Array,
    intercept: Array,
    out: Array,
) -> None:
    """Polynomial `out` (n, n_outputs) of every row of `X` (n, k)."""
    scaled = np.empty(X.shape[1])
    for row in range(X.shape[0]):
        polynomial_row(X[row], mean, inverse_scale, terms, coef, intercept, scaled, out[row])


@compiled
def add_product(x: Array, matrix: Array, out: Array) -> None:
    """Add ``x @ matrix`` to `out`, one element of `x` after the other.

    A function of its own, in which the compiler sees that the inner loop runs along one row: it
    then handles several units at once, without changing the order of any sum.

    Parameters
    ----------
    x : ndarray, shape (n,)
    matrix : ndarray, shape (n * m,)
        Row by row.
    out : ndarray, shape (m,)
    """
    m = out.shape[0]
    for i in range(x.shape[0]):
        factor = x[i]
        for j in range(m):
            out[j] += factor * matrix[i * m + j]


@compiled
def network_row(
    x: Array,
    mean: Array,
    inverse_scale: Array,
    sizes: Integers,
    weights: Array,
    biases: Array,
    target_mean: Array,
    target_scale: Array,
    work: Array,
    out: Array,
) -> None:
    """Forward pass of one sample through layers of logistic units and a linear output.

    Parameters
    ----------
    x, mean, inverse_scale : ndarray, shape (k,)
        Features and their scaling (0 where a feature is not used).
    sizes : ndarray of int, shape (n_layers + 1,)
        Units of the input, the hidden layers and the output.
    weights : ndarray, 1-D
        All layers one after the other, each (inputs, units) in row order.
    biases : ndarray, 1-D
        All layers one after the other.
    target_mean, target_scale, out : ndarray, shape (n_outputs,)
    work : ndarray, shape (2, max(sizes))
        Room for the activations.
    """
    for i in range(sizes[0]):
        work[0, i] = (x[i] - mean[i]) * inverse_scale[i]
    weight = 0
    bias = 0
    n_layers = sizes.shape[0] - 1
    for layer in range(n_layers):
        n_inputs, n_units = sizes[layer], sizes[layer + 1]
        target = work[(layer + 1) % 2, :n_units]
        for j in range(n_units):
            target[j] = biases[bias + j]
        end = weight + n_inputs * n_units
        add_product(work[layer % 2, :n_inputs], weights[weight:end], target)
        weight = end
        bias += n_units
        if layer < n_layers - 1:
            for j in range(n_units):
                target[j] = 1.0 / (1.0 + math.exp(-target[j]))
    for k in range(out.shape[0]):
        out[k] = target_mean[k] + target_scale[k] * work[n_layers % 2, k]


@compiled
def network_rows(
    X: Array,
    mean: Array,
    inverse_scale: Array,
    sizes: Integers,
    weights: Array,
    biases: Array,
    target_mean: Array,
    target_scale: Array,
    out: Array,
) -> None:
    """Network output `out` (n, n_outputs) of every row of `X` (n, k)."""
    work = np.empty((2, np.max(sizes)))
    for row in range(X.shape[0]):
        network_row(
            X[row], mean, inverse_scale, sizes, weights, biases,
            target_mean, target_scale, work, out[row],
        )  # fmt: skip
