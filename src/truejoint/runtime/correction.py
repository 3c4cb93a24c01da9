"""One sample of the control loop: judged, and put out with a correction that does not leap.

And what a corrector is told between samples: the homing, an offset, that the zero is right.
"""

from math import inf, isfinite, isnan, nan
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.calibration import conditions as seen
from truejoint.calibration.conditions import follow_motion, swing_cell
from truejoint.calibration.interval import range_excess
from truejoint.compiled import compiled, copy, fill, inlined, vector
from truejoint.estimators.family import call_row
from truejoint.features.feature_set import feature_row
from truejoint.layout import part_memory, part_numbers
from truejoint.products import add_triangle
from truejoint.runtime import fields as at
from truejoint.runtime.fields import unpack
from truejoint.runtime.limits import AT_ONCE, BRIEFLY, RATE_STEPS, SHORTEST_STEP, SLIP_SHARE
from truejoint.runtime.status import Status, Unlearnt

MANY_LATE: Final = 10
"""Samples in a row with no newer stamp that a network is taken to have doubled or delayed."""
SET_BACK: Final = 0.5
"""Time by which a stamp is older than the newest one at least where the clock was set back [s]."""
LONGEST_MOVE: Final = 0.1
"""Time for which the correction moves at most between two samples [s]: a gap is no leap either."""


@compiled
def correct_sample(numbers: Integers, memory: Array) -> int:
    """Correct the sample that lies in the memory.

    A sample that cannot be believed (not finite, stale, spike, frozen, far out of range) enters no
    history, so that what follows is as if it had never come. A message that comes twice or late is
    normal on a network: it is put out with the last correction.

    Reads ``sample`` and ``t`` of `fields`, fills ``position``, ``half_width`` and ``correction``,
    and gives the bits of `Status`.
    """
    m = unpack(numbers, memory)
    status = int(m.homing) | int(m.suspect) | take_in(numbers, memory)
    if status == 0 and is_late(numbers, memory):
        for j in range(m.n_joints):
            m.position[j] = m.reported[j] + m.applied[j]
            m.correction[j] = nan
        return 0
    status = judge(numbers, memory, status)
    put_out(numbers, memory, status)
    return status


@compiled
def judge(numbers: Integers, memory: Array, status: int) -> int:
    """Judge the sample, and correct it into ``position`` where it can be used; all status bits."""
    m = unpack(numbers, memory)
    for j in range(m.n_joints):
        m.correction[j] = nan
    if not isfinite(m.t):
        return status | Status.NOT_FINITE.value
    status |= judge_stamp(numbers, memory)
    if status & (Status.NOT_FINITE.value | Status.STALE.value):
        return status
    doubts = judge_signals(numbers, memory)
    if doubts:
        return status | doubts
    status |= judge_parity(numbers, memory)
    copy(m.sample, m.last, m.n_signals)
    numbers[at.HAS_LAST] = 1
    numbers[at.WAS_STALE] = 0
    memory[at.LAST_T] = m.t
    status |= judge_rate(numbers, memory)
    step = m.t - m.clock[1]
    fresh = feature_row(
        m.operation, m.source, m.parameter, m.slot, m.longest, m.t, m.sample, m.feature_memory,
        m.clock, m.features,
    )  # fmt: skip
    judge_motion(numbers, memory, fresh)
    status |= judge_features(numbers, memory)
    predict(numbers, memory, 0.0 if fresh else float(step))
    return status | judge_correction(numbers, memory)


@compiled
def take_in(numbers: Integers, memory: Array) -> int:
    """Keep the measured positions; status bit if a signal is not finite."""
    m = unpack(numbers, memory)
    for j in range(m.n_joints):
        m.reported[j] = m.sample[m.measured[j]]
    for i in range(m.n_shifted):  # signals whose zero has moved since the training
        m.sample[i] += m.shift[i]
    status = 0
    for i in range(m.n_signals):
        if not isfinite(m.sample[i]):
            status = Status.NOT_FINITE.value
    return status


@compiled
def is_late(numbers: Integers, memory: Array) -> bool:
    """Whether a sample has come again, or after a newer one, as messages of a network may.

    Several in a row are a clock that stands still, and one unlike the last sample is a fault: they
    are `judge`'s to name.
    """
    m = unpack(numbers, memory)
    step, back = m.t - m.stamp, max(m.longest, SET_BACK)
    if m.has_stamp == 0 or m.is_doubted or not (-back <= step < SHORTEST_STEP * m.training_dt):
        return False
    count = m.n_late + 1
    numbers[at.N_LATE] = count
    numbers[at.WAS_STALE] = 1
    return bool(count < MANY_LATE and not is_unlikely(numbers, memory))


@compiled
def judge_correction(numbers: Integers, memory: Array) -> int:
    """Put the corrected position into ``position``; status bits of the correction."""
    m = unpack(numbers, memory)
    status = 0
    for j in range(m.n_joints):
        base = 0.0 if m.is_position else m.reported[j]
        m.correction[j] = m.predicted[j] - (m.reported[j] if m.is_position else 0.0)
        m.position[j] = base + m.predicted[j] + m.offset[j]
        # `not (a <= b)` holds for NaN too.
        if not (m.correction_lower[j] <= m.correction[j] <= m.correction_upper[j]):
            status |= Status.IMPLAUSIBLE.value
        if isnan(m.predicted_width[j]):
            status |= Status.OUT_OF_DOMAIN.value
    return status


@compiled
def put_out(numbers: Integers, memory: Array, status: int) -> None:
    """Put out the corrected position or, in doubt, what `fields` says under ``on_fault``.

    The correction that was believed last is held for a time in doubt, and then taken back; it moves
    there, and to the next one that is believed, no faster than ``return_speed``. The position never
    leaps, then, but where the measured one does.
    """
    m = unpack(numbers, memory)
    elapsed = m.t - m.output_t if m.has_output and m.t > m.output_t else 0.0
    if isfinite(m.t):
        numbers[at.HAS_OUTPUT] = 1
        memory[at.OUTPUT_T] = m.t
    believed, holds = status == 0, m.on_fault == at.HOLD
    memory[at.DOUBTED_TIME] = m.doubted_time + elapsed if m.is_doubted and not believed else 0.0
    moving_time = min(elapsed, max(LONGEST_MOVE, m.training_dt))
    for j in range(m.n_joints):
        reach = m.return_speed[j] * moving_time if holds else inf
        if believed:
            correction = m.position[j] - m.reported[j]
            if m.is_doubted:
                m.rest[j] = m.applied[j] - correction
            m.rest[j] = nearer_zero(m.rest[j], reach)
            m.applied[j] = correction + m.rest[j]
            m.position[j] += m.rest[j]
            m.half_width[j] = m.predicted_width[j] + abs(m.rest[j])
        else:
            if not (holds and memory[at.DOUBTED_TIME] <= m.hold_time):
                m.applied[j] = nearer_zero(m.applied[j], reach)
            m.position[j] = nan if m.on_fault == at.SILENT else m.reported[j] + m.applied[j]
            m.half_width[j] = inf
    numbers[at.IS_DOUBTED] = 0 if believed else 1


@inlined
def nearer_zero(value: float, reach: float) -> float:
    """Move a value towards zero, by no more than `reach`."""
    return value - min(max(value, -reach), reach)


@compiled
def correct_rows(
    numbers: Integers,
    memory: Array,
    t: Array,
    samples: Array,
    position: Array,
    half_width: Array,
    status: Integers,
    unlearnt: Integers,
    starts: Integers,
    beside: Array,
) -> None:
    """Correct rows one after the other, as the loop would.

    The rows are stamps `t` (n,) [s] and `samples` (n, n_signals). `position` and `half_width`
    (n, n_joints), `status` and `unlearnt` (n,) receive what is put out, `beside` (n, k, 2) the two
    numbers that stand at each of `starts` (k,) in the memory.
    """
    m = unpack(numbers, memory)
    for i in range(t.shape[0]):
        memory[at.T] = t[i]
        copy(samples[i], m.sample, m.n_signals)
        status[i] = correct_sample(numbers, memory)
        unlearnt[i] = numbers[at.UNLEARNT]
        copy(m.position, position[i], m.n_joints)
        copy(m.half_width, half_width[i], m.n_joints)
        for k in range(starts.shape[0]):
            copy(vector(memory, starts[k], 2), beside[i, k], 2)


@compiled
def judge_stamp(numbers: Integers, memory: Array) -> int:
    """Status bits of the stamp; a usable one is remembered, a clock set back clears the history."""
    m = unpack(numbers, memory)
    step, status = m.t - m.stamp, 0
    if m.has_stamp == 0:
        forget(numbers, memory)
    elif step < -max(m.longest, SET_BACK):
        forget(numbers, memory)
        status = Status.TIME_JUMP.value
    elif step < m.shortest:
        numbers[at.WAS_STALE] = 1
        return Status.STALE.value
    elif step > m.longest:
        restart_standstill(numbers, memory)
        status = Status.TIME_JUMP.value if m.remembers else 0
    numbers[at.HAS_STAMP] = 1
    numbers[at.N_LATE] = 0
    memory[at.STAMP] = m.t
    return status


@compiled
def forget(numbers: Integers, memory: Array) -> None:
    """Let the next sample be the first."""
    m = unpack(numbers, memory)
    numbers[at.HAS_STAMP] = 0
    numbers[at.HAS_LAST] = 0
    memory[at.LATE] = 0.0
    forget_spikes(numbers, memory)
    m.clock[0] = 0.0
    restart_standstill(numbers, memory)


@compiled
def begin(numbers: Integers, memory: Array) -> None:
    """Let the next sample be the first, and the first position be put out as it is corrected."""
    m = unpack(numbers, memory)
    forget(numbers, memory)
    numbers[at.HAS_OUTPUT] = 0
    numbers[at.IS_DOUBTED] = 0
    memory[at.DOUBTED_TIME] = 0.0
    fill(m.applied, m.n_joints, 0.0)
    fill(m.rest, m.n_joints, 0.0)


@compiled
def restart_standstill(numbers: Integers, memory: Array) -> None:
    """Let every signal count as having changed at the next sample, and parity as having held."""
    m = unpack(numbers, memory)
    fill(m.stood, m.n_signals, nan)  # near nothing
    memory[at.PARITY_T] = m.t


@inlined
def forget_spikes(numbers: Integers, memory: Array) -> None:
    """Let no signal have jumped."""
    m = unpack(numbers, memory)
    numbers[at.HAS_SPIKED] = 0
    for i in range(m.n_signals):
        m.spiked[i] = 0


@compiled
def judge_signals(numbers: Integers, memory: Array) -> int:
    """Status bits of signals that cannot be believed."""
    if is_unlikely(numbers, memory):
        return name_signals(numbers, memory)
    return judge_standstill(numbers, memory)


@inlined
def is_unlikely(numbers: Integers, memory: Array) -> bool:
    """Whether a signal is out of range or too far from the last one."""
    m = unpack(numbers, memory)
    steps = steps_passed(memory)
    # No branch for each signal here: a processor cannot guess what noise decides.
    outside, far = False, False
    for i in range(m.n_signals):
        outside = outside | (m.sample[i] < m.signal_lower[i]) | (m.sample[i] > m.signal_upper[i])
        change = abs(m.sample[i] - m.last[i])
        far = far | (change > max(m.jump[i], m.reach[i] * steps))
    return bool(outside or (far and m.has_last))


@inlined
def steps_passed(memory: Array) -> float:
    """Training time steps since the last used sample: at least one, unless it was much less."""
    elapsed = abs(memory[at.T] - memory[at.LAST_T]) / memory[at.TRAINING_DT]
    return float(min(BRIEFLY * elapsed, max(elapsed, 1.0)))


@compiled
def name_signals(numbers: Integers, memory: Array) -> int:
    """Status bits of signals out of range or too far from the last ones, which are kept in mind."""
    m = unpack(numbers, memory)
    status, steps = 0, steps_passed(memory)
    for i in range(m.n_signals):
        value = m.sample[i]
        farthest = max(m.jump[i], m.reach[i] * steps)
        if value < m.signal_lower[i] or value > m.signal_upper[i]:
            status |= Status.OUT_OF_RANGE.value
        elif m.has_last and abs(value - m.last[i]) > farthest:
            status |= Status.SPIKE.value
            if m.spiked[i] == 0:
                m.spiked[i], m.spike[i] = 1, m.last[i]
                m.spike_step[i], m.spike_peak[i] = value - m.last[i], 0.0
            numbers[at.HAS_SPIKED] = 1
        follow_spike(numbers, memory, i)
    return status


@compiled
def follow_spike(numbers: Integers, memory: Array, i: int) -> None:
    """Tell a jump of signal `i` from a fast motion, whose neighbouring changes are alike."""
    m = unpack(numbers, memory)
    if m.spiked[i] > 0:
        change = m.sample[i] - m.spike[i]
        m.spike_peak[i] = max(m.spike_peak[i], abs(change))
        if abs(change - m.spike_step[i]) > AT_ONCE * m.spike_peak[i]:
            m.spiked[i] = 2
        m.spike[i], m.spike_step[i] = m.sample[i], change


@compiled
def judge_standstill(numbers: Integers, memory: Array) -> int:
    """Status bit if a signal stands still though another one says that it should not."""
    m = unpack(numbers, memory)
    stood, low, high = m.stood, m.partner_low, m.partner_high
    frozen, changed = False, False
    for i in range(m.n_signals):
        value, other = m.sample[i], m.sample[m.partner[i]]
        # `not (a <= b)` holds for NaN too.
        moved = not (abs(value - stood[i]) <= m.flicker[i])
        stood[i] = value if moved else stood[i]
        low[i] = other if moved else min(low[i], other)
        high[i] = other if moved else max(high[i], other)
        frozen = frozen | (high[i] - low[i] > m.travel[i])
        changed = changed | (moved & (m.moves[i] != 0))
    if changed:
        memory[at.CHANGED_T] = m.t
    if frozen or m.t - memory[at.CHANGED_T] > m.hold:
        return Status.FROZEN.value
    return 0


@compiled
def judge_parity(numbers: Integers, memory: Array) -> int:
    """Status bit of positions that have slipped, or contradict what is redundant to them."""
    m = unpack(numbers, memory)
    status = 0
    for i in range(m.n_parity):
        rest = m.parity_intercept[i] - m.parity_shift[i]
        for k in range(m.n_terms):
            rest += m.parity[i, k] * m.sample[m.parity_terms[i, k]]
        if rest < m.parity_lower[i] or rest > m.parity_upper[i]:
            if m.anchor:
                m.parity_shift[i] += rest - 0.5 * (m.parity_lower[i] + m.parity_upper[i])
            else:
                status = Status.ZERO_SUSPECT.value
    numbers[at.ANCHOR] = 0
    if status == 0:
        memory[at.PARITY_T] = m.t
    elif m.t - m.parity_t > m.patience:
        numbers[at.SUSPECT] = status
    if m.has_spiked:
        judge_slips(numbers, memory)
    return status | int(numbers[at.SUSPECT])


@compiled
def judge_slips(numbers: Integers, memory: Array) -> None:
    """Suspect the zero of positions that jumped, and now are further off than they can be.

    Not after stale stamps: there the clock jumped.
    """
    m = unpack(numbers, memory)
    steps = steps_passed(memory)
    for i in range(m.n_signals):
        follow_spike(numbers, memory, i)
        farthest = max(m.jump[i], m.reach[i] * steps)
        is_off = abs(m.sample[i] - m.last[i]) > SLIP_SHARE * farthest
        if m.spiked[i] == 2 and is_off and m.is_position_signal[i] and not m.was_stale:
            numbers[at.SUSPECT] = Status.ZERO_SUSPECT.value
    forget_spikes(numbers, memory)


@compiled
def judge_rate(numbers: Integers, memory: Array) -> int:
    """Status bit while most samples come late, for a model that counts them: it starts anew."""
    m = unpack(numbers, memory)
    step = m.t - m.clock[1]
    if m.clock[0] == 0.0 or step > m.longest:
        return 0
    late = step > m.slowest
    memory[at.LATE] += ((1.0 if late else 0.0) - memory[at.LATE]) / RATE_STEPS
    if memory[at.LATE] <= 0.5:
        return 0
    if late:
        m.clock[0] = 0.0
    return Status.TIME_JUMP.value


@compiled
def judge_features(numbers: Integers, memory: Array) -> int:
    """Status bits of features unlike those of the training rows, one by one and together."""
    m = unpack(numbers, memory)
    white, inside = m.white, True
    memory[at.EXCESS] = range_excess(m.features, m.trained_lower, m.trained_upper, m.per_span)
    for i in range(m.n_features):
        value = m.features[i]
        inside = (
            inside & (value >= m.feature_lower[i]) & (value <= m.feature_upper[i])
        )  # NaN is not
        m.centred[i] = value - m.domain_mean[i]
    status = 0 if inside else Status.OUT_OF_RANGE.value
    fill(white, m.n_white, 0.0)
    add_triangle(m.centred, m.whitening, white)
    square = 0.0
    for i in range(0, m.n_white, 4):
        square += (white[i] * white[i] + white[i + 1] * white[i + 1]) + (
            white[i + 2] * white[i + 2] + white[i + 3] * white[i + 3]
        )
    if not square <= m.square:
        status |= Status.OUT_OF_DOMAIN.value
    return status


@compiled
def judge_motion(numbers: Integers, memory: Array, fresh: bool) -> None:
    """Say how the motion is unlike that of the training, once it has gone on for long enough."""
    m = unpack(numbers, memory)
    follow_motion(fresh, m.t, m.sample, m.measured, m.stride, m.rate, m.motion)
    unlearnt = 0
    if m.rate[seen.COUNT] >= seen.AVERAGED:
        if m.rate[seen.PACE] < m.pace_lower:
            unlearnt |= Unlearnt.FASTER.value
        elif m.rate[seen.PACE] > m.pace_upper:
            unlearnt |= Unlearnt.SLOWER.value
    for j in range(m.n_joints):
        valley, peak = m.motion[seen.VALLEY, j], m.motion[seen.PEAK, j]
        cell = swing_cell(valley, peak, m.swing_lower[j], m.cells[j])
        if m.motion[seen.TURNED, j] > 1.0 and m.swings[j, cell] == 0:
            unlearnt |= Unlearnt.SWING.value
    numbers[at.UNLEARNT] = unlearnt


@compiled
def predict(numbers: Integers, memory: Array, dt: float) -> None:
    """Predict error or position, and how far off it may be."""
    m = unpack(numbers, memory)
    grown = 1.0 + m.growth * m.excess if m.growth > 0.0 else 1.0
    for j in range(m.n_joints):
        m.predicted_width[j] = m.base_width[j] * grown
    if m.needs_rezero and m.rezeroed == 0:
        fill(m.predicted_width, m.n_joints, inf)
    model, state = part_numbers(numbers, at.MODEL), part_memory(numbers, memory, at.MODEL)
    call_row(numbers[at.ROW], model, state, dt, m.features, m.predicted, m.predicted_width)
    for j in range(m.n_joints):
        m.predicted[j] += m.added[j]


@compiled
def acknowledge(numbers: Integers, memory: Array) -> None:
    """Let the zero count as right, and parity at the next sample."""
    numbers[at.SUSPECT] = 0
    numbers[at.ANCHOR] = 1
    memory[at.PARITY_T] = memory[at.T]


@compiled
def tell_homing(numbers: Integers, memory: Array) -> int:
    """Take over what is told of the homing; the status bits that samples have from now on.

    Reads ``is_homed`` and ``told_id``. Where positions may have moved, the offset ends and the
    history starts anew: a homing that was left is another one when it is told again.
    """
    m = unpack(numbers, memory)
    homing, homing_id = numbers[at.HOMING], numbers[at.HOMING_ID]
    if m.is_homed == 0:
        numbers[at.WAS_LOST] = 1
        numbers[at.HOMING_ID] = at.HOMING_UNKNOWN
        numbers[at.HOMING] = Status.NOT_HOMED.value
    else:
        if m.told_id != at.HOMING_UNKNOWN:
            if m.own_id == at.HOMING_UNKNOWN:
                numbers[at.OWN_ID] = m.told_id
            is_rezeroed = m.rezeroed != 0 and m.told_id == homing_id
            fits = m.told_id < 0 or m.told_id == numbers[at.OWN_ID] or is_rezeroed
            numbers[at.WAS_LOST] = 0 if fits else 1
            numbers[at.HOMING_ID] = m.told_id
        numbers[at.HOMING] = Status.HOMED_AGAIN.value if numbers[at.WAS_LOST] else 0
    if numbers[at.HOMING] != homing or numbers[at.HOMING_ID] != homing_id:
        numbers[at.REZEROED] = 0
        fill(m.offset, m.n_joints, 0.0)
        forget(numbers, memory)
        # The zero counts as that of the training, and parity holds as it did there.
        numbers[at.SUSPECT] = 0
        numbers[at.ANCHOR] = 0
        fill(m.parity_shift, m.n_parity, 0.0)
    if m.zeroed and numbers[at.HOMING] == 0:
        numbers[at.REZEROED] = 1
    return int(numbers[at.HOMING])


@compiled
def accept_offset(numbers: Integers, memory: Array) -> int:
    """Let the offset be that of the present homing; status bits as of `tell_homing`."""
    if numbers[at.HOMING] != Status.NOT_HOMED.value:
        numbers[at.WAS_LOST] = 0
        numbers[at.REZEROED] = 1
        numbers[at.HOMING] = 0
    acknowledge(numbers, memory)
    return int(numbers[at.HOMING])
