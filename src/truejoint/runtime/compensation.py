"""One step of the compensator: from where the joints are wanted to set-points of the motors."""

from __future__ import annotations

from math import isfinite, isnan, nan
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.layout import Layout

LAYOUT: Final = Layout()
N_JOINTS: Final = LAYOUT.integer("n_joints", "that are compensated")
STATUS: Final = LAYOUT.integer("status", "bits that the corrector gave for this sample")
DOUBTED: Final = LAYOUT.integer("doubted", "bits with which a sample is not believed")
KNOWS_LOST: Final = LAYOUT.integer("knows_lost", "whether a sample was believed")

LEAD: Final = LAYOUT.scalar("lead", "steps by which set-points are ahead of what is wanted")
GAIN: Final = LAYOUT.scalar("gain", "share of the remaining error that is added")
SHARE: Final = LAYOUT.scalar("share", "of the low-pass of what is lost, a step")
INTEGRAL: Final = LAYOUT.scalar("integral", "share of the remaining error made up for, a step")
SETTLE: Final = LAYOUT.scalar("settle", "share of the way that is gone a step, standing still")
DEAD_BAND: Final = LAYOUT.scalar("dead_band", "error let be where a joint stands still [rad or m]")

WANTED: Final = LAYOUT.array("wanted", "at the next step [rad or m]")
MEASURED: Final = LAYOUT.array("measured", "of this sample [rad or m]")
CORRECTION: Final = LAYOUT.array("correction", "true less measured, as the model says [rad or m]")
SETPOINT: Final = LAYOUT.array("setpoint", "put out [rad or m]")
LAST_WANTED: Final = LAYOUT.array("last_wanted", "one step before; NaN at first [rad or m]")
LOST: Final = LAYOUT.array("lost", "correction less expected, low-passed [rad or m]")
MADE_UP: Final = LAYOUT.array("made_up", "of the error that remained [rad or m]")
EXPECTED: Final = LAYOUT.array("expected", "of the correction, by feed-forward [rad or m]")
FORWARD: Final = LAYOUT.array("forward", "true less measured at the set-points [rad or m]")
LOWER: Final = LAYOUT.array("lower", "limit of the set-point [rad or m]")
UPPER: Final = LAYOUT.array("upper", "limit of the set-point [rad or m]")
STEP: Final = LAYOUT.array("step", "longest step of the set-point [rad or m]")
IS_LIMITED: Final = LAYOUT.integers("is_limited", "1 where a limit held the set-point back")
RESTS: Final = LAYOUT.integers("rests", "1 where a joint stands within the dead band")


@compiled
def begin(numbers: Integers, memory: Array) -> None:
    """Begin at rest from the set-points in the memory."""
    n = numbers[N_JOINTS]
    numbers[KNOWS_LOST] = 0
    for k in range(n):
        memory[numbers[LAST_WANTED] + k] = nan
        memory[numbers[LOST] + k] = 0.0
        memory[numbers[MADE_UP] + k] = 0.0
        numbers[numbers[IS_LIMITED] + k] = 0
        numbers[numbers[RESTS] + k] = 0


@compiled
def compensate(numbers: Integers, memory: Array) -> None:
    """Take a step: reads what is wanted, measured and corrected, and changes the set-points."""
    n = numbers[N_JOINTS]
    known = int(numbers[KNOWS_LOST])
    believed = is_believed(numbers, memory)
    if believed:
        numbers[KNOWS_LOST] = 1
    for k in range(n):
        wanted, last = memory[numbers[WANTED] + k], memory[numbers[LAST_WANTED] + k]
        before = wanted if isnan(last) else last
        goal = wanted if isfinite(wanted) else before
        if isfinite(goal):
            fed_back = feed_back(numbers, memory, k, known, before, goal) if believed else 0.0
            ahead = goal + memory[LEAD] * (goal - before) + fed_back
            go_on(numbers, memory, k, before, goal, ahead)


@compiled
def is_believed(numbers: Integers, memory: Array) -> bool:
    """Whether the corrector says where all joints are."""
    believed = bool((numbers[STATUS] & numbers[DOUBTED]) == 0)
    for k in range(numbers[N_JOINTS]):
        if not isfinite(memory[numbers[CORRECTION] + k]):
            believed = False
    return believed


@compiled
def feed_back(
    numbers: Integers, memory: Array, k: int, known: int, before: float, goal: float
) -> float:
    """Learn what joint `k` loses, and give the share of its error that is added at once."""
    correction, lost = memory[numbers[CORRECTION] + k], memory[numbers[LOST] + k]
    strange = correction - memory[numbers[EXPECTED] + k]
    missing = before - memory[numbers[MEASURED] + k] - correction
    is_near = abs(missing) < memory[DEAD_BAND]
    if known == 0:
        memory[numbers[LOST] + k] = strange
        if memory[INTEGRAL] > 0.0:  # the first set-point is that which is there
            memory[numbers[MADE_UP] + k] = memory[numbers[SETPOINT] + k] - before + correction
    else:
        memory[numbers[LOST] + k] = lost + memory[SHARE] * (strange - lost)
        if numbers[numbers[IS_LIMITED] + k] == 0 and not is_near:
            memory[numbers[MADE_UP] + k] += memory[INTEGRAL] * missing
    numbers[numbers[RESTS] + k] = 1 if goal == before and is_near else 0
    return float(memory[GAIN] * missing)


@compiled
def go_on(
    numbers: Integers, memory: Array, k: int, before: float, goal: float, ahead: float
) -> None:
    """Move the set-point of joint `k`, within its limits."""
    setpoint, longest = memory[numbers[SETPOINT] + k], memory[numbers[STEP] + k]
    lost = memory[numbers[LOST] + k] + memory[numbers[FORWARD] + k]
    asked = ahead + memory[numbers[MADE_UP] + k] - lost
    if numbers[KNOWS_LOST] == 0:
        asked = setpoint + goal - before
    elif goal == before:
        way = 0.0 if numbers[numbers[RESTS] + k] else memory[SETTLE] * (asked - setpoint)
        asked = setpoint + way
    else:
        numbers[numbers[RESTS] + k] = 0
    kept = min(max(asked, setpoint - longest), setpoint + longest)
    kept = min(max(kept, memory[numbers[LOWER] + k]), memory[numbers[UPPER] + k])
    numbers[numbers[IS_LIMITED] + k] = 1 if kept != asked else 0
    memory[numbers[SETPOINT] + k] = kept
    memory[numbers[LAST_WANTED] + k] = goal
