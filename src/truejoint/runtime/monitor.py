"""Notice, without a sensor at the joints, that a calibration may no longer hold.

Motors show four things: efforts that no longer fit position and direction (a load, a damaged
cable), friction that changed, samples far outside the trained range, and how long the arm has
worked since it was last compared with the truth. They do not show cables that lengthen evenly:
positions shift, efforts do not. Only the working time stands for that.
"""

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Integers
from truejoint.calibration.calibration import Calibration, as_calibration, as_recorded
from truejoint.calibration.efforts import (
    ANCHOR,
    MOVED,
    N_TRAVEL,
    TIME,
    average_effort,
    effort_terms,
    travelled,
)
from truejoint.calibration.interval import inverse_span, range_excess
from truejoint.compiled import compiled, copy
from truejoint.errors import CalibrationError
from truejoint.features.feature_set import feature_row
from truejoint.layout import Layout, refuse_copy
from truejoint.products import weighted

if TYPE_CHECKING:
    from truejoint.recordings import Recording


LONGEST_WORK: Final = 3600.0
"""Motion [s] after which a comparison with the truth is due: accuracy falls within an hour or two
of work, and hardly at rest (peng2024, II-G)."""
FAR_OUTSIDE: Final = 0.5
"""Share of its trained range by which a feature may be outside before a sample counts as far
outside; the interval has doubled there."""
OUTSIDE_TIME: Final = 60.0
"""Time over which the share of such samples is averaged [s]."""
REST: Final = 2.0
"""Without a step of any joint for this long [s] the arm is at rest."""
RELEASE: Final = 0.7
"""A level is left when its measure falls below this share of the threshold: no flicker."""

# Measures, in the order of the bits of `Reason`.
SHIFT, FRICTION, RANGE, WORK = 0, 1, 2, 3
N_MEASURES: Final = 4

LAYOUT: Final = Layout().declare(__package__, "monitor", N_MEASURES=N_MEASURES, N_TRAVEL=N_TRAVEL)
HAS_LAST, OUTSIDE, WORKED, LAST, LAST_STEP = LAYOUT.places("has_last outside worked last last_step")
unpack = LAYOUT.unpacker()

_CHECK: Final = np.array([1.0, 1.0, 0.1, 1.0])
_RECALIBRATE: Final = np.array([6.0, 3.0, 0.5, math.inf])


class Alarm(IntEnum):
    """Advice.

    Examples
    --------
    >>> Alarm(1).name
    'CHECK'
    """

    NONE = 0
    CHECK = 1
    """Compare with a brief truth: ``truejoint check``."""
    RECALIBRATE = 2
    """The arm is no longer the one that was calibrated."""


class Reason(IntFlag):
    """Subject of an alarm.

    Examples
    --------
    >>> Reason.FRICTION in Reason(3)
    True
    """

    NOTHING = 0
    SHIFT = 1
    """Efforts are shifted in both directions alike: gravity, load or pretension changed."""
    FRICTION = 2
    """Efforts of the two directions are further apart or closer together than they were."""
    RANGE = 4
    """Many samples lie far outside the trained range."""
    WORK = 8
    """The arm has moved for long since it was last compared with the truth."""


@dataclass(frozen=True, eq=False)
class MonitorTrace:
    """What a monitor said along a recording."""

    t: Array  # (n,) time stamps [s]
    alarm: Integers  # (n,) `Alarm` after each sample
    reasons: Integers  # (n,) `Reason` bits of the measures that are above their threshold
    measures: Array  # (n, 4) as in `Monitor.measures`


class Monitor:
    """Watches the samples of a control loop, or of a recording, for signs of staleness.

    One compiled call per sample, nothing allocated. An alarm rises when a measure reaches its
    threshold and falls when it is below 0.7 of it.

    Parameters
    ----------
    calibration : Calibration
        A `Calibration`, or what `decode` gives; efforts are compared with its
        `effort_baseline`.
    working_time : float
        Motion after which a comparison with the truth is due [s]; infinite for never.

    Attributes
    ----------
    alarm : Alarm
    reasons : Reason
        Reasons of the measures that are above their threshold.
    measures : ndarray, shape (4,)
        Shift and change of friction of the worst joint, as shares of their limits; share of samples
        far outside the trained range; working time as a share of `working_time`.
    shifts, frictions : ndarray, shape (n_joints,)
        Deviation of the efforts as shares of their limits, averaged over about two of the joint's
        ranges each way; NaN for joints whose efforts are not known.

    Raises
    ------
    CalibrationError
        If it is no calibration or has no effort baseline, or `working_time` is not above 0.

    Examples
    --------
    >>> int(Monitor(model).run(test).alarm.max())
    0
    """

    def __init__(self, calibration: Calibration, *, working_time: float = LONGEST_WORK) -> None:
        baseline = as_calibration(calibration).effort_baseline
        if baseline is None:
            raise CalibrationError(
                f"the calibration of {calibration.robot} keeps no baseline of how efforts looked; "
                "calibrate it again"
            )
        if not working_time > 0.0:
            raise CalibrationError(f"working time {working_time!r} s; give a time above 0 s")
        self._calibration = calibration
        joints, signals = calibration.joints, calibration.signals
        efforts = [f"effort/{joint}" for joint in joints]
        learnt = ("lower", "upper", "coef", "scale", "shift_limit", "friction_limit", "monitored")
        operation, source, parameter, slot = calibration.feature_set.program
        travel = np.zeros((N_TRAVEL, len(joints)))
        travel[ANCHOR] = np.nan
        share = np.where(baseline.monitored, 0.0, np.nan)
        self._packed = LAYOUT.pack(
            gap_limit=calibration.gap_limit, working_time=working_time, travel=travel,
            shifts=share, frictions=share,
            measured=[signals.index(f"measured/{joint}") for joint in joints],
            effort=[signals.index(name) if name in signals else -1 for name in efforts],
            operation=operation, source=source, parameter=parameter, slot=slot,
            feature_memory=np.zeros(calibration.feature_set.memory_size),
            trained_lower=calibration.lower, trained_upper=calibration.upper,
            per_span=inverse_span(calibration.lower, calibration.upper),
            **{name: getattr(baseline, name) for name in learnt},
        )  # fmt: skip
        self._numbers, self._memory = self._packed.numbers, self._packed.memory
        self._begun = self._numbers.copy(), self._memory.copy()
        self.shifts: Array = self._packed.view("shifts")
        self.frictions: Array = self._packed.view("frictions")
        self.measures: Array = self._packed.view("measures")
        self._levels: Integers = self._packed.view("levels")
        self._stamp, self._sample = np.zeros(1), np.zeros((1, len(signals)))
        self._graded = np.zeros((1, N_MEASURES), np.int64), np.zeros((1, N_MEASURES))
        # Compile, then forget.
        watch_rows(self._numbers, self._memory, self._stamp, self._sample, *self._graded)
        self.reset()

    __reduce__ = refuse_copy

    @property
    def alarm(self) -> Alarm:
        """Advice after the last sample."""
        return Alarm(int(self._levels.max()))

    @property
    def reasons(self) -> Reason:
        """Measures that are above their threshold."""
        return Reason(int(_bits(self._levels)))

    def reset(self) -> None:
        """Forget everything seen, also how long the arm has worked: it was checked or re-zeroed."""
        self._numbers[:], self._memory[:] = self._begun

    def step(self, t: float, sample: ArrayLike) -> int:
        """Take one `sample` (n_signals,), taken at `t` [s]; returns the `Alarm`.

        It holds the values of a corrector's `signals`, in their order and units, or of the first of
        these, the calibration's. One that does not advance the time, or is not finite, is passed
        over; CalibrationError for a wrong size.
        """
        values, calibration = np.asarray(sample, dtype=np.float64), self._calibration
        n, signals = len(calibration.signals), calibration.loop_signals
        if values.shape not in ((n,), (len(signals),)):
            raise CalibrationError(
                f"sample has shape {values.shape}; it must hold the {n} signals "
                f"{', '.join(signals[:n])}"
            )
        self._stamp[0], self._sample[0] = t, values[:n]
        watch_rows(self._numbers, self._memory, self._stamp, self._sample, *self._graded)
        return int(self._levels.max())

    def run(self, recording: "Recording") -> MonitorTrace:
        """Watch a whole recording, from a fresh start; RecordingError if it lacks a signal."""
        as_recorded(recording)
        self.reset()
        t = np.array(recording.t)
        signals = self._calibration.signals
        samples = np.ascontiguousarray(np.column_stack([recording.column(s) for s in signals]))
        levels = np.empty((len(t), N_MEASURES), dtype=np.int64)
        measures = np.empty(levels.shape)
        watch_rows(self._numbers, self._memory, t, samples, levels, measures)
        return MonitorTrace(t, levels.max(axis=1), _bits(levels), measures)


def _bits(levels: Integers) -> Integers:
    """`Reason` bits of the measures above their threshold, of their levels (..., 4)."""
    return np.asarray((levels > 0) @ (1 << np.arange(N_MEASURES)))


@compiled
def watch_rows(
    numbers: Integers, memory: Array, t: Array, samples: Array, levels: Integers, measures: Array
) -> None:
    """Watch rows of stamps `t` (n,) [s] and `samples` (n, n_signals), one after the other.

    `levels` and `measures` (n, 4) receive what stands after each row. A row that is not finite, or
    no later than the last one, is passed over.
    """
    m = unpack(numbers, memory)
    for i in range(t.shape[0]):
        is_usable = np.isfinite(t[i]) and (numbers[HAS_LAST] == 0 or t[i] > memory[LAST])
        for value in samples[i]:
            is_usable = is_usable and np.isfinite(value)
        if is_usable:
            watch(numbers, memory, t[i], samples[i])
            grade(m.measures, m.levels)
        copy(m.measures, measures[i], N_MEASURES)
        copy(m.levels, levels[i], N_MEASURES)


@compiled
def watch(numbers: Integers, memory: Array, t: float, values: Array) -> None:
    """Take one usable sample into all averages and measures."""
    m = unpack(numbers, memory)
    feature_row(
        m.operation, m.source, m.parameter, m.slot, m.gap_limit, t, values, m.feature_memory,
        m.clock, m.features,
    )  # fmt: skip
    excess = range_excess(m.features, m.trained_lower, m.trained_upper, m.per_span)
    elapsed = t - m.last if m.has_last != 0 else 0.0
    if elapsed > m.gap_limit:
        # Nobody saw what happened meanwhile; direction and friction have to build up again.
        elapsed = 0.0
        m.travel[ANCHOR] = np.nan
        m.travel[1:] = 0.0
    for j in range(m.n_joints):
        m.position[j] = values[m.measured[j]]
    for j in range(m.n_joints):
        before = m.travel[TIME, j]
        speed = travelled(j, t, m.position, m.lower, m.upper, m.travel)
        if m.travel[TIME, j] != before:
            memory[LAST_STEP] = t
        if speed == 0.0 or m.monitored[j] == 0:
            continue
        effort_terms(m.position, speed, m.lower, m.upper, m.terms)
        deviation = (values[m.effort[j]] - weighted(m.terms, m.coef[j])) / m.scale[j]
        shift, friction = average_effort(deviation, speed, m.travel[MOVED, j], j, m.mean)
        m.shifts[j] = shift / m.shift_limit[j]
        m.frictions[j] = friction / m.friction_limit[j]
    if m.has_last != 0 and t - memory[LAST_STEP] <= REST:
        memory[WORKED] += elapsed
    outside = 1.0 if excess > FAR_OUTSIDE else 0.0
    memory[OUTSIDE] += (1.0 - np.exp(-elapsed / OUTSIDE_TIME)) * (outside - memory[OUTSIDE])
    numbers[HAS_LAST] = 1
    memory[LAST] = t
    m.measures[SHIFT] = largest(m.shifts)
    m.measures[FRICTION] = largest(m.frictions)
    m.measures[RANGE] = memory[OUTSIDE]
    m.measures[WORK] = memory[WORKED] / m.working_time


@compiled
def largest(shares: Array) -> float:
    """Largest absolute value; NaN counts as 0."""
    most = 0.0
    for j in range(shares.shape[0]):
        if not np.isnan(shares[j]):
            most = max(most, abs(shares[j]))
    return most


@compiled
def grade(measures: Array, levels: Integers) -> None:
    """Level of each measure, with hysteresis, into `levels` (4,)."""
    for i in range(measures.shape[0]):
        level = 0
        if measures[i] >= _CHECK[i] or (levels[i] > 0 and measures[i] >= RELEASE * _CHECK[i]):
            level = 1
        most = _RECALIBRATE[i]
        if measures[i] >= most or (levels[i] == 2 and measures[i] >= RELEASE * most):
            level = 2
        levels[i] = level
