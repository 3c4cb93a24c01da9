"""One sample of the control loop: judged, corrected, or passed through as it is."""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.calibration.interval import range_excess
from truejoint.compiled import compiled, copy, fill, matrix, vector
from truejoint.layout import part_memory, part_numbers
from truejoint.models.family import call_row
from truejoint.models.feature_kernels import feature_row
from truejoint.models.products import add_triangle
from truejoint.runtime import fields as at
from truejoint.runtime.status import Status

_NOT_FINITE: Final = int(Status.NOT_FINITE)
_STALE: Final = int(Status.STALE)
_TIME_JUMP: Final = int(Status.TIME_JUMP)
_SPIKE: Final = int(Status.SPIKE)
_FROZEN: Final = int(Status.FROZEN)
_OUT_OF_RANGE: Final = int(Status.OUT_OF_RANGE)
_OUT_OF_DOMAIN: Final = int(Status.OUT_OF_DOMAIN)
_IMPLAUSIBLE: Final = int(Status.IMPLAUSIBLE)


@compiled
def correct_sample(numbers: Integers, memory: Array) -> int:
    """Correct the sample that lies in the memory.

    A sample that cannot be believed (not finite, stale, spike, frozen, far out of range) enters no
    history, so that what follows is as if it had never come.

    Reads `SAMPLE` and `T` of `fields`, fills `POSITION`, `HALF_WIDTH` and `CORRECTION`, and gives
    the bits of `Status`.
    """
    pass_through(numbers, memory)
    move_signals(numbers, memory)
    status = int(numbers[at.HOMING]) | judge_finite(numbers, memory)
    if not isfinite(memory[at.T]):
        return status | _NOT_FINITE
    status |= judge_stamp(numbers, memory)
    if status & (_NOT_FINITE | _STALE):
        return status
    doubts = judge_signals(numbers, memory)
    if doubts:
        return status | doubts
    remember(numbers, memory)
    step = memory[at.T] - vector(memory, numbers[at.CLOCK], 2)[1]
    fresh = compute_features(numbers, memory)
    status |= judge_features(numbers, memory)
    predict(numbers, memory, 0.0 if fresh else float(step))
    status |= judge_correction(numbers, memory)
    if status == 0:
        put_out(numbers, memory)
    return status


@compiled
def pass_through(numbers: Integers, memory: Array) -> None:
    """Put out the measured position as it is, of unknown accuracy."""
    for j in range(numbers[at.N_JOINTS]):
        measured = memory[numbers[at.SAMPLE] + numbers[numbers[at.MEASURED] + j]]
        memory[numbers[at.POSITION] + j] = measured
        memory[numbers[at.HALF_WIDTH] + j] = inf
        memory[numbers[at.CORRECTION] + j] = nan


@compiled
def move_signals(numbers: Integers, memory: Array) -> None:
    """Add to the signals by how much their zero has moved since the training."""
    shift = vector(memory, numbers[at.SHIFT], numbers[at.N_SIGNALS])
    for i in range(numbers[at.N_SIGNALS]):
        memory[numbers[at.SAMPLE] + i] += shift[i]


@compiled
def judge_finite(numbers: Integers, memory: Array) -> int:
    """Status bit if a signal is NaN or infinite."""
    for i in range(numbers[at.N_SIGNALS]):
        if not isfinite(memory[numbers[at.SAMPLE] + i]):
            return _NOT_FINITE
    return 0


@compiled
def judge_stamp(numbers: Integers, memory: Array) -> int:
    """Status bits of the stamp; a usable one is remembered, a clock set back clears the history."""
    step = memory[at.T] - memory[at.STAMP]
    status = 0
    if numbers[at.HAS_STAMP] == 0:
        forget(numbers, memory)
    elif step < -memory[at.LONGEST]:
        forget(numbers, memory)
        status = _TIME_JUMP
    elif step < memory[at.SHORTEST]:
        return _STALE
    elif step > memory[at.LONGEST]:
        status = _TIME_JUMP
    if status:
        restart_standstill(numbers, memory)
    numbers[at.HAS_STAMP] = 1
    memory[at.STAMP] = memory[at.T]
    return status


@compiled
def forget(numbers: Integers, memory: Array) -> None:
    """Let the next sample be the first."""
    numbers[at.HAS_STAMP] = 0
    numbers[at.HAS_LAST] = 0
    vector(memory, numbers[at.CLOCK], 2)[0] = 0.0
    restart_standstill(numbers, memory)


@compiled
def restart_standstill(numbers: Integers, memory: Array) -> None:
    """Let every signal count as having changed at the next sample."""
    n = numbers[at.N_SIGNALS]
    fill(vector(memory, numbers[at.LATEST], n), n, nan)  # equal to nothing


@compiled
def judge_signals(numbers: Integers, memory: Array) -> int:
    """Status bits of signals that cannot be believed."""
    n = numbers[at.N_SIGNALS]
    sample = vector(memory, numbers[at.SAMPLE], n)
    lower = vector(memory, numbers[at.SIGNAL_LOWER], n)
    upper = vector(memory, numbers[at.SIGNAL_UPPER], n)
    last = vector(memory, numbers[at.LAST], n)
    reach = vector(memory, numbers[at.REACH], n)
    elapsed = max((memory[at.T] - memory[at.LAST_T]) / memory[at.TRAINING_DT], 1.0)
    status = 0
    for i in range(n):
        if sample[i] < lower[i] or sample[i] > upper[i]:
            status |= _OUT_OF_RANGE
        elif numbers[at.HAS_LAST] and abs(sample[i] - last[i]) > reach[i] * elapsed:
            status |= _SPIKE
    if status:
        return status
    return judge_standstill(numbers, memory)


@compiled
def watch_partner(numbers: Integers, memory: Array, i: int) -> int:
    """Status bit if the partner of a signal that stands still has moved too far since it does."""
    n = numbers[at.N_SIGNALS]
    partner = numbers[numbers[at.PARTNER] + i]
    low = vector(memory, numbers[at.PARTNER_LOW], n)
    high = vector(memory, numbers[at.PARTNER_HIGH], n)
    if numbers[numbers[at.STILL] + i] == 0:
        before = vector(memory, numbers[at.LATEST], n)[partner]
        numbers[numbers[at.STILL] + i] = 1
        low[i] = before
        high[i] = before
    other = vector(memory, numbers[at.SAMPLE], n)[partner]
    low[i] = min(low[i], other)
    high[i] = max(high[i], other)
    return _FROZEN if high[i] - low[i] > vector(memory, numbers[at.TRAVEL], n)[i] else 0


@compiled
def judge_standstill(numbers: Integers, memory: Array) -> int:
    """Status bit if a signal stands exactly still though it should not."""
    n = numbers[at.N_SIGNALS]
    sample = vector(memory, numbers[at.SAMPLE], n)
    latest = vector(memory, numbers[at.LATEST], n)
    status = 0
    for i in range(n):
        if sample[i] != latest[i]:
            numbers[numbers[at.STILL] + i] = 0
            if numbers[numbers[at.MOVES] + i]:
                memory[at.CHANGED_T] = memory[at.T]
        elif numbers[numbers[at.PARTNER] + i] >= 0:
            status |= watch_partner(numbers, memory, i)
    copy(sample, latest, n)
    if memory[at.T] - memory[at.CHANGED_T] > memory[at.HOLD]:
        status = _FROZEN
    return status


@compiled
def remember(numbers: Integers, memory: Array) -> None:
    """Make this sample the one that the next is compared with."""
    for i in range(numbers[at.N_SIGNALS]):
        memory[numbers[at.LAST] + i] = memory[numbers[at.SAMPLE] + i]
    numbers[at.HAS_LAST] = 1
    memory[at.LAST_T] = memory[at.T]


@compiled
def compute_features(numbers: Integers, memory: Array) -> bool:
    """Compute the features; returns whether their history starts here."""
    n, k = numbers[at.N_SIGNALS], numbers[at.N_FEATURES]
    size = numbers[at.CLOCK] - numbers[at.FEATURE_MEMORY]
    return feature_row(
        vector(numbers, numbers[at.OPERATION], k),
        vector(numbers, numbers[at.SOURCE], k),
        vector(memory, numbers[at.PARAMETER], k),
        vector(numbers, numbers[at.SLOT], k),
        memory[at.LONGEST],
        memory[at.T],
        vector(memory, numbers[at.SAMPLE], n),
        vector(memory, numbers[at.FEATURE_MEMORY], size),
        vector(memory, numbers[at.CLOCK], 2),
        vector(memory, numbers[at.FEATURES], k),
    )


@compiled
def judge_features(numbers: Integers, memory: Array) -> int:
    """Status bits of features unlike those of the training rows, one by one and together."""
    k = numbers[at.N_FEATURES]
    features = vector(memory, numbers[at.FEATURES], k)
    lower = vector(memory, numbers[at.FEATURE_LOWER], k)
    upper = vector(memory, numbers[at.FEATURE_UPPER], k)
    mean = vector(memory, numbers[at.MEAN], k)
    n_white = numbers[at.N_WHITE]
    centred = vector(memory, numbers[at.CENTRED], n_white)
    white = vector(memory, numbers[at.WHITE], n_white)
    status = 0
    memory[at.EXCESS] = range_excess(
        features,
        vector(memory, numbers[at.TRAINED_LOWER], k),
        vector(memory, numbers[at.TRAINED_UPPER], k),
        vector(memory, numbers[at.PER_SPAN], k),
    )
    if memory[at.EXCESS] > 0.0:
        for i in range(k):
            # `not (a and b)` holds for NaN too.
            if not (features[i] >= lower[i] and features[i] <= upper[i]):
                status = _OUT_OF_RANGE
    for i in range(k):
        centred[i] = features[i] - mean[i]
    fill(white, n_white, 0.0)
    add_triangle(centred, matrix(memory, numbers[at.WHITENING], n_white, n_white), white)
    square = 0.0
    for i in range(0, n_white, 4):
        square += (white[i] * white[i] + white[i + 1] * white[i + 1]) + (
            white[i + 2] * white[i + 2] + white[i + 3] * white[i + 3]
        )
    if not square <= memory[at.SQUARE]:
        status |= _OUT_OF_DOMAIN
    return status


@compiled
def predict(numbers: Integers, memory: Array, dt: float) -> None:
    """Predict error or position, and how far off it may be."""
    n = numbers[at.N_JOINTS]
    half_width = vector(memory, numbers[at.PREDICTED_WIDTH], n)
    for j in range(n):
        grown = 1.0 + memory[at.GROWTH] * memory[at.EXCESS]
        half_width[j] = memory[numbers[at.BASE_WIDTH] + j] * grown
    call_row(
        numbers[at.ROW],
        part_numbers(numbers, at.MODEL),
        part_memory(numbers, memory, at.MODEL),
        dt,
        vector(memory, numbers[at.FEATURES], numbers[at.N_FEATURES]),
        vector(memory, numbers[at.PREDICTED], n),
        half_width,
    )
    for j in range(n):
        memory[numbers[at.PREDICTED] + j] += memory[numbers[at.ADDED] + j]


@compiled
def judge_correction(numbers: Integers, memory: Array) -> int:
    """Status bit of a correction larger than any error in training."""
    status = 0
    for j in range(numbers[at.N_JOINTS]):
        correction = memory[numbers[at.PREDICTED] + j]
        if numbers[at.IS_POSITION]:
            correction -= memory[numbers[at.POSITION] + j]
        memory[numbers[at.CORRECTION] + j] = correction
        lower = memory[numbers[at.CORRECTION_LOWER] + j]
        if not (correction >= lower and correction <= memory[numbers[at.CORRECTION_UPPER] + j]):
            status = _IMPLAUSIBLE
    return status


@compiled
def put_out(numbers: Integers, memory: Array) -> None:
    """Put out the corrected position and its half-width."""
    for j in range(numbers[at.N_JOINTS]):
        base = 0.0 if numbers[at.IS_POSITION] else memory[numbers[at.POSITION] + j]
        predicted = base + memory[numbers[at.PREDICTED] + j]
        memory[numbers[at.POSITION] + j] = predicted + memory[numbers[at.OFFSET] + j]
        memory[numbers[at.HALF_WIDTH] + j] = memory[numbers[at.PREDICTED_WIDTH] + j]
