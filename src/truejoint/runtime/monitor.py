"""Notice, without a sensor at the joints, that a calibration may no longer hold.

Motors show four things: efforts that no longer fit position and direction (a load, a damaged
cable), friction that changed, samples far outside the trained range, and how long the arm has
worked since it was last compared with the truth. They do not show cables that lengthen evenly:
positions shift, efforts do not. Only the working time stands for that.
"""

from __future__ import annotations

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
from truejoint.compiled import compiled, copy, matrix, vector
from truejoint.errors import CalibrationError
from truejoint.estimators.products import weighted
from truejoint.features.feature_set import FeatureState
from truejoint.features.kernels import feature_row
from truejoint.layout import Layout, refuse_copy

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

LAYOUT: Final = Layout()
N_JOINTS: Final = LAYOUT.integer("n_joints", "watched or not")
N_TERMS: Final = LAYOUT.integer("n_terms", "of one joint's effort")
HAS_LAST: Final = LAYOUT.integer("has_last", "whether there was a sample")
GAP_LIMIT: Final = LAYOUT.scalar("gap_limit", "time that nothing is told of [s]")
WORKING_TIME: Final = LAYOUT.scalar("working_time", "after which a comparison is due [s]")
OUTSIDE: Final = LAYOUT.scalar("outside", "averaged share of samples far outside")
WORKED: Final = LAYOUT.scalar("worked", "time of motion since the last comparison [s]")
LAST: Final = LAYOUT.scalar("last", "stamp of the last sample [s]")
LAST_STEP: Final = LAYOUT.scalar("last_step", "when a joint last moved a step [s]")
LOWER: Final = LAYOUT.array("lower", "range of each joint")
UPPER: Final = LAYOUT.array("upper", "range of each joint")
COEF: Final = LAYOUT.array("coef", "effort of each joint over the terms")
SCALE: Final = LAYOUT.array("scale", "deviation of each joint's effort")
SHIFT_LIMIT: Final = LAYOUT.array("shift_limit", "in deviations")
FRICTION_LIMIT: Final = LAYOUT.array("friction_limit", "in deviations")
TERMS: Final = LAYOUT.array("terms", "of one joint's effort")
POSITION: Final = LAYOUT.array("position", "measured")
TRAVEL: Final = LAYOUT.array("travel", "see `effort_baseline.travelled`")
MEAN: Final = LAYOUT.array("mean", "of the efforts' deviations, each way")
SHIFTS: Final = LAYOUT.array("shifts", "shares of their limits")
FRICTIONS: Final = LAYOUT.array("frictions", "shares of their limits")
MEASURES: Final = LAYOUT.array("measures", "in the order of `Reason`")
MEASURED: Final = LAYOUT.integers("measured", "signal of each joint's position")
EFFORT: Final = LAYOUT.integers("effort", "signal of each joint's effort; -1: none")
MONITORED: Final = LAYOUT.integers("monitored", "1 where efforts are compared")
LEVELS: Final = LAYOUT.integers("levels", "of each measure")

_CHECK: Final = np.array([1.0, 1.0, 0.1, 1.0])
_RECALIBRATE: Final = np.array([6.0, 3.0, 0.5, math.inf])


class Alarm(IntEnum):
    """What is advised.

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
    """What an alarm is about.

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

    def first(self, alarm: Alarm = Alarm.CHECK, reasons: Reason | None = None) -> float:
        """Time since the first sample [s] at which `alarm` was first reached; NaN if never.

        With `reasons`, only alarms with one of these among their own count.
        """
        at = self.alarm >= alarm
        if reasons is not None:
            at &= (self.reasons & int(reasons)) != 0
        return float(self.t[int(np.argmax(at))] - self.t[0]) if at.any() else math.nan


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
        Of the measures that are above their threshold.
    measures : ndarray, shape (4,)
        Shift and change of friction of the worst joint, as shares of their limits; share of samples
        far outside the trained range; working time as a share of `working_time`.
    shifts, frictions : ndarray, shape (n_joints,)
        Deviation of the efforts as shares of their limits, averaged over about two of the joint's
        ranges each way; NaN for joints whose efforts are not known (`watched`).

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
        n = len(joints)
        names = [f"effort/{joint}" for joint in joints]
        learnt = ("lower", "upper", "coef", "scale", "shift_limit", "friction_limit", "monitored")
        self._packed = LAYOUT.pack(
            n_joints=n,
            n_terms=baseline.coef.shape[1],
            gap_limit=calibration.gap_limit,
            working_time=working_time,
            terms=np.zeros(baseline.coef.shape[1]),
            travel=np.zeros((N_TRAVEL, n)),
            measures=np.zeros(N_MEASURES),
            measured=[signals.index(f"measured/{joint}") for joint in joints],
            effort=[signals.index(name) if name in signals else -1 for name in names],
            levels=np.zeros(N_MEASURES),
            **dict.fromkeys(("position", "shifts", "frictions"), np.zeros(n)),
            mean=np.zeros((2, n)),
            **{name: getattr(baseline, name) for name in learnt},
        )
        self._numbers, self._memory = self._packed.numbers, self._packed.memory
        self.shifts: Array = self._packed.view("shifts")
        self.frictions: Array = self._packed.view("frictions")
        self.measures: Array = self._packed.view("measures")
        self._levels: Integers = self._packed.view("levels")
        self._per_span = inverse_span(calibration.lower, calibration.upper)
        self._stamp, self._sample = np.zeros(1), np.zeros((1, len(signals)))
        self._graded = np.zeros((1, N_MEASURES), np.int64), np.zeros((1, N_MEASURES))
        self._row = np.zeros(len(calibration.feature_set))
        self.reset()
        # Compile, then forget.
        self._watch(self._stamp, self._sample, *self._graded)
        self.reset()

    __reduce__ = refuse_copy

    @property
    def watched(self) -> tuple[str, ...]:
        """Joints whose efforts are compared with the baseline."""
        joints = self._calibration.joints
        monitored = self._packed.view("monitored")
        return tuple(joint for joint, on in zip(joints, monitored, strict=True) if on)

    @property
    def alarm(self) -> Alarm:
        """What is advised after the last sample."""
        return Alarm(int(self._levels.max()))

    @property
    def reasons(self) -> Reason:
        """Measures that are above their threshold."""
        return Reason(int(_bits(self._levels)))

    def reset(self) -> None:
        """Forget everything seen."""
        unknown = self._packed.view("monitored") == 0
        self.shifts[:] = self.frictions[:] = np.where(unknown, np.nan, 0.0)
        self.measures[:] = 0.0
        self._levels[:] = 0
        self._packed.view("travel")[:] = 0.0
        self._packed.view("mean")[:] = 0.0
        self._packed.view("travel")[ANCHOR] = np.nan
        self._memory[[OUTSIDE, WORKED, LAST, LAST_STEP]] = 0.0
        self._numbers[HAS_LAST] = 0
        self._features: FeatureState = self._calibration.feature_set.start()

    def compared_with_truth(self) -> None:
        """Start the working time anew: the arm was checked or re-zeroed."""
        self._memory[WORKED] = 0.0
        self.measures[WORK] = 0.0
        self._levels[WORK] = 0

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
        self._watch(self._stamp, self._sample, *self._graded)
        return int(self._levels.max())

    def run(self, recording: Recording) -> MonitorTrace:
        """Watch a whole recording, from a fresh start; RecordingError if it lacks a signal."""
        as_recorded(recording)
        self.reset()
        t = np.array(recording.t)
        signals = self._calibration.signals
        samples = np.ascontiguousarray(np.column_stack([recording.column(s) for s in signals]))
        levels = np.empty((len(t), N_MEASURES), dtype=np.int64)
        measures = np.empty(levels.shape)
        self._watch(t, samples, levels, measures)
        return MonitorTrace(t, levels.max(axis=1), _bits(levels), measures)

    def _watch(self, t: Array, samples: Array, levels: Integers, measures: Array) -> None:
        """Take rows one after the other; `levels` and `measures` (n, 4) receive what each says."""
        calibration, features = self._calibration, self._features
        watch_rows(
            self._numbers, self._memory, *calibration.feature_set.program, calibration.gap_limit,
            features.memory, features.clock, self._row, calibration.lower, calibration.upper,
            self._per_span, t, samples, levels, measures,
        )  # fmt: skip


def _bits(levels: Integers) -> Integers:
    """`Reason` bits of the measures above their threshold, of their levels (..., 4)."""
    return np.asarray((levels > 0) @ (1 << np.arange(N_MEASURES)))


@compiled
def watch_rows(
    numbers: Integers,
    memory: Array,
    operation: Integers,
    source: Integers,
    parameter: Array,
    slot: Integers,
    gap_limit: float,
    feature_memory: Array,
    clock: Array,
    features: Array,
    lower: Array,
    upper: Array,
    per_span: Array,
    t: Array,
    samples: Array,
    levels: Integers,
    measures: Array,
) -> None:
    """Watch rows of stamps `t` (n,) [s] and `samples` (n, n_signals), one after the other.

    The `features` (k,) are those of `feature_row`; `lower`, `upper` and `per_span` (k,) are their
    trained range and its inverse length. `levels` and `measures` (n, 4) receive what stands after
    each row.
    """
    for i in range(t.shape[0]):
        if acceptable(numbers, memory, t[i], samples[i]):
            feature_row(
                operation, source, parameter, slot, gap_limit, t[i], samples[i], feature_memory,
                clock, features,
            )  # fmt: skip
            excess = range_excess(features, lower, upper, per_span)
            watch(numbers, memory, t[i], samples[i], excess)
        copy(vector(memory, numbers[MEASURES], N_MEASURES), measures[i], N_MEASURES)
        for k in range(N_MEASURES):
            levels[i, k] = numbers[numbers[LEVELS] + k]


@compiled
def acceptable(numbers: Integers, memory: Array, t: float, values: Array) -> bool:
    """Whether a sample is finite and later than the last one."""
    if not np.isfinite(t) or (numbers[HAS_LAST] != 0 and not t > memory[LAST]):
        return False
    for i in range(values.shape[0]):  # noqa: SIM110  # a loop, compiled
        if not np.isfinite(values[i]):
            return False
    return True


@compiled
def watch(numbers: Integers, memory: Array, t: float, values: Array, excess: float) -> int:
    """Take one acceptable sample into all averages and grade them; returns the alarm.

    `excess` is the share of its trained range by which a feature lies outside.
    """
    n, n_terms = numbers[N_JOINTS], numbers[N_TERMS]
    position = vector(memory, numbers[POSITION], n)
    lower, upper = vector(memory, numbers[LOWER], n), vector(memory, numbers[UPPER], n)
    travel = matrix(memory, numbers[TRAVEL], N_TRAVEL, n)
    elapsed = t - memory[LAST] if numbers[HAS_LAST] != 0 else 0.0
    if elapsed > memory[GAP_LIMIT]:
        # Nobody saw what happened meanwhile; direction and friction have to build up again.
        elapsed = 0.0
        travel[ANCHOR] = np.nan
        travel[1:] = 0.0
    for j in range(n):
        position[j] = values[numbers[numbers[MEASURED] + j]]
    terms = vector(memory, numbers[TERMS], n_terms)
    coef = matrix(memory, numbers[COEF], n, n_terms)
    mean = matrix(memory, numbers[MEAN], 2, n)
    shifts, frictions = vector(memory, numbers[SHIFTS], n), vector(memory, numbers[FRICTIONS], n)
    for j in range(n):
        before = travel[TIME, j]
        speed = travelled(j, t, position, lower, upper, travel)
        if travel[TIME, j] != before:
            memory[LAST_STEP] = t
        if speed == 0.0 or numbers[numbers[MONITORED] + j] == 0:
            continue
        effort_terms(position, speed, lower, upper, terms)
        deviation = values[numbers[numbers[EFFORT] + j]] - weighted(terms, coef[j])
        deviation /= memory[numbers[SCALE] + j]
        shift, friction = average_effort(deviation, speed, travel[MOVED, j], j, mean)
        shifts[j] = shift / memory[numbers[SHIFT_LIMIT] + j]
        frictions[j] = friction / memory[numbers[FRICTION_LIMIT] + j]
    if numbers[HAS_LAST] != 0 and t - memory[LAST_STEP] <= REST:
        memory[WORKED] += elapsed
    outside = 1.0 if excess > FAR_OUTSIDE else 0.0
    memory[OUTSIDE] += (1.0 - np.exp(-elapsed / OUTSIDE_TIME)) * (outside - memory[OUTSIDE])
    numbers[HAS_LAST] = 1
    memory[LAST] = t
    measures = vector(memory, numbers[MEASURES], N_MEASURES)
    measures[SHIFT] = largest(shifts)
    measures[FRICTION] = largest(frictions)
    measures[RANGE] = memory[OUTSIDE]
    measures[WORK] = memory[WORKED] / memory[WORKING_TIME]
    return grade(measures, vector(numbers, numbers[LEVELS], N_MEASURES))


@compiled
def largest(shares: Array) -> float:
    """Largest absolute value; NaN counts as 0."""
    most = 0.0
    for j in range(shares.shape[0]):
        if not np.isnan(shares[j]):
            most = max(most, abs(shares[j]))
    return most


@compiled
def grade(measures: Array, levels: Integers) -> int:
    """Level of each measure, with hysteresis, into `levels` (4,); returns the highest."""
    highest = 0
    for i in range(measures.shape[0]):
        held = 0
        if measures[i] >= _RECALIBRATE[i] or (
            levels[i] == 2 and measures[i] >= RELEASE * _RECALIBRATE[i]
        ):
            held = 2
        elif measures[i] >= _CHECK[i] or (levels[i] > 0 and measures[i] >= RELEASE * _CHECK[i]):
            held = 1
        levels[i] = held
        highest = max(highest, held)
    return highest
