"""Notice, without a sensor at the joints, that a calibration may no longer hold.

Five things can be seen from the motors: efforts that no longer fit position and direction (a load,
a damaged cable), friction that changed, samples far outside the trained range, a filter's
innovations, and how long the arm has worked since it was last compared with the truth. What
they cannot see is cables that lengthen evenly: positions shift, efforts do not. Only the working
time stands for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.calibration.effort_baseline import (
    ANCHOR,
    MOVED,
    N_TRAVEL,
    TIME,
    WINDOW_FILLED,
    average_effort,
    effort_terms,
    travelled,
)
from truejoint.calibration.encoding import CalibrationData
from truejoint.calibration.interval import inverse_span, range_excess
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError

if TYPE_CHECKING:
    from truejoint.recordings import Recording

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

WORKING_TIME: Final = 3600.0
"""Motion [s] after which a comparison with the truth is due: accuracy falls within an hour or two
of work, and hardly at rest (peng2024, II-G)."""
FAR_OUTSIDE: Final = 0.5
"""Share of its trained range by which a feature may be outside before a sample counts as far
outside; the interval has doubled there."""
OUTSIDE_TIME: Final = 60.0
"""Time over which the share of such samples is averaged [s]."""
REST: Final = 2.0
"""Without a step of any joint for this long [s] the arm is at rest."""
INNOVATION_SAMPLES: Final = 500.0
"""Innovations are averaged over about this many."""
RELEASE: Final = 0.7
"""A level is left when its measure falls below this share of the threshold: no flicker."""

# Measures, in the order of the bits of `Reason`.
SHIFT, FRICTION, RANGE, INNOVATION, WORK = 0, 1, 2, 3, 4
N_MEASURES: Final = 5
# Slow state.
OUTSIDE, RATIO, RATIO_WEIGHT, WORKED, LAST, LAST_STEP, SEEN = 0, 1, 2, 3, 4, 5, 6
N_SLOW: Final = 7

_CHECK: Final = np.array([1.0, 1.0, 0.1, 2.0, 1.0])
_RECALIBRATE: Final = np.array([3.0, 3.0, 0.5, 4.0, math.inf])


class Alarm(IntEnum):
    """What is advised."""

    NONE = 0
    CHECK = 1
    """Compare with a brief truth: ``truejoint check``."""
    RECALIBRATE = 2
    """The arm is no longer the one that was calibrated."""


class Reason(IntFlag):
    """What an alarm is about."""

    NOTHING = 0
    SHIFT = 1
    """Efforts are shifted in both directions alike: gravity, load or pretension changed."""
    FRICTION = 2
    """Efforts of the two directions are further apart or closer together than they were."""
    RANGE = 4
    """Many samples lie far outside the trained range."""
    INNOVATION = 8
    """A filter's innovations are larger than it states."""
    WORK = 16
    """The arm has moved for long since it was last compared with the truth."""


@dataclass(frozen=True, eq=False)
class MonitorTrace:
    """What a monitor said along a recording."""

    t: Array  # (n,), time stamps [s]
    alarm: Integers  # (n,), `Alarm` after each sample
    reasons: Integers  # (n,), `Reason` bits of the measures that are above their threshold
    measures: Array  # (n, 5), as in `Monitor.measures`

    def first(self, alarm: Alarm = Alarm.CHECK, reasons: Reason | None = None) -> float:
        """Time since the first sample [s] at which `alarm` was first reached; NaN if never.

        With `reasons`, only alarms with one of these among their reasons count.
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
    calibration : CalibrationData
        A `Calibration`, or what `decode` gives; its `reference` is what efforts are compared with.
    working_time : float
        Motion after which a comparison with the truth is due [s]; infinite for never.

    Attributes
    ----------
    alarm : Alarm
    reasons : Reason
        Of the measures that are above their threshold.
    measures : ndarray, shape (5,)
        Shift and change of friction of the worst joint, as shares of their limits; share of samples
        far outside the trained range; mean normalised innovation squared per degree of freedom;
        working time as a share of `working_time`.
    shifts, frictions : ndarray, shape (n_joints,)
        Deviation of the efforts as shares of their limits; NaN until a joint has travelled about
        half its range each way, and for joints whose efforts are not known (`watched`).

    Raises
    ------
    CalibrationError
        If the calibration has no reference, or `working_time` is not above 0.

    Examples
    --------
    >>> int(Monitor(model).run(test).alarm.max())
    0
    """

    def __init__(
        self, calibration: CalibrationData[Any], *, working_time: float = WORKING_TIME
    ) -> None:
        reference = calibration.effort_baseline
        if reference is None:
            raise CalibrationError(
                f"the calibration of {calibration.robot} keeps no reference of how efforts looked; "
                "calibrate it again"
            )
        if not working_time > 0.0:
            raise CalibrationError(f"working time {working_time!r} s; give a time above 0 s")
        self._calibration = calibration
        self._reference = reference
        joints, signals = calibration.joints, calibration.signals
        self._measured = np.array([signals.index(f"measured/{j}") for j in joints])
        names = [f"effort/{joint}" for joint in joints]
        self._effort = np.array([signals.index(n) if n in signals else -1 for n in names])
        self._monitored = reference.monitored.astype(np.int64)
        self._per_span = inverse_span(calibration.lower, calibration.upper)
        self._working_time = float(working_time)
        self._terms = np.zeros(reference.coef.shape[1])
        self._position = np.zeros(len(joints))
        self._row = np.zeros(len(calibration.feature_set))
        self.shifts, self.frictions = np.zeros((2, len(joints)))
        self.measures = np.zeros(N_MEASURES)
        self._levels = np.zeros(N_MEASURES, dtype=np.int64)
        self._travel = np.zeros((N_TRAVEL, len(joints)))
        self._mean, self._weight = np.zeros((2, 2, len(joints)))
        self._slow = np.zeros(N_SLOW)
        self.reset()
        self._warm_up()

    @property
    def watched(self) -> tuple[str, ...]:
        """Joints whose efforts are compared with the reference."""
        joints = self._calibration.joints
        return tuple(joint for joint, on in zip(joints, self._monitored, strict=True) if on)

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
        self.shifts[:] = self.frictions[:] = np.nan
        self.measures[:] = 0.0
        self._levels[:] = 0
        self._travel[:] = 0.0
        self._travel[ANCHOR] = np.nan
        self._mean[:] = self._weight[:] = 0.0
        self._slow[:] = 0.0
        self._features = self._calibration.feature_set.start()

    def compared_with_truth(self) -> None:
        """Start the working time anew: the arm was checked or re-zeroed."""
        self._slow[WORKED] = 0.0
        self.measures[WORK] = 0.0
        self._levels[WORK] = 0

    def step(self, t: float, sample: ArrayLike) -> int:
        """Take one sample.

        Parameters
        ----------
        t : float
            Time stamp [s]. A sample that does not advance it, or is not finite, is passed over.
        sample : array_like, shape (n_signals,)
            Values of the calibration's `signals`, in their order and units.

        Returns
        -------
        int
            The `Alarm`.
        """
        values = np.asarray(sample, dtype=np.float64)
        if values.shape != (len(self._calibration.signals),):
            raise CalibrationError(
                f"sample has shape {values.shape}; it must hold the "
                f"{len(self._calibration.signals)} signals {', '.join(self._calibration.signals)}"
            )
        return int(self._advance(float(t), values))

    def innovation(self, squared: float, degrees: int) -> int:
        """Take the normalised innovation squared of a filter's update; returns the `Alarm`.

        Parameters
        ----------
        squared : float
            ``v.T @ inv(S) @ v``, on average equal to `degrees` while the filter is right.
        degrees : int
            How many measurements it is of, above 0.
        """
        return int(take_innovation(squared / degrees, self._slow, self.measures, self._levels))

    def run(self, recording: Recording) -> MonitorTrace:
        """Watch a whole recording, from a fresh start.

        Raises
        ------
        RecordingError
            If the recording lacks a signal of the calibration.
        """
        self.reset()
        t = np.array(recording.t)
        signals = self._calibration.signals
        samples = np.ascontiguousarray(np.column_stack([recording.column(s) for s in signals]))
        alarm, reasons = np.empty(len(t), dtype=np.int64), np.empty(len(t), dtype=np.int64)
        measures = np.empty((len(t), N_MEASURES))
        for i in range(len(t)):
            alarm[i] = self._advance(t[i], samples[i])
            reasons[i] = _bits(self._levels)
            measures[i] = self.measures
        return MonitorTrace(t, alarm, reasons, measures)

    def _advance(self, t: float, values: Array) -> int:
        reference, calibration = self._reference, self._calibration
        if not acceptable(t, values, self._slow):
            return int(self._levels.max())
        calibration.feature_set.step(self._features, t, values, calibration.gap_limit, self._row)
        excess = range_excess(self._row, calibration.lower, calibration.upper, self._per_span)
        return int(
            watch(
                t, values, self._measured, self._effort, self._monitored, reference.lower,
                reference.upper, reference.coef, reference.scale, reference.shift_limit,
                reference.friction_limit, excess, calibration.gap_limit, self._working_time,
                self._terms, self._position, self._travel, self._mean, self._weight, self._slow,
                self.shifts, self.frictions, self.measures, self._levels,
            )
        )  # fmt: skip

    def _warm_up(self) -> None:
        """Compile, then forget."""
        self._advance(1.0, np.zeros(len(self._calibration.signals)))
        self.innovation(1.0, 1)
        self.reset()


@compiled
def acceptable(t: float, values: Array, slow: Array) -> bool:
    """Whether a sample is finite and later than the last one."""
    if not np.isfinite(t) or (slow[SEEN] != 0.0 and not t > slow[LAST]):
        return False
    for i in range(values.shape[0]):  # noqa: SIM110  # a loop, compiled
        if not np.isfinite(values[i]):
            return False
    return True


@compiled
def watch(
    t: float,
    values: Array,
    measured: Integers,
    effort: Integers,
    monitored: Integers,
    lower: Array,
    upper: Array,
    coef: Array,
    scale: Array,
    shift_limit: Array,
    friction_limit: Array,
    excess: float,
    gap_limit: float,
    working_time: float,
    terms: Array,
    position: Array,
    travel: Array,
    mean: Array,
    weight: Array,
    slow: Array,
    shifts: Array,
    frictions: Array,
    measures: Array,
    levels: Integers,
) -> int:
    """Take one acceptable sample into all averages and grade them; returns the alarm.

    The reference's arrays, then the state of `Monitor`, changed in place. `measured` and `effort`
    are the places of the joints' signals in `values`.
    """
    n_joints = measured.shape[0]
    elapsed = t - slow[LAST] if slow[SEEN] != 0.0 else 0.0
    if elapsed > gap_limit:
        # Nobody saw what happened meanwhile; direction and friction have to build up again.
        elapsed = 0.0
        travel[ANCHOR] = np.nan
        travel[1:] = 0.0
    for j in range(n_joints):
        position[j] = values[measured[j]]
    for j in range(n_joints):
        before = travel[TIME, j]
        speed = travelled(j, t, position, lower, upper, travel)
        if travel[TIME, j] != before:
            slow[LAST_STEP] = t
        if speed == 0.0 or monitored[j] == 0:
            continue
        effort_terms(position, speed, lower, upper, terms)
        deviation = (values[effort[j]] - dot(coef[j], terms)) / scale[j]
        average_effort(deviation, speed, travel[MOVED, j], j, mean, weight)
        if min(weight[0, j], weight[1, j]) > WINDOW_FILLED:
            down, up = mean[0, j] / weight[0, j], mean[1, j] / weight[1, j]
            shifts[j] = 0.5 * (up + down) / shift_limit[j]
            frictions[j] = 0.5 * (up - down) / friction_limit[j]
    if slow[SEEN] != 0.0 and t - slow[LAST_STEP] <= REST:
        slow[WORKED] += elapsed
    outside = 1.0 if excess > FAR_OUTSIDE else 0.0
    slow[OUTSIDE] += (1.0 - np.exp(-elapsed / OUTSIDE_TIME)) * (outside - slow[OUTSIDE])
    slow[SEEN] = 1.0
    slow[LAST] = t
    measures[SHIFT] = largest(shifts)
    measures[FRICTION] = largest(frictions)
    measures[RANGE] = slow[OUTSIDE]
    measures[WORK] = slow[WORKED] / working_time
    return grade(measures, levels)


@compiled
def dot(a: Array, b: Array) -> float:
    """Inner product; numba's own would load SciPy's BLAS into the control loop."""
    total = 0.0
    for k in range(a.shape[0]):
        total += a[k] * b[k]
    return total


@compiled
def largest(shares: Array) -> float:
    """Largest absolute value; NaN counts as 0."""
    most = 0.0
    for j in range(shares.shape[0]):
        if not np.isnan(shares[j]):
            most = max(most, abs(shares[j]))
    return most


@compiled
def take_innovation(ratio: float, slow: Array, measures: Array, levels: Integers) -> int:
    """Take one innovation, squared and normalised per degree of freedom, into its average."""
    if np.isfinite(ratio):
        gain = 1.0 / INNOVATION_SAMPLES
        slow[RATIO] += gain * (ratio - slow[RATIO])
        slow[RATIO_WEIGHT] += gain * (1.0 - slow[RATIO_WEIGHT])
        if slow[RATIO_WEIGHT] > WINDOW_FILLED:
            measures[INNOVATION] = slow[RATIO] / slow[RATIO_WEIGHT]
    return grade(measures, levels)


@compiled
def grade(measures: Array, levels: Integers) -> int:
    """Level of each measure, with hysteresis, into `levels` (5,); returns the highest."""
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


@compiled
def _bits(levels: Integers) -> int:
    """`Reason` bits of the measures that are above their threshold."""
    bits = 0
    for i in range(levels.shape[0]):
        if levels[i] > 0:
            bits |= 1 << i
    return bits
