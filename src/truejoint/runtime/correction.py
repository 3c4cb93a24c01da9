"""One sample of the control loop: judged, corrected, or passed through as it is."""

from __future__ import annotations

from math import inf, isfinite, isnan, nan
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.calibration.interval import range_excess
from truejoint.compiled import compiled, copy, fill, inlined, matrix, vector
from truejoint.estimators.family import call_row
from truejoint.estimators.products import add_triangle
from truejoint.features.kernels import feature_row
from truejoint.layout import part_memory, part_numbers
from truejoint.runtime import fields as at
from truejoint.runtime.limits import BRIEFLY, RATE_STEPS, SLIP_SHARE
from truejoint.runtime.status import Status

_NOT_FINITE: Final = int(Status.NOT_FINITE)
_STALE: Final = int(Status.STALE)
_TIME_JUMP: Final = int(Status.TIME_JUMP)
_SPIKE: Final = int(Status.SPIKE)
_FROZEN: Final = int(Status.FROZEN)
_OUT_OF_RANGE: Final = int(Status.OUT_OF_RANGE)
_OUT_OF_DOMAIN: Final = int(Status.OUT_OF_DOMAIN)
_IMPLAUSIBLE: Final = int(Status.IMPLAUSIBLE)
_ZERO_SUSPECT: Final = int(Status.ZERO_SUSPECT)


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
    status = int(numbers[at.HOMING]) | int(numbers[at.SUSPECT]) | judge_finite(numbers, memory)
    if not isfinite(memory[at.T]):
        return status | _NOT_FINITE
    status |= judge_stamp(numbers, memory)
    if status & (_NOT_FINITE | _STALE):
        return status
    doubts = judge_signals(numbers, memory)
    if doubts:
        return status | doubts
    status |= judge_parity(numbers, memory)
    remember(numbers, memory)
    status |= judge_rate(numbers, memory)
    step = memory[at.T] - vector(memory, numbers[at.CLOCK], 2)[1]
    fresh = compute_features(numbers, memory)
    status |= judge_features(numbers, memory)
    predict(numbers, memory, 0.0 if fresh else float(step))
    status |= judge_correction(numbers, memory)
    if status == 0:
        put_out(numbers, memory)
    return status


@compiled
def correct_rows(
    numbers: Integers,
    memory: Array,
    t: Array,
    samples: Array,
    position: Array,
    half_width: Array,
    status: Integers,
    starts: Integers,
    beside: Array,
) -> None:
    """Correct rows one after the other, as the loop would.

    The rows are stamps `t` (n,) [s] and `samples` (n, n_signals). `position` and `half_width`
    (n, n_joints) and `status` (n,) receive what is put out, `beside` (n, k, 2) the two numbers that
    stand at each of `starts` (k,) in the memory.
    """
    n_signals, n_joints = numbers[at.N_SIGNALS], numbers[at.N_JOINTS]
    for i in range(t.shape[0]):
        memory[at.T] = t[i]
        copy(samples[i], vector(memory, numbers[at.SAMPLE], n_signals), n_signals)
        status[i] = correct_sample(numbers, memory)
        copy(vector(memory, numbers[at.POSITION], n_joints), position[i], n_joints)
        copy(vector(memory, numbers[at.HALF_WIDTH], n_joints), half_width[i], n_joints)
        for k in range(starts.shape[0]):
            copy(vector(memory, starts[k], 2), beside[i, k], 2)


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
    n = numbers[at.N_SHIFTED]
    sample, shift = vector(memory, numbers[at.SAMPLE], n), vector(memory, numbers[at.SHIFT], n)
    for i in range(n):
        sample[i] += shift[i]


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
        numbers[at.WAS_STALE] = 1
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
    memory[at.LATE] = 0.0
    forget_spikes(numbers)
    vector(memory, numbers[at.CLOCK], 2)[0] = 0.0
    restart_standstill(numbers, memory)


@compiled
def restart_standstill(numbers: Integers, memory: Array) -> None:
    """Let every signal count as having changed at the next sample, and parity as having held."""
    n = numbers[at.N_SIGNALS]
    fill(vector(memory, numbers[at.STOOD], n), n, nan)  # near nothing
    memory[at.PARITY_T] = memory[at.T]


@inlined
def forget_spikes(numbers: Integers) -> None:
    """Let no signal have jumped."""
    numbers[at.HAS_SPIKED] = 0
    for i in range(numbers[at.N_SIGNALS]):
        numbers[numbers[at.SPIKED] + i] = 0


@compiled
def judge_signals(numbers: Integers, memory: Array) -> int:
    """Status bits of signals that cannot be believed."""
    n = numbers[at.N_SIGNALS]
    sample = vector(memory, numbers[at.SAMPLE], n)
    lower = vector(memory, numbers[at.SIGNAL_LOWER], n)
    upper = vector(memory, numbers[at.SIGNAL_UPPER], n)
    last = vector(memory, numbers[at.LAST], n)
    reach = vector(memory, numbers[at.REACH], n)
    jump = vector(memory, numbers[at.JUMP], n)
    steps = steps_passed(memory)
    # No branch for each signal here: a processor cannot guess what noise decides.
    outside, far = False, False
    for i in range(n):
        outside = outside | (sample[i] < lower[i]) | (sample[i] > upper[i])
        change = abs(sample[i] - last[i])
        far = far | (change > max(jump[i], reach[i] * steps))
    if outside or (far and numbers[at.HAS_LAST]):
        return name_signals(numbers, memory)
    return judge_standstill(numbers, memory)


@inlined
def steps_passed(memory: Array) -> float:
    """Training time steps since the last used sample: at least one, unless it was much less."""
    elapsed = (memory[at.T] - memory[at.LAST_T]) / memory[at.TRAINING_DT]
    return float(min(BRIEFLY * elapsed, max(elapsed, 1.0)))


@inlined
def farthest(numbers: Integers, memory: Array, i: int) -> float:
    """How far a signal may be from the last used sample."""
    steps = steps_passed(memory)
    return float(max(memory[numbers[at.JUMP] + i], memory[numbers[at.REACH] + i] * steps))


@compiled
def name_signals(numbers: Integers, memory: Array) -> int:
    """Status bits of signals out of range or too far from the last ones, which are kept in mind."""
    status = 0
    for i in range(numbers[at.N_SIGNALS]):
        value = memory[numbers[at.SAMPLE] + i]
        outside = (
            value < memory[numbers[at.SIGNAL_LOWER] + i]
            or value > memory[numbers[at.SIGNAL_UPPER] + i]
        )
        if outside:
            status |= _OUT_OF_RANGE
        elif numbers[at.HAS_LAST] and abs(value - memory[numbers[at.LAST] + i]) > farthest(
            numbers, memory, i
        ):
            status |= _SPIKE
            numbers[numbers[at.SPIKED] + i] = 1
            numbers[at.HAS_SPIKED] = 1
    return status


@compiled
def judge_standstill(numbers: Integers, memory: Array) -> int:
    """Status bit if a signal stands still though another one says that it should not."""
    n = numbers[at.N_SIGNALS]
    sample = vector(memory, numbers[at.SAMPLE], n)
    stood = vector(memory, numbers[at.STOOD], n)
    flicker = vector(memory, numbers[at.FLICKER], n)
    low = vector(memory, numbers[at.PARTNER_LOW], n)
    high = vector(memory, numbers[at.PARTNER_HIGH], n)
    travel = vector(memory, numbers[at.TRAVEL], n)
    partner = vector(numbers, numbers[at.PARTNER], n)
    moves = vector(numbers, numbers[at.MOVES], n)
    frozen, changed = False, False
    for i in range(n):
        other = sample[partner[i]]
        # `not (a <= b)` holds for NaN too.
        moved = not (abs(sample[i] - stood[i]) <= flicker[i])
        stood[i] = sample[i] if moved else stood[i]
        low[i] = other if moved else min(low[i], other)
        high[i] = other if moved else max(high[i], other)
        frozen = frozen | (high[i] - low[i] > travel[i])
        changed = changed | (moved & (moves[i] != 0))
    if changed:
        memory[at.CHANGED_T] = memory[at.T]
    if frozen or memory[at.T] - memory[at.CHANGED_T] > memory[at.HOLD]:
        return _FROZEN
    return 0


@compiled
def judge_parity(numbers: Integers, memory: Array) -> int:
    """Status bit of positions that have slipped, or contradict what is redundant to them."""
    n_parity, n_terms = numbers[at.N_PARITY], numbers[at.N_TERMS]
    sample = vector(memory, numbers[at.SAMPLE], numbers[at.N_SIGNALS])
    terms = matrix(numbers, numbers[at.PARITY_TERMS], n_parity, n_terms)
    weights = matrix(memory, numbers[at.PARITY], n_parity, n_terms)
    intercept = vector(memory, numbers[at.PARITY_INTERCEPT], n_parity)
    shift = vector(memory, numbers[at.PARITY_SHIFT], n_parity)
    lower = vector(memory, numbers[at.PARITY_LOWER], n_parity)
    upper = vector(memory, numbers[at.PARITY_UPPER], n_parity)
    status = 0
    for i in range(n_parity):
        rest = intercept[i] - shift[i]
        for k in range(n_terms):
            rest += weights[i, k] * sample[terms[i, k]]
        if rest < lower[i] or rest > upper[i]:
            if numbers[at.ANCHOR]:
                shift[i] += rest - 0.5 * (lower[i] + upper[i])
            else:
                status = _ZERO_SUSPECT
    numbers[at.ANCHOR] = 0
    if status == 0:
        memory[at.PARITY_T] = memory[at.T]
    elif memory[at.T] - memory[at.PARITY_T] > memory[at.PATIENCE]:
        numbers[at.SUSPECT] = status
    if numbers[at.HAS_SPIKED]:
        judge_slips(numbers, memory)
    return status | int(numbers[at.SUSPECT])


@compiled
def judge_slips(numbers: Integers, memory: Array) -> None:
    """Suspect the zero of positions that jumped, and now are further off than they can be.

    Not after stale stamps: there the clock jumped.
    """
    n = numbers[at.N_SIGNALS]
    sample, last = vector(memory, numbers[at.SAMPLE], n), vector(memory, numbers[at.LAST], n)
    for i in range(n):
        if (
            numbers[numbers[at.SPIKED] + i]
            and abs(sample[i] - last[i]) > SLIP_SHARE * farthest(numbers, memory, i)
            and numbers[numbers[at.IS_POSITION_SIGNAL] + i]
            and not numbers[at.WAS_STALE]
        ):
            numbers[at.SUSPECT] = _ZERO_SUSPECT
    forget_spikes(numbers)


@compiled
def remember(numbers: Integers, memory: Array) -> None:
    """Make this sample the one that the next is compared with."""
    n = numbers[at.N_SIGNALS]
    copy(vector(memory, numbers[at.SAMPLE], n), vector(memory, numbers[at.LAST], n), n)
    numbers[at.HAS_LAST] = 1
    numbers[at.WAS_STALE] = 0
    memory[at.LAST_T] = memory[at.T]


@compiled
def judge_rate(numbers: Integers, memory: Array) -> int:
    """Status bit while most samples come late, for a model that counts them: it starts anew."""
    clock = vector(memory, numbers[at.CLOCK], 2)
    step = memory[at.T] - clock[1]
    if clock[0] == 0.0 or step > memory[at.LONGEST]:
        return 0
    late = step > memory[at.SLOWEST]
    memory[at.LATE] += ((1.0 if late else 0.0) - memory[at.LATE]) / RATE_STEPS
    if memory[at.LATE] <= 0.5:
        return 0
    if late:
        clock[0] = 0.0
    return _TIME_JUMP


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
    memory[at.EXCESS] = range_excess(
        features,
        vector(memory, numbers[at.TRAINED_LOWER], k),
        vector(memory, numbers[at.TRAINED_UPPER], k),
        vector(memory, numbers[at.PER_SPAN], k),
    )
    inside = True
    for i in range(k):
        value = features[i]
        inside = inside & (value >= lower[i]) & (value <= upper[i])  # NaN is not
        centred[i] = value - mean[i]
    status = 0 if inside else _OUT_OF_RANGE
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
        grown = 1.0 + memory[at.GROWTH] * memory[at.EXCESS] if memory[at.GROWTH] > 0.0 else 1.0
        half_width[j] = memory[numbers[at.BASE_WIDTH] + j] * grown
    if numbers[at.NEEDS_REZERO] and numbers[at.REZEROED] == 0:
        fill(half_width, n, inf)
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
    """Status bits of a correction larger than any error in training, or of a model cut off."""
    status = 0
    for j in range(numbers[at.N_JOINTS]):
        correction = memory[numbers[at.PREDICTED] + j]
        if numbers[at.IS_POSITION]:
            correction -= memory[numbers[at.POSITION] + j]
        memory[numbers[at.CORRECTION] + j] = correction
        lower = memory[numbers[at.CORRECTION_LOWER] + j]
        if not (correction >= lower and correction <= memory[numbers[at.CORRECTION_UPPER] + j]):
            status |= _IMPLAUSIBLE
        if isnan(memory[numbers[at.PREDICTED_WIDTH] + j]):
            status |= _OUT_OF_DOMAIN
    return status


@compiled
def put_out(numbers: Integers, memory: Array) -> None:
    """Put out the corrected position and its half-width."""
    for j in range(numbers[at.N_JOINTS]):
        base = 0.0 if numbers[at.IS_POSITION] else memory[numbers[at.POSITION] + j]
        predicted = base + memory[numbers[at.PREDICTED] + j]
        memory[numbers[at.POSITION] + j] = predicted + memory[numbers[at.OFFSET] + j]
        memory[numbers[at.HALF_WIDTH] + j] = memory[numbers[at.PREDICTED_WIDTH] + j]
