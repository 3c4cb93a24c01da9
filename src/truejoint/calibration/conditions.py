"""Conditions of motion: those of a recording as a whole, and those that a loop sees as it runs.

A loop sees how fast the arm moves, and where each joint turned last: the innermost loop of its
hysteresis, which lies between its last two turning points until a larger swing wipes it out
(Preisach, Zeitschrift fuer Physik 94, 1935). What the training showed of both is learnt.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.schema import Bounds

if TYPE_CHECKING:
    from truejoint.recordings import Recording

SPEED_TIME: Final = 0.1  # [s], over which speed is taken: an encoder's counts make it noise else
_LEAST_ROWS: Final = 10  # with truth, for a slope
STEPS: Final = 50  # in the trained range of a joint
AVERAGED: Final = 75  # steps, to and fro, over which the rate of motion is averaged
CELLS: Final = 8  # of the trained range, by which turning points are told apart
_NOISE: Final = 4.0  # standard deviations of a position's noise by which one has moved at least
PLACE, END, VALLEY, PEAK, HEADING, TURNED, N_MOTION = range(7)
"""Rows of what is kept of each joint: its place at the arm's last step; the end of this swing, the
turning points before, its direction, and how often it turned."""
PACE, COUNT, SINCE, N_RATE = range(4)
"""What is kept of the arm: the time of a step, how many there were, and when the last one was."""
_Number = Annotated[float, Bounds(-1e15, 1e15)]


@dataclass(frozen=True)
class Condition:
    """How a joint moves in a recording, in SI units; NaN where that cannot be said.

    Positions are measured. The slope is that of the true position over the measured one.
    """

    joint: str
    speed: _Number = math.nan  # RMS
    range: _Number = math.nan
    middle: _Number = math.nan  # of the range
    effort: _Number = math.nan  # RMS
    slope: _Number = math.nan


def conditions_of(recording: "Recording", joints: Sequence[str]) -> tuple[Condition, ...]:
    """Conditions of a recording, for each of `joints`."""
    every = max(1, round(SPEED_TIME / float(np.median(np.diff(recording.t)))))
    conditions = []
    for joint in joints:
        q = recording.column(f"measured/{joint}")
        effort, truth = (
            recording.column(f"{name}/{joint}") if joint in recording.joints_of(name) else q[:0]
            for name in ("effort", "truth")
        )
        slope, low, high = math.nan, float(q.min()), float(q.max())
        x, y = (values[np.flatnonzero(np.isfinite(truth))] for values in (q, truth))
        if len(x) >= _LEAST_ROWS and np.ptp(x) > 0.0:
            slope = float(np.polyfit(x - x.mean(), y, 1)[0])
        speed = _rms(np.diff(q[::every]) / np.diff(recording.t[::every]))
        shape = high - low, 0.5 * (low + high)
        conditions.append(Condition(joint, speed, *shape, _rms(effort), slope))
    return tuple(conditions)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan


def learn_motion(
    times: Sequence[Array], positions: Sequence[Array], gap_limit: float, noise: Array
) -> dict[str, Any]:
    """Fields of a domain, of `positions` (n, n_joints) at `times` (n,) and their `noise`."""
    together = np.concatenate(positions)
    lower, upper = together.min(axis=0), together.max(axis=0)
    span = np.where(upper > lower, upper - lower, 1.0)
    stride = np.maximum(span / STEPS, np.minimum(_NOISE * noise, span / CELLS))
    pace, swings = np.array([np.inf, 0.0]), np.zeros((len(span), CELLS, CELLS))
    for t, rows in zip(times, positions, strict=True):
        learn_rows(t, rows, gap_limit, stride, lower, CELLS / span, pace, swings)
    wide = np.pad(swings, ((0, 0), (1, 1), (1, 1)))
    near = [wide[:, i : i + CELLS, k : k + CELLS] for i in range(3) for k in range(3)]
    return {
        "stride": stride, "swing_lower": lower, "swing_upper": lower + span,
        "pace_lower": min(pace), "pace_upper": pace[1],
        "swings": np.max(near, axis=0).reshape(len(span), -1),
    }  # fmt: skip


@compiled
def learn_rows(
    t: Array, rows: Array, gap_limit: float, stride: Array, lower: Array, cells: Array,
    pace: Array, swings: Array,
) -> None:  # fmt: skip
    """Enlarge the range `pace` (2,) [s] and the set `swings` (n_joints, CELLS, CELLS) by rows."""
    n_joints = rows.shape[1]
    measured, rate, motion = np.arange(n_joints), np.zeros(N_RATE), np.zeros((N_MOTION, n_joints))
    for i in range(t.shape[0]):
        fresh = i == 0 or not t[i] - t[i - 1] <= gap_limit
        follow_motion(fresh, t[i], rows[i], measured, stride, rate, motion)
        if rate[COUNT] >= AVERAGED:
            pace[0], pace[1] = min(pace[0], rate[PACE]), max(pace[1], rate[PACE])
        for j in range(n_joints):
            if motion[TURNED, j] > 0.0:  # one of the two may be where it started
                at = swing_cell(motion[VALLEY, j], motion[PEAK, j], lower[j], cells[j])
                swings[j, at // CELLS, at % CELLS] = 1.0


@compiled
def follow_motion(
    fresh: bool, t: float, sample: Array, measured: Integers, stride: Array, rate: Array,
    motion: Array,
) -> None:  # fmt: skip
    """Bring `rate` (N_RATE,) and `motion` (N_MOTION, n_joints) up to date, or start them anew.

    Positions are those of a `sample` that are `measured` (n_joints,). The arm goes a step when one
    of its joints does; its time is limited to what an average over `AVERAGED` of them could
    change by, so that a pause counts as one step.
    """
    moved = 0.0
    for j in range(measured.shape[0]):
        position = sample[measured[j]]
        if fresh:
            for row in range(N_MOTION):
                motion[row, j] = position if row <= PEAK else 0.0
        moved = max(moved, abs(position - motion[PLACE, j]) / stride[j])
        follow_swing(j, position, stride[j], motion)
    if fresh:
        rate[PACE], rate[COUNT], rate[SINCE] = 0.0, 0.0, t
    elif moved >= 1.0:
        now, most = (t - rate[SINCE]) / moved, 1.0 + moved / min(rate[COUNT] + 1.0, AVERAGED * 1.0)
        last = rate[PACE] if rate[PACE] > 0.0 else now
        if rate[COUNT] > 0.0:  # the arm stood before the first step, who knows how long
            rate[PACE] = min(max(now, last / most), last * most)
        rate[COUNT] += moved
        rate[SINCE] = t
        for j in range(measured.shape[0]):
            motion[PLACE, j] = sample[measured[j]]


@compiled
def follow_swing(j: int, position: float, stride: float, motion: Array) -> None:
    """Bring the last turning points of joint `j` up to date: it turned once it is a step back."""
    heading, gone = motion[HEADING, j], position - motion[END, j]
    if heading * gone > 0.0:
        motion[END, j] = position
    elif abs(gone) > stride:
        if heading != 0.0:
            motion[PEAK if heading > 0.0 else VALLEY, j] = motion[END, j]
            motion[TURNED, j] += 1.0
        motion[HEADING, j] = 1.0 if gone > 0.0 else -1.0
        motion[END, j] = position
    # Beyond a turning point nothing of it is left.
    motion[VALLEY, j] = min(motion[VALLEY, j], position)
    motion[PEAK, j] = max(motion[PEAK, j], position)


@compiled
def swing_cell(valley: float, peak: float, lower: float, cells: float) -> int:
    """Place of a pair of turning points among `CELLS` ** 2; what lies beyond counts as an end."""
    first = int(min(max((valley - lower) * cells, 0.0), CELLS - 1.0))
    return first * CELLS + int(min(max((peak - lower) * cells, 0.0), CELLS - 1.0))
