"""How an arm behaves while its calibration holds: efforts on the way, and errors over time.

Efforts show with no sensor at the joints that cables, friction or load changed: the part that keeps
its sign when the motion turns carries gravity and load, the part that does not is friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import compiled

STEPS_PER_RANGE: Final = 200  # of a joint's trained range, at which its effort is looked at
SETTLE_STEPS: Final = 4  # steps after a reversal until friction has built up
RANGE_MARGIN: Final = 0.1  # efforts are compared up to this share of a joint's range outside it
AVERAGED_TRAVEL: Final = 2.0
"""Ranges of a joint's travel each way over which its efforts are averaged: friction that varies
along the way averages out, and a load shows after the first of them."""

BEGINNINGS: Final = (0.05, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Times in motion [s] from the start of a recording of which the errors are known; in the first, a
joint has not moved yet."""
PAUSE: Final = 0.5
"""A joint that takes longer [s] for a step rests meanwhile."""

# Rows of a joint's travel: position and time of the last step, its direction, travel since the
# reversal and of the last step (in ranges); of its motion: position and time of the last step, time
# when it was last seen, and for how long it has been in motion.
ANCHOR, TIME, HEADING, RUN, MOVED = 0, 1, 2, 3, 4
AT, SINCE, SEEN, IN_MOTION = 0, 1, 2, 3
N_TRAVEL, N_MOTION = 5, 4


@dataclass(frozen=True, eq=False)
class EffortBaseline:
    """What was seen while the calibration held; made by `fit_effort_baseline`.

    Each of shape (n_joints,), but for `coef` and `beginning`.
    """

    lower: Array  # range of each measured position [rad or m]
    upper: Array
    monitored: Array  # 1 where efforts are known well enough to be compared, 0 elsewhere
    coef: Array  # (n_joints, n_terms), effort [its unit] over `effort_terms`
    scale: Array  # standard deviation of the effort about that
    # How far, in units of `scale`, the mean over both directions and half their difference may lie
    # from the baseline before it means something.
    shift_limit: Array
    friction_limit: Array
    residual: Array  # standard deviation of corrected positions about their mean error [rad or m]
    correlation: Array  # time over which such errors resemble each other [s]
    # (n, n_joints), standard deviation [rad or m] of the offset of the first `BEGINNINGS` in motion
    # about the mean error of the recording: the calibration does not know what was before them.
    beginning: Array

    @property
    def step(self) -> Array:
        """How far each joint (n_joints,) [rad or m] goes before it counts as having moved."""
        return (self.upper - self.lower) / STEPS_PER_RANGE

    def beginning_sd(self, in_motion: Array) -> Array:
        """Deviation (n_joints,) [rad or m] of the offset of a beginning with so much motion [s].

        Of each joint (n_joints,), as `time_in_motion` has it. Beyond the longest that was looked at
        it falls with the root of the time.
        """
        longest = np.maximum(in_motion / BEGINNINGS[-1], 1.0)
        pairs = zip(np.maximum(in_motion, BEGINNINGS[0]), self.beginning.T, strict=True)
        deviations = [np.interp(np.log(time), np.log(BEGINNINGS), values) for time, values in pairs]
        return np.asarray(np.array(deviations) / np.sqrt(longest), dtype=np.float64)


def count_effort_terms(n_joints: int) -> int:
    """Count the terms of `effort_terms`."""
    return 1 + n_joints + n_joints * (n_joints + 1) // 2 + 1 + n_joints + 1


@compiled
def effort_terms(position: Array, speed: float, lower: Array, upper: Array, out: Array) -> None:
    """Terms (n_terms,), into `out`, that a joint's effort is linear in.

    Gravity as a quadratic in all positions, Coulomb friction that varies with them, and viscous
    friction of the joint's own `speed` [ranges/s, not 0]; others (n_joints,) [rad or m].
    """
    n = position.shape[0]
    direction = 1.0 if speed > 0.0 else -1.0
    for i in range(n):
        scaled = (2.0 * position[i] - lower[i] - upper[i]) / (upper[i] - lower[i])
        out[1 + i] = scaled
        out[out.shape[0] - 1 - n + i] = direction * scaled
    k = 1 + n
    for i in range(n):
        for j in range(i, n):
            out[k] = out[1 + i] * out[1 + j]
            k += 1
    out[0] = 1.0
    out[k] = direction
    out[out.shape[0] - 1] = speed


@compiled
def travelled(
    j: int, t: float, position: Array, lower: Array, upper: Array, travel: Array
) -> float:
    """Speed [ranges/s] of joint `j` once it has moved one more step the same way, in range; else 0.

    Counting travel and not time makes it the same at any rate, and blind to standstill, where
    static friction may hold any effort. `travel` (5, n_joints), NaN in the first row to start with,
    is changed in place; `position`, `lower` and `upper` (n_joints,) [rad or m].
    """
    if not np.isfinite(travel[ANCHOR, j]):
        travel[ANCHOR, j] = position[j]
        travel[TIME, j] = t
    span = upper[j] - lower[j]
    moved = (position[j] - travel[ANCHOR, j]) / span
    elapsed = t - travel[TIME, j]
    if not abs(moved) >= 1.0 / STEPS_PER_RANGE or not elapsed > 0.0:
        return 0.0
    heading = 1.0 if moved > 0.0 else -1.0
    travel[RUN, j] = travel[RUN, j] + abs(moved) if heading == travel[HEADING, j] else 0.0
    travel[HEADING, j] = heading
    travel[ANCHOR, j] = position[j]
    travel[TIME, j] = t
    travel[MOVED, j] = abs(moved)
    if travel[RUN, j] < SETTLE_STEPS / STEPS_PER_RANGE:
        return 0.0
    for i in range(position.shape[0]):
        margin = RANGE_MARGIN * (upper[i] - lower[i])
        if not (lower[i] - margin <= position[i] <= upper[i] + margin):
            return 0.0
    speed: float = moved / elapsed
    return speed


@compiled
def go_on_in_motion(j: int, t: float, position: float, step: float, motion: Array) -> float:
    """Time [s] for which joint `j` has been in motion by `t` [s], where it is at `position`.

    A joint is in motion while it goes by a `step` [rad or m] within half a second, or from one
    sample to the next; else it rests, and friction holds what it held: its errors are one error.
    `motion` (4, n_joints) is changed in place: NaN in the first row and 0 in the last to start
    with. A position that is not known (NaN) changes nothing.
    """
    if not np.isfinite(position):
        return float(motion[IN_MOTION, j])
    if np.isnan(motion[AT, j]):
        motion[AT, j] = position
        motion[SINCE, j] = t
    elif abs(position - motion[AT, j]) >= step:
        longest = max(PAUSE, t - motion[SEEN, j])
        motion[IN_MOTION, j] += min(t - motion[SINCE, j], longest)
        motion[AT, j] = position
        motion[SINCE, j] = t
    motion[SEEN, j] = t
    return float(motion[IN_MOTION, j])


@compiled
def time_in_motion(t: Array, position: Array, step: Array) -> Array:
    """Time (n, n_joints) [s] for which each joint has been in motion: see `go_on_in_motion`.

    Of stamps (n,) [s], positions (n, n_joints) and steps (n_joints,) [rad or m].
    """
    times = np.empty(position.shape)
    motion = np.zeros((N_MOTION, position.shape[1]))
    motion[AT] = np.nan
    for i in range(t.shape[0]):
        for j in range(position.shape[1]):
            times[i, j] = go_on_in_motion(j, t[i], position[i, j], step[j], motion)
    return times


@compiled
def average_effort(
    deviation: float, speed: float, moved: float, j: int, mean: Array
) -> tuple[float, float]:
    """Take a deviation into joint `j`'s average each way; returns its shift and its friction's.

    `mean` (2, n_joints), 0 at first, is changed in place; row 1 is for positive `speed`.
    """
    side = 1 if speed > 0.0 else 0
    mean[side, j] += (1.0 - np.exp(-moved / AVERAGED_TRAVEL)) * (deviation - mean[side, j])
    return 0.5 * (mean[1, j] + mean[0, j]), 0.5 * (mean[1, j] - mean[0, j])


@compiled
def effort_steps(
    t: Array, position: Array, effort: Array, lower: Array, upper: Array, rows: Array
) -> int:
    """Collect the steps of all joints in a recording; returns how many there are.

    `rows` (n * n_joints, 4 + n_terms) receives joint, effort, speed, travel and terms of each, of
    `t` (n,), `position` and `effort` (n, n_joints), `lower` and `upper` (n_joints,).
    """
    n_joints = position.shape[1]
    travel = np.zeros((N_TRAVEL, n_joints))
    travel[ANCHOR] = np.nan
    count = 0
    for i in range(t.shape[0]):
        for j in range(n_joints):
            speed = travelled(j, t[i], position[i], lower, upper, travel)
            if speed == 0.0:
                continue
            rows[count, 0] = j
            rows[count, 1] = effort[i, j]
            rows[count, 2] = speed
            rows[count, 3] = travel[MOVED, j]
            effort_terms(position[i], speed, lower, upper, rows[count, 4:])
            count += 1
    return count


@compiled
def largest_shifts(deviation: Array, speed: Array, moved: Array) -> tuple[float, float]:
    """Largest mean and half difference of the directions' averages, over one joint's steps (n,)."""
    mean = np.zeros((2, 1))
    shift, friction = 0.0, 0.0
    for i in range(deviation.shape[0]):
        now = average_effort(deviation[i], speed[i], moved[i], 0, mean)
        shift, friction = max(shift, abs(now[0])), max(friction, abs(now[1]))
    return shift, friction
