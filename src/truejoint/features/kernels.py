"""Per-sample kernels of the features.

Each ``*_row`` kernel handles one sample and allocates nothing; each ``*_rows`` kernel calls it for
every row of a recording. Offline and in the loop, the same machine code makes the same bits.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, unrolled, vector

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
        for i in range(1, length + 1):
            memory[i] = value
    slot = int(memory[0])
    past = memory[slot + 1]
    memory[slot + 1] = value
    memory[0] = (slot + 1) % length
    return float(past)


@compiled
def lowpass(constant: float, fresh: bool, dt: float, value: float, past: Array) -> float:
    """First-order low-pass, exact for a signal that runs straight between its samples.

    Solves ``constant * dy/dt = u - y`` over `dt` [s] with u going linearly from the last value
    to `value`, so that a recording at 30 Hz and a loop at 1 kHz see nearly the same feature.
    `past` (2,) is the output and the input of the last sample.
    """
    if fresh:
        past[0] = value
    else:
        trail = constant * (value - past[1]) / dt
        past[0] = value - trail + (past[0] - past[1] + trail) * math.exp(-dt / constant)
    past[1] = value
    return float(past[0])


@compiled
def play(half_width: float, fresh: bool, value: float, last: float) -> float:
    """Play (backlash) operator: the output stands still until `value` leaves its dead band.

    `last` is the last output. A fresh start puts the output in the middle of the band.
    """
    output = value if fresh else last
    return min(max(output, value - half_width), value + half_width)


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
    """Features of one sample, into `out` (k,); returns whether their history starts here.

    Each applies its `operation` (`VALUE`, `LAG`, ...) with its `parameter` (samples, time constant
    [s] or half-width) to the signal `source` of the `sample`; its state begins at `slot` of
    `memory`. `clock` (2,) is whether a sample was seen and its stamp [s]; after `gap_limit` [s] all
    starts anew.
    """
    step = t - clock[1]
    fresh = bool(clock[0] == 0.0 or not (step > 0.0 and step <= gap_limit))
    dt = float(step)
    for i in range(unrolled(operation.shape[0])):
        value = sample[source[i]]
        if operation[i] == LAG:
            length = int(parameter[i])
            out[i] = lag(length, fresh, value, vector(memory, slot[i], length + 1))
        elif operation[i] == LOWPASS:
            out[i] = lowpass(parameter[i], fresh, dt, value, vector(memory, slot[i], 2))
        elif operation[i] == RATE:
            trail = lowpass(parameter[i], fresh, dt, value, vector(memory, slot[i], 2))
            out[i] = (value - trail) / parameter[i]
        elif operation[i] == PLAY:
            last = vector(memory, slot[i], 1)
            last[0] = play(parameter[i], fresh, value, last[0])
            out[i] = last[0]
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
