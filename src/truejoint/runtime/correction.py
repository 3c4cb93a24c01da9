"""One sample of the control loop: judged, corrected, or passed through as it is."""

from __future__ import annotations

from math import inf, isfinite, nan, sqrt
from typing import Final

from truejoint.calibration.interval import range_excess
from truejoint.compiled import compiled
from truejoint.filters.memory import vector
from truejoint.models import kernels
from truejoint.models.row_model import call_row
from truejoint.runtime import layout as lay
from truejoint.runtime.layout import Array, Integers
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
def correct_sample(
    numbers: Integers, memory: Array, model_numbers: Integers, model_memory: Array
) -> int:
    """Correct the sample that lies in the memory.

    A sample that cannot be believed (not finite, stale, spike, frozen, far out of range) enters no
    history, so that what follows is as if it had never come.

    Parameters
    ----------
    numbers, memory : ndarray, 1-D
        See `layout`: `SAMPLE` and `T` are read; `POSITION`, `HALF_WIDTH` and `CORRECTION` filled.
    model_numbers, model_memory : ndarray, 1-D
        Those of the `RowModel`.

    Returns
    -------
    int
        Bits of `Status`.
    """
    pass_through(numbers, memory)
    status = int(numbers[lay.HOMING]) | judge_finite(numbers, memory)
    if not isfinite(memory[lay.T]):
        return status | _NOT_FINITE
    status |= judge_stamp(numbers, memory)
    if status & (_NOT_FINITE | _STALE):
        return status
    doubts = judge_signals(numbers, memory)
    if doubts:
        return status | doubts
    remember(numbers, memory)
    step = memory[lay.T] - vector(memory, numbers[lay.CLOCK], 2)[1]
    fresh = compute_features(numbers, memory)
    status |= judge_features(numbers, memory)
    predict(numbers, memory, model_numbers, model_memory, 0.0 if fresh else step)
    status |= judge_correction(numbers, memory)
    if status == 0:
        put_out(numbers, memory)
    return status


@compiled
def pass_through(numbers: Integers, memory: Array) -> None:
    """Put out the measured position as it is, of unknown accuracy."""
    n = numbers[lay.N_JOINTS]
    sample = vector(memory, numbers[lay.SAMPLE], numbers[lay.N_SIGNALS])
    position = vector(memory, numbers[lay.POSITION], n)
    half_width = vector(memory, numbers[lay.HALF_WIDTH], n)
    correction = vector(memory, numbers[lay.CORRECTION], n)
    for j in range(n):
        position[j] = sample[numbers[numbers[lay.MEASURED] + j]]
        half_width[j] = inf
        correction[j] = nan


@compiled
def judge_finite(numbers: Integers, memory: Array) -> int:
    """Status bit if a signal is NaN or infinite."""
    n = numbers[lay.N_SIGNALS]
    sample = vector(memory, numbers[lay.SAMPLE], n)
    for i in range(n):
        if not isfinite(sample[i]):
            return _NOT_FINITE
    return 0


@compiled
def judge_stamp(numbers: Integers, memory: Array) -> int:
    """Status bits of the stamp; a usable one is remembered, a clock set back clears the history."""
    step = memory[lay.T] - memory[lay.STAMP]
    status = 0
    if numbers[lay.HAS_STAMP] == 0:
        forget(numbers, memory)
    elif step < -memory[lay.LONGEST]:
        forget(numbers, memory)
        status = _TIME_JUMP
    elif step < memory[lay.SHORTEST]:
        return _STALE
    elif step > memory[lay.LONGEST]:
        status = _TIME_JUMP
    if status:
        restart_standstill(numbers, memory)
    numbers[lay.HAS_STAMP] = 1
    memory[lay.STAMP] = memory[lay.T]
    return status


@compiled
def forget(numbers: Integers, memory: Array) -> None:
    """Let the next sample be the first."""
    numbers[lay.HAS_STAMP] = 0
    numbers[lay.HAS_REFERENCE] = 0
    vector(memory, numbers[lay.CLOCK], 2)[0] = 0.0
    restart_standstill(numbers, memory)


@compiled
def restart_standstill(numbers: Integers, memory: Array) -> None:
    """Let every signal count as having changed at the next sample."""
    n = numbers[lay.N_SIGNALS]
    latest = vector(memory, numbers[lay.LATEST], n)
    for i in range(n):
        latest[i] = nan  # equal to nothing


@compiled
def judge_signals(numbers: Integers, memory: Array) -> int:
    """Status bits of signals that cannot be believed."""
    n = numbers[lay.N_SIGNALS]
    sample = vector(memory, numbers[lay.SAMPLE], n)
    lower = vector(memory, numbers[lay.SIGNAL_LOWER], n)
    upper = vector(memory, numbers[lay.SIGNAL_UPPER], n)
    reference = vector(memory, numbers[lay.REFERENCE], n)
    reach = vector(memory, numbers[lay.REACH], n)
    elapsed = max((memory[lay.T] - memory[lay.REFERENCE_T]) / memory[lay.INTERVAL], 1.0)
    status = 0
    for i in range(n):
        if sample[i] < lower[i] or sample[i] > upper[i]:
            status |= _OUT_OF_RANGE
        elif numbers[lay.HAS_REFERENCE] and abs(sample[i] - reference[i]) > reach[i] * elapsed:
            status |= _SPIKE
    if status:
        return status
    return judge_standstill(numbers, memory)


@compiled
def judge_standstill(numbers: Integers, memory: Array) -> int:
    """Status bit if a signal stands exactly still though it should not."""
    n = numbers[lay.N_SIGNALS]
    sample = vector(memory, numbers[lay.SAMPLE], n)
    latest = vector(memory, numbers[lay.LATEST], n)
    low = vector(memory, numbers[lay.PARTNER_LOW], n)
    high = vector(memory, numbers[lay.PARTNER_HIGH], n)
    travel = vector(memory, numbers[lay.TRAVEL], n)
    partners, moves = numbers[lay.PARTNER], numbers[lay.MOVES]
    status = 0
    for i in range(n):
        partner = numbers[partners + i]
        other = sample[partner] if partner >= 0 else 0.0
        if sample[i] == latest[i]:
            low[i] = min(low[i], other)
            high[i] = max(high[i], other)
            if partner >= 0 and high[i] - low[i] > travel[i]:
                status = _FROZEN
        else:
            low[i] = other
            high[i] = other
            if numbers[moves + i]:
                memory[lay.CHANGED_T] = memory[lay.T]
        latest[i] = sample[i]
    if memory[lay.T] - memory[lay.CHANGED_T] > memory[lay.HOLD]:
        status = _FROZEN
    return status


@compiled
def remember(numbers: Integers, memory: Array) -> None:
    """Make this sample the one that the next is compared with."""
    n = numbers[lay.N_SIGNALS]
    sample = vector(memory, numbers[lay.SAMPLE], n)
    reference = vector(memory, numbers[lay.REFERENCE], n)
    for i in range(n):
        reference[i] = sample[i]
    numbers[lay.HAS_REFERENCE] = 1
    memory[lay.REFERENCE_T] = memory[lay.T]


@compiled
def compute_features(numbers: Integers, memory: Array) -> bool:
    """Compute the features; returns whether their history starts here."""
    n, k = numbers[lay.N_SIGNALS], numbers[lay.N_FEATURES]
    size = numbers[lay.CLOCK] - numbers[lay.FEATURE_MEMORY]
    return kernels.feature_row(
        vector(numbers, numbers[lay.OPERATION], k),
        vector(numbers, numbers[lay.SOURCE], k),
        vector(memory, numbers[lay.PARAMETER], k),
        vector(numbers, numbers[lay.SLOT], k),
        memory[lay.LONGEST],
        memory[lay.T],
        vector(memory, numbers[lay.SAMPLE], n),
        vector(memory, numbers[lay.FEATURE_MEMORY], size),
        vector(memory, numbers[lay.CLOCK], 2),
        vector(memory, numbers[lay.FEATURES], k),
    )


@compiled
def judge_features(numbers: Integers, memory: Array) -> int:
    """Status bits of features unlike those of the training rows, one by one and together."""
    k = numbers[lay.N_FEATURES]
    features = vector(memory, numbers[lay.FEATURES], k)
    lower = vector(memory, numbers[lay.FEATURE_LOWER], k)
    upper = vector(memory, numbers[lay.FEATURE_UPPER], k)
    mean = vector(memory, numbers[lay.MEAN], k)
    centred = vector(memory, numbers[lay.CENTRED], k)
    white = vector(memory, numbers[lay.WHITE], k)
    status = 0
    for i in range(k):
        # `not (a and b)` holds for NaN too.
        if not (features[i] >= lower[i] and features[i] <= upper[i]):
            status = _OUT_OF_RANGE
        centred[i] = features[i] - mean[i]
        white[i] = 0.0
    kernels.add_product(centred, vector(memory, numbers[lay.WHITENING], k * k), white)
    square = 0.0
    for i in range(k):
        square += white[i] * white[i]
    if not sqrt(square) <= memory[lay.DISTANCE]:
        status |= _OUT_OF_DOMAIN
    return status


@compiled
def predict(
    numbers: Integers, memory: Array, model_numbers: Integers, model_memory: Array, interval: float
) -> None:
    """Predict error or position, and how far off it may be."""
    n, k = numbers[lay.N_JOINTS], numbers[lay.N_FEATURES]
    features = vector(memory, numbers[lay.FEATURES], k)
    half_width = vector(memory, numbers[lay.PREDICTED_WIDTH], n)
    base = vector(memory, numbers[lay.BASE_WIDTH], n)
    excess = range_excess(
        features,
        vector(memory, numbers[lay.TRAINED_LOWER], k),
        vector(memory, numbers[lay.TRAINED_UPPER], k),
        vector(memory, numbers[lay.PER_SPAN], k),
    )
    for j in range(n):
        half_width[j] = base[j] * (1.0 + memory[lay.GROWTH] * excess)
    call_row(
        numbers[lay.FUNCTION],
        model_numbers,
        model_memory,
        interval,
        features,
        vector(memory, numbers[lay.PREDICTED], n),
        half_width,
    )


@compiled
def judge_correction(numbers: Integers, memory: Array) -> int:
    """Status bit of a correction larger than any error in training."""
    n = numbers[lay.N_JOINTS]
    position = vector(memory, numbers[lay.POSITION], n)
    predicted = vector(memory, numbers[lay.PREDICTED], n)
    correction = vector(memory, numbers[lay.CORRECTION], n)
    lower = vector(memory, numbers[lay.CORRECTION_LOWER], n)
    upper = vector(memory, numbers[lay.CORRECTION_UPPER], n)
    status = 0
    for j in range(n):
        correction[j] = predicted[j]
        if numbers[lay.IS_POSITION]:
            correction[j] -= position[j]
        if not (correction[j] >= lower[j] and correction[j] <= upper[j]):
            status = _IMPLAUSIBLE
    return status


@compiled
def put_out(numbers: Integers, memory: Array) -> None:
    """Put out the corrected position and its half-width."""
    n = numbers[lay.N_JOINTS]
    position = vector(memory, numbers[lay.POSITION], n)
    half_width = vector(memory, numbers[lay.HALF_WIDTH], n)
    predicted = vector(memory, numbers[lay.PREDICTED], n)
    predicted_width = vector(memory, numbers[lay.PREDICTED_WIDTH], n)
    offset = vector(memory, numbers[lay.OFFSET], n)
    for j in range(n):
        base = 0.0 if numbers[lay.IS_POSITION] else position[j]
        position[j] = (base + predicted[j]) + offset[j]
        half_width[j] = predicted_width[j]
