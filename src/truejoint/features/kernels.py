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
DELAY: Final = 5
TRAIL: Final = 6

POINTS: Final = 32  # that a memory of a time or a way keeps, however fast the samples come
RECALL_MEMORY: Final = 1 + 2 * POINTS
TRAIL_MEMORY: Final = 1 + RECALL_MEMORY
_GAPS: Final = float(POINTS - 2)


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
    kept = value if fresh else last
    return min(max(kept, value - half_width), value + half_width)


@compiled
def recall(length: float, fresh: bool, moved: float, value: float, memory: Array) -> float:
    """Value of `length` ago on an axis on which this sample is `moved` ahead of the last.

    Between the points that are kept, at least ``length / _GAPS`` apart, it runs straight. `memory`
    (`RECALL_MEMORY`,) is the newest slot, then how far each point lies back (negative), then their
    values.
    """
    slot = int(memory[0])
    if fresh:
        for i in range(POINTS):
            memory[1 + i] = 0.0
            memory[1 + POINTS + i] = value
    else:
        for i in range(POINTS):
            memory[1 + i] = memory[1 + i] - moved
    before = (slot + POINTS - 1) % POINTS
    if memory[1 + slot] - memory[1 + before] >= length / _GAPS:
        slot = (slot + 1) % POINTS
        memory[0] = slot
    memory[1 + slot] = 0.0
    memory[1 + POINTS + slot] = value
    newer = slot
    for _i in range(POINTS - 1):
        older = (newer + POINTS - 1) % POINTS
        if memory[1 + older] <= -length:
            late = memory[1 + newer] + length
            share = late / (memory[1 + newer] - memory[1 + older])
            last = memory[1 + POINTS + newer]
            return float(last - share * (last - memory[1 + POINTS + older]))
        newer = older
    return float(memory[1 + POINTS + newer])


@compiled
def recall_way(length: float, fresh: bool, value: float, memory: Array) -> float:
    """Where the signal was a way of `length` ago, but for a play that noise does not get through.

    `memory` (`TRAIL_MEMORY`,) is the output of that play, then that of `recall`.
    """
    last = memory[0]
    memory[0] = play(length / (2.0 * _GAPS), fresh, value, last)
    moved = abs(memory[0] - last)
    return float(recall(length, fresh, moved, memory[0], vector(memory, 1, RECALL_MEMORY)))


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
        elif operation[i] == DELAY:
            past = vector(memory, slot[i], RECALL_MEMORY)
            out[i] = recall(parameter[i], fresh, dt, value, past)
        elif operation[i] == TRAIL:
            way = vector(memory, slot[i], TRAIL_MEMORY)
            out[i] = recall_way(parameter[i], fresh, value, way)
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
